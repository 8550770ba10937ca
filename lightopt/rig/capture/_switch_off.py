"""All lights off, whatever else of the rig or its file is out of order."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from lightopt.config import LightsOnly
from lightopt.core.errors import HardwareError, InputError, LightoptError
from lightopt.rig.capture._open_lights import NONE_OF_THE_RIG, open_lights
from lightopt.rig.capture._signals import EndSignals
from lightopt.rig.capture._simulated_rig import start_lights
from lightopt.rig.capture._wiring import VIRTUAL, VIRTUAL_EXPOSURE_US, Wiring, wiring_of
from lightopt.rig.devices import LightController, SerialLog


@dataclass(frozen=True)
class SwitchedOff:
    """Controllers all of whose channels were darkened.

    Attributes
    ----------
    controllers
        By name.
    told
        Those of them that can only be told, because they cannot be read back.
    """

    controllers: tuple[str, ...] = ()
    told: tuple[str, ...] = ()


def switch_off(
    lights: LightsOnly,
    *,
    serial_log: Path | None = None,
    warn: Callable[[str], None] | None = None,
) -> SwitchedOff:
    """Darken every channel of every controller, no controller waiting for another; stage and camera are left alone.

    Parameters
    ----------
    lights
        The rig's lights, as far as its file can be read.
    serial_log
        File that gets every byte on the wires.
    warn
        Called with what is out of the ordinary on the wires, as it happens, and if that file ends early.

    Raises
    ------
    HardwareError
        Once all were tried, with what failed, the controllers that are dark and the lights that may still burn.
    InputError
        The same, where nothing failed but controllers of the file cannot be read.
    """
    wiring = _wiring(lights)
    names = wiring.hardware.controllers
    real = [name for name in names if names[name].port != VIRTUAL]
    virtual = [name for name in names if names[name].port == VIRTUAL]
    signals = EndSignals()
    signals.install()
    problems: dict[str, LightoptError] = {}
    told: list[str] = []
    burning: list[str] = []
    with ExitStack() as stack:
        stack.callback(signals.restore)
        stack.enter_context(signals.shielded())  # Ctrl-C waits until every channel was tried
        log = SerialLog(serial_log, warn=warn)
        stack.callback(log.close)
        ports: dict[str, str] = {}
        for group in (real, virtual):  # what is real does not wait for what is not
            if group is virtual and virtual:
                ports.update(stack.enter_context(start_lights(wiring)).ports)
            done = open_lights(
                wiring, group, ports=ports, log=log, darken=True, opened=lambda c: stack.callback(c.close)
            )
            problems |= done.problems
            burning += done.burning
            told += [name for name, controller in done.controllers.items() if _only_told(controller)]
    dark = SwitchedOff(tuple(name for name in names if name not in problems), tuple(told))
    if problems or lights.unreadable or lights.lights_unknown:
        unknown = [name for name in lights.lights_unknown if name not in burning]
        raise _failed(lights, problems.values(), dark, [*burning, *unknown])
    if signals.pending is not None:
        raise KeyboardInterrupt(signals.pending)
    return dark


def _wiring(lights: LightsOnly) -> Wiring:
    if lights.rig is not None:
        wiring = wiring_of(lights.rig)
        return replace(wiring, hardware=wiring.hardware.model_copy(update={"stage": None}))
    assert lights.hardware is not None
    return Wiring(lights.hardware, given=True, exposure_us=VIRTUAL_EXPOSURE_US)


def _failed(
    lights: LightsOnly, problems: Collection[LightoptError], dark: SwitchedOff, burning: Iterable[str]
) -> LightoptError:
    """What failed, what is dark and what may burn."""
    messages = [message for problem in problems for message in problem.messages]
    if lights.unreadable:
        messages.append(
            f"not switched off, because the file is wrong there: controller {', '.join(lights.unreadable)}; mend "
            "it and repeat, or switch it off by hand"
        )
    kind = HardwareError if problems else InputError
    return kind(
        *messages,
        f"controllers that went dark: {', '.join(dark.controllers) or 'none'}",
        f"lights that may still burn: {', '.join(burning) or NONE_OF_THE_RIG}",
    )


def _only_told(controller: LightController) -> bool:
    """Whether it cannot be read back; where reading fails, darkening failed before, which is told."""
    try:
        return controller.read_level(1) is None
    except Exception:  # noqa: BLE001  (what is dark and what is not must be said)
        return False
