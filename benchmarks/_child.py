"""``python -m benchmarks._child COMMAND…``: run a command, print its seconds and its peak memory as JSON.

A process of its own, and a small one: as the system counts, a child's peak memory is never below that of the process
that started it.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time


def main() -> None:
    """Run the command of ``sys.argv``; its standard output is dropped."""
    start = time.perf_counter()
    child = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
    peak = None
    if hasattr(os, "wait4"):
        _, status, usage = os.wait4(child.pid, 0)
        code = os.waitstatus_to_exitcode(status)
        peak = usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    else:
        code = child.wait()
    print(json.dumps({"seconds": time.perf_counter() - start, "peak_bytes": peak, "status": code}))


if __name__ == "__main__":
    main()
