"""Where the lights stand, now and over their ranges: in the view, under the table, in collision."""

import itertools
import math
from collections.abc import Iterator

import numpy as np

from lightopt.config import RANGE_KEYS, RigConfig
from lightopt.core.errors import counted
from lightopt.lights import PanelLight, SurfaceLight, outlines, surface_mesh
from lightopt.preflight._fields import light_entries
from lightopt.preflight._findings import CheckedRig, CheckedScene, Finding, percent
from lightopt.rendering import hidden_by, panels_in_part
from lightopt.scene import area_in_view, build_lights, housing_corners, image_area, lights_meet

_ROUNDING_MM = 1e-6
STEP_DEG = 5.0  # a light's ranges are tried at least this finely where the camera's view is concerned


def check_lights_in_view(checked: CheckedRig) -> Iterator[Finding]:
    """Panels between the camera and what it looks at: they are in every picture, and hide what is behind them."""
    pixels = checked.camera.width * checked.camera.height
    clear = True
    for index, light in enumerate(checked.lights):
        if _is_backlight(light):
            continue  # made to be in the view; what it hides of a part is said with the part
        area = area_in_view(checked.camera, light)
        if area > 0.0:
            clear = False
            text = f"{light.name} stands in the camera's view and covers {area:,.0f} px, {percent(area / pixels)} of "
            text += "it, where the part is black: move it, or the camera"
            values = {"light": light.name, "pixels": area, "share": area / pixels}
            yield Finding("warning", "light in view", text, checked.at("lights", index), values)
            continue
        moved = [p for p in _moved(checked.rig, index, STEP_DEG) if area_in_view(checked.camera, p) > 0.0]
        if moved:
            clear = False
            yield _at_range(checked, index, light.name, "light in view", moved, "comes into the camera's view")
    if clear:
        yield Finding("ok", "light in view", "no light stands in the camera's view, nor moves into it")


def check_image_count(checked: CheckedRig) -> Iterator[Finding]:
    """A rig that takes a single image of a posture, so that no other image confirms a defect."""
    if len(checked.lights) == 1:
        (light,) = checked.lights
        text = f"{light.name} is the only light: no second image of a posture confirms what its image shows, and by "
        text += "default two must show a defect. Add a light or let one image decide"
        yield Finding("note", "number of images", text, checked.at("lights", 0), {"images": 1})


def check_housings(checked: CheckedRig) -> Iterator[Finding]:
    """Housings that hide the part from the camera, or that nothing shows."""
    own, level = checked.rig.environment.housings, checked.rig.environment.level
    if own is None:
        return
    corners, where = housing_corners(checked.rig), checked.rig.source.at("environment", "housings")
    backlights = {light.name for light in checked.lights if _is_backlight(light)}
    for name, polygon in corners.items():
        area = 0.0 if name in backlights else image_area(checked.camera, polygon)
        if area > 0.0:
            text = f"the housing of {name} stands in the camera's view and covers {area:,.0f} px of it, where the part "
            text += "is black: make margin_mm smaller, or move the light"
            yield Finding("warning", "housings", text, where, {"light": name, "pixels": area})
    text = f"{counted(len(corners), 'housing')} of level {own.level:g}, in surroundings of level {level:g}"
    if own.level == level:
        yield Finding("warning", "housings", f"{text}: they are as bright, so that the part shows none", where)
    else:
        yield Finding("ok", "housings", text, where)


def _lowest(light: PanelLight) -> float:
    return float(outlines(light)[..., 2].min())


def _is_backlight(light: PanelLight) -> bool:
    # which may be behind the part, below a table of glass
    return isinstance(light, SurfaceLight) and light.kind == "backlight"


def check_below_horizon(checked: CheckedRig) -> Iterator[Finding]:
    """Lights that reach below the table top; channels of a light are one."""
    for name, channels in light_entries(checked.rig.lights):
        index, light = channels[0], checked.lights[channels[0]]
        if _is_backlight(light):
            continue
        lowest = min(_lowest(checked.lights[channel]) for channel in channels)
        if lowest < -_ROUNDING_MM:
            text = f"a corner of {name} is {-lowest:.3g} mm below the table top; raise it, or take a smaller light"
            values = {"light": name, "lowest_mm": lowest}
            yield Finding("warning", "light below table", text, checked.at("lights", index), values)
            continue
        moved = [p for i in channels for p in _moved(checked.rig, i, 180.0) if _lowest(p) < -_ROUNDING_MM]
        if moved:
            depth = -min(_lowest(p) for p in moved)
            text = f"reaches {depth:.3g} mm below the table top"
            yield _at_range(checked, index, name, "light below table", moved, text)


