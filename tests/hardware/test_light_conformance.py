"""What every light controller does, whatever its protocol, against its firmware over real ports."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest
from faulty_bench import unplug

from lightopt.core.errors import HardwareError, InputError
from lightopt.rig.devices import LIGHT_DRIVERS, LightController, LightSettings, all_off
from lightopt.rig.devices._device import LinkLostError
from lightopt.rig.simulated import BenchProcess

PTYS = sys.platform != "win32"
TEMPLATE = {
    "set": "L{channel}{level:04d}\r\n",
    "set_reply": "OK",
    "read": "?{letter}\r\n",
    "read_reply": "L[1-4]=(?P<level>[0-9]{4})",
    "end": "\r\n",
}
SHORT = {"set": "#CH{channel:02d}BW{level:04d}E"}  # neither replies nor readings
AT_POWER_UP = {"1": 255, "3": 17}


@dataclass(frozen=True)
class Kind:
    """A driver with its settings, the firmware that it meets, and whether what it set can be read back."""

    driver: str
    settings: dict[str, Any]
    firmware: dict[str, Any]
    reads: bool = True


KINDS = {
    "ccs-lan": Kind("ccs", {}, {"gap_s": 0.005}),
    "ccs-serial": Kind("ccs", {"dialect": "serial"}, {"gap_s": 0.005}),
    "ccs-1023": Kind("ccs", {"top_level": 1023, "channels": 2}, {"top_level": 1023, "channels": 2}),
    "sa-lower": Kind("sa", {}, {"ack": "lower"}),
    "sa-upper": Kind("sa", {}, {"ack": "upper"}),
    "sa-!": Kind("sa", {"channels": 6, "top_level": 999}, {"channels": 6, "top_level": 999, "ack": "!"}),
    "template": Kind("template", {"template": TEMPLATE}, {"template": TEMPLATE}),
    "template-mute": Kind("template", {"template": SHORT}, {"template": SHORT}, reads=False),
}


@dataclass(frozen=True)
class Rig:
    """A controller and the bench behind it."""

    name: str
    kind: Kind
    controller: LightController
    bench: BenchProcess

    def shines(self) -> dict[int, float]:
        """Brightness of the lamps now."""
        return self.bench.levels(self.name)

    def comes_to(self, expected: dict[int, float]) -> bool:
        """Whether the lamps shine so; at once where the controller replies, else once it has heard all."""
        until = time.monotonic() + (0 if self.kind.reads else 60)
        while (found := self.shines()) != expected and time.monotonic() < until:
            time.sleep(0.01)
        return found == expected

    def heard(self) -> int:
        """How often the device heard something."""
        return self.bench.state()["deliveries"][self.name]


TESTS = ("life", "range", "pulled", "shared")
PLACES = [(name, tcp) for name in KINDS for tcp in ((False, True) if PTYS else (True,))]


@pytest.fixture(scope="module")
def bench() -> Iterator[BenchProcess]:
    """One process with a device of its own for every test."""
    devices: dict[str, Any] = {}
    for name, tcp in PLACES:
        kind = KINDS[name]
        levels = {c: n for c, n in AT_POWER_UP.items() if int(c) <= kind.firmware.get("channels", 4)}
        spec = {"kind": kind.driver, "options": {**kind.firmware, "levels": levels}, "tcp": tcp}
        for test in TESTS:
            devices[f"{name} {tcp} {test}"] = spec | {"wedges": kind.driver == "ccs"}
    with BenchProcess(devices) as process:
        yield process


@pytest.fixture(params=PLACES, ids=[f"{name}-{'tcp' if tcp else 'pty'}" for name, tcp in PLACES])
def rig(request: pytest.FixtureRequest, bench: BenchProcess) -> Iterator[Rig]:
    name, tcp = request.param
    device = f"{name} {tcp} {request.function.__name__.split('_')[1]}"
    controller = opened(KINDS[name], bench.ports[device])
    yield Rig(device, KINDS[name], controller, bench)
    controller.close()


def opened(kind: Kind, port: str) -> LightController:
    settings = LightSettings("main", port, timeout_s=0.5, **kind.settings)
    return LIGHT_DRIVERS[kind.driver](settings, None)


def set_until_stopped(controller: LightController, times: int) -> None:
    for _ in range(times):
        controller.set_level(1, 0)


def test_life_of_a_controller(rig: Rig) -> None:
    """Opening and asking change no light; setting changes one; darkening changes all."""
    controller, top = rig.controller, rig.controller.top_level
    at_power_up = rig.shines()
    assert {c for c, share in at_power_up.items() if share} == {1, 3} & set(at_power_up)
    assert controller.channels == len(at_power_up)
    assert top == rig.kind.firmware.get("top_level", 255)

    identity = controller.identify()
    assert (identity["driver"], identity["port"]) == (rig.kind.driver, rig.bench.ports[rig.name])
    assert identity["read_back"] == ("yes" if rig.kind.reads else "no")
    assert controller.read_level(1) == (255 if rig.kind.reads else None)
    assert rig.comes_to(at_power_up)

    for level in (1, top // 2, top):
        controller.set_level(2, level)
        assert controller.read_level(2) == (level if rig.kind.reads else None)
        assert rig.comes_to(at_power_up | {2: level / top})
    controller.set_level(2, 0)
    assert controller.read_level(2) == (0 if rig.kind.reads else None)
    assert rig.comes_to(at_power_up)

    for channel in at_power_up:
        controller.set_level(channel, channel)
    assert rig.comes_to({c: c / top for c in at_power_up})
    all_off({"main": controller})
    assert rig.comes_to(dict.fromkeys(at_power_up, 0.0))
    controller.set_level(1, 5)
    assert rig.comes_to({c: 5 / top if c == 1 else 0.0 for c in at_power_up})
    controller.close()
    controller.close()
    assert rig.bench.levels(rig.name)[1] == 5 / top  # closing changes no light


def test_range_is_checked_before_the_wire(rig: Rig) -> None:
    before = rig.shines()
    heard = rig.heard()
    for channel, level in ((0, 1), (rig.controller.channels + 1, 1), (1, -1), (1, rig.controller.top_level + 1)):
        with pytest.raises(InputError, match=r"light controller main \("):
            rig.controller.set_level(channel, level)
    with pytest.raises(InputError):
        rig.controller.read_level(0)
    assert rig.heard() == heard
    assert rig.comes_to(before)


def test_pulled_cable(rig: Rig) -> None:
    unplug(rig.bench, rig.name)
    with pytest.raises(LinkLostError, match=r"light controller main \(.*the device is gone"):
        set_until_stopped(rig.controller, 1 if rig.kind.reads else 50)  # TCP takes what is written before it knows
    with pytest.raises(HardwareError, match=r"controller main, channels 1, 2.*may still be lit"):
        all_off({"main": rig.controller})
    assert rig.bench.levels(rig.name)[1] > 0
    rig.controller.close()


def test_shared_by_nobody(rig: Rig) -> None:
    rig.controller.set_level(1, 0)
    assert rig.comes_to(rig.shines() | {1: 0.0})
    with pytest.raises((InputError, HardwareError), match=r"in use|no other program holds its one connection"):
        opened(rig.kind, rig.bench.ports[rig.name])
    rig.controller.identify()
