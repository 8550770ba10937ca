"""What goes wrong with a stage, and what its driver makes of it.

Whatever happens, one of two things holds afterwards: the driver says that the stage stands where it was sent, and it
does; or it raises, the stage has been told to stop, and no further move is made before it has been homed.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from faulty_bench import set_fault, unplug
from stage_worlds import AXES, DEVICE_AXES, KINDS, STEP, Pool, open_kind

from lightopt.core.errors import HardwareError
from lightopt.core.transforms import Posture
from lightopt.rig.devices import open_stage
from lightopt.rig.devices._device import LinkLostError
from lightopt.rig.devices._stage import Stage

pytestmark = pytest.mark.slow

WIRE = "tcp" if os.name == "nt" else "pty"
START, TARGET = Posture(-20.0, 100.0), Posture(30.0, 250.0)


@pytest.fixture(scope="module")
def pool() -> Iterator[Pool]:
    pool = Pool()
    yield pool
    pool.close()


@pytest.fixture(autouse=True)
def banner(monkeypatch: pytest.MonkeyPatch) -> None:
    """No one waits three seconds for a board that will not say its name."""
    monkeypatch.setattr("lightopt.rig.devices._stage_grbl._BANNER_S", 0.6)


@contextmanager
def hurried() -> Iterator[None]:
    """No one waits three seconds for an axis that will not arrive; one that will has them: the machine may be busy."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("lightopt.rig.devices._stage._MARGIN_S", 0.5)
        patch.setattr("lightopt.rig.devices._stage._SETTLE_S", 0.15)
        yield


def real(pool: Pool, kind: str, name: str) -> tuple[float, float]:
    places = pool.of(name).positions(name)
    first, second = DEVICE_AXES[kind]
    return places[first], places[second]


def units(kind: str, posture: Posture) -> tuple[float, float]:
    tilt, turn = AXES[kind]
    return tilt.units_of(posture.elevation_deg), turn.units_of(posture.rotation_deg)


def at_start(pool: Pool, kind: str, *, timeout_s: float = 1.0) -> tuple[str, Stage]:
    name = pool.take(kind, WIRE)
    stage = open_kind(kind, pool.of(name).ports[name], timeout_s=timeout_s)
    stage.home()
    stage.move_to(START)
    return name, stage


def stands_still(pool: Pool, kind: str, name: str) -> bool:
    before = real(pool, kind, name)
    time.sleep(0.03)
    return real(pool, kind, name) == before


@pytest.mark.parametrize("busy", [False, True], ids=["says-idle", "says-busy"])
@pytest.mark.parametrize("kind", KINDS)
def test_an_axis_stalls(pool: Pool, kind: str, busy: bool) -> None:
    name, stage = at_start(pool, kind)
    set_fault(pool.of(name), name, "stall", axis=DEVICE_AXES[kind][1], share=0.5, busy=busy)
    with hurried(), pytest.raises(HardwareError) as failed:
        stage.move_to(TARGET)
    text = str(failed.value)
    assert "rotation should be at 250° and stands at 175°" in text
    assert "It stands still now. Before the next move, home it first: lightopt bench home RIG" in text
    assert stands_still(pool, kind, name)
    with pytest.raises(HardwareError, match=r"lightopt bench home RIG|clear it"):
        stage.move_to(START)
    if "clear it" not in (stage.state().alarm or ""):
        stage.home()
        stage.move_to(TARGET)
        assert real(pool, kind, name) == pytest.approx(units(kind, TARGET), abs=STEP[kind])
    stage.close()


@pytest.mark.parametrize("kind", KINDS)
def test_an_axis_meets_its_limit_switch(pool: Pool, kind: str) -> None:
    name, stage = at_start(pool, kind)
    set_fault(pool.of(name), name, "limit", axis=DEVICE_AXES[kind][0], share=0.5)
    words = {"shot": "limit switch", "gsc": "limit switch", "grbl": r"ALARM:1 \(hard limit", "zaber": r"WL \(a limit"}
    with hurried(), pytest.raises(HardwareError, match=words[kind]) as failed:
        stage.move_to(TARGET)
    assert ("answers nothing until it is reset" in str(failed.value)) is (kind == "grbl")
    assert stands_still(pool, kind, name)
    state = stage.state()
    assert state.alarm is not None
    assert state.referenced is False
    with pytest.raises(HardwareError, match="was not moved: alarm: "):
        stage.move_to(START)
    stage.close()