def check_collisions(checked: CheckedRig) -> Iterator[Finding]:
    """Lights that touch or cross each other; one may surround another, and a coaxial light is the image of one."""
    configs, reported = checked.rig.lights, set[tuple[int, int]]()
    moved = [
        [] if configs[i].kind == "coaxial" else [light, *_moved(checked.rig, i, 360.0)]
        for i, light in enumerate(checked.lights)
    ]
    for i, j in _close_pairs(moved):
        a, b = checked.lights[i], checked.lights[j]
        entries = configs[i].entry, configs[j].entry
        if entries[0] == entries[1] or entries in reported:
            continue  # channels of one light, or other channels of a pair
        apart = float(np.linalg.norm(a.centre - b.centre))
        sizes = " and ".join(f"{light.size[0]:g} × {light.size[1]:g} mm" for light in (a, b))
        if lights_meet(a, b):
            reported.add(entries)
            text = f"{a.name} and {b.name} ({sizes}) cross each other: their centres are {apart:.3g} mm apart"
            values = {"lights": [a.name, b.name], "centres_mm": apart}
            yield Finding("warning", "lights collide", text, checked.at("lights", j), values)
            continue
        meeting = next(((p, q) for p in moved[i] for q in moved[j] if lights_meet(p, q)), None)
        if meeting is not None:
            reported.add(entries)
            angles = [(p.name, math.degrees(p.elevation), math.degrees(p.azimuth)) for p in meeting]
            places = " and ".join(f"{name} at elevation {el:.3g}°, azimuth {az:.3g}°" for name, el, az in angles)
            text = f"within their ranges {a.name} and {b.name} ({sizes}) can cross each other: {places}"
            yield Finding("note", "lights collide", text, checked.at("lights", j), {"lights": [a.name, b.name]})


def _moved(rig: RigConfig, index: int, step: float) -> list[PanelLight]:
    # the light at the ends of its ranges and, at `step` degrees or less, between those of its angles
    light = rig.lights[index]
    ranges = {
        "elevation_deg": light.elevation_range_deg,
        "azimuth_deg": light.azimuth_range_deg,
        "distance_mm": light.distance_range_mm,
    }
    moving = {key: ends for key, ends in ranges.items() if ends is not None}
    if not moving:
        return []
    # distances at the ends only
    values = [sorted({*ends}) if key == "distance_mm" else _steps(ends, step) for key, ends in moving.items()]
    places = (dict(zip(moving, place, strict=True)) for place in itertools.product(*values))
    lights = tuple(light.model_copy(update=place) for place in places)
    return list(build_lights(rig.model_copy(update={"lights": lights})))


def _steps(ends: tuple[float, float], step: float) -> list[float]:
    low, high = ends
    return np.linspace(low, high, 1 + math.ceil((high - low) / step)).tolist()


def _close_pairs(moved: list[list[PanelLight]]) -> Iterator[tuple[int, int]]:
    # pairs whose panels could touch anywhere in their ranges, by the spheres around them
    numbers = [i for i, places in enumerate(moved) if places]
    moved = [moved[i] for i in numbers]
    centres = [np.mean([p.centre for p in places], axis=0) for places in moved]
    reach = [
        max(float(np.linalg.norm(p.centre - c)) + 0.5 * float(np.hypot(*p.size)) for p in places)
        for places, c in zip(moved, centres, strict=True)
    ]
    for i, j in itertools.combinations(range(len(moved)), 2):
        if np.linalg.norm(centres[j] - centres[i]) <= reach[i] + reach[j]:
            yield numbers[i], numbers[j]


def _at_range(checked: CheckedRig, index: int, name: str, topic: str, moved: list[PanelLight], what: str) -> Finding:
    elevations = [math.degrees(p.elevation) for p in moved]
    azimuths = [math.degrees(p.azimuth) for p in moved]
    ranges = f"elevation {_span(elevations)}, azimuth {_span(azimuths)}"
    light = checked.rig.lights[index]
    if light.distance_range_mm is not None:
        distances = [p.distance for p in moved]
        ranges += f", distance {min(distances):.4g} to {max(distances):.4g} mm"
    where = checked.at("lights", index, next(key for key in RANGE_KEYS if getattr(light, key) is not None))
    values = {
        "light": name,
        "elevation_deg": [min(elevations), max(elevations)],
        "azimuth_deg": [min(azimuths), max(azimuths)],
    }
    return Finding("note", topic, f"within its range {name} {what} ({ranges})", where, values)


def _span(angles: list[float]) -> str:
    low, high = min(angles), max(angles)
    return f"{low:.3g}°" if math.isclose(low, high) else f"{low:.3g}° to {high:.3g}°"


def check_hidden_part(checked: CheckedScene) -> Iterator[Finding]:
    """How much of the part's image a light hides, standing between camera and part."""
    for sample, (at, light) in itertools.product(checked.samples, enumerate(checked.scene.lights)):
        own = sample.view.lights[at]
        if area_in_view(sample.view.camera, own) == 0.0:
            continue
        vertices, faces = surface_mesh(own)
        hidden = hidden_by(vertices[faces], sample.view.camera.position, sample.hits.points)
        count = int(np.count_nonzero(hidden))
        if not count:
            continue
        pixels, share = count * sample.step**2, count / len(hidden)
        text = f"posture {sample.posture}: {light.name} stands before the part and hides about {pixels:,} px of it, "
        text += f"{percent(share)}, which is black in images"
        values = {"light": light.name, "posture": sample.posture.as_dict(), "pixels": pixels, "share": share}
        yield Finding("warning", "light in view", text, checked.rig.source.at("lights", at), values)


def check_lights_in_part(checked: CheckedScene) -> Iterator[Finding]:
    """Panels that are inside the part, wholly or in places."""
    index = {light.name: i for i, light in enumerate(checked.rig.lights)}
    for found in panels_in_part(checked.scene):
        where = checked.rig.source.at("lights", index[found.light])
        values = {"light": found.light, "posture": found.posture.as_dict(), "share": found.share}
        yield Finding("error", "light in part", found.text, where, values)
