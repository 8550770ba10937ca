"""The virtual bench with faults: of its lines, lamps, axes and GigE camera, and of whole devices.

:func:`install` turns the process of a bench into one with faults; :func:`with_faults` makes this process start such
benches. :func:`set_fault`, :func:`unplug` and :func:`trace` are requests to them. A fault strikes by count or by seeded
chance, so that a failed test can be run again; :class:`Trigger` has the options that all faults of replies, moves and
frames share.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import random
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar
from unittest import mock

from lightopt.rig.simulated import CAMERA, BenchProcess, _bench_process, _devices, _host
from lightopt.rig.simulated._camera import BenchCamera
from lightopt.rig.simulated._camera_gige import GigeCamera
from lightopt.rig.simulated._devices import PtyWire, SimulatedDevices, TcpWire
from lightopt.rig.simulated._firmware import Firmware, LampFirmware, SimulatedAxis, StageFirmware, build
from lightopt.rig.simulated._light_ccs import CcsFirmware
from lightopt.rig.simulated._light_sa import SaFirmware
from lightopt.rig.simulated._light_screen import ScreenFirmware
from lightopt.rig.simulated._light_template import TemplateFirmware
from lightopt.rig.simulated._stage_grbl import GcodeError, GrblFirmware
from lightopt.rig.simulated._stage_sigmakoki import GscFirmware, ShotFirmware
from lightopt.rig.simulated._stage_zaber import ZaberFirmware

__all__ = ["FaultyGigeCamera", "Trigger", "faulty", "install", "set_fault", "trace", "unplug", "with_faults"]


def set_fault(bench: BenchProcess, device: str, fault: str, **options: Any) -> None:
    """Set a fault of a device or of its line; ``clear`` ends them."""
    bench.request("fault", device=device, fault=fault, options=options)


def unplug(bench: BenchProcess, device: str) -> None:
    """Pull the cable of a device; the device goes on with what it does."""
    bench.request("unplug", device=device)


def trace(bench: BenchProcess) -> list[tuple[float, str, int, float]]:
    """Changes of the lights so far: time [s, the bench's clock], device, channel, share of the brightest."""
    return [(t, name, channel, level) for t, name, channel, level in bench.request("trace")[0]["changes"]]


@contextlib.contextmanager
def with_faults() -> Iterator[None]:
    """Benches that are started from nothing have faults."""
    install_first = f"sys.path.append({str(Path(__file__).parent)!r}); import faulty_bench; faulty_bench.install(); "
    program = _bench_process._START.replace("import runpy; ", f"import runpy; {install_first}")
    with mock.patch.object(_bench_process, "_START", program):
        yield


def install() -> None:
    """Let the benches of this process have faults."""
    _devices.build = faulty
    _host.SimulatedDevices = FaultyDevices
    _host.BenchCamera = FaultyBenchCamera
    _host.GigeCamera = FaultyGigeCamera


class Trigger:
    """Decides whether a fault strikes: `after` so many occasions, `count` times (None: always), by a seeded chance."""

    struck = 0  # how often faults struck in this process, those of all triggers together

    def __init__(self, *, after: int = 0, count: int | None = 1, probability: float = 1.0, seed: int = 0) -> None:
        if after < 0 or (count is not None and count < 1) or not 0 <= probability <= 1:
            raise ValueError("after counts from 0, count from 1, and probability lies between 0 and 1")
        self._after = after
        self._left = count
        self._probability = probability
        self._random = random.Random(seed)

    def strikes(self) -> bool:
        """Whether the fault strikes at this occasion."""
        if self._after > 0:
            self._after -= 1
            return False
        if self._left == 0 or self._random.random() >= self._probability:
            return False
        if self._left is not None:
            self._left -= 1
        Trigger.struck += 1
        return True


def trigger(fault: str, options: Mapping[str, Any]) -> Trigger:
    """Trigger of a fault from the options of a request; a ValueError names the fault."""
    try:
        return Trigger(**options)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{fault}: {error}") from None


class Faulty:
    """What the firmware of all devices with faults shares: faults of replies, each with the options of a Trigger."""

    FAULTS: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    """Faults of replies by name, each with its option, if any, and the default of that, beside the trigger's."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self._faults: dict[str, tuple[Trigger, Any]] = {}
        super().__init__(*arguments, **options)

    def inject(self, fault: str, options: Mapping[str, Any], now: float) -> None:
        """Set a fault of the device from now on, none of the line; ``clear`` ends all. ValueError lists the faults."""
        if fault in self.FAULTS:
            own = self.FAULTS[fault]
            values = {**own, **options}
            value = next((values.pop(name) for name in own), True)
            self._faults[fault] = (trigger(fault, values), value)
            return
        if fault == "clear":
            self._faults.clear()
        self._suffer(fault, options, now)

    def _suffer(self, fault: str, options: Mapping[str, Any], now: float) -> None:
        """Set a fault of the lamps or axes, or of the whole device."""
        raise NotImplementedError

    def _struck(self, fault: str) -> Any:
        """Option of a fault of replies that strikes now, True where it has none; None where it does not strike."""
        strikes, value = self._faults.get(fault, (None, None))
        return value if strikes is not None and strikes.strikes() else None


class Held(dict):
    """What a controller holds by channel; a deaf one keeps what it has."""

    def __init__(self, values: Mapping[int, Any], faults: Mapping[int, str]) -> None:
        super().__init__(values)
        self._faults = faults

    def __setitem__(self, channel: int, value: Any) -> None:
        if self._faults.get(channel) != "deaf":
            super().__setitem__(channel, value)


LAMP_FAULTS = ("dark", "lit", "deaf", "aged", "swapped", "power_cycle")


class FaultyLamps(Faulty, LampFirmware):
    """Lamps with faults.

    ``ng`` (a command is refused); ``dark`` (the lamp gives no light, the controller does not know), ``lit`` (it is on
    at full brightness, the controller does not know), ``deaf`` (the controller acknowledges and keeps what it has),
    ``aged`` (it gives that ``share`` of its light), ``swapped`` (its plug is where that of channel ``other`` belongs,
    and the other way round), each for one channel; ``power_cycle`` (the channels are as at power-up).
    """

    FAULTS: ClassVar[Mapping[str, Mapping[str, Any]]] = {"ng": {}}

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._lamp_faults: dict[int, str] = {}
        self._aged: dict[int, float] = {}
        self._lamp_of = {channel: channel for channel in self._level}
        self._at_power_up = dict(self._level), dict(self._on)
        self._level, self._on = (Held(held, self._lamp_faults) for held in self._at_power_up)

    def _suffer(self, fault: str, options: Mapping[str, Any], now: float) -> None:
        if fault == "clear":
            self._lamp_faults.clear()
            self._aged.clear()
            self._lamp_of = {channel: channel for channel in self._level}
            return
        if fault not in LAMP_FAULTS:
            raise ValueError(f'no fault called "{fault}"; there are {", ".join((*LAMP_FAULTS, *self.FAULTS, "clear"))}')
        if fault == "power_cycle":
            self._level, self._on = (Held(held, self._lamp_faults) for held in self._at_power_up)
            return
        more = {"aged": {"share"}, "swapped": {"other"}}.get(fault, set())
        if set(options) != {"channel", *more} or options["channel"] not in self._level:
            wants = "".join(f" and {name}" for name in more)
            raise ValueError(f"{fault} wants a channel from 1 to {self._channels}{wants}, got {dict(options)}")
        channel = options["channel"]
        if fault == "aged":
            self._aged[channel] = float(options["share"])
        elif fault == "swapped":
            other = options["other"]
            if other not in self._level:
                raise ValueError(f"swapped wants another channel from 1 to {self._channels}, got {dict(options)}")
            self._lamp_of |= {channel: other, other: channel}
        else:
            self._lamp_faults[channel] = fault

    def levels(self) -> dict[int, float]:
        """Brightness of the lamps, whatever the controller believes."""
        plugged = super().levels()
        for channel, fault in self._lamp_faults.items():
            plugged[channel] = {"dark": 0.0, "lit": 1.0}.get(fault, plugged[channel])
        return {lamp: plugged[channel] * self._aged.get(lamp, 1.0) for channel, lamp in self._lamp_of.items()}


class FaultyCcs(FaultyLamps, CcsFirmware):
    """Also ``checksum`` (the reply's is wrong); ``ng`` has a ``code``: 1 command, 2 checksum, 3 value.

    A frame that comes less than `gap_s` [s] after another is ignored.
    """

    FAULTS: ClassVar[Mapping[str, Mapping[str, Any]]] = {"ng": {"code": 1}, "checksum": {}}

    def __init__(self, *, gap_s: float = 0.0, **lamps: Any) -> None:
        super().__init__(**lamps)
        self._gap_s = gap_s
        self._last = -float("inf")

    def _answer(self, command: bytes, now: float) -> bytes:
        if now - self._last < self._gap_s:
            return b""
        self._last = now
        return super()._answer(command, now)

    def inject(self, fault: str, options: Mapping[str, Any], now: float) -> None:
        if fault == "ng" and options.get("code", 1) not in (1, 2, 3):
            raise ValueError(f"ng wants code 1, 2 or 3, got {options['code']}")
        super().inject(fault, options, now)

    def _obey(self, channel: int, instruction: str, data: str) -> str | int:
        code = self._struck("ng")
        return super()._obey(channel, instruction, data) if code is None else code

    def _reply(self, head: str, outcome: str) -> bytes:
        reply = super()._reply(head, outcome)
        return _spoilt(reply) if self._struck("checksum") else reply


def _spoilt(reply: bytes) -> bytes:
    """A reply that ends with two digits of a checksum, CR and LF, with another checksum."""
    return reply[:-4] + f"{int(reply[-4:-2], 16) ^ 0x55:02X}\r\n".encode("ascii")


class FaultySa(FaultyLamps, SaFirmware):
    """Its faults are those of all lamps; `ack` is how it acknowledges: ``upper`` or ``lower`` letter, or ``!``."""

    def __init__(self, *, ack: str = "lower", **lamps: Any) -> None:
        if ack not in ("upper", "lower", "!"):
            raise ValueError(f'ack is one of upper, lower, !, not "{ack}"')
        super().__init__(**lamps)
        self._ack = ack

    def _obey(self, command: str) -> str:
        if self._struck("ng"):
            return "NG"
        reply = super()._obey(command)
        return {"upper": reply.upper(), "lower": reply, "!": "!"}[self._ack] if len(reply) == 1 else reply


class FaultyTemplate(FaultyLamps, TemplateFirmware):
    """Its faults are those of all lamps; a command that is refused is answered ``?``."""

    def _obey(self, verb: str, channel: int, level: int) -> str:
        return "?" + self._end if self._struck("ng") else super()._obey(verb, channel, level)


class FaultyAxis(SimulatedAxis):
    """An axis that stalls, meets a switch, or loses steps."""

    fault: tuple[str, Trigger, float, bool] | None = None  # kind, trigger, share of the way, whether it stays busy
    _stays_busy = False

    def lose_steps(self, steps: float) -> None:
        """Lose steps: the axis stands that much short of its count from now on."""
        self._offset -= steps

    def power_cycle(self, now: float) -> None:
        """Go off and on: the axis stays where it stands, and the count starts again."""
        self.stop(now)
        self._offset += self._start
        self._start = self._end = 0.0
        self.at_limit = self.homed = False

    def moving(self, now: float) -> bool:
        return super().moving(now) or self._stays_busy

    def stop(self, now: float) -> None:
        super().stop(now)
        self._stays_busy = False

    def move(self, target: float, speed: float, now: float, *, homing: float | None = None) -> None:
        self._stays_busy = False
        if self.fault is None or not self.fault[1].strikes():
            super().move(target, speed, now, homing=homing)
            return
        kind, _, share, busy = self.fault
        start = self.count(now)
        end = start + share * (target - start)
        super().move(end, speed, now)
        if kind == "stall":
            self._stays_busy = busy
        elif end == start:
            self.at_limit = True
        else:
            self._ends_at_switch = True


class FaultyStage(Faulty, StageFirmware):
    """A stage with faults.

    ``power_cycle``; of an ``axis`` or of all: ``stall`` (the axis stops after a ``share`` of a move, and reports that
    it stands still, or with ``busy`` that it moves), ``limit`` (it meets a switch there), both counting moves;
    ``lost_step`` (it lost ``steps``). ``clear`` ends them.
    """

    DEVICE_FAULTS: ClassVar[tuple[str, ...]] = ()  # further faults of the whole device, for the message

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        for axis in self._axes.values():
            axis.__class__ = FaultyAxis

    def _power_up(self) -> None:
        """Begin with the state at power-up, that of the axes apart."""
        raise NotImplementedError

    def _suffer(self, fault: str, options: Mapping[str, Any], now: float) -> None:
        if fault == "power_cycle":
            for axis in self._axes.values():
                axis.power_cycle(now)
            self._power_up()
            return
        chosen = dict(options)
        name = chosen.pop("axis", None)
        if name is not None and name not in self._axes:
            raise ValueError(f'{fault}: no axis called "{name}"; there is {", ".join(self._axes)}')
        axes = list(self._axes.values()) if name is None else [self._axes[name]]
        if fault == "clear":
            for axis in axes:
                axis.fault = None
        elif fault == "lost_step":
            steps = float(chosen.pop("steps", 100))
            if chosen:
                raise ValueError(f"lost_step: unknown option {', '.join(chosen)}")
            for axis in axes:
                axis.lose_steps(steps)
        elif fault in ("stall", "limit"):
            share, busy = float(chosen.pop("share", 0.5)), bool(chosen.pop("busy", False))
            strikes = trigger(fault, chosen)
            for axis in axes:
                axis.fault = (fault, strikes, share, busy)
        else:
            known = ("stall", "limit", "lost_step", *self.DEVICE_FAULTS, *self.FAULTS, "power_cycle", "clear")
            raise ValueError(f'no fault called "{fault}"; there is {", ".join(known)}')


class FaultySigmakoki(FaultyStage):
    """Also ``refuse``: a command other than a question is refused and not obeyed."""

    FAULTS: ClassVar[Mapping[str, Mapping[str, Any]]] = {"refuse": {}}

    def _power_up(self) -> None:
        self._speed = dict.fromkeys(self._speed, self.SPEED)
        self._planned.clear()
        self._buffer = b""

    def _obey(self, line: str, now: float) -> bool:
        return not self._struck("refuse") and super()._obey(line, now)


class FaultyShot(FaultySigmakoki, ShotFirmware):
    """A SHOT with faults."""


class FaultyGsc(FaultySigmakoki, GscFirmware):
    """A GSC-02 with faults."""


class FaultyGrbl(FaultyStage, GrblFirmware):
    """Also ``alarm`` (option ``code``; at once) and ``refuse`` (option ``code``: lines are answered by error:code)."""

    FAULTS: ClassVar[Mapping[str, Mapping[str, Any]]] = {"refuse": {"code": 8}}
    DEVICE_FAULTS = ("alarm",)

    def _power_up(self) -> None:
        GrblFirmware._power_up(self)

    def _suffer(self, fault: str, options: Mapping[str, Any], now: float) -> None:
        if fault == "alarm":
            code = int(options.get("code", 1))
            if set(options) - {"code"} or not 1 <= code <= 10:
                raise ValueError("alarm wants a code from 1 to 10, and no other option")
            self._pending += self._alarm(code, now)
        else:
            super()._suffer(fault, options, now)

    def _gcode(self, text: str, now: float) -> bytes:
        self._refuse()
        return super()._gcode(text, now)

    def _dollar(self, text: str, now: float) -> bytes:
        self._refuse()
        return super()._dollar(text, now)

    def _refuse(self) -> None:
        if (code := self._struck("refuse")) is not None:
            raise GcodeError(code)


class FaultyZaber(FaultyStage, ZaberFirmware):
    """Also ``alarm``, ``refuse`` and ``checksum``.

    ``alarm`` (option ``flag``: a warning that stays, FS by default, ``axis``; moves stop), ``refuse`` (commands other
    than questions are rejected with ``reason``, BADDATA by default), ``checksum`` (a reply's is wrong).
    """

    FAULTS: ClassVar[Mapping[str, Mapping[str, Any]]] = {"refuse": {"reason": "BADDATA"}, "checksum": {}}
    DEVICE_FAULTS = ("alarm",)

    def _power_up(self) -> None:
        self._buffer = b""
        for name, flags in self._flags.items():
            flags.clear()
            self._moves[name] = False

    def _suffer(self, fault: str, options: Mapping[str, Any], now: float) -> None:
        if fault == "alarm":
            chosen = {"flag": "FS", "axis": None, **options}
            axis = chosen["axis"]
            if len(chosen) > 2 or (axis is not None and axis not in self._flags):
                raise ValueError("alarm wants a flag, and an axis of the device")
            self._stop_axes(now)
            for name in self._flags if axis is None else [axis]:
                self._flags[name].add(str(chosen["flag"]))
        else:
            super()._suffer(fault, options, now)

    def _obey(self, words: list[str], names: list[str], axis: int, now: float) -> str:
        if words and words[0] not in ("get", "warnings") and (reason := self._struck("refuse")):
            return reason
        return super()._obey(words, names, axis, now)

    def _reply(self, *arguments: Any) -> bytes:
        reply = super()._reply(*arguments)
        return _spoilt(reply) if self._struck("checksum") else reply


FIRMWARE: dict[str, Callable[..., Firmware]] = {
    "ccs": FaultyCcs,
    "sa": FaultySa,
    "template": FaultyTemplate,
    "screen": ScreenFirmware,
    "shot": FaultyShot,
    "gsc": FaultyGsc,
    "grbl": FaultyGrbl,
    "zaber": FaultyZaber,
}


def faulty(kind: str, options: dict[str, Any]) -> Any:
    """Power up the firmware of a protocol, with faults; errors are those of the firmware without."""
    if kind not in FIRMWARE:
        build(kind, options)
    try:
        return FIRMWARE[kind](**options)
    except TypeError as error:
        raise ValueError(f"firmware {kind}: {error}") from None


# by name, each with its option and the default of that
LINE_FAULTS: dict[str, dict[str, Any]] = {
    "drop": {},
    "delay": {"delay_s": 0.5},
    "truncate": {"keep": 1},
    "garbage_before": {"bytes": 3},
    "garbage_instead": {"bytes": 5},
    "vanish": {"obeyed": False},
}


class FaultyLine:
    """Firmware behind a line that transmits the bytes that it sends, with faults.

    Each has the options of :class:`Trigger`: ``drop``; ``delay`` (by ``delay_s``); ``truncate`` (to ``keep`` bytes);
    ``garbage_before`` and ``garbage_instead`` (so many ``bytes``); ``vanish`` (the cable is pulled when a command
    arrives; ``obeyed``: whether the device still hears it). Occasions of ``vanish`` are deliveries of bytes to the
    device, those of the others are replies.
    """

    def __init__(self, firmware: Any, wire: PtyWire | TcpWire) -> None:
        self._firmware = firmware
        self._wire = wire
        self._faults: list[tuple[str, Trigger, dict[str, Any]]] = []
        self._late: list[tuple[float, bytes]] = []  # when [s], what
        self.deliveries = 0
        self.levels, self.positions, self.picture = firmware.levels, firmware.positions, firmware.picture

    def feed(self, data: bytes, now: float) -> bytes:
        self.deliveries += 1
        for kind, strikes, options in self._faults:
            if kind == "vanish" and strikes.strikes():
                self._wire.pull()
                if not options["obeyed"]:
                    return b""
                break
        return self._carry(self._firmware.feed(data, now), now)

    def poll(self, now: float) -> bytes:
        sent = self._carry(self._firmware.poll(now), now)
        due = [late for late in self._late if late[0] <= now]
        self._late = [late for late in self._late if late[0] > now]
        return b"".join(data for _, data in due) + sent

    def inject(self, fault: str, options: Mapping[str, Any], now: float) -> None:
        if fault in LINE_FAULTS:
            chosen = dict(options)
            values = {key: chosen.pop(key, value) for key, value in LINE_FAULTS[fault].items()}
            values["seed"] = chosen.get("seed", 0)
            self._faults.append((fault, trigger(fault, chosen), values))
            return
        if fault == "clear":
            self._faults.clear()
            self._late.clear()  # late replies do not come any more
        self._firmware.inject(fault, options, now)

    def _carry(self, data: bytes, now: float) -> bytes:
        """What arrives at the client now of a reply that the device sends."""
        if not data:
            return b""
        due = now
        for kind, strikes, options in self._faults:
            if kind == "vanish" or not strikes.strikes():
                continue
            if kind == "drop":
                data = b""
            elif kind == "delay":
                due = now + float(options["delay_s"])
            elif kind == "truncate":
                data = data[: int(options["keep"])]
            else:
                # bytes as a disturbed line has them: any but those that end or begin commands
                chance = random.Random(int(options["seed"]))
                noise = bytes(chance.choice(range(0x80, 0xFF)) for _ in range(int(options["bytes"])))
                data = noise + (data if kind == "garbage_before" else b"")
        if due > now:
            self._late.append((due, data))
            return b""
        return data


class WedgingWire(TcpWire):
    """A loopback socket that a client which leaves without a word disables (PD3-EI)."""

    def __init__(self) -> None:
        super().__init__()
        self._wedged = self._spoken = False

    def receive(self) -> bytes:
        before = self._client
        data = super().receive()
        if before is not None and self._client is None:
            self._wedged = self._wedged or not self._spoken
            self._spoken = False
        self._spoken = self._spoken or bool(data)
        return b"" if self._wedged else data


class FaultyDevices(SimulatedDevices):
    """All devices of a bench with faults, and its lights through time; ``wedges`` of a device is a WedgingWire."""

    def __init__(self, devices: Mapping[str, Mapping[str, Any]]) -> None:
        super().__init__(devices)
        self._served = threading.Event()
        # changes of the lights: time [s, monotonic clock], device, channel, share of the highest brightness
        self.trace: deque[tuple[float, str, int, float]] = deque(maxlen=100_000)
        self._brightness: dict[tuple[str, int], float] = {}
        for name, device in self.devices.items():
            if devices[name].get("wedges") and isinstance(device.wire, TcpWire):
                device.wire.pull()
                device.wire = WedgingWire()
            device.firmware = FaultyLine(device.firmware, device.wire)

    def requests(self) -> dict[str, Any]:
        return {"state": self._state, "trace": self._trace, "fault": self._fault, "unplug": self._unplug}

    def _state(self, request: Mapping[str, Any]) -> tuple[dict[str, Any], bytes]:
        with self.lock:
            deliveries = {name: device.firmware.deliveries for name, device in self.devices.items()}
            more = {"pid": os.getpid(), "time": time.monotonic(), "deliveries": deliveries, "struck": Trigger.struck}
            more["pictures"] = {name: picture.radiance.tolist() for name, picture in self.pictures().items()}
            return {**super()._state(request)[0], **more}, b""

    def _trace(self, _: Mapping[str, Any]) -> tuple[dict[str, Any], bytes]:
        with self.lock:
            return {"changes": list(self.trace)}, b""

    def _fault(self, request: Mapping[str, Any]) -> tuple[dict[str, Any], bytes]:
        device, kind, options = request["device"], request["fault"], dict(request.get("options", {}))
        if FaultyGigeCamera.running is not None and device == CAMERA:
            FaultyGigeCamera.running.inject(kind, options)
        else:
            self.inject(device, kind, options, time.monotonic())
        return {}, b""

    def _unplug(self, request: Mapping[str, Any]) -> tuple[dict[str, Any], bytes]:
        if FaultyGigeCamera.running is not None and request["device"] == CAMERA:
            FaultyGigeCamera.running.unplug()
        else:
            self.pull(request["device"])
        return {}, b""

    def serve(self, now: float, ready: Any) -> None:
        with self.lock:
            super().serve(now, ready)
            self._record_lights(now)
            self._served.set()

    def inject(self, name: str, fault: str, options: dict[str, Any], now: float) -> None:
        with self.lock:
            if name not in self.devices:
                raise ValueError(f'no device called "{name}"; there is {", ".join(self.devices)}')
            device = self.devices[name]
            device._received_at = now
            device.firmware.inject(fault, options, now)
            self._record_lights(now)

    def pull(self, name: str) -> None:
        """Pull the cable of a device, and wait until its end is no longer in use."""
        with self.lock:
            self.devices[name].wire.pull()
            self._served.clear()
        # The system keeps a wire open for as long as the serving thread waits on it.
        self._served.wait(1)

    def _record_lights(self, now: float) -> None:
        for name, levels in self.levels().items():
            for channel, level in levels.items():
                if self._brightness.get((name, channel), 0.0) != level:
                    self._brightness[name, channel] = level
                    self.trace.append((now, name, channel, level))


class FaultyBenchCamera(BenchCamera):
    """The camera of a bench; one that does not arrive is not `counted`, so that the next has its noise."""

    def expose(self, exposure_us: float, gain_db: float, triggered: bool, counted: bool = True) -> Any:
        taken = dict(self._build()._taken)
        levels = super().expose(exposure_us, gain_db, triggered)
        if not counted:
            self._build()._taken = taken
        return levels


GIGE_FAULTS = (
    "lost",  # no packet of a frame arrives
    "incomplete",  # some packets do not arrive
    "duplicate",  # the frame has the number of the one before
    "order",  # its number is lower than that of the one before
    "stale",  # its time is before that of the one before
    "old_image",  # its image is that of the one before
    "exposure",  # it is exposed half as long
    "format",  # the camera holds another pixel format from here on, as after a power cycle
    "hang",  # the camera neither sends nor answers any more
    "vanish",  # its cable is pulled
)
UNSOUND = {"lost", "incomplete", "duplicate", "order", "stale", "hang", "vanish"}
BACK = 3
BACK_NS = 10**9
LOST_SHARES = {"lost": 1.0, "vanish": 1.0, "incomplete": 0.5}  # of a frame's packets
OTHER_FORMAT = 0x0108000B  # BayerBG8


class FaultyGigeCamera(GigeCamera):
    """Decides at each frame which faults strike, and suffers them; `expose` also gets whether the frame will arrive."""

    running: ClassVar[FaultyGigeCamera | None] = None  # in this process

    def __init__(self, expose: Callable[[float, float, bool, bool], Any], **options: Any) -> None:
        FaultyGigeCamera.running = self
        self._triggers: dict[str, Trigger] = {}
        self._now: set[str] = set()
        self._image: Any = None
        self._stamp_ns = 0
        self._losing = False
        self._awake = threading.Event()
        self._sees = expose
        super().__init__(self._seen, **options)
        for field in ("frame_id", "timestamp"):
            get, put = (getattr(self.c, f"arv_buffer_{verb}_{field}") for verb in ("get", "set"))
            get.restype, get.argtypes = ctypes.c_uint64, [ctypes.c_void_p]
            put.argtypes = [ctypes.c_void_p, ctypes.c_uint64]

    def inject(self, fault: str, options: dict[str, Any]) -> None:
        """Set a fault; ``clear`` ends all."""
        if fault == "clear":
            self._triggers = {}
            return
        if fault not in GIGE_FAULTS:
            raise ValueError(f'a camera has no fault "{fault}"; there is {", ".join(GIGE_FAULTS)}')
        self._triggers = {**self._triggers, fault: trigger(fault, options)}

    def close(self) -> None:
        self._awake.set()
        super().close()

    def _fill(self, buffer: int, _: int | None, exposure_us: float, gain: int, code: int) -> None:
        super()._fill(buffer, None, self._begin(buffer, int(exposure_us)), gain, code)
        if "stale" in self._now:
            self.c.arv_buffer_set_timestamp(buffer, (self._stamp_ns or time.time_ns()) - BACK_NS)
        else:
            self._stamp_ns = int(self.c.arv_buffer_get_timestamp(buffer))

    def _begin(self, buffer: int, exposure_us: int) -> float:
        """Apply the faults that strike at this frame; returns how long it is really exposed [µs]."""
        number = int(self.c.arv_buffer_get_frame_id(buffer))
        self._now = {fault for fault, one in self._triggers.items() if one.strikes()}
        share = max((LOST_SHARES.get(fault, 0.0) for fault in self._now), default=0.0)
        if share or self._losing:
            self._losing = share > 0
            if self._server is not None:
                self._server.set_property("gvsp-lost-ratio", share)
        for fault, back in (("duplicate", 1), ("order", BACK)):
            if fault in self._now:
                self.c.arv_buffer_set_frame_id(buffer, number - back)
        if "exposure" in self._now:
            exposure_us = max(10, exposure_us // 2)
            self._write("EXPOSURE_TIME_US", exposure_us)
        if "format" in self._now:
            self._write("PIXEL_FORMAT", OTHER_FORMAT)
        if "hang" in self._now:
            self._awake.wait()  # the camera's one thread, which also answers questions
        if "vanish" in self._now:
            # the camera's own thread is here and cannot end itself
            threading.Thread(target=self.unplug, daemon=True).start()
        return float(exposure_us)

    def _seen(self, exposure_us: float, gain_db: float, triggered: bool) -> Any:
        """What the frame has of what is seen."""
        image = self._sees(exposure_us, gain_db, triggered, not self._now & UNSOUND)
        old, self._image = self._image, image
        return old if "old_image" in self._now and old is not None else image

    def _write(self, register: str, value: int) -> None:
        """Write a register of the camera, as a fault of the camera itself would."""
        if self._device is not None:
            self._device.write_register(self._register(register), value)
