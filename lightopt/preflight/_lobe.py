"""The specular lobe against the panels, and the levels to expect."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from lightopt.optics import Sensor
from lightopt.preflight._report import Finding
from lightopt.preflight._subject import SceneSubject
from lightopt.rendering import highlight_level
from lightopt.scene import COARSE_SHARE, PanelLight, coarse_points, like_panels, point_spacing, points_advice

NEGLIGIBLE_ERROR = 0.015


def check_points(subject: SceneSubject) -> Iterator[Finding]:
    """The panels' point lights against σ; panels of the same kind are told together."""
    sigma = subject.scene.reflectance.sigma
    for indices in like_panels(subject.scene.lights):
        light = subject.scene.lights[indices[0]]
        names = ", ".join(subject.scene.lights[i].name for i in indices)
        own = subject.rig.lights[indices[0]].points is not None
        keys = ("lights", indices[0], "points") if own else ("light_source", "points")
        yield _points(replace(light, name=names), sigma, subject.rig.source.at(*keys))


def _points(light: PanelLight, sigma: float, where: str) -> Finding:
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
    warning = coarse_points(light, sigma)
    if warning is not None:
        return Finding("warning", "points", warning, where, values)
    points = "1 point stands for" if found.points == 1 else f"{found.points} points stand apart by"
    text = (
        f"{light.name}: the panel's {points} {found.spacing:.3g} mm, the lobe of σ = {sigma:g} rad takes in "
        f"{found.lobe:.3g} mm (2·distance·σ): overexposed areas about {100 * abs(found.area_error):.1f} % too "
        f"{'small' if found.area_error < 0.0 else 'large'}"
    )
    if abs(found.area_error) <= NEGLIGIBLE_ERROR:
        return Finding("ok", "points", text, where, values)
    assert abs(found.area_error) <= COARSE_SHARE
    return Finding("note", "points", f"{text}. {points_advice(light, found.enough)}", where, values)


def check_levels(subject: SceneSubject) -> Iterator[Finding]:
    """The brightest diffuse level at exposure 1 against saturation."""
    reflectance, sensor = subject.scene.reflectance, subject.scene.sensor
    where = subject.part.source.at("reflectance")
    if reflectance.R_d == 0.0 and reflectance.R_s == 0.0:
        yield Finding("warning", "levels", "R_d and R_s are both 0: every image will be black", where)
        return
    # in levels of the reflectance's full scale, as R_d is
    saturation = (sensor.saturated_from - sensor.black_level) / sensor.max_level * reflectance.full_scale
    brightest = max(subject.scene.lights, key=lambda light: light.total_weight)
    level = reflectance.R_d * brightest.total_weight
    peak, mirrored = max(
        (highlight_level(subject.scene, light), light.name) for light in subject.scene.lights
    )
    values = {
        "diffuse_level": level,
        "highlight_level": peak,
        "saturation_level": saturation,
        "full_scale": reflectance.full_scale,
    }
    shown = f"{peak:.3g}" if peak < 100.0 else f"{peak:,.0f}"
    text = (
        f"at exposure 1 a surface that faces {brightest.name} shows {level:.3g} levels of diffuse light, and one that "
        f"mirrors the whole panel of {mirrored} {shown} of specular light; saturation is at {saturation:.4g}"
        f"{_taken_off(sensor, reflectance.full_scale)}"
    )
    if level >= saturation:
        exposure = 0.5 * saturation / level
        yield Finding(
            "warning",
            "levels",
            f"{text}: it saturates without any highlight. Check R_d, gain, normalisation, or expose by {exposure:.2g}",
            where,
            values,
        )
    else:
        yield Finding("ok", "levels", text, where, values)


def _taken_off(sensor: Sensor, full_scale: float) -> str:
    # why light saturates at another level than the sensor file says
    black = f" less its black level of {sensor.black_level:g}" if sensor.black_level else ""
    scale = f", in levels of full_scale {full_scale:g}" if sensor.max_level != full_scale else ""
    return f" (the sensor's {sensor.saturated_from:g}{black}{scale})" if black or scale else ""
