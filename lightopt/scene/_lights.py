"""From a rig's file to its lights: panels where they stand, and the surfaces of lights of other kinds."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lightopt import lights
from lightopt.config import HOUSED, LightConfig, RigConfig, points_problem, standing_at
from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError, refuse
from lightopt.core.transforms import rotation_from_vector
from lightopt.images import read_png
from lightopt.scene._scene import Housings

# elements of whole lights: each is seen or hidden as its middle is, so that they decide how finely shadows are known
AROUND, UP_DOME, ACROSS, ALONG = 24, 4, 8, 6


def build_lights(
    rig: RigConfig, names: Sequence[str] | None = None, points: int | Literal["auto"] | None = None
) -> tuple[lights.PanelLight, ...]:
    """The rig's lights, world frame; each channel of a light is one, or each image of the rig's programme.

    points: Point lights per panel, instead of the rig's
    Raises InputError: One of `names` that the rig does not have
    """
    known = [light.name for light in rig.lights]
    there = f"in {rig.source.path}; it has {', '.join(known)}"
    refuse(f'no light "{name}" {there}' for name in names or () if name not in known)
    chosen = [light for light in rig.lights if names is None or light.name in names]
    return tuple(_light(rig, one, points) for one in chosen)


def build_housings(rig: RigConfig) -> Housings | None:
    """The housings of the rig's lights, world frame; None where they are as bright as the surroundings."""
    own = rig.environment.housings
    if own is None or own.level == rig.environment.level:
        return None
    rows = [
        [light.centre, light.outward, light.across / across, light.along / along]
        for light, (across, along) in _housed(rig)
    ]
    return Housings(level=own.level, rectangles=np.array(rows))


def housing_corners(rig: RigConfig) -> dict[str, Float64]:
    """Corners of each light's housing in order around it [mm], shape (4, 3), world frame."""
    around = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    return {
        light.name: light.centre + around * half @ np.array([light.across, light.along]) for light, half in _housed(rig)
    }


def _housed(rig: RigConfig) -> list[tuple[lights.PanelLight, tuple[float, float]]]:
    # the lights that have a housing, and half of the lengths of its sides [mm]
    own = rig.environment.housings
    if own is None:
        return []
    some = [_light(rig, one, None) for one in rig.channels if one.channel == 0 and one.kind in HOUSED]
    return [(one, (0.5 * one.size[0] + own.margin_mm, 0.5 * one.size[1] + own.margin_mm)) for one in some]


def _light(rig: RigConfig, light: LightConfig, points: int | Literal["auto"] | None) -> lights.PanelLight:
    if not light.mixture:
        return _panel(rig, light, points) if light.kind == "panel" else _surface_light(rig, light)
    parts = [(_light(rig, one, points), weight) for one, weight in light.mixture]
    first, weight = parts[0]
    if not isinstance(first, lights.SurfaceLight):
        # panels are alone
        return replace(first, name=light.name, gain=weight * first.gain)
    return lights.mixed_light(
        light.name, [(one, weight) for one, weight in parts if isinstance(one, lights.SurfaceLight)]
    )


def _where(light: LightConfig) -> dict[str, Any]:
    return {"elevation": math.radians(light.elevation_deg), "azimuth": math.radians(light.azimuth_deg)}


