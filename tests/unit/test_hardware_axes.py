"""Angles to device units and back, and the status lines of the stages."""

from __future__ import annotations

import math

import pytest
from hypothesis import assume, given, strategies as st

from lightopt.core.errors import InputError
from lightopt.rig.devices import Axis
from lightopt.rig.devices._stage_grbl import parse_report
from lightopt.rig.devices._stage_sigmakoki import axis_command, parse_status, signed
from lightopt.rig.devices._stage_zaber import checksum, frame, parse_reply

steps = st.floats(1e-3, 1e6) | st.floats(-1e6, -1e-3)
angles = st.floats(-720, 720)


@given(steps_per_deg=steps, zero=st.floats(-1e6, 1e6), angle=angles)
def test_angle_to_units_and_back(steps_per_deg: float, zero: float, angle: float) -> None:
    axis = Axis("rotation", "1", (-720, 720), steps_per_deg=steps_per_deg, zero=zero)
    units = axis.units_of(angle)
    assert axis.angle_of(units) == pytest.approx(angle, abs=1e-6 + abs(zero / steps_per_deg) * 1e-12)
    assert (axis.units_of(angle + 1) > units) is (steps_per_deg > 0)


@given(steps_per_deg=steps, zero=st.floats(-1e6, 1e6), angle=angles, step=st.sampled_from([1.0, 0.004, 0.001]))
def test_a_target_is_a_whole_number_of_steps_within_half_of_one(
    steps_per_deg: float, zero: float, angle: float, step: float
) -> None:
    axis = Axis("rotation", "1", (-720, 720), steps_per_deg=steps_per_deg, zero=zero)
    target = axis.target(angle, step=step)
    assert math.isclose(target / step, round(target / step), abs_tol=1e-3)
    assert abs(target - axis.units_of(angle)) <= step / 2 * (1 + 1e-6) + abs(target) * 1e-12


@given(low=st.floats(-360, 360), high=st.floats(-360, 360), angle=angles)
def test_limits(low: float, high: float, angle: float) -> None:
    assume(low <= high)
    axis = Axis("elevation", "1", (low, high))
    if low <= angle <= high:
        axis.target(angle, step=1.0)
    elif angle < low - 1e-6 or angle > high + 1e-6:
        with pytest.raises(InputError, match="lies outside the rig's range"):
            axis.target(angle, step=1.0)


@given(
    positions=st.lists(st.integers(-16_777_215, 16_777_215), min_size=1, max_size=2),
    detached=st.booleans(),
    width=st.integers(8, 12),
    ack1=st.sampled_from("KX"),
    ack2=st.sampled_from("KLMW"),
    ack3=st.sampled_from("BR"),
)
def test_status_lines(positions: list[int], detached: bool, width: int, ack1: str, ack2: str, ack3: str) -> None:
    fields = [f"{'-' if p < 0 else ' '}{abs(p):{width}d}" if detached else f"{p:{width}d}" for p in positions]
    status = parse_status(",".join([*fields, ack1, ack2, ack3]).encode() + b"\r\n")
    assert status.positions == tuple(positions)
    assert (status.accepted, status.limit is None, status.busy) == (ack1 == "K", ack2 == "K", ack3 == "B")


def test_status_lines_that_were_seen() -> None:
    assert parse_status(b"        100,        -20,K,K,R\r\n").positions == (100, -20)
    assert parse_status(b"-    1000,K,L,B\r\n").positions == (-1000,)


@given(st.binary(max_size=40))
def test_noise_is_no_status(noise: bytes) -> None:
    try:
        status = parse_status(noise)
    except ValueError:
        return
    assert noise.count(b",") >= 3
    assert status.positions


@pytest.mark.parametrize(
    "line",
    [
        b"\r\n",
        b"OK\r\n",
        b"        100,K,K\r\n",
        b"        1x0,        -20,K,K,R\r\n",
        b"        100,        -20,K,K,Q\r\n",
        b"        100,        -20,k,K,R\r\n",
        b"        1 0,        -20,K,K,R\r\n",
        b"-,        -20,K,K,R\r\n",
    ],
)
def test_broken_status_lines(line: bytes) -> None:
    with pytest.raises(ValueError, match="expected"):
        parse_status(line)


@given(first=st.integers(-99999, 99999), second=st.integers(-99999, 99999))
def test_words_of_both_axes(first: int, second: int) -> None:
    words = axis_command("A", {"1": signed(first), "2": signed(second)})
    assert words == f"A:W{'-' if first < 0 else '+'}P{abs(first)}{'-' if second < 0 else '+'}P{abs(second)}"


@given(device=st.integers(1, 99), axis=st.integers(0, 9), number=st.integers(0, 99), data=st.integers())
def test_zaber_replies_with_and_without_checksum(device: int, axis: int, number: int, data: int) -> None:
    body = f"{device:02d} {axis} {number:02d} OK IDLE -- {data}".encode()
    plain = parse_reply(b"@" + body + b"\r\n")
    assert parse_reply(b"@" + body + b":" + checksum(body) + b"\r\n") == plain
    assert (plain.device, plain.axis, plain.number, plain.data) == (device, axis, number, str(data))
    wrong = b"%02X" % ((int(checksum(body), 16) + 1) % 256)
    with pytest.raises(ValueError, match="checksum"):
        parse_reply(b"@" + body + b":" + wrong + b"\r\n")
    assert (sum(frame(device, axis, number, "x")[1:-4]) + int(frame(device, axis, number, "x")[-3:-1], 16)) % 256 == 0


@given(st.binary(max_size=40))
def test_noise_is_no_reply(noise: bytes) -> None:
    with pytest.raises(ValueError, match="broken"):
        parse_reply(noise)


@given(place=st.tuples(*[st.floats(-999, 999)] * 3), state=st.sampled_from(["Idle", "Run", "Hold:1", "Door:0", "Jog"]))
def test_grbl_reports(place: tuple[float, float, float], state: str) -> None:
    text = ",".join(f"{value:.3f}" for value in place)
    report = parse_report(f"<{state}|MPos:{text}|FS:0,0|Pn:XYZ|Ov:100,100,100>\r\n".encode())
    assert report is not None
    assert report[0] == state
    assert report[1] == pytest.approx(place, abs=6e-4)


def test_grbl_reports_that_are_none() -> None:
    assert parse_report(b"ok\r\n") is None
    assert parse_report(b"<Idle|MPos:0.000") is None
    with pytest.raises(ValueError, match=r"set \$10=1"):
        parse_report(b"<Idle|WPos:0.000,0.000,0.000|FS:0,0>\r\n")
    with pytest.raises(ValueError, match="without a machine position"):
        parse_report(b"<Idle|MPos:0.000,x,0.000|FS:0,0>\r\n")
