"""``python -m lightopt.rig.simulated SPEC``: serve the devices of a JSON description until standard input ends."""

import json
import sys

from lightopt.rig.simulated._bench_process import WRONG
from lightopt.rig.simulated._host import run

if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit('usage: python -m lightopt.rig.simulated \'{"devices": {"lights": {"kind": "ccs"}}}\'')
    try:
        run(json.loads(sys.argv[1]))
    except (KeyError, ValueError) as error:
        print(f"the description lacks {error}" if isinstance(error, KeyError) else error, file=sys.stderr)  # noqa: T201
        sys.exit(WRONG)
    except KeyboardInterrupt:
        sys.exit(130)