def _panel(rig: RigConfig, light: LightConfig, points: int | Literal["auto"] | None) -> lights.PanelLight:
    if points is not None and (problem := points_problem(points)):
        raise InputError(f"points of {light.name}: {problem}")
    shared = rig.light_source
    assert shared is not None
    own = {key: getattr(light, key) for key in type(shared).model_fields if getattr(light, key) is not None}
    source = shared.model_copy(update=own)
    panel: dict[str, Any] = {
        "name": light.name,
        "size": source.size_mm,
        "points": source.points if points is None else points,
        "normalisation": source.normalisation,
        "gain": light.gain,
        "inverse_square": source.falloff == "inverse_square",
        "emission_exponent": source.emission_exponent,
        "reference_distance": source.reference_distance_mm,
    }
    if light.pose is None:
        return lights.place_light(distance=light.distance_mm, **_where(light), **panel)
    measured = standing_at(light.pose.centre_mm)
    return lights.pose_light(
        centre=np.array(light.pose.centre_mm, np.float64) * (light.distance_mm / measured["distance_mm"]),
        rotation=rotation_from_vector(np.radians(light.pose.rotation_vector_deg)),
        start=(math.radians(measured["elevation_deg"]), math.radians(measured["azimuth_deg"])),
        **_where(light),
        **panel,
    )


def _surface_light(rig: RigConfig, light: LightConfig) -> lights.PanelLight:
    own, whole, size = _elements(light)
    gain = light.gain
    if light.kind == "coaxial":
        gain *= _or(light.transmission, 0.5) * _or(light.reflection, 0.5)
    panel = lights.place_light(
        distance=light.distance_mm, **_where(light), name=light.name, size=size, points="auto", gain=gain
    )
    more: dict[str, Any] = {} if light.pattern is None else {"pattern": _pattern(rig.source.path.parent, light)}
    if light.direct_level and light.gain > 0.0:
        more["direct_level"] = light.direct_level / light.gain
    return lights.surface_light(panel, kind=light.kind, entry=light.entry, elements=own, whole=whole, **more)


def _or(value: float | None, default: float) -> float:
    return default if value is None else value


def _given(*values: float | None) -> list[float]:
    # of keys that the light's kind needs
    return [value for value in values if value is not None]


def _elements(light: LightConfig) -> tuple[Float64, Float64 | None, tuple[float, float]]:
    # elements of a channel and of the whole light where that has others, and the sides of the rectangle around it
    size = light.size_mm or (0.0, 0.0)
    match light.kind:
        case "ring":
            inner, outer = _given(light.inner_radius_mm, light.outer_radius_mm)
            height = (outer - inner) * math.tan(math.radians(_or(light.ring_tilt_deg, 0.0)))
            return *_around(light, ((inner, 0.5 * height), (outer, -0.5 * height))), _square(outer)
        case "low_angle_ring":
            radius, height = _given(light.radius_mm, light.height_mm)
            return *_around(light, ((radius, 0.5 * height), (radius, -0.5 * height))), _square(radius)
        case "spot":
            (half_angle,) = _given(light.half_angle_deg)
            radius = light.distance_mm * math.tan(math.radians(half_angle))
            return lights.cone_elements((0.0, 0.0), (radius, 0.0), (0.0, 2.0 * math.pi), (4, 1)), None, _square(radius)
        case "dome":
            return _dome(light)
        case "tunnel":
            radius, length = _given(light.radius_mm, light.length_mm)
            return lights.half_pipe_elements(radius, length, _or(light.slot_mm, 0.0)), None, (length, 2.0 * radius)
        case "flat_dome" if light.camera_hole_mm is not None:
            return lights.frame_elements(size, light.camera_hole_mm), None, size
        case "led_array":
            return *_led(light, size), size
        case _:
            return lights.plane_elements(size, _cells(size)), None, size


def _square(radius: float) -> tuple[float, float]:
    return 2.0 * radius, 2.0 * radius


def _cells(size: tuple[float, float]) -> tuple[int, int]:
    # elements of a rectangle, not much longer than wide
    ratio = size[0] / size[1]
    if ratio >= 1.0:
        return ACROSS, max(1, min(ALONG, round(ACROSS / ratio)))
    return max(1, round(ALONG * ratio)), ALONG


def _turn(light: LightConfig) -> tuple[tuple[float, float], int]:
    # azimuths of a segment, and how many elements it has around
    segments = light.segments or 1
    step, number = 2.0 * math.pi / segments, light.channel % segments  # channels of a pattern all have the whole light
    return (number * step, (number + 1) * step), math.ceil(AROUND / segments)


