"""The committed sample parts are what they are meant to be: size, closed solids, ridges, self-shadow."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

PARTS = Path(__file__).resolve().parents[2] / "configs" / "parts"
NAMES = ("cover-knob", "spout")
SIZES_MM = {"cover-knob": (52.0, 46.0, 18.49), "spout": (50.0, 43.0, 34.26)}
VOLUMES_MM3 = {"cover-knob": 24_370.0, "spout": 28_060.0}  # of the CAD solids
HOLES = {"cover-knob": 0, "spout": 1}  # through the handle

Floats = NDArray[np.float64]


@pytest.fixture(scope="module")
def meshes() -> dict[str, trimesh.Trimesh]:
    return {name: trimesh.load_mesh(PARTS / f"{name}.stl") for name in NAMES}


def from_above(mesh: trimesh.Trimesh, x: Floats, y: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Heights [mm] and triangles that vertical rays from above meet first."""
    origins = np.column_stack([x, y, np.full(x.shape, 100.0)])
    triangles = mesh.ray.intersects_first(origins, np.tile([0.0, 0.0, -1.0], (len(x), 1)))
    assert (triangles >= 0).all()
    normal, corner = mesh.face_normals[triangles], mesh.triangles[triangles, 0]
    heights = corner[:, 2] + (normal[:, :2] * (corner - origins)[:, :2]).sum(1) / normal[:, 2]
    return heights, triangles


def circle(radius: float) -> tuple[Floats, Floats]:
    angle = np.radians(np.arange(0.5, 360.0, 1.0))
    return radius * np.cos(angle), radius * np.sin(angle)


@pytest.mark.parametrize("name", NAMES)
def test_stl_is_one_closed_solid_of_the_stated_size(name: str, meshes: dict[str, trimesh.Trimesh]) -> None:
    mesh = meshes[name]
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.body_count == 1
    assert mesh.euler_number == 2 - 2 * HOLES[name]
    assert mesh.volume == pytest.approx(VOLUMES_MM3[name], rel=5e-3)  # positive: the normals point outwards
    assert mesh.extents == pytest.approx(SIZES_MM[name], abs=0.1)
    assert mesh.bounds[0, 2] == pytest.approx(0.0, abs=1e-6)
    assert mesh.area_faces.min() > 1e-5


@pytest.mark.parametrize("name", NAMES)
def test_step_is_the_same_solid_in_millimetres(name: str, meshes: dict[str, trimesh.Trimesh]) -> None:
    text = (PARTS / f"{name}.step").read_text(encoding="ascii")
    assert len(re.findall(r"=MANIFOLD_SOLID_BREP\(", text)) == 1
    assert "SI_UNIT(.MILLI.,.METRE.)" in text
    assert f"PRODUCT('{name}'" in text
    exact = trimesh.load_scene(PARTS / f"{name}.step").to_mesh()  # glTF, hence metres
    assert exact.bounds * 1000.0 == pytest.approx(meshes[name].bounds, abs=0.1)
    assert exact.volume * 1e9 == pytest.approx(VOLUMES_MM3[name], rel=5e-3)


@pytest.mark.parametrize(("suffix", "limit_kb"), [("step", 300), ("stl", 150)])
@pytest.mark.parametrize("name", NAMES)
def test_files_stay_small(name: str, suffix: str, limit_kb: int) -> None:
    assert (PARTS / f"{name}.{suffix}").stat().st_size < 1000 * limit_kb


@pytest.mark.parametrize("name", NAMES)
def test_facets_follow_the_surface_without_folds(name: str, meshes: dict[str, trimesh.Trimesh]) -> None:
    mesh = meshes[name]
    above_the_base = mesh.vertices[mesh.face_adjacency_edges][:, :, 2].mean(axis=1) > 0.01
    assert np.degrees(mesh.face_adjacency_angles[above_the_base]).max() < 55.0


@pytest.mark.parametrize("radius_mm", [14.0, 16.0, 18.0])
def test_knob_has_four_ridges(radius_mm: float, meshes: dict[str, trimesh.Trimesh]) -> None:
    mesh = meshes["cover-knob"]
    normals = mesh.face_normals[from_above(mesh, *circle(radius_mm))[1]]
    turn = np.degrees(np.arccos(np.clip((normals * np.roll(normals, -8, axis=0)).sum(axis=1), -1.0, 1.0)))
    at = np.flatnonzero(turn > 6.5)  # a face turns by 3 to 5 degrees over these 8 degrees of the circle
    assert len(at) > 0
    gaps = np.diff(at, append=at[0] + 360)
    assert (gaps > 30).sum() == 4
    assert gaps[gaps > 30].min() > 45


def test_knob_is_curved_everywhere(meshes: dict[str, trimesh.Trimesh]) -> None:
    mesh = meshes["cover-knob"]
    upward = mesh.face_normals[:, 2] > 0.2
    normals, areas = mesh.face_normals[upward], mesh.area_faces[upward] * mesh.face_normals[upward, 2]
    within = (normals @ normals.T > np.cos(np.radians(4.0))) @ areas
    assert within.max() < 0.03 * areas.sum()  # no direction holds more than 3 % of the plan view


@pytest.mark.parametrize("azimuth_deg", [45, 135, 225, 315])
def test_knob_mirrors_each_panel_once(azimuth_deg: int, meshes: dict[str, trimesh.Trimesh]) -> None:
    """A light at elevation 60 seen from above: the normal half way, 15 degrees from +Z, is in one place."""
    mesh = meshes["cover-knob"]
    a, t = np.radians(azimuth_deg), np.radians(15.0)
    half_way = np.array([np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.cos(t)])
    centres = mesh.triangles_center[mesh.face_normals @ half_way > np.cos(np.radians(4.0))]
    assert len(centres) > 3
    assert np.ptp(centres[:, :2], axis=0).max() < 12.0
    assert centres[:, :2].mean(axis=0) @ half_way[:2] > 0.0


@pytest.mark.parametrize("rotation_deg", [82, 180, 278])
def test_knob_looks_different_in_each_posture(rotation_deg: int, meshes: dict[str, trimesh.Trimesh]) -> None:
    heights, _ = from_above(meshes["cover-knob"], *circle(16.0))
    assert np.ptp(heights - np.roll(heights, rotation_deg)) > 0.3


@pytest.mark.parametrize("elevation_deg", [30, 45, 60])
@pytest.mark.parametrize("azimuth_deg", [45, 135, 225, 315])
def test_spout_handle_shades_the_bowl(elevation_deg: int, azimuth_deg: int, meshes: dict[str, trimesh.Trimesh]) -> None:
    mesh = meshes["spout"]
    x, y = (grid.ravel() for grid in np.meshgrid(np.linspace(-9.0, 22.0, 63), np.linspace(-9.0, 9.0, 37)))
    heights, triangles = from_above(mesh, x, y)
    bowl = heights < 19.0
    points = np.column_stack([x, y, heights])[bowl] + 1e-3 * mesh.face_normals[triangles[bowl]]
    e, a = np.radians(elevation_deg), np.radians(azimuth_deg)
    light = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    blocker = mesh.ray.intersects_first(points, np.tile(light, (len(points), 1)))
    by_handle = (blocker >= 0) & (mesh.triangles_center[blocker, 2] > 22.0)
    assert by_handle.mean() > 0.03
    assert (blocker < 0).mean() > 0.15
