"""The opened devices of a rig, safe on every way out."""

import atexit
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from lightopt.core.errors import HardwareError, InputError, LightoptError, error_text
from lightopt.core.transforms import Posture
from lightopt.rig import devices
from lightopt.rig.capture._lights_off import NONE_OF_THE_RIG, lights_on
from lightopt.rig.capture._signals import EndSignals
from lightopt.rig.capture._wiring import VIRTUAL, Wiring


class Devices:
    """Lights, stage and camera of a rig, opened.

    Entering switches every channel off, because a previous run may have left lights on. On every way out, whatever the
    reason, every channel is switched off, each tried even if another fails; a stage that may move is stopped; then all
    is closed. Signals that end a program wait until that is done.
    """

    def __init__(
        self,
        *,
        wiring: Wiring,
        controllers: Mapping[str, devices.LightController],
        stage: devices.Stage | None = None,
        camera: devices.Camera | None = None,
        events: Callable[[], Sequence[devices.Event]] = tuple,  # irregularities on the links so far
        closing: Sequence[Callable[[], None]] = (),  # called last, in order: the links' log, the virtual bench
        signals: EndSignals | None = None,  # already installed where devices were opened under their protection
        touch_lights: bool = True,  # False to query the devices only: lights that are on stay on
        dark: bool = False,  # whether every channel has been switched off since it was opened
    ) -> None:
        self.wiring = wiring
        self.controllers = dict(controllers)
        self.stage = stage
        self._camera = camera
        self.events = events
        self.step = "switching all lights off"
        self._closing = tuple(closing)
        self._signals = signals
        self._stage_may_move = False
        self._homed = False
        self._watchdog = LightWatchdog(self._darken)
        self._lit: set[str] = set()
        self._touch_lights = touch_lights
        self._dark = dark
        self._left = False

    @property
    def camera(self) -> devices.Camera:
        assert self._camera is not None
        return self._camera

    @property
    def retries(self) -> int:
        return sum(event.retry for event in self.events())

    def __enter__(self) -> "Devices":
        self._signals = self._signals or EndSignals().install()
        self._signals.hold_in(Devices.__exit__.__code__)
        atexit.register(self._last_resort)
        try:
            if self._touch_lights and not self._dark and (failures := self.all_off()):
                raise HardwareError(*failures)
        except BaseException as error:
            self.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        assert self._signals is not None
        try:
            with self._signals.shielded():
                lit, stage = self._make_safe(failed=error is not None)
                unclosed = self._close()
                self._left = True
        finally:
            atexit.unregister(self._last_resort)
            self._signals.restore()
        if isinstance(error, HardwareError) or (error is not None and lit):
            raise self._failure(error, lit, stage, unclosed) from error
        if error is None and lit:
            raise HardwareError(f"while switching all lights off at the end: {lit[0]}", *lit[1:], *unclosed)
        if error is None and unclosed:
            raise HardwareError(*unclosed, *(["all lights are off"] if self._touch_lights else []))
        if error is None and self._signals.pending is not None:
            raise KeyboardInterrupt(self._signals.pending)

    def light_on(self, name: str, level: int | None = None) -> int | None:
        """Light a panel, at its level unless another is given; returns the level read back, None where impossible.

        From here on the channel is on for its `max_on_s` at most, whatever hangs: see :meth:`check_watchdog`.
        Raises InputError: The level is above the channel's `max_level`; nothing was sent.
        Raises HardwareError: The controller does not obey.
        """
        channel = self.wiring.light(name)
        controller = self.controllers[channel.controller]
        requested = channel.level if level is None else level
        if channel.max_level is not None and requested > channel.max_level:
            raise InputError(f"{name}: level {requested} is above its max_level {channel.max_level}; nothing was sent")
        if channel.max_on_s is not None:
            self._watchdog.start(name, channel.max_on_s)
        self._lit.add(name)
        held = controller.set_level(channel.channel, requested)
        if channel.max_on_s is not None and self._watchdog.remaining_s(name) is None:
            self._darken(name)  # its time was up before the level was sent: nothing watches it now
            self.check_watchdog(name)
        return held

    def light_off(self, image: str) -> None:
        """Darken the lights of an image; HardwareError when the watchdog had darkened one after its `max_on_s`."""
        for name in self.wiring.levels(image):
            self._darken(name)
            self._lit.discard(name)
            self._watchdog.stop(name)
        self.check_watchdog(image)

    def remaining_on_s(self, image: str) -> float | None:
        """How long all lights of an image may stay on [s]; None where nothing limits it."""
        left = [self._watchdog.remaining_s(name) for name in self.wiring.levels(image)]
        return min((s for s in left if s is not None), default=None)

    def check_watchdog(self, image: str) -> None:
        """Raise a :class:`HardwareError` when the watchdog darkened a light that had been lit for its `max_on_s`."""
        if problems := [p for name in self.wiring.levels(image) if (p := self._watchdog.pop_problem(name))]:
            raise HardwareError(*problems)

    def grab(self, exposure_us: float, light: str | None) -> devices.Frame:
        """Take a frame at the exposure time that the camera holds; waits no longer than the light may stay on."""
        limit_s = devices.frame_limit_s(exposure_us, self.wiring.hardware.timing.frame_timeout_s)
        left_s = None if light is None else self.remaining_on_s(light)
        frame = self.camera.grab(timeout_s=limit_s if left_s is None else max(0.0, min(limit_s, left_s)))
        if light is not None:
            self.check_watchdog(light)
        return frame

    def _darken(self, name: str) -> None:
        channel = self.wiring.light(name)
        self.controllers[channel.controller].set_level(channel.channel, 0)

    def all_off(self) -> list[str]:
        """Switch every channel off, lit ones first, each even if another fails; returns failures."""
        lit: dict[str, list[int]] = {}
        for channel in map(self.wiring.light, tuple(self._lit)):
            lit.setdefault(channel.controller, []).append(channel.channel)
        try:
            devices.all_off(self.controllers, lit=lit)
        except devices.LightsStillOnError as error:
            lights = lights_on(self.wiring, error.channels)
            return [*error.messages, f"lights that may still be on: {', '.join(lights) or NONE_OF_THE_RIG}"]
        except Exception as error:  # noqa: BLE001  (the stage must be stopped and all be closed, whatever this is)
            lights = sorted(self.wiring.hardware.lights)
            return [error_text(error), f"lights that may still be on: {', '.join(lights)}"]
        self._lit.clear()
        return []

    def check_referenced(self) -> None:
        """Refuse (HardwareError) a real stage that may not have been homed since power-up; moves nothing."""
        config = self.wiring.hardware.stage
        if self.stage is None or config is None or config.port == VIRTUAL:
            return
        referenced = self.stage.state().referenced
        how = "so it was not moved; home it (option 'home' of this command, or lightopt bench home RIG)"
        if referenced is False:
            raise HardwareError(f"the stage has no reference position, {how}")
        if referenced is None and not config.assume_referenced:
            raise HardwareError(
                f"a stage with driver {config.driver} cannot report whether it was homed since power-up, {how}, or "
                "write assume_referenced: true under hardware.stage if it is always homed by hand after power-up"
            )

    def home(self) -> None:
        assert self.stage is not None
        with self._moving():
            self.stage.home()
        self._homed = True

    def move_to(self, posture: Posture) -> devices.StageState:
        assert self.stage is not None
        if not self._homed:
            self.check_referenced()
        with self._moving():
            return self.stage.move_to(posture)

    @contextmanager
    def _moving(self) -> Generator[None]:
        """Record that the stage may move; a driver that fails has stopped it."""
        self._stage_may_move = True
        try:
            yield
        except LightoptError:
            self._stage_may_move = False
            raise
        self._stage_may_move = False

    def identities(self) -> dict[str, Any]:
        others = {"stage": self.stage, "camera": self._camera}
        return {
            "lights": {name: device.identify() for name, device in self.controllers.items()},
            **{name: device and device.identify() for name, device in others.items()},
        }

    def _make_safe(self, *, failed: bool) -> tuple[list[str], str | None]:
        """Lights first, then the stage; returns failures of the lights and the state of the stage."""
        lit = self.all_off() if self._touch_lights else []
        self._watchdog.stop_all()
        if self.stage is None or not failed or not self._stage_may_move:
            return lit, None
        try:
            self.stage.stop()
            stopped = "the stage was stopped"
        except Exception as error:  # noqa: BLE001  (whatever fails here, the devices must be closed)
            return lit, f"the stage MAY STILL MOVE, stopping it failed: {error_text(error)}"
        try:
            state = self.stage.state()
        except Exception as error:  # noqa: BLE001  (as above)
            return lit, f"{stopped}; its position is unknown: {error_text(error)}"
        alarm = f", alarm: {state.alarm}" if state.alarm else ""
        return lit, f"{stopped} and is at {state.posture}{alarm}"

    def _last_resort(self) -> None:
        """At the end of the program, if it ended without leaving these devices."""
        if self._touch_lights and not self._left:
            self.all_off()

    def _close(self) -> list[str]:
        """Close all, each even if another fails; returns messages about what failed."""
        opened = (self._camera, self.stage, *self.controllers.values())
        problems: list[str] = []
        for close in (*(device.close for device in opened if device is not None), *self._closing):
            try:
                close()
            except Exception as error:  # noqa: BLE001, PERF203  (whatever fails here, the rest must be closed, too)
                problems.append(f"closing a device failed: {error_text(error)}")
        return problems

    def _failure(self, error: BaseException, lit: list[str], stage: str | None, unclosed: list[str]) -> HardwareError:
        messages = error.messages if isinstance(error, LightoptError) else ()
        cause = messages or (f"ended by {error_text(error)}",)
        # a failure of all_off at the start and again at the end is reported once
        lights = [line for line in lit if line not in cause]
        if self._touch_lights and not lit:
            lights = ["all lights are off"]
        states = [*lights, *([stage] if stage else []), *unclosed]
        return HardwareError(f"while {self.step}: {cause[0]}", *cause[1:], *states)


