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
