"""``python -m lightopt.rig.simulated SPEC``: serve the devices of a JSON description until standard input ends."""

import json
import sys

from lightopt.rig.simulated._host import run

WRONG = 2  # exit status where the description is at fault

if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit('usage: python -m lightopt.rig.simulated \'{"devices": {"lights": {"kind": "ccs"}}}\'')
    try:
        run(json.loads(sys.argv[1]))
    except KeyError as error:
        print(f"the description lacks {error}", file=sys.stderr)  # noqa: T201
        sys.exit(WRONG)
    except ValueError as error:
        print(error, file=sys.stderr)  # noqa: T201
        sys.exit(WRONG)
    except KeyboardInterrupt:
        sys.exit(130)