@pytest.mark.parametrize("kind", KINDS)
def test_a_command_is_refused(pool: Pool, kind: str) -> None:
    name, stage = at_start(pool, kind)
    set_fault(pool.of(name), name, "refuse", count=1)
    words = {"shot": r"refused \(NG\)", "gsc": "ACK1 is X", "grbl": "error:8", "zaber": "BADDATA"}
    with pytest.raises(HardwareError, match=words[kind]):
        stage.move_to(TARGET)
    assert real(pool, kind, name) == pytest.approx(units(kind, START), abs=STEP[kind])
    stage.home()
    stage.move_to(TARGET)
    stage.close()


@pytest.mark.parametrize("after", range(4))
@pytest.mark.parametrize("kind", KINDS)
def test_any_command_is_refused(pool: Pool, kind: str, after: int) -> None:
    """Of switching on, homing and moving, the command that comes after so many others."""
    name = pool.take(kind, WIRE)
    stage = open_kind(kind, pool.of(name).ports[name], timeout_s=1.0)
    set_fault(pool.of(name), name, "refuse", after=after, count=1)
    refused = 0
    for _ in range(3):
        try:
            stage.home()
            stage.move_to(START)
            stage.move_to(TARGET)
        except HardwareError:  # noqa: PERF203
            refused += 1
            assert stands_still(pool, kind, name)
        else:
            assert real(pool, kind, name) == pytest.approx(units(kind, TARGET), abs=STEP[kind])
    assert refused == 1
    stage.close()


@pytest.mark.parametrize("busy", [False, True], ids=["says-idle", "says-busy"])
@pytest.mark.parametrize("kind", KINDS)
def test_an_axis_stalls_on_its_way_home(pool: Pool, kind: str, busy: bool) -> None:
    name = pool.take(kind, WIRE)
    port = pool.of(name).ports[name]
    stage = open_stage(kind, port=port, axes=AXES[kind], timeout_s=0.2, home_timeout_s=0.6)
    set_fault(pool.of(name), name, "stall", axis=DEVICE_AXES[kind][0], busy=busy)
    with hurried(), pytest.raises(HardwareError) as failed:
        stage.home()
    assert any(words in str(failed.value) for words in ("has not found its origin", "ALARM:9", "no reply after"))
    assert "home it first" in str(failed.value)
    assert stands_still(pool, kind, name)
    assert stage.state().referenced is False
    with pytest.raises(HardwareError):
        stage.move_to(START)
    stage.close()


@pytest.mark.parametrize(("kind", "options"), [("grbl", {"code": 1}), ("grbl", {"code": 3}), ("zaber", {"flag": "FD"})])
def test_an_alarm_in_the_middle_of_a_move(pool: Pool, kind: str, options: dict[str, object]) -> None:
    name, stage = at_start(pool, kind)
    stage._clock.sleep = lambda _: set_fault(pool.of(name), name, "alarm", **options)
    with pytest.raises(HardwareError, match=r"ALARM:[13]|alarm during the move: axis 1: FD"):
        stage.move_to(TARGET)
    assert stands_still(pool, kind, name)
    assert stage.state().alarm is not None
    stage.close()


@pytest.mark.parametrize(("code", "silent"), [(1, True), (2, True), (3, False)])
def test_grbl_alarms_are_not_cleared(pool: Pool, code: int, silent: bool) -> None:
    name, stage = at_start(pool, "grbl")
    set_fault(pool.of(name), name, "alarm", code=code)
    time.sleep(0.05)
    with pytest.raises(HardwareError, match=f"ALARM:{code} "):
        stage.move_to(TARGET)
    state = stage.state()
    assert state.referenced is False
    assert ("until it is reset" in (state.alarm or "")) is silent
    assert ("locked" in (state.alarm or "")) is not silent
    with pytest.raises(HardwareError, match="was not moved: alarm: "):
        stage.move_to(START)
    stage.close()
    if silent:  # the next program finds it still silent
        with pytest.raises(HardwareError, match="or a limit alarm \\(press its reset button"):
            open_kind("grbl", pool.of(name).ports[name])
    else:
        again = open_kind("grbl", pool.of(name).ports[name])
        again.home()
        again.move_to(START)
        again.close()


def test_zaber_faults_are_not_cleared(pool: Pool) -> None:
    name, stage = at_start(pool, "zaber")
    set_fault(pool.of(name), name, "alarm", flag="FD", axis="2")
    with pytest.raises(HardwareError, match=r"axis 2: FD \(the driver is disabled.*warnings clear"):
        stage.move_to(TARGET)
    assert stage.state().alarm is not None
    stage.close()


