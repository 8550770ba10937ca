"""Switch all lights off, and open light controllers so that what can be reached goes dark and the rest is named."""

from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from lightopt.config import LightsOnly
from lightopt.core.errors import HardwareError, InputError, LightoptError, error_text
from lightopt.core.run_context import RunContext
from lightopt.rig import devices
from lightopt.rig.capture._signals import EndSignals
from lightopt.rig.capture._wiring import VIRTUAL, VIRTUAL_EXPOSURE_US, Wiring, simulated_controllers, wiring_of
from lightopt.rig.simulated import BenchProcess

NONE_OF_THE_RIG = "none that the rig names"


@dataclass
class OpenedLights:
    """Controllers that answered, by name, and why others did not, or did not go dark."""

    controllers: dict[str, devices.LightController] = field(default_factory=dict[str, devices.LightController])
    problems: dict[str, LightoptError] = field(default_factory=dict[str, LightoptError])
    may_be_on: list[str] = field(default_factory=list[str])  # lights that may still be on

    def error(self, *others: LightoptError) -> LightoptError:
        """The error for what failed, other devices included, with the lights that may still be on."""
        problems = [*self.problems.values(), *others]
        kind = HardwareError if any(isinstance(p, HardwareError) for p in problems) else type(problems[0])
        messages = [message for problem in problems for message in problem.messages]
        if not self.problems:
            return kind(*messages, "all lights are off")
        return kind(*messages, f"lights that may still be on: {', '.join(self.may_be_on) or NONE_OF_THE_RIG}")


def open_lights(
    wiring: Wiring,
    names: Iterable[str],
    *,
    ports: Mapping[str, str],  # of those that are simulated
    log: devices.SerialLog | None,
    darken: bool,  # False to query the controllers only
    opened: Callable[[devices.LightController], object],  # called before anything is sent, from a thread of each
) -> OpenedLights:
    """Open controllers in parallel, each even if another fails, and darken each as it opens."""

    def open_one(name: str) -> tuple[devices.LightController | None, LightoptError | None]:
        port = ports.get(name) or wiring.hardware.controllers[name].port or ""
        controller: devices.LightController | None = None
        try:
            controller = open_controller(wiring, name, port=port, log=log)
            opened(controller)
            if darken:
                devices.all_off({name: controller})
        except LightoptError as error:
            return controller, error
        except Exception as error:  # noqa: BLE001  (the others must go dark, and what may be on be named)
            problem = HardwareError(f"controller {name}: {error_text(error)}")
            problem.__cause__ = error
            return controller, problem
        return controller, None

    result = OpenedLights()
    for name, (controller, problem) in devices.run_in_parallel({n: partial(open_one, n) for n in names}).items():
        if controller is not None:
            result.controllers[name] = controller
        if problem is not None:
            result.problems[name] = problem
            every = {name: range(1, wiring.hardware.controllers[name].channels + 1)}
            found = problem.channels if isinstance(problem, devices.LightsStillOnError) else every
            result.may_be_on += lights_on(wiring, found)
    return result


def open_controller(wiring: Wiring, name: str, *, port: str, log: devices.SerialLog | None) -> devices.LightController:
    config = wiring.hardware.controllers[name]
    settings = devices.LightSettings(
        name=name,
        port=port,
        **config.model_dump(exclude={"driver", "port", "picture"}),
        picture=config.picture,
        pictures=wiring.pictures(name),
        folder=wiring.folder,
        max_levels={
            channel.channel: channel.max_level
            for channel in wiring.hardware.lights.values()
            if channel.controller == name and channel.max_level is not None
        },
    )
    return devices.LIGHT_DRIVERS[config.driver](settings, log)


def lights_on(wiring: Wiring, channels: Mapping[str, Iterable[int]]) -> list[str]:
    wanted = {(name, number) for name, numbers in channels.items() for number in numbers}
    return [light for light, plug in wiring.hardware.lights.items() if (plug.controller, plug.channel) in wanted]


class SwitchedOff(NamedTuple):
    """Controllers all of whose channels were darkened, and those of them that cannot be read back."""

    controllers: tuple[str, ...]
    unverified: tuple[str, ...]


def switch_off(lights: LightsOnly, *, serial_log: Path | None = None, run: RunContext | None = None) -> SwitchedOff:
    """Darken every channel of every controller, no controller waiting for another; stage and camera are left alone.

    `lights` are the rig's, as far as its file can be read. `serial_log` gets every byte on the wires, `run` warnings
    of irregularities on the wires as they happen, and if that file ends early.

    Raises HardwareError: Once all were tried, with what failed, the controllers that are dark and the lights that may
        still be on.
    Raises InputError: The same, where nothing failed but controllers of the file cannot be read.
    """
    run = run or RunContext()
    wiring = _wiring(lights)
    names = wiring.hardware.controllers
    problems: dict[str, LightoptError] = {}
    unverified: list[str] = []
    may_be_on: list[str] = []
    with ExitStack() as stack:
        signals = stack.enter_context(EndSignals())
        stack.enter_context(signals.shielded())  # Ctrl-C waits until every channel was tried
        log = devices.SerialLog(serial_log, warn=run.warn)
        stack.callback(log.close)
        ports: dict[str, str] = {}
        for virtual in (False, True):  # what is real does not wait for what is not
            group = [name for name in names if (names[name].port == VIRTUAL) is virtual]
            if virtual and group:
                ports.update(stack.enter_context(BenchProcess(simulated_controllers(wiring))).ports)
            done = open_lights(
                wiring, group, ports=ports, log=log, darken=True, opened=lambda c: stack.callback(c.close)
            )
            problems |= done.problems
            may_be_on += done.may_be_on
            unverified += [name for name, controller in done.controllers.items() if _cannot_read_back(controller)]
    dark = SwitchedOff(tuple(name for name in names if name not in problems), tuple(unverified))
    if problems or lights.unreadable or lights.lights_unknown:
        messages = [message for problem in problems.values() for message in problem.messages]
        if lights.unreadable:
            unread = f"because of errors in the file: controller {', '.join(lights.unreadable)}"
            messages.append(f"not switched off, {unread}; correct them and repeat, or switch it off by hand")
        may_be_on += [name for name in lights.lights_unknown if name not in may_be_on]
        kind = HardwareError if problems else InputError
        raise kind(
            *messages,
            f"controllers switched off: {', '.join(dark.controllers) or 'none'}",
            f"lights that may still be on: {', '.join(may_be_on) or NONE_OF_THE_RIG}",
        )
    if signals.pending is not None:
        raise KeyboardInterrupt(signals.pending)
    return dark


def _wiring(lights: LightsOnly) -> Wiring:
    if lights.rig is not None:
        wiring = wiring_of(lights.rig)
        return replace(wiring, hardware=wiring.hardware.model_copy(update={"stage": None}))
    assert lights.hardware is not None
    return Wiring(lights.hardware, given=True, exposure_us=VIRTUAL_EXPOSURE_US)


def _cannot_read_back(controller: devices.LightController) -> bool:
    """Whether levels cannot be read back; where reading fails, darkening failed before and was reported."""
    try:
        return controller.read_level(1) is None
    except Exception:  # noqa: BLE001  (what is dark and what is not must be reported)
        return False