def _around(
    light: LightConfig, profile: tuple[tuple[float, float], tuple[float, float]]
) -> tuple[Float64, Float64 | None]:
    turn, around = _turn(light)
    own = lights.cone_elements(*profile, turn, (around, 1))
    segments = light.segments or 1
    return own, None if segments == 1 else lights.cone_elements(*profile, (0.0, 2.0 * math.pi), (around * segments, 1))


def _dome(light: LightConfig) -> tuple[Float64, Float64 | None, tuple[float, float]]:
    (radius,), (turn, around) = _given(light.radius_mm), _turn(light)
    hole = math.acos(min(1.0, 0.5 * _or(light.camera_hole_mm, 0.0) / radius))
    up = math.radians(_or(light.lower_elevation_deg, 0.0)), hole
    own = lights.sphere_elements(radius, turn, up, (around, UP_DOME))
    size, segments = _square(radius), light.segments or 1
    if segments == 1:
        return own, None, size
    whole = lights.sphere_elements(radius, (0.0, 2.0 * math.pi), up, (around * segments, UP_DOME))
    leak = _or(light.leak, 0.0)
    if leak == 0.0:
        return own, whole, size
    # what leaks comes from all of the dome; the segment's own elements shine the more
    everywhere = whole.copy()
    everywhere[:, lights.RADIANCE] = leak / segments
    first = len(own) * light.channel
    everywhere[first : first + len(own), lights.RADIANCE] += 1.0 - leak
    return everywhere, whole, size


def _led(light: LightConfig, size: tuple[float, float]) -> tuple[Float64, Float64]:
    assert light.rows is not None
    assert light.columns is not None
    across, along = (
        [side * ((i + 0.5) / count - 0.5) for i in range(count)]
        for side, count in zip(size, (light.columns, light.rows), strict=True)
    )
    side = _or(light.led_mm, 0.0)
    leds = [lights.plane_elements((side, side), (1, 1), centre=(u, v)) for v in along for u in across]
    return leds[light.channel], np.concatenate(leds)


def _pattern(folder: Path, light: LightConfig) -> lights.Pattern:
    pattern = light.pattern
    assert pattern is not None
    if pattern.files is not None:
        assert light.size_mm is not None
        paths = [folder / file for file in pattern.files]
        return _pictures(tuple((path, path.stat().st_mtime_ns) for path in paths), light.size_mm)[light.channel]
    periods = pattern.periods_mm or (math.radians(pattern.period_deg or 360.0),)
    block, step = divmod(light.channel, pattern.steps)
    direction, number = divmod(block, len(periods))
    axis = "uv".index(pattern.directions[direction])
    period, phase = periods[number], -2.0 * math.pi * step / pattern.steps
    if pattern.kind == "bars":
        return lights.bar_pattern(axis, period=period, phase=phase, duty=pattern.duty)
    return lights.sine_pattern(axis, period=period, phase=phase)


def display_picture(light: LightConfig, pixels: tuple[int, int], *, folder: Path = Path()) -> Float64:
    """Share of the full radiance of each pixel, shape (rows, columns), as :func:`lightopt.lights.picture_light` has it.

    light: A channel of a display; white without a pattern
    pixels: Columns and rows as seen from the part, with `along` upwards
    folder: Of the rig's file, which names of pictures are relative to
    """
    if light.pattern is None:
        return np.ones(pixels[::-1])
    assert light.size_mm is not None
    return lights.pattern_picture(_pattern(folder, light), light.size_mm, pixels)


@lru_cache(maxsize=4)
def _pictures(files: tuple[tuple[Path, int], ...], size: tuple[float, float]) -> list[lights.Pattern]:
    # of files with the time of their last change: every channel of a display asks for them
    read = [read_png(path) for path, _ in files]
    return lights.picture_patterns([levels / np.iinfo(levels.dtype).max for levels in read], size)
