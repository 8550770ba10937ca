"""Whether highlights are rendered right: panel points and mesh facets against the lobe, levels against saturation.

Flat shading is off by up to half the angle β between two facets, an error of first order in the edge length h. Between
vertices with normals, interpolation is off by the second order, κ'·h²/8, where the curvature κ changes along the edge,
and by β³/42 where it does not. That error is measured from the mesh itself. Along an edge with unit direction e and
normals N₀, N₁ at its ends, the surface leaves the chord with the slopes −N₀·e and −N₁·e. The cubic through both ends
with these slopes has the slope (N₀ + N₁)·e/4 in the middle, where the interpolated normal stands for −(N₀ + N₁)·e/2;
they differ by

    ¾ · |(N₀ + N₁)·e|

which is κ'·h²/8 for exact normals, zero on a sphere, and also finds normals that were averaged badly from uneven
triangles.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Bool, Float64
from lightopt.geometry import TriangleMesh, face_normals, mesh_edges
from lightopt.lights import PanelLight, SurfaceLight
from lightopt.optics import Reflectance
from lightopt.preflight._findings import CheckedScene, Finding
from lightopt.rendering import highlight_level
from lightopt.scene import coarse_points, like_panels, point_spacing, points_advice

NEGLIGIBLE_ERROR = 0.015
# normals that are off by this share of σ change the level on a highlight's flank by about half: facets show
VISIBLE_ERROR = 0.5
LEAST_BEND = 0.05  # edges where the normal turns by less than this share of σ are flat to this lobe and do not count


def check_points(checked: CheckedScene) -> Iterator[Finding]:
    """The panels' point lights against σ; like panels are reported together."""
    if checked.scene.sharpest.R_s == 0.0:
        return  # without a lobe few points are enough
    for indices in like_panels(checked.scene.lights):
        if isinstance(checked.scene.lights[indices[0]], SurfaceLight):
            continue  # integrated whatever σ is
        light = checked.scene.lights[indices[0]]
        names = ", ".join(checked.scene.lights[i].name for i in indices)
        own = checked.rig.lights[indices[0]].points is not None
        keys = ("lights", indices[0], "points") if own else ("light_source", "points")
        yield _points(replace(light, name=names), checked.scene.sharpest, checked.rig.source.at(*keys))


def _points(light: PanelLight, reflectance: Reflectance, where: str) -> Finding:
    sigma = reflectance.sigma
    found = point_spacing(light, sigma)
    if found is None:
        text = f"{light.name}: points: auto, the whole panel is integrated whatever σ is"
        return Finding("ok", "points", text, where, {"points": "auto", "sigma_rad": sigma})
    values = {
        "points": found.points,
        "sigma_rad": sigma,
        "spacing_mm": found.spacing,
        "lobe_mm": found.lobe,
        "saturated_area_error": found.area_error,
        "enough_points": found.enough,
    }
    warning = coarse_points(light, reflectance)
    if warning is not None:
        return Finding("warning", "points", warning, where, values)
    text = f"{found.text_of(light, reflectance)}: overexposed areas about {100 * abs(found.area_error):.1f} % too "
    text += "small" if found.area_error < 0.0 else "large"
    if abs(found.area_error) <= NEGLIGIBLE_ERROR:
        return Finding("ok", "points", text, where, values)
    return Finding("note", "points", f"{text}. {points_advice(light, found.enough)}", where, values)


def check_levels(checked: CheckedScene) -> Iterator[Finding]:
    """The brightest diffuse level at exposure 1 against saturation."""
    reflectance, sensor = checked.scene.reflectance, checked.scene.sensor
    where = checked.part.source.at("reflectance")
    if all(one.R_d == 0.0 and one.R_s == 0.0 for one in checked.scene.shown):
        yield Finding("warning", "levels", "R_d and R_s are both 0: every image will be black", where)
        return
    # in levels of the reflectance's full scale, as R_d is
    saturation = (sensor.saturated_from - sensor.black_level) / sensor.max_level * reflectance.full_scale
    brightest = max(checked.scene.lights, key=lambda light: light.total_weight)
    level = max(one.R_d for one in checked.scene.shown) * brightest.total_weight
    peak, mirrored = max((highlight_level(checked.scene, one), one.name) for one in checked.scene.lights)
    values = {
        "diffuse_level": level,
        "highlight_level": peak,
        "saturation_level": saturation,
        "full_scale": reflectance.full_scale,
    }
    shown = f"{peak:.3g}" if peak < 100.0 else f"{peak:,.0f}"
    # why light saturates at another level than the sensor's saturation level
    black = f" less its black level of {sensor.black_level:g}" if sensor.black_level else ""
    same_scale = sensor.max_level == reflectance.full_scale
    scale = "" if same_scale else f", in levels of full_scale {reflectance.full_scale:g}"
    why = f" (the sensor's {sensor.saturated_from:g}{black}{scale})" if black or scale else ""
    text = f"at exposure 1 a surface that faces {brightest.name} shows {level:.3g} levels of diffuse light, and one "
    text += f"that mirrors all of {mirrored} {shown} of specular light; saturation is at {saturation:.4g}{why}"
    saturates = level >= saturation
    if saturates:
        exposure = 0.5 * saturation / level
        text += f": it saturates without any highlight. Check R_d, gain, normalisation, or expose by {exposure:.2g}"
    yield Finding("warning" if saturates else "ok", "levels", text, where, values)