_RETRY_S = 0.5  # a light that did not go dark is tried again after


class LightWatchdog:
    """Darkens lights that have been on for their `max_on_s`, each from a thread of its own.

    A light goes dark even if a camera hangs, a disk is slow or nobody is there. What was being done then fails at its
    next step, because its images would be wrong. If switching off fails, it is tried again, and no light waits for
    another whose controller hangs. `darken` switches a light off; a command under way on its link is broken off for it.
    """

    def __init__(self, darken: Callable[[str], None]) -> None:
        self._darken = darken
        self._lock = threading.Lock()
        # until when [s, monotonic] a light may be on, and what ends the thread that watches it
        self._periods: dict[str, tuple[float, threading.Event]] = {}
        self._problems: dict[str, str] = {}
        # held while a light is darkened, so that it is not lit again meanwhile
        self._darkening: defaultdict[str, threading.Lock] = defaultdict(threading.Lock)

    def start(self, light: str, longest_s: float) -> None:
        """Allow a light to be on for so long [s] from now."""
        self.stop(light)
        over = threading.Event()
        with self._lock:
            self._problems.pop(light, None)
            self._periods[light] = time.monotonic() + longest_s, over
        try:
            threading.Thread(target=self._watch, args=(light, longest_s, over), daemon=True).start()
        except BaseException:  # the light is not lit then
            self.stop(light)
            raise

    def remaining_s(self, light: str) -> float | None:
        """Remaining time that a light may be on [s]; None where nothing limits it."""
        with self._lock:
            period = self._periods.get(light)
            return None if period is None else period[0] - time.monotonic()

    def stop(self, light: str) -> None:
        """Stop watching a light, which is dark; waits while it is being darkened."""
        with self._darkening_of(light), self._lock:
            if period := self._periods.pop(light, None):
                period[1].set()

    def stop_all(self) -> None:
        """Stop watching all lights: they are dark, or switching them off was tried."""
        for light in tuple(self._periods):
            self.stop(light)

    def pop_problem(self, light: str) -> str | None:
        """Message about a light that had to be darkened, once; None where it had not."""
        with self._lock:
            return self._problems.pop(light, None)

    def _watch(self, light: str, longest_s: float, over: threading.Event) -> None:
        """Darken a light when its time is up, and try again for as long as that fails."""
        wait_s, longest = longest_s, f"its max_on_s of {longest_s:g} s"
        while not over.wait(wait_s):
            with self._darkening_of(light):
                if over.is_set():
                    return
                problem: str | None = None
                try:
                    self._darken(light)
                except BaseException as error:  # noqa: BLE001  (nothing that a driver raises may end the watch)
                    problem = error_text(error)
                with self._lock:
                    if problem is None:
                        self._periods.pop(light, None)
                        over.set()
                        outcome = "and was switched off, although it was still needed: something took too long"
                        self._problems[light] = f"{light} was on for {longest} {outcome}"
                    else:
                        self._problems[light] = f"{light} is on for longer than {longest}: {problem}"
            wait_s = _RETRY_S

    def _darkening_of(self, light: str) -> threading.Lock:
        with self._lock:
            return self._darkening[light]
