"""All lights off, whatever else of the rig is out of order."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from lightopt.capture._open_lights import NONE_OF_THE_RIG, open_lights
from lightopt.capture._signals import EndSignals
from lightopt.capture._virtual import start_bench
from lightopt.capture._wiring import VIRTUAL, Wiring
from lightopt.config import RigConfig
from lightopt.errors import HardwareError, LightoptError
from lightopt.hardware import LightController, SerialLog

__all__ = ["switch_off"]


def switch_off(
    rig: RigConfig,
    wiring: Wiring,
    *,
    serial_log: Path | None = None,
    warn: Callable[[str], None] | None = None,
) -> tuple[str, ...]:
    """Darken every channel of every controller, no controller waiting for another; stage and camera are left alone.

    Parameters
    ----------
    rig, wiring
        The rig and its devices.
    serial_log
        File that gets every byte on the wires.
    warn
        Called with what is out of the ordinary on the wires, as it happens, and if that file ends early.

    Returns
    -------
    tuple of str
        Controllers that can only be told, because they cannot be read back.

    Raises
    ------
    HardwareError
        Once all were tried, with what failed and the lights that may still burn.
    """
    names = wiring.hardware.controllers
    real = [name for name in names if names[name].port != VIRTUAL]
    virtual = [name for name in names if names[name].port == VIRTUAL]
    signals = EndSignals()
    signals.install()
    with ExitStack() as stack:
        stack.callback(signals.restore)
        stack.enter_context(signals.shielded())  # Ctrl-C waits until every channel was tried
        log = SerialLog(serial_log, warn=warn)
        stack.callback(log.close)
        ports: dict[str, str] = {}
        problems: list[LightoptError] = []
        told: list[str] = []
        burning: list[str] = []
        for group in (real, virtual):  # what is real does not wait for what is not
            if group is virtual and virtual:
                ports.update(stack.enter_context(start_bench(rig, wiring)).ports)
            done = open_lights(
                wiring, group, ports=ports, log=log, darken=True, opened=lambda c: stack.callback(c.close)
            )
            problems += done.problems.values()
            burning += done.burning
            told += [name for name, controller in done.controllers.items() if _only_told(controller)]
        if problems:
            raise HardwareError(
                *(message for problem in problems for message in problem.messages),
                f"lights that may still burn: {', '.join(burning) or NONE_OF_THE_RIG}",
            )
    if signals.pending is not None:
        raise KeyboardInterrupt(signals.pending)
    return tuple(told)


def _only_told(controller: LightController) -> bool:
    """Whether it cannot be read back; where reading fails, darkening failed before, which is told."""
    try:
        return controller.read_level(1) is None
    except LightoptError:
        return False
