"""Simulated firmware driven by clients that others wrote, so that driver and firmware are not wrong in the same way.

``pyOptoSigma`` and ``SigmaKokiPy`` speak to SHOT controllers, ``zaber-motion`` is Zaber's own library.
"""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Iterator
from typing import Any

import pytest
from faulty_bench import set_fault
from stage_worlds import KINDS, Pool, open_kind

with warnings.catch_warnings():  # one of them has an escape sequence that Python no longer likes
    warnings.simplefilter("ignore")
    import pyOptoSigma
    from SigmaKokiPy.SK_SHOT import StageControlShot

posix = pytest.mark.skipif(
    os.name == "nt", reason="these clients open serial ports only, and Windows has no pseudo ones"
)


@pytest.fixture(scope="module")
def pool() -> Iterator[Pool]:
    pool = Pool(batch=4)
    yield pool
    pool.close()


@posix
def test_pyoptosigma_drives_the_shot_firmware(pool: Pool) -> None:
    name = pool.take("shot")
    bench = pool.of(name)
    session = pyOptoSigma.Session(pyOptoSigma.Controllers.SHOT_302GS, wait_time=0.02)
    session.append_stage(pyOptoSigma.Stages.SGSP_60A75)  # 0.002° a full step, two pulses to a step
    session.append_stage(pyOptoSigma.Stages.SGSP_60YAW)  # 0.005°
    session.connect(bench.ports[name])
    try:
        session.initialize()
        assert bench.positions(name) == {"1": 0.0, "2": 0.0}
        assert session.get_status() == ([0, 0], "K", "K", "R")
        session.set_speed(stage=1, S=5000, F=100_000, R=100)
        session.set_speed(stage=2, S=5000, F=100_000, R=100)
        session.move(amount=(-4500, 82_000), absolute=True)  # thousandths of a degree
        assert bench.positions(name) == {"1": -4500.0, "2": 32_800.0}
        session.move(stage=2, amount=-2000, absolute=False)
        assert bench.positions(name) == {"1": -4500.0, "2": 32_000.0}
        assert session.get_position() == [-4500.0, 80_000.0]
        session.move(stage=2, amount=90_000, absolute=True, wait_for_finish=False)
        with pytest.raises(pyOptoSigma.Bad_Command_Parameter_or_Timing):
            session.move(stage=1, amount=10, in_pulse=True)  # it moves: NG
        session.stop(emergency=True)
        assert session.is_ready()
    finally:
        session.port.close()


@posix
def test_sigmakokipy_drives_the_shot_firmware(pool: Pool) -> None:
    name = pool.take("shot")
    bench = pool.of(name)
    client: Any = StageControlShot(bench.ports[name], "SHOT-702 / SHOT-302GS", 9600)
    try:
        assert client.ReturnMechanicalOriginAll()
        settle(client)
        assert bench.positions(name) == {"1": 0.0, "2": 0.0}
        assert client.SetSpeedSinglePulse(1, 50_000, 100)
        client.SetStrokeLimitMaxPulse(1, 99_999)
        client.SetStrokeLimitMinPulse(1, -99_999)
        assert client.AbsoluteDriveSinglePulse(1, 1800)
        settle(client)
        assert client.GetPositionPulse(1) == 1800
        assert bench.positions(name)["1"] == 1800.0
        client.StopDriveAll()
    finally:
        client.comports.close()


def settle(client: Any) -> None:
    """Ask until it is ready."""
    until = time.monotonic() + 60
    while True:
        client.UpdateStatus()
        if not client.IsBusy:
            return
        assert time.monotonic() < until


@pytest.mark.parametrize("wire", ["tcp"] if os.name == "nt" else ["pty", "tcp"])
def test_zaber_motion_drives_the_zaber_firmware(pool: Pool, wire: str) -> None:
    from zaber_motion import Units
    from zaber_motion.ascii import Connection
    from zaber_motion.exceptions import BadCommandException, BadDataException

    name = pool.take("zaber", wire)
    bench = pool.of(name)
    port = bench.ports[name]
    if wire == "tcp":
        host, _, number = port.removeprefix("socket://").rpartition(":")
        connection = Connection.open_tcp(host, int(number))
    else:
        connection = Connection.open_serial_port(port)
    try:
        connection.disable_alerts() if hasattr(connection, "disable_alerts") else None
        device = connection.get_device(1)
        tilt, turn = device.get_axis(1), device.get_axis(2)
        assert not tilt.is_homed()
        tilt.home()
        turn.home()
        assert tilt.is_homed()
        assert bench.positions(name) == {"1": 0.0, "2": 0.0}
        tilt.settings.set("maxspeed", 1_638_400)
        tilt.move_absolute(82_000, Units.NATIVE)
        assert tilt.get_position() == 82_000
        assert bench.positions(name)["1"] == 82_000.0
        turn.move_absolute(50_000, Units.NATIVE, wait_until_idle=False)
        assert turn.is_busy()
        turn.stop()
        assert 0 < turn.get_position() < 50_000
        with pytest.raises(BadDataException):
            tilt.move_absolute(9_999_999, Units.NATIVE)
        with pytest.raises(BadCommandException):
            tilt.generic_command("fly")
        set_fault(bench, name, "alarm", flag="FS", axis="1")
        assert tilt.warnings.get_flags() == {"FS"}
        assert tilt.warnings.clear_flags() == {"FS"}
    finally:
        connection.close()


@posix
@pytest.mark.parametrize("kind", KINDS)
def test_after_another_client_the_driver_finds_the_device_where_it_is(pool: Pool, kind: str) -> None:
    """Its own client, twice: the second has not seen the stage homed, and knows only what the device says."""
    name = pool.take(kind)
    first = open_kind(kind, pool.of(name).ports[name])
    first.home()
    first.close()
    second = open_kind(kind, pool.of(name).ports[name])
    state = second.state()
    assert state.referenced is (True if kind == "zaber" else None)
    assert state.alarm is None
    second.close()
