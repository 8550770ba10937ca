"""The angles that a light may take: its ranges at a step."""

import math
from collections.abc import Sequence

from lightopt.config import LightConfig, RigConfig
from lightopt.core.errors import InputError

MOST_POSITIONS = 100_000  # candidate positions of a light; more are refused


def can_move(light: LightConfig) -> bool:
    """Whether a light has a range in either angle."""
    return light.elevation_range_deg is not None or light.azimuth_range_deg is not None


def light_angles(
    rig: RigConfig, index: int, *, step_deg: float, elevations: Sequence[float] | None = None
) -> list[tuple[float, float]]:
    """Candidate (elevation, azimuth) of a light [°], ascending by elevation, then azimuth.

    Both ends of a range are candidates, and from the lower one on every `step_deg`. A light without a range stays at
    that angle. `elevations` replaces those of the light's range, for lights that share their elevation.

    Raises InputError: A step that is not a positive number, or that makes too many positions.
    """
    if not (math.isfinite(step_deg) and step_deg > 0.0):
        raise InputError(f"option 'step_deg': expected degrees above 0, found {step_deg:g}")
    light = rig.lights[index]
    if elevations is None or light.elevation_range_deg is None:
        elevations = _steps(light.elevation_range_deg, light.elevation_deg, step_deg)
    azimuths = _steps(light.azimuth_range_deg, light.azimuth_deg, step_deg)
    if len(azimuths) > 1 and math.isclose(azimuths[-1] - azimuths[0], 360.0):
        azimuths.pop()  # the full turn ends where it begins
    if len(elevations) * len(azimuths) > MOST_POSITIONS:
        raise InputError(
            f"{rig.source.at('lights', index)}: at option 'step_deg' {step_deg:g} light {light.name} has more than "
            f"{MOST_POSITIONS:,} positions, the most that are accepted; take a larger step"
        )
    return [(elevation, azimuth) for elevation in elevations for azimuth in azimuths]


def common_elevations(rig: RigConfig, *, step_deg: float) -> list[float] | None:
    """The elevations that all lights with an elevation range can share [°]; None where no light has one.

    Raises InputError: Ranges that do not overlap.
    """
    movable = [light for light in rig.lights if light.elevation_range_deg is not None]
    if not movable:
        return None
    highest_low = max(movable, key=lambda light: _ends(light)[0])
    lowest_high = min(movable, key=lambda light: _ends(light)[1])
    low, high = _ends(highest_low)[0], _ends(lowest_high)[1]
    if low > high:
        raise InputError(
            f"{rig.source.at('lights')}: option 'common_elevation': {highest_low.name} stays at {low:g}° or above and "
            f"{lowest_high.name} at {high:g}° or below, so that there is no elevation for both; widen a range"
        )
    return _steps((low, high), low, step_deg)


def _ends(light: LightConfig) -> tuple[float, float]:
    assert light.elevation_range_deg is not None
    return light.elevation_range_deg


def _steps(ends: tuple[float, float] | None, now: float, step: float) -> list[float]:
    if ends is None:
        return [now]
    low, high = ends
    # a last step that only rounding keeps from the end is the end
    count = (high - low) / step + 1e-9  # infinite for the least of steps
    if count > MOST_POSITIONS:
        return [low] * (MOST_POSITIONS + 1)
    angles = [round(low + k * step, 9) for k in range(math.floor(count) + 1)]
    return angles if math.isclose(angles[-1], high, abs_tol=1e-9) else [*angles, high]
