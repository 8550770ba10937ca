"""Whether two exposures show the same light: where neither is saturated they differ by the exposure alone."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lightopt.optics import Sensor
from lightopt.rig.capture._frames import Exposed

LEAST_LEVEL = 1.5
"""Pixels count that should be at least so far above black in the shorter exposure [sensor level]."""

LEAST_PIXELS = 30

MOST_PIXELS = 200_000
"""Of larger images a grid of about so many pixels is compared: the next exposure waits for it."""

TOLERANCE = 0.1
"""Share by which the exposures may differ: exposure times of cameras are not exact."""

TOLERANCE_LEVELS = 0.4
"""And so many levels: what is clipped at level 0, and a black level that is not quite right."""

Float32 = NDArray[np.float32]


def exposures_disagree(
    light: str,
    one: Exposed,
    other: Exposed,
    *,
    darks: tuple[Float32 | float, Float32 | float],
    sensor: Sensor,
) -> str | None:
    """Say in words how the brightness of a light differs between two exposures; None where it does not.

    Pixels that are saturated in the longer exposure must be at least as bright as that says in the shorter one.

    Parameters
    ----------
    light
        That burned.
    one, other
        The exposures, of one shape (H, W).
    darks
        What each shows without the light [sensor level], (H, W) or one level.
    sensor
        That took them.
    """
    first = (one, np.asarray(darks[0], np.float32))
    second = (other, np.asarray(darks[1], np.float32))
    (long, long_dark), (short, short_dark) = (
        (first, second) if one.exposure >= other.exposure else (second, first)
    )
    ratio = short.exposure / long.exposure
    step = max(1, round(math.sqrt(long.mean.size / MOST_PIXELS)))
    some = (slice(step // 2, None, step), slice(step // 2, None, step))
    long_dark, short_dark = (dark[some] if dark.ndim else dark for dark in (long_dark, short_dark))
    long_full, short_full = long.saturated[some], short.saturated[some]
    expected = np.minimum(long.mean[some], sensor.saturated_from) - long_dark
    expected = expected * np.float32(ratio)
    seen = short.mean[some] - short_dark
    bright = expected >= LEAST_LEVEL
    both = bright & ~long_full & ~short_full
    only_long = bright & long_full & ~short_full
    for where, least in ((both, False), (only_long, True)):
        count = int(np.count_nonzero(where))
        if count < LEAST_PIXELS:
            continue
        should, found = (float(a[where].mean(dtype=np.float64)) for a in (expected, seen))
        off = found - should
        noise = sensor.noise_variance(should)
        allowed = TOLERANCE * should + TOLERANCE_LEVELS + 6.0 * float(np.sqrt(2.0 * noise / count))
        if off < -allowed or (off > allowed and not least):
            return (
                f"{light} is {max(found, 0.0) / should:.0%} as bright as at exposure {other.exposure:g}"
                if one is short
                else f"{light} is {should / max(found, 1e-3):.0%} as bright as at exposure {other.exposure:g}"
            ) + ": it went out, changed, or another light came on between the exposures"
    return None
