"""A Dask cluster of this machine as a user starts it, whose workers are killed while they compute."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import time
from pathlib import Path

from lightopt.core.run_context import RunContext


class Cluster:
    """``dask scheduler`` and ``dask worker``, as a user starts them."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "scheduler.json"
        self._folder = folder
        self._processes = [
            self._start("scheduler", "--host", "127.0.0.1", "--port", "0", "--dashboard-address", "127.0.0.1:0")
        ]
        self.workers: list[subprocess.Popen[bytes]] = []
        self.killed = 0
        for _ in range(2):
            self.add_worker()
        # the scheduler makes the file, and then writes it
        while not (self.file.is_file() and self.file.read_text(encoding="utf-8").endswith("}")):
            assert self._processes[0].poll() is None
            time.sleep(0.05)

    @property
    def address(self) -> str:
        return json.loads(self.file.read_text(encoding="utf-8"))["address"]

    def add_worker(self) -> None:
        own = "--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(self._folder)
        self.workers.append(self._start("worker", *own))

    def kill(self, number: int) -> None:
        """Kill a worker without warning, and start another."""
        worker = self.workers.pop(number)
        worker.kill()
        worker.wait()
        self.killed += 1
        self.add_worker()

    def close(self) -> None:
        for process in (*self.workers, *self._processes):
            process.kill()
            process.wait()

    def _start(self, *words: str) -> subprocess.Popen[bytes]:
        environment = {**os.environ, "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "50"}
        command = [sys.executable, "-m", "dask", *words, "--scheduler-file", str(self.file)]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment)


def kill_some(cluster: Cluster, times: int, seed: int) -> RunContext:
    """A context in which workers are killed as tasks are completed, while they compute."""
    draw, left = random.Random(seed), [times]

    def killing(_stage: str, share: float) -> None:
        if left[0] and share < 1.0:
            left[0] -= 1
            time.sleep(draw.uniform(0.0, 0.3))
            cluster.kill(draw.randrange(2))

    return RunContext(progress=killing)
