"""What every stage driver promises, each against its simulated firmware over a real pseudo-terminal and over TCP."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass

import pytest
from faulty_bench import set_fault
from stage_worlds import AXES, DEVICE_AXES, HOMED, KINDS, STEP, Pool, open_kind

from lightopt.core.errors import HardwareError, InputError
from lightopt.core.transforms import Posture
from lightopt.rig.devices._stage import Clock, Stage

WIRES = ["tcp"] if os.name == "nt" else ["pty", "tcp"]


@pytest.fixture(scope="module")
def pool() -> Iterator[Pool]:
    pool = Pool()
    yield pool
    pool.close()


@dataclass
class World:
    """A stage and the bench that it stands on."""

    kind: str
    name: str
    pool: Pool
    stage: Stage

    @property
    def port(self) -> str:
        return self.pool.of(self.name).ports[self.name]

    def real(self) -> tuple[float, float]:
        places = self.pool.of(self.name).positions(self.name)
        first, second = DEVICE_AXES[self.kind]
        return places[first], places[second]

    def wanted(self, posture: Posture) -> tuple[float, float]:
        tilt, turn = AXES[self.kind]
        return tilt.units_of(posture.elevation_deg), turn.units_of(posture.rotation_deg)

    def fault(self, fault: str, **options: object) -> None:
        set_fault(self.pool.of(self.name), self.name, fault, **options)


@pytest.fixture(params=[(kind, wire) for kind in KINDS for wire in WIRES], ids=lambda p: "-".join(p))
def world(request: pytest.FixtureRequest, pool: Pool) -> Iterator[World]:
    kind, wire = request.param
    name = pool.take(kind, wire)
    stage = open_kind(kind, pool.of(name).ports[name])
    yield World(kind, name, pool, stage)
    stage.close()


@pytest.fixture
def homed(world: World) -> World:
    world.stage.home()
    return world


def test_it_plays_the_role(world: World) -> None:
    stage: Stage = world.stage
    identity = stage.identify()
    assert (identity["driver"], identity["port"]) == (world.kind, world.port)
    assert len(identity) > 2
    json.dumps(identity)
    state = stage.state()
    assert state.moving is False
    assert state.referenced in (False, None)


def test_asking_moves_nothing(world: World) -> None:
    before = world.real()
    world.stage.identify()
    world.stage.state()
    assert world.real() == before


def test_home(world: World) -> None:
    world.stage.home()
    assert world.real() == (HOMED[world.kind],) * 2
    state = world.stage.state()
    assert (state.referenced, state.moving, state.alarm) == (True, False, None)


def test_homes_again_where_it_is(homed: World) -> None:
    homed.stage.home()
    assert homed.real() == (HOMED[homed.kind],) * 2


def test_moves_and_stands_there(homed: World) -> None:
    for posture in (Posture(0.0, 0.0), Posture(-45.0, 360.0), Posture(20.0, 360.0), Posture(20.0, 90.0)):
        state = homed.stage.move_to(posture)
        assert state.posture.elevation_deg == pytest.approx(posture.elevation_deg, abs=1e-9)
        assert state.posture.rotation_deg == pytest.approx(posture.rotation_deg, abs=1e-9)
        assert (state.moving, state.referenced, state.alarm) == (False, True, None)
        assert homed.real() == pytest.approx(homed.wanted(posture), abs=STEP[homed.kind])
        assert homed.stage.state() == state


def test_is_there_already(homed: World) -> None:
    homed.stage.move_to(Posture(10.0, 20.0))
    waits: list[float] = []
    homed.stage._clock = Clock(sleep=waits.append)
    homed.stage.move_to(Posture(10.0, 20.0))
    assert not waits


def test_out_of_range(homed: World) -> None:
    before = homed.real()
    for posture in (Posture(-45.01, 0.0), Posture(0.0, 360.1), Posture(90.0, 999.0)):
        with pytest.raises(InputError, match="outside the rig's range"):
            homed.stage.move_to(posture)
    with pytest.raises(InputError) as failed:
        homed.stage.move_to(Posture(90.0, 999.0))
    assert len(failed.value.messages) == 2
    assert homed.real() == before


def test_between_two_steps_is_reported(homed: World) -> None:
    requested = Posture(10.0012345, 20.0)
    state = homed.stage.move_to(requested)
    tilt = AXES[homed.kind][0]
    assert abs(state.posture.elevation_deg - requested.elevation_deg) <= STEP[homed.kind] / 2 / tilt.steps_per_deg
    assert any("elevation: 10.0012° lies between two steps" in event.what for event in homed.stage.events)


def test_travel_time(homed: World) -> None:
    start, end = Posture(-40.0, 10.0), Posture(40.0, 40.0)
    homed.stage.move_to(start)
    expected = 80 / 800
    began = time.monotonic()
    homed.stage.move_to(end)
    assert 0.8 * expected < time.monotonic() - began < expected + 10.0


def test_interrupted_in_the_middle_it_stops(homed: World) -> None:
    looks = 0

    def interrupt(seconds: float) -> None:
        nonlocal looks
        looks += 1
        if looks == 1:
            raise KeyboardInterrupt
        time.sleep(seconds)

    homed.stage._clock = Clock(sleep=interrupt)
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        homed.stage.move_to(Posture(40.0, 300.0))
    short_of_the_end = time.monotonic() - began < 0.8 * 300 / 800  # a busy machine may stop it too late
    stands = homed.real()
    if short_of_the_end:
        assert stands != pytest.approx(homed.wanted(Posture(40.0, 300.0)), abs=1.0)
    time.sleep(0.1)
    assert homed.real() == stands
    with pytest.raises(HardwareError, match="lightopt bench home RIG"):
        homed.stage.move_to(Posture(0.0, 0.0))
    homed.stage.home()
    homed.stage.move_to(Posture(0.0, 0.0))


def test_stop_when_it_stands_still(homed: World) -> None:
    homed.stage.stop()
    assert homed.stage.state().moving is False
    homed.stage.move_to(Posture(5.0, 5.0))
    assert homed.real() == pytest.approx(homed.wanted(Posture(5.0, 5.0)), abs=STEP[homed.kind])


def test_switched_off_between_two_moves(homed: World) -> None:
    homed.stage.move_to(Posture(-30.0, 90.0))
    assert homed.stage.confirm().posture == homed.stage.state().posture
    homed.fault("power_cycle")
    before = homed.real()
    with pytest.raises(HardwareError, match="lightopt bench home RIG"):
        homed.stage.confirm()
    with pytest.raises(HardwareError, match=r"was not moved: .*lightopt bench home RIG"):
        homed.stage.move_to(Posture(0.0, 0.0))
    assert homed.real() == before
    assert homed.stage.state().referenced is False
    homed.stage.home()
    homed.stage.move_to(Posture(0.0, 0.0))
    assert homed.real() == pytest.approx(homed.wanted(Posture(0.0, 0.0)), abs=STEP[homed.kind])


@pytest.mark.skipif(os.name == "nt", reason="a TCP device on Windows takes one client by itself")
def test_one_program_at_a_time(pool: Pool) -> None:
    for kind in KINDS:
        name = pool.take(kind)
        stage = open_kind(kind, pool.of(name).ports[name])
        with pytest.raises(HardwareError, match="in use"):
            open_kind(kind, pool.of(name).ports[name])
        stage.close()
        open_kind(kind, pool.of(name).ports[name]).close()


def test_close_moves_nothing_and_never_raises(homed: World) -> None:
    before = homed.real()
    homed.stage.close()
    homed.stage.close()
    assert homed.real() == before
