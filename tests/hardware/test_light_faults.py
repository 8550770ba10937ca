"""Faults of replies and of lamps between drivers and firmware, over real ports."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest
from faulty_bench import FaultySa, set_fault, unplug
from test_light_conformance import TEMPLATE

from lightopt.core.errors import HardwareError, InputError
from lightopt.rig.devices import LIGHT_DRIVERS, LightController, LightSettings, all_off
from lightopt.rig.devices._device import LinkLostError, ReplyError
from lightopt.rig.simulated import BenchProcess

pytestmark = pytest.mark.slow

TIMEOUT_S = 1.0  # a reply that comes at all comes within it, however busy the machine
DRIVERS = ("ccs", "sa", "template")
OPTIONS: dict[str, dict[str, Any]] = {"ccs": {}, "sa": {}, "template": {"template": TEMPLATE}}


@pytest.fixture(scope="module")
def bench() -> Iterator[BenchProcess]:
    with BenchProcess({name: {"kind": name, "options": OPTIONS[name]} for name in DRIVERS}) as process:
        yield process


@pytest.fixture(params=DRIVERS)
def lights(request: pytest.FixtureRequest, bench: BenchProcess) -> Iterator[tuple[str, LightController]]:
    controller = opened(request.param, bench)
    yield request.param, controller
    set_fault(bench, request.param, "clear")
    all_off({request.param: controller})
    controller.close()


def opened(name: str, bench: BenchProcess) -> LightController:
    settings = LightSettings(name, bench.ports[name], timeout_s=TIMEOUT_S, **OPTIONS[name])
    return LIGHT_DRIVERS[name](settings, None)


def retries(controller: Any) -> int:
    return sum(event.retry for event in controller.events)


FAULTS: dict[str, dict[str, Any]] = {
    "drop": {},
    "delay": {"delay_s": TIMEOUT_S * 1.3},
    "truncate": {"keep": 0},
    "garbage_before": {"bytes": 3},
    "garbage_instead": {"bytes": 5},
}


@pytest.mark.parametrize(("fault", "after"), [*((fault, 1) for fault in FAULTS), ("drop", 0), ("drop", 2)])
def test_one_spoilt_reply_is_mended_and_counted(
    lights: tuple[str, LightController], bench: BenchProcess, fault: str, after: int
) -> None:
    name, controller = lights
    set_fault(bench, name, fault, after=after, **FAULTS[fault])
    controller.set_level(2, 40)
    assert controller.read_level(2) == 40
    assert bench.levels(name)[2] == 40 / 255
    assert retries(controller) == 1


@pytest.mark.parametrize("fault", ["drop", "delay", "garbage_before"])
def test_a_line_that_stays_bad_is_an_error_in_bounded_time(
    lights: tuple[str, LightController], bench: BenchProcess, fault: str
) -> None:
    name, controller = lights
    set_fault(bench, name, fault, count=None, **(FAULTS[fault] | ({"delay_s": 30} if fault == "delay" else {})))
    started = time.monotonic()
    with pytest.raises(ReplyError, match=rf"light controller {name}.*sent 3 times"):
        controller.set_level(2, 40)
    assert time.monotonic() - started < 10 * TIMEOUT_S + 60
    assert retries(controller) == 2


@pytest.mark.parametrize("seed", [1, 2])
def test_a_bad_line_never_leaves_a_wrong_light(
    lights: tuple[str, LightController], bench: BenchProcess, seed: int
) -> None:
    """Every second reply or so is spoilt: each set either holds or is an error."""
    name, controller = lights
    for fault, options in FAULTS.items():
        set_fault(bench, name, fault, count=None, probability=0.07, seed=seed, **options)
    held = 0
    for level in range(10, 20):
        try:
            controller.set_level(3, level)
        except ReplyError:
            continue
        held += 1
        assert bench.levels(name)[3] == level / 255
    assert held >= 5


def test_wrong_checksum_and_refusals(bench: BenchProcess) -> None:
    controller = opened("ccs", bench)
    set_fault(bench, "ccs", "checksum")
    controller.set_level(1, 9)
    assert retries(controller) == 1
    set_fault(bench, "ccs", "ng", code=2)
    controller.set_level(1, 10)
    assert retries(controller) == 2
    for code, words in ((1, "does not know the command"), (3, "out of its range")):
        set_fault(bench, "ccs", "ng", code=code)
        with pytest.raises(HardwareError, match=words):
            controller.set_level(1, 11)
    assert retries(controller) == 2
    set_fault(bench, "ccs", "clear")
    all_off({"ccs": controller})
    controller.close()


def test_a_controller_that_does_not_obey(lights: tuple[str, LightController], bench: BenchProcess) -> None:
    name, controller = lights
    controller.set_level(2, 30)
    set_fault(bench, name, "deaf", channel=2)
    with pytest.raises(HardwareError, match="channel 2 was set to 31 but holds 30"):
        controller.set_level(2, 31)
    with pytest.raises(HardwareError, match="channel 2: not switched off, may still be lit"):
        all_off({name: controller})


@pytest.mark.parametrize(("fault", "share"), [("dark", 0.0), ("lit", 1.0)])
def test_a_lamp_that_does_not_obey_cannot_be_seen_on_the_wire(
    lights: tuple[str, LightController], bench: BenchProcess, fault: str, share: float
) -> None:
    """The images must show it: the controller does not know."""
    name, controller = lights
    set_fault(bench, name, fault, channel=2)
    controller.set_level(2, 30)
    assert controller.read_level(2) == 30
    assert bench.levels(name)[2] == share


def test_all_lights_off_tries_every_channel_of_every_controller() -> None:
    with BenchProcess({name: {"kind": name, "options": OPTIONS[name]} for name in DRIVERS}) as bench:
        controllers = {name: opened(name, bench) for name in DRIVERS}
        for controller in controllers.values():
            for channel in (1, 2, 3, 4):
                controller.set_level(channel, 50)
        unplug(bench, "sa")
        set_fault(bench, "ccs", "ng", code=1, after=2)
        with pytest.raises(HardwareError) as caught:
            all_off(controllers)
        assert [m.partition(": ")[0] for m in caught.value.messages] == [
            "controller ccs, channel 1",
            "controller sa, channels 1, 2, 3, 4",
        ]
        levels = bench.state()["levels"]
        assert set(levels["ccs"].values()) == set(levels["template"].values()) == {0}
        assert set(levels["sa"].values()) == {50 / 255}
        for controller in controllers.values():
            controller.close()


@pytest.mark.parametrize("obeyed", [False, True])
@pytest.mark.parametrize("after", range(3))
def test_cable_pulled_at_every_command_of_a_set(after: int, obeyed: bool) -> None:
    with BenchProcess({"ccs": {"kind": "ccs", "options": {"levels": {"1": 200}}}}) as bench:
        controller = opened("ccs", bench)
        set_fault(bench, "ccs", "vanish", after=after, obeyed=obeyed)
        with pytest.raises(LinkLostError):
            controller.set_level(1, 0)
        controller.close()
        dark = bench.levels("ccs")[1] == 0
        assert dark == (after > 0 or obeyed)


@pytest.mark.parametrize("name", DRIVERS)
def test_no_level_above_the_channel_s_is_sent(name: str) -> None:
    with BenchProcess({name: {"kind": name, "options": OPTIONS[name]}}) as bench:
        settings = LightSettings(name, bench.ports[name], max_levels={2: 90}, **OPTIONS[name])
        controller = LIGHT_DRIVERS[name](settings, None)
        controller.set_level(2, 90)
        heard = bench.state()["deliveries"][name]
        with pytest.raises(InputError, match=r"channel 2 may have an intensity of 90 at most \(max_level\), found 91"):
            controller.set_level(2, 91)
        assert bench.state()["deliveries"][name] == heard
        controller.set_level(1, 91)
        all_off({name: controller})
        controller.close()


def test_lamps_age_are_swapped_and_lose_what_they_held() -> None:
    lamps = FaultySa(channels=3, top_level=200, levels={"3": 50})
    lamps.feed(b"SA0100#", 0.0)
    lamps.inject("aged", {"channel": 1, "share": 0.8}, 0.0)
    assert lamps.levels() == {1: 0.4, 2: 0.0, 3: 0.25}
    lamps.inject("swapped", {"channel": 1, "other": 2}, 0.0)
    assert lamps.levels() == {1: 0.0, 2: 0.5, 3: 0.25}
    lamps.inject("power_cycle", {}, 0.0)
    assert lamps.feed(b"SA#SC#", 0.0) == b"a0000c0050"
    lamps.inject("clear", {}, 0.0)
    lamps.feed(b"SA0100#", 0.0)
    assert lamps.levels() == {1: 0.5, 2: 0.0, 3: 0.25}
    for fault, options in (
        ("swapped", {"channel": 1}),
        ("swapped", {"channel": 1, "other": 9}),
        ("aged", {"channel": 1}),
    ):
        with pytest.raises(ValueError, match=fault):
            lamps.inject(fault, options, 0.0)