@pytest.mark.parametrize("kind", KINDS)
def test_switched_off_in_the_middle(pool: Pool, kind: str) -> None:
    """The count begins anew, so the stage is not where it was sent, whatever the device says."""
    name, stage = at_start(pool, kind)
    stage._clock.sleep = lambda _: (set_fault(pool.of(name), name, "power_cycle"), time.sleep(0.02))[1]
    with pytest.raises(HardwareError):
        stage.move_to(TARGET)
    assert stage.state().referenced is False
    stage.close()


@pytest.mark.parametrize("kind", KINDS)
def test_the_cable_is_pulled_while_it_stands(pool: Pool, kind: str) -> None:
    name, stage = at_start(pool, kind)
    unplug(pool.of(name), name)
    with pytest.raises(LinkLostError, match=f"stage \\({kind}\\) on .*the device is gone"):
        stage.state()
    with pytest.raises(LinkLostError):
        stage.move_to(TARGET)
    stage.close()


@pytest.mark.parametrize("kind", KINDS)
def test_the_cable_is_pulled_at_every_step_of_a_move(pool: Pool, kind: str) -> None:
    """From the first command of a move to the last look at it; the error says that the stage may still move."""
    said: list[str] = []
    for after in range(99):
        name, stage = at_start(pool, kind)
        set_fault(pool.of(name), name, "vanish", after=after, obeyed=after % 2 == 1)
        try:
            stage.move_to(TARGET)
        except LinkLostError as error:
            said.append(str(error))
            stage.close()
        else:
            stage.close()
            assert real(pool, kind, name) == pytest.approx(units(kind, TARGET), abs=STEP[kind])
            break
    assert len(said) >= 4
    stopped = [text for text in said if "Stopping it failed" in text]
    assert stopped
    assert all("so it may still move" in text for text in stopped)


FAULTS = {
    "drop": {},
    "delay": {"delay_s": 0.7},
    "truncate": {"keep": 5},
    "garbage_before": {"bytes": 4},
    "garbage_instead": {"bytes": 6},
}


def suffer(pool: Pool, kind: str, fault: str, after: int) -> HardwareError | None:
    """Move once with one spoilt reply; the error with which it failed. Asserts that it is one thing or the other."""
    name, stage = at_start(pool, kind, timeout_s=0.5)
    set_fault(pool.of(name), name, fault, after=after, count=1, seed=after, **FAULTS[fault])
    failed: HardwareError | None = None
    try:
        state = stage.move_to(TARGET)
    except HardwareError as error:
        failed = error
    else:
        assert state.posture == Posture(pytest.approx(30.0), pytest.approx(250.0))
        assert real(pool, kind, name) == pytest.approx(units(kind, TARGET), abs=STEP[kind])
    if failed is not None:
        assert stands_still(pool, kind, name)
    stage.close()
    return failed


@pytest.mark.parametrize("first", [pytest.param(0, id="even"), pytest.param(1, id="odd", marks=pytest.mark.nightly)])
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("kind", KINDS)
def test_one_spoilt_reply(pool: Pool, kind: str, fault: str, first: int) -> None:
    """Lost, late, cut short, or with noise: asked again where that does no harm, and verified in any case."""
    failed = {after: error for after in range(first, 9, 2) if (error := suffer(pool, kind, fault, after)) is not None}
    assert not failed


@pytest.mark.parametrize("kind", KINDS)
def test_no_reply_at_all(pool: Pool, kind: str) -> None:
    name, stage = at_start(pool, kind, timeout_s=0.5)
    set_fault(pool.of(name), name, "drop", count=None)
    began = time.monotonic()
    with pytest.raises(HardwareError, match=r"no reply after(.|\n)*No move had been sent to it"):
        stage.move_to(TARGET)
    assert time.monotonic() - began < 60
    assert real(pool, kind, name) == pytest.approx(units(kind, START), abs=STEP[kind])
    stage.close()


def test_zaber_wrong_checksums(pool: Pool) -> None:
    name, stage = at_start(pool, "zaber")
    set_fault(pool.of(name), name, "checksum", count=1)
    stage.move_to(TARGET)
    assert any("checksum" in event.what and event.retry for event in stage.events)
    set_fault(pool.of(name), name, "checksum", count=None)
    with pytest.raises(HardwareError, match="the checksum should be"):
        stage.move_to(START)
    stage.close()
