"""Opening light controllers so that what can be reached goes dark, and what cannot is named."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

from lightopt.config import ControllerConfig
from lightopt.core.errors import HardwareError, LightoptError, error_text
from lightopt.rig.capture._wiring import Wiring
from lightopt.rig.devices import (
    LightController,
    LightSettings,
    LightsStillOnError,
    SerialLog,
    all_off,
    light_drivers,
    run_in_parallel,
)

NONE_OF_THE_RIG = "none that the rig has a name for"


@dataclass
class OpenedLights:
    """What came of opening the controllers.

    Attributes
    ----------
    controllers
        Those that answered, by name.
    problems
        Why others did not, or did not go dark, by name.
    burning
        Lights that may still burn.
    """

    controllers: dict[str, LightController] = field(default_factory=dict[str, LightController])
    problems: dict[str, LightoptError] = field(default_factory=dict[str, LightoptError])
    burning: list[str] = field(default_factory=list[str])

    def raised(self, *others: LightoptError) -> LightoptError:
        """The error for what failed, other devices included, with the lights that may still burn."""
        problems = [*self.problems.values(), *others]
        kind = HardwareError if any(isinstance(p, HardwareError) for p in problems) else type(problems[0])
        messages = [message for problem in problems for message in problem.messages]
        if not self.problems:
            return kind(*messages, "all lights are off")
        return kind(*messages, f"lights that may still burn: {', '.join(self.burning) or NONE_OF_THE_RIG}")


def open_lights(
    wiring: Wiring,
    names: Iterable[str],
    *,
    ports: Mapping[str, str],
    log: SerialLog | None,
    darken: bool,
    opened: Callable[[LightController], object],
) -> OpenedLights:
    """Open controllers side by side, each even if another fails, and darken each as it opens.

    Parameters
    ----------
    wiring
        The devices.
    names
        Which controllers.
    ports
        Ports of those that are simulated.
    log
        Of every byte.
    darken
        False for a mere look.
    opened
        Called with each that is open, before anything else is sent to it, from the thread that opened it.
    """
    done = run_in_parallel(
        {
            name: lambda name=name: _open_one(
                wiring, name, port=ports.get(name), log=log, darken=darken, opened=opened
            )
            for name in names
        }
    )
    result = OpenedLights()
    for name, (controller, problem) in done.items():
        if controller is not None:
            result.controllers[name] = controller
        if problem is not None:
            result.problems[name] = problem
            if isinstance(problem, LightsStillOnError):
                result.burning += lights_on(wiring, problem.channels)
            else:
                channels = range(1, wiring.hardware.controllers[name].channels + 1)
                result.burning += lights_on(wiring, {name: channels})
    return result


def _open_one(
    wiring: Wiring,
    name: str,
    *,
    port: str | None,
    log: SerialLog | None,
    darken: bool,
    opened: Callable[[LightController], object],
) -> tuple[LightController | None, LightoptError | None]:
    """The controller, if it can be opened, and what went wrong with it."""
    config = wiring.hardware.controllers[name]
    try:
        controller = open_controller(wiring, name, port=port or config.port, log=log)
    except LightoptError as error:
        return None, error
    except Exception as error:  # noqa: BLE001  (the other controllers must go dark, and what may burn be named)
        return None, _unexpected(name, error)
    opened(controller)
    if darken:
        try:
            all_off({name: controller})
        except LightsStillOnError as error:
            return controller, error
        except Exception as error:  # noqa: BLE001  (as above)
            return controller, _unexpected(name, error)
    return controller, None


def _unexpected(name: str, error: Exception) -> HardwareError:
    problem = HardwareError(f"controller {name}: {error_text(error)}")
    problem.__cause__ = error
    return problem


def open_controller(wiring: Wiring, name: str, *, port: str, log: SerialLog | None) -> LightController:
    """Open one controller; no light changes."""
    config: ControllerConfig = wiring.hardware.controllers[name]
    settings = LightSettings(
        name=name,
        port=port,
        baud=config.baud,
        channels=config.channels,
        top_level=config.top_level,
        dialect=config.dialect,
        template=None if config.template is None else config.template.model_dump(),
        timeout_s=config.timeout_s,
        max_levels={
            channel.channel: channel.max_level
            for channel in wiring.hardware.lights.values()
            if channel.controller == name and channel.max_level is not None
        },
    )
    return light_drivers()[config.driver](settings, log)


def lights_on(wiring: Wiring, channels: Mapping[str, Iterable[int]]) -> list[str]:
    """The rig's lights on some channels of controllers, by name."""
    there = {(name, number) for name, numbers in channels.items() for number in numbers}
    return [
        light
        for light, channel in wiring.hardware.lights.items()
        if (channel.controller, channel.channel) in there
    ]