@dataclass(frozen=True)
class NormalErrors:
    """Errors of the normal at the edges of a mesh where it bends: median and 90th percentile, by edge length [rad]."""

    median: float
    high: float
    angle: float  # median of the angle by which the normal turns there [rad]
    edge: float  # median of the edges' length [mm]


def facet_angles(mesh: TriangleMesh, *, bent: float, crease: float) -> NormalErrors | None:
    """Angles between facets over edges with angles from `bent` to `crease` [rad]; None where no edge bends."""
    found = mesh_edges(mesh.faces)
    pair = found.uses == 2
    normals = face_normals(mesh)
    chord = np.linalg.norm(normals[found.faces[pair, 0]] - normals[found.faces[pair, 1]], axis=1)
    angle = 2.0 * np.arcsin(np.minimum(1.0, 0.5 * chord))
    ends = found.ends[pair]
    length = np.linalg.norm(mesh.vertices[ends[:, 1]] - mesh.vertices[ends[:, 0]], axis=1)
    return _summary(angle, angle, length, (angle > bent) & (angle <= crease))


def interpolation_errors(mesh: TriangleMesh, *, bent: float) -> NormalErrors | None:
    """Errors of interpolated normals midway along edges that bend by more than `bent` [rad]; None: no such edge."""
    assert mesh.normals is not None
    ends = mesh_edges(mesh.faces).ends
    along = mesh.vertices[ends[:, 1]] - mesh.vertices[ends[:, 0]]
    length = np.linalg.norm(along, axis=1)
    first, second = mesh.normals[ends[:, 0]], mesh.normals[ends[:, 1]]
    error = 0.75 * np.abs(np.einsum("ij,ij->i", first + second, along)) / length
    angle = 2.0 * np.arcsin(np.minimum(1.0, 0.5 * np.linalg.norm(first - second, axis=1)))
    return _summary(error, angle, length, angle > bent)


def check_facets(checked: CheckedScene) -> Iterator[Finding]:
    """Whether the highlight shows the mesh's facets."""
    reflectance, mesh, source = checked.scene.sharpest, checked.scene.mesh, checked.part.source
    sigma, width = reflectance.sigma, f"{reflectance.width_text}, {_angle(reflectance.sigma)}"
    flat, bent, visible = mesh.normals is None, LEAST_BEND * sigma, VISIBLE_ERROR * sigma
    if flat:
        found = facet_angles(mesh, bent=bent, crease=math.radians(checked.part.mesh.crease_angle_deg))
    else:
        found = interpolation_errors(mesh, bent=bent)
    if found is None:
        why = "no curved surface" if flat else f"normals turn by less than {LEAST_BEND:g}·σ along every edge"
        text = f"{why}: no facets to show at {reflectance.width_text}"
        yield Finding("ok", "facets", text, source.at("mesh", "normals"))
        return
    if flat:
        wrong = found.median
        text = f"shaded flat, with {_angle(found.median)} between facets (median over curved surface; 90 % below "
        text += f"{_angle(found.high)}) against a lobe of {width}"
        advice = ": highlights break up into facets. Use normals: smooth, a STEP file, or facets "
        advice += f"{wrong / visible:.2g} times shorter"
    else:
        wrong = found.high
        text = f"normals turn by {_angle(found.angle)} along an edge of {found.edge:.3g} mm (medians over curved "
        text += f"surface); interpolated, 90 % are off by less than {_angle(found.high)}, against a lobe of {width}"
        advice = f": highlights show the mesh's facets. Use a STEP file, edges {math.sqrt(wrong / visible):.2g} times "
        advice += "shorter or, where sharp edges were smoothed over, a smaller crease_angle_deg"
    values = {
        "sigma_rad": sigma,
        "median_angle_rad": found.angle,
        "median_edge_mm": found.edge,
        "median_normal_error_rad": found.median,
        "high_normal_error_rad": found.high,
    }
    shows = wrong > visible
    where = source.at("mesh", "normals" if flat else "file")
    yield Finding("warning" if shows else "ok", "facets", text + advice if shows else text, where, values)


def _angle(radians: float) -> str:
    return f"{math.degrees(radians):.2g}°"


def _summary(error: Float64, angle: Float64, length: Float64, counts: Bool) -> NormalErrors | None:
    if not counts.any():
        return None
    error, angle, length = error[counts], angle[counts], length[counts]
    found: list[float] = []
    for values, share in ((error, 0.5), (error, 0.9), (angle, 0.5), (length, 0.5)):
        order = np.argsort(values, kind="stable")
        total = np.cumsum(length[order])
        found.append(float(values[order[np.searchsorted(total, share * total[-1])]]))
    return NormalErrors(*found)
