"""``python -m lightopt.virtualbench SPEC``: serve the devices of a JSON description until standard input ends."""

from __future__ import annotations

import json
import sys

from lightopt.virtualbench._host import run

if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit('usage: python -m lightopt.virtualbench \'{"devices": {"lights": {"kind": "ccs"}}}\'')
    try:
        run(json.loads(sys.argv[1]))
    except (ValueError, KeyError) as error:
        sys.exit(f"{type(error).__name__}: {error}")
    except KeyboardInterrupt:
        sys.exit(130)
