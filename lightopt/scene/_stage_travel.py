"""The order of postures in which the stage travels least, and how fast it goes."""

from collections.abc import Callable, Sequence
from itertools import permutations

from lightopt.config import RigConfig, StageDeviceConfig
from lightopt.core.transforms import Posture

VIRTUAL_DEG_PER_S = 90.0
"""Speed of both axes of the virtual bench's stage, which stands in for one that the rig's file does not name [°/s]."""

_EXACT_UP_TO = 7

Time = Callable[[Posture, Posture], float]


def travel_order(postures: Sequence[Posture], *, start: Posture, time: Time) -> tuple[Posture, ...]:
    """Postures in an order that takes the stage little time: the least for up to 7, else a good one.

    postures: In the order that counts where times are equal
    time: Of the move between two postures [s]
    """
    if len(postures) <= _EXACT_UP_TO:
        # ties go to the first permutation, the one nearest to the order given; rounding must not break them
        return min(permutations(postures), key=lambda order: round(_total(order, start, time), 6))
    left, order, here = list(postures), [], start
    while left:
        here = min(left, key=lambda posture: time(here, posture))
        left.remove(here)
        order.append(here)
    return _improved(order, start, time)


def travel_s(stage: StageDeviceConfig | None, start: Posture, end: Posture) -> float:
    """Seconds that a stage takes from one posture to another, both axes at a time.

    stage: The device; None for the virtual bench's
    """
    tilt, turn = end.elevation_deg - start.elevation_deg, end.rotation_deg - start.rotation_deg
    if stage is None:
        return max(abs(tilt), abs(turn)) / VIRTUAL_DEG_PER_S
    ways = ((stage.elevation, tilt), (stage.rotation, turn))
    return max((abs(way) / axis.speed_deg_per_s for axis, way in ways if axis is not None), default=0.0)


def pace_text(rig: RigConfig) -> str:
    """How fast the stage of a rig goes by :func:`travel_s`, and who says so."""
    if rig.hardware is None:
        return f"at {VIRTUAL_DEG_PER_S:g}°/s of the virtual bench, since the rig has no hardware section"
    stage = rig.hardware.stage
    if stage is None:
        return "the rig's hardware has no stage"
    axes = (("tilt", stage.elevation), ("rotation", stage.rotation))
    speeds = {name: axis.speed_deg_per_s for name, axis in axes if axis is not None}
    if len(set(speeds.values())) == 1:
        speed_text = f"{next(iter(speeds.values())):g}°/s"
    else:
        speed_text = ", ".join(f"{speed:g}°/s in {name}" for name, speed in speeds.items())
    return f"at {speed_text}, the speed_deg_per_s of the rig's hardware.stage"


def _total(order: Sequence[Posture], start: Posture, time: Time) -> float:
    return sum(time(a, b) for a, b in zip((start, *order), order, strict=False))


def _improved(order: list[Posture], start: Posture, time: Time) -> tuple[Posture, ...]:
    """Reverse stretches while that shortens the way (2-opt)."""
    best, better = _total(order, start, time), True
    while better:
        better = False
        for i in range(len(order) - 1):
            for j in range(i + 2, len(order) + 1):
                turned = order[:i] + order[i:j][::-1] + order[j:]
                total = _total(turned, start, time)
                if total < best - 1e-9:
                    order, best, better = turned, total, True
    return tuple(order)
