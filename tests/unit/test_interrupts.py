"""Ctrl-C where compiled code calls Python, which would swallow it or make another error of it: held back, not lost."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

SCRIPT = """
import signal, sys, time
from lightopt.{module} import {name}

{install}

# a finaliser as llvmlite's: what is raised in it is swallowed, and its lock stays taken
module = {{"__name__": "{inside}", "signal": signal, "steps": []}}
exec('''
class Owned:
    def __del__(self):
        steps.append("lock taken")
        signal.raise_signal(signal.SIGINT)
        steps.append("lock released")
''', module)
try:
    owned = module["Owned"]()
    del owned
    {wait}
    end = "lost"
except KeyboardInterrupt:
    # on a busy machine it may come before the next line
    end = "interrupted"
print(*module["steps"], sep=", ")
print(end)
"""

HANDLERS = {
    "command line": ("core.interrupts", "interrupt", "signal.signal(signal.SIGINT, interrupt)"),
    "capture": ("rig.capture._signals", "EndSignals", "EndSignals().install()"),
}


@pytest.mark.slow
@pytest.mark.parametrize("inside", ["llvmlite.binding.ffi", "numba.core.serialize"])
@pytest.mark.parametrize("handler", HANDLERS)
@pytest.mark.parametrize(
    "wait",
    [
        "for _ in range(6000): time.sleep(0.01)",
        pytest.param(
            "import threading; threading.Event().wait(60)",
            marks=pytest.mark.skipif(
                not hasattr(signal, "pthread_kill"), reason="Windows cannot wake a thread that waits for a lock"
            ),
        ),
    ],
    ids=["working", "waiting"],
)
def test_raised_after_the_lock_was_released(handler, wait, inside):
    module, name, install = HANDLERS[handler]
    script = SCRIPT.format(module=module, name=name, install=install, wait=wait, inside=inside)
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=300)
    assert (ran.stdout.splitlines(), ran.stderr) == (["lock taken, lock released", "interrupted"], "")


def test_pythons_own_handler_would_lose_it():
    script = SCRIPT.format(
        module="core.interrupts", name="interrupt", install="", wait="time.sleep(0.1)", inside="llvmlite"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=300)
    assert ran.stdout.splitlines() == ["lock taken", "lost"]
    assert "ignored" in ran.stderr


HELD_BACK = """
import signal, threading
from lightopt.core.interrupts import held_back, interrupt

signal.signal(signal.SIGINT, interrupt)
steps = []
try:
    with held_back():
        signal.raise_signal(signal.SIGINT)
        steps.append("started")
        # as Dask starts its workers
        import multiprocessing
        context = multiprocessing.get_context("spawn")
        pipe, other = context.Pipe()
        def start():
            child = context.Process(target=other.send, args=("a child",))
            child.start()
            from pathlib import Path
            lines = Path(f"/proc/{child.pid}/status").read_text().splitlines()
            blocked = int(next(line for line in lines if "SigBlk" in line).split()[1], 16)
            steps.append(bool(blocked & 1 << signal.SIGINT - 1))
            child.join()
        thread = threading.Thread(target=start)
        thread.start()
        thread.join()
    steps.append("not reached")
except KeyboardInterrupt:
    steps.append("interrupted")
print(*steps)
"""


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads what a process blocks from /proc")
def test_an_interrupt_waits_for_the_end_of_a_start_and_does_not_reach_what_was_started():
    ran = subprocess.run([sys.executable, "-c", HELD_BACK], capture_output=True, text=True, timeout=300)
    assert (ran.stdout.split(), ran.stderr) == (["started", "True", "interrupted"], "")
