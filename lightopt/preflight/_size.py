"""The part's size, and whether its unit can be right."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from lightopt.config import PartConfig, RigConfig
from lightopt.errors import InputError
from lightopt.mesh import UNITLESS_SUFFIXES, load_mesh
from lightopt.preflight._camera import view_size
from lightopt.preflight._report import Finding, percent
from lightopt.preflight._subject import SceneSubject
from lightopt.scene import build_camera
from lightopt.units import MM_PER_UNIT

__all__ = ["check_size", "likely_units", "unit_hints"]

ABSURD = (1.0 / 15.0, 2.5)
"""A part whose longest side is not between these shares of the view's shorter side is suspected of a wrong unit."""

SENSIBLE = (0.15, 1.3)
"""A unit is worth proposing where it brings the part's longest side between these shares."""


def likely_units(longest: float, view: float, unit: str) -> tuple[str, ...]:
    """Units that would make sense of a part that does not fit the view at all; none where it does.

    Parameters
    ----------
    longest
        The part's longest side as it is read now [mm].
    view
        The view's shorter side [mm].
    unit
        The unit that it is read in.
    """
    if ABSURD[0] <= longest / view <= ABSURD[1]:
        return ()
    shares = {name: longest / view * mm / MM_PER_UNIT[unit] for name, mm in MM_PER_UNIT.items()}
    return tuple(name for name, share in shares.items() if SENSIBLE[0] <= share <= SENSIBLE[1])


def check_size(subject: SceneSubject) -> Iterator[Finding]:
    """Size of the part, and what other units of its file would make of it."""
    low, high = subject.scene.mesh.bounds
    sides = [float(side) for side in high - low]
    where = subject.part.source.at("mesh", "units")
    values = {"size_mm": sides}
    size = view_size(subject.scene.camera)
    text = f"{' × '.join(f'{side:.4g}' for side in sides)} mm"
    if size is None:
        yield Finding("ok", "size", text, where, values)
        return
    longest, view = max(sides), min(size)
    unit = _unit(subject.part)
    share = longest / view
    times = percent(share) if share < ABSURD[1] else f"{share:.3g} times the length"
    text += f", {times} of the view's shorter side of {view:.4g} mm"
    units = likely_units(longest, view, unit)
    if units:
        told = _proposals(longest, unit, units)
        values = {**values, "unit": unit, "likely_units": list(units)}
        yield Finding("warning", "size", f"{text}: a wrong unit? {told}", where, values)
    elif not ABSURD[0] <= longest / view <= ABSURD[1]:
        kind = "small" if longest < view else "large"
        yield Finding("warning", "size", f"{text}: very {kind} for this camera", where, values)
    else:
        yield Finding("ok", "size", text, where, values)


def unit_hints(rig: RigConfig, part: PartConfig) -> tuple[str, ...]:
    """What other units would make of a part that no scene can be built of; nothing where that is not what is wrong."""
    mesh = part.mesh
    path = part.source.resolve(mesh.file)
    unit = _unit(part)
    if path.suffix.lower() not in UNITLESS_SUFFIXES:
        return ()
    try:
        size = view_size(build_camera(rig))
        loaded = load_mesh(
            path,
            unit_mm=MM_PER_UNIT[unit],
            normals="facet",
            crease_angle=math.pi,
            max_triangles=mesh.max_triangles,
        )
    except InputError:
        # the same trouble has been told already
        return ()
    longest = float(np.max(loaded.description.size_mm))
    units = likely_units(longest, min(size), unit) if size is not None else ()
    if not units:
        return ()
    return (f"{part.source.at('mesh', 'units')}: a wrong unit? {_proposals(longest, unit, units)}",)


def _unit(part: PartConfig) -> str:
    if part.mesh.units is not None:
        return part.mesh.units
    # formats that carry their unit: GLB is in metres, STEP is converted to millimetres as it is read
    return "m" if part.mesh.file.lower().endswith(".glb") else "mm"


def _proposals(longest: float, unit: str, units: tuple[str, ...]) -> str:
    told = " or ".join(
        f"{name} ({longest * MM_PER_UNIT[name] / MM_PER_UNIT[unit]:.4g} mm, a factor of "
        f"{_factor(MM_PER_UNIT[name] / MM_PER_UNIT[unit])})"
        for name in units
    )
    read = f"Read as {unit}, the part's longest side is {longest:.4g} mm"
    return f"{read}; it would fit the view if the file were in {told}"


def _factor(ratio: float) -> str:
    return f"{ratio:.4g}" if ratio >= 1.0 else f"1/{1.0 / ratio:.4g}"
