"""Evidence of defects on patches is that of images with such defects; levels stay as they were."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_design_luminance import matrix_of, small_scene

from lightopt import build_scene
from lightopt.defects import BUILT_IN_CATALOGUE, CatalogueEntry, DefectShape, expected_change, tangent_direction
from lightopt.design import DetectionModel, luminance_matrix, planned_catalogue
from lightopt.design.responses._evidence import UNITS_OF_IMAGE, PatchEvidence
from lightopt.design.responses._image_evaluator import patch_points
from lightopt.rendering import (
    build_patches,
    cast_rays_at,
    mask_pixels,
    patch_positions,
    render_posture,
    surface_variants,
)
from lightopt.rendering._converged_panel import converged_panel, panel_probes, probe_targets, shade_converged
from lightopt.rendering._surface_variants import shade_variants
from lightopt.scene import view_from_part

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
CATALOGUE = planned_catalogue(BUILT_IN_CATALOGUE)


def leaning(normals, axes, slope, direction):
    towards = [tangent_direction(n, direction, x_axis=axes[:, 0], y_axis=axes[:, 1]) for n in normals]
    return math.cos(slope) * normals + math.sin(slope) * np.array(towards)


WIDE = {
    "dent": ("dent", 3.0, 0.8),
    "bump": ("bump", 2.5, 1.5),
    "blister": ("blister", 3.0, 2.0),
    "stain": ("stain", 3.0, 0.95),
    "haze": ("haze", 4.0, 1.1),
}
"""Kind, size [mm], and slope [deg] or factor: wide for pixels of 0.17 mm, and some of them hardly visible."""


def entry(name):
    kind, size, value = WIDE[name]
    what = {"stain": "R_d_factor", "haze": "sigma_factor"}.get(kind)
    change = {"slope": math.radians(value)} if what is None else {what: value}
    return CatalogueEntry(name, DefectShape(kind=kind, length=size, width=size, **change))


def evidence_of(scene, posture, caster, good, clean):
    """E of each image of a scene, in plain NumPy from rendered images."""
    sensor, found = scene.sensor, []
    scale = sensor.max_level / scene.reflectance.full_scale
    limit = sensor.saturated_from - sensor.black_level
    for before, after in zip(good.lights, render_posture(scene, posture, caster=caster).lights, strict=True):
        level = scale * before.level.astype(float)
        down, right = np.gradient(np.clip(level, 0.0, limit))
        variance = sensor.noise_variance(np.minimum(level, limit)) + 0.1**2 * (down**2 + right**2)
        m = expected_change(level, scale * after.level.astype(float), deviation=np.sqrt(variance), limit=limit)
        found.append(float((m[clean] ** 2).sum()))
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "lobe"),
    [
        ("cover-knob", None),
        *(
            pytest.param(*case, marks=pytest.mark.nightly)
            for case in (
                ("spout", None),
                ("cover-knob", "model: ggx, R_s: 9000, alpha: 0.08"),
                ("cover-knob", "model: two-lobe, R_s: 12500, sigma_rad: 0.0475, R_s_wide: 600, sigma_wide_rad: 0.15"),
            )
        ),
    ],
)
def test_evidence_on_patches_is_that_of_rendered_images(tmp_path, part, lobe):
    """Images of the good part and of the part with a defect at a patch, against what is expected at the patch."""
    text = (CONFIGS / "rigs" / "four-panel.yaml").read_text(encoding="utf-8")
    text = text.replace("[1600, 1200]", "[400, 300]").replace("pixel_size_um: 4.4 ", "pixel_size_um: 17.6 ")
    (tmp_path / "rig.yaml").write_text(text, encoding="utf-8")
    source = (CONFIGS / "parts" / f"{part}.yaml").read_text(encoding="utf-8")
    source = source.replace(f"file: {part}", f"file: {CONFIGS / 'parts' / part}")
    if lobe is not None:
        source, replaced = re.subn(r"R_s: .*\n *sigma_rad: .*\n", lobe.replace(", ", "\n  ") + "\n", source)
        assert replaced == 1
    own = tmp_path / "part.yaml"
    own.write_text(source, encoding="utf-8")
    scene = build_scene(tmp_path / "rig.yaml", own, points=4)
    posture, caster = scene.postures[0], cast_rays_at(scene)
    table = build_patches(scene, caster=caster, budget=20_000, edges=False)
    model = DetectionModel(
        catalogue=planned_catalogue([entry(name) for name in WIDE]), sensor=scene.sensor, full_scale=255.0
    )
    surface, seen = patch_points(scene, table, posture)
    expected = PatchEvidence(scene, table, surface, posture, model)
    lights = view_from_part(scene, posture).lights
    words = [units[0] for _, units in expected.evaluate(lights, caster, caster, (1.0,))]
    clean = mask_pixels(scene, posture, caster).clean
    good = render_posture(scene, posture, caster=caster)
    columns, rows = (np.floor(a[seen]).astype(int) for a in patch_positions(table, scene, posture))
    # whole defects only: nothing is left out near them
    whole = [clean[y - 15 : y + 16, x - 15 : x + 16].all() for x, y in zip(columns, rows, strict=True)]
    rng = np.random.default_rng(4)
    agree = []
    for patch in rng.choice(np.flatnonzero(whole), 8, replace=False):
        for h, name in enumerate(WIDE):
            kind, size, value = WIDE[name]
            key = {"stain": "R_d_factor", "haze": "sigma_factor"}.get(kind, "slope_deg")
            at = f"{{posture: {{elevation_deg: {posture.elevation_deg:g}, rotation_deg: {posture.rotation_deg:g}}}, "
            at += f"pixel: [{columns[patch]}, {rows[patch]}]}}"
            own.write_text(
                f"{source}\ndefects:\n"
                f"  - {{name: one, at_pixel: {at}, kind: {kind}, size_mm: {size:g}, {key}: {value:g}}}\n",
                encoding="utf-8",
            )
            marked = build_scene(tmp_path / "rig.yaml", own, points=4)
            energies = evidence_of(marked, posture, caster, good, clean)
            for light, energy in enumerate(energies):
                limits = expected._limits[h]
                if np.abs(np.log(max(energy, 1e-9) / limits)).min() < math.log(1.5):
                    continue
                units = sum(int(words[light][j, patch, 0] >> np.uint64(h)) & 1 for j in range(UNITS_OF_IMAGE))
                agree.append((units == int((energy >= limits).sum()), units))
    assert len(agree) > 60
    assert {0, UNITS_OF_IMAGE} <= {units for _, units in agree}
    assert np.mean([same for same, _ in agree]) >= 0.95


@pytest.mark.parametrize("points", [None, "auto"])
def test_levels_are_the_same_with_and_without_defects_and_threads(tmp_path, points):
    scene, rig = small_scene(tmp_path, "spout", points=points)
    posture = scene.postures[0]
    plain, found, table = matrix_of(scene, rig, posture, budget=120)
    inspection = DetectionModel(catalogue=CATALOGUE, sensor=scene.sensor, full_scale=255.0)
    caster = cast_rays_at(scene)
    examined = [
        luminance_matrix(scene, table, posture, found.panels, caster=caster, detection=inspection, threads=threads)
        for threads in (1, 3)
    ]
    for one, other in zip(plain.levels, examined[0].levels, strict=True):
        np.testing.assert_array_equal(one, other)
    for one, other in zip(examined[0].visibility.words, examined[1].visibility.words, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.slow
def test_converged_panels_on_leaning_patches(tmp_path):
    """Where the panel is seen whole, what the renderer itself says of the turned normal; in penumbrae nearly."""
    scene, _ = small_scene(tmp_path, "spout", points="auto")
    posture = scene.postures[0]
    caster = cast_rays_at(scene)
    table = build_patches(scene, caster=caster, budget=60)
    surface, _ = patch_points(scene, table, posture)
    axes = scene.placement.rotation
    references = np.array([tangent_direction(n, 0.0, x_axis=axes[:, 0], y_axis=axes[:, 1]) for n in surface.normals])
    # slope, direction, factors of R_d and of sigma
    few = [(0.07, 2.4, 1.0, 1.0), (0.035, 3.1, 1.0, 1.0), (0.35, 0.8, 1.0, 1.0), (0, 0, 0.7, 1.0), (0, 0, 1.0, 1.5)]
    slope, direction, R_d_factor, sigma_factor = np.array(few).T
    (variants,) = surface_variants(
        slope=slope,
        direction=direction,
        R_d_factor=R_d_factor,
        sigma_factor=sigma_factor,
        reflectances=scene.reflectances,
    )
    for light in view_from_part(scene, posture).lights:
        probes = panel_probes(surface, probe_targets(light), caster).sum(axis=1)
        whole = (probes == 0) | (probes == 5)
        near = converged_panel(light, centre=caster.centre, radius=caster.radius)
        assert near.points_for(scene.reflectance.sigma) == 16
        assert near.points_for(0.003) is None
        (few_points,) = shade_variants(surface, references, [near], [variants], caster=caster)
        # as if it were so near that a few points would not do
        panel = replace(near, least_distance=0.0)
        (found,) = shade_variants(surface, references, [panel], [variants], caster=caster)
        for t, (slope, direction, R_d_factor, sigma_factor) in enumerate(few):
            changed = scene.reflectance.changed(R_d_factor=R_d_factor, sigma_factor=sigma_factor)
            turned = replace(surface, normals=leaning(surface.normals, axes, slope, direction))
            diffuse, specular, _ = shade_converged(
                turned,
                panel,
                sample=2 * np.arange(len(surface)),
                shape=(1, 2 * len(surface)),
                reflectance=changed,
                caster=caster,
            )
            exact = changed.R_d * diffuse + changed.R_s * specular
            off = np.abs(np.minimum(found.varied[t], 255) - np.minimum(exact, 255))
            assert (off[whole] < 0.02).all()
            assert np.mean(off < 3.0) > 0.98
            change, by_few = (np.minimum(one.varied[t], 255) - np.minimum(one.good, 255) for one in (found, few_points))
            assert np.sqrt(np.mean((by_few - change) ** 2)) < 0.1 * np.sqrt(np.mean(change**2)) + 0.05
