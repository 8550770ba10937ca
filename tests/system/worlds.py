"""The same world twice: as YAML files or scene objects for lightopt, as plain arrays for the reference."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import reference as ref

from lightopt import build_scene, render
from lightopt.core.transforms import Posture
from lightopt.geometry import TriangleMesh
from lightopt.lights import place_light
from lightopt.optics import Reflectance, Sensor
from lightopt.scene import Scene, Stage, place_camera
from lightopt.scene._camera import Distortion

PARTS = Path(__file__).parents[2] / "configs" / "parts"
PAPER = {"R_d": 45.0, "R_s": 12500.0, "sigma": 0.0475}
DISTORTION = ("k1", "k2", "p1", "p2", "k3")


def rig_yaml(camera, lights, *, points=None, pivot=(0, 0, 0)):
    """A rig file that says what the reference's camera and lights are."""
    lens = ", ".join(f"{k}: {float(v)!r}" for k, v in zip(DISTORTION, camera.distortion, strict=True))
    lines = [
        "format: lightopt-rig/1",
        "name: written-by-test",
        "camera:",
        f"  distance_mm: {camera.distance}",
        f"  elevation_deg: {camera.elevation}",
        f"  azimuth_deg: {camera.azimuth}",
        f"  roll_deg: {camera.roll}",
        f"  resolution_px: [{camera.width}, {camera.height}]",
        f"  pixel_size_um: {camera.pixel_um}",
        f"  image_distance_mm: {camera.image_distance}",
        f"  distortion: {{{lens}}}",
        "  sensor: {bit_depth: 8}",
        "light_source: {size_mm: [1, 1], points: 1}",
        "lights:",
    ]
    lines += [
        f"  - {{name: light{i}, distance_mm: {x.distance}, elevation_deg: {x.elevation}, azimuth_deg: {x.azimuth}, "
        f"size_mm: [{x.size[0]}, {x.size[1]}], points: {points or x.k**2}, normalisation: {x.normalisation}, "
        f"falloff: {x.falloff}, emission_exponent: {x.emission}, gain: {x.gain}}}"
        for i, x in enumerate(lights)
    ]
    lines += [
        "stage:",
        f"  pivot_mm: [{pivot[0]}, {pivot[1]}, {pivot[2]}]",
        "  elevation_range_deg: [-90, 90]",
        "  rotation_range_deg: [-360, 360]",
    ]
    return "\n".join(lines) + "\n"


def part_yaml(mesh_file, *, postures=((0, 0),), reflectance=PAPER, normals="smooth", anchor="rest_on_table"):
    """A part file."""
    stands = ", ".join(f"{{elevation_deg: {e}, rotation_deg: {r}}}" for e, r in postures)
    return (
        "format: lightopt-part/1\nname: written-by-test\n"
        f"mesh: {{file: '{Path(mesh_file).as_posix()}', units: mm, normals: {normals}}}\n"
        f"placement: {{anchor: {anchor}}}\npostures: [{stands}]\n"
        f"reflectance: {{R_d: {reflectance['R_d']!r}, R_s: {reflectance['R_s']!r}, "
        f"sigma_rad: {reflectance['sigma']!r}}}\n"
    )


def scene_from_files(folder, camera, lights, mesh_file, *, points=None, pivot=(0, 0, 0), **part):
    """Write rig and part into a folder and build the scene from them."""
    folder.mkdir(exist_ok=True)
    (folder / "rig.yaml").write_text(rig_yaml(camera, lights, points=points, pivot=pivot), encoding="utf-8")
    (folder / "part.yaml").write_text(part_yaml(mesh_file, **part), encoding="utf-8")
    return build_scene(folder / "rig.yaml", folder / "part.yaml")


def scene_from_mesh(camera, lights, mesh, *, points=None, pivot=(0, 0, 0), postures=((0, 0),), reflectance=PAPER):
    """A scene of a mesh made here, which no loader repairs and whose normals are what the test gave it."""
    return Scene(
        camera=place_camera(
            distance=camera.distance,
            elevation=math.radians(camera.elevation),
            azimuth=math.radians(camera.azimuth),
            roll=math.radians(camera.roll),
            width=camera.width,
            height=camera.height,
            pixel_size=camera.pixel_um * 1e-3,
            image_distance=camera.image_distance,
            distortion=Distortion(**dict(zip(DISTORTION, camera.distortion, strict=True))),
        ),
        lights=tuple(
            place_light(
                name=f"light{i}",
                distance=x.distance,
                elevation=math.radians(x.elevation),
                azimuth=math.radians(x.azimuth),
                size=x.size,
                points=points or x.k**2,
                normalisation=x.normalisation,
                gain=x.gain,
                inverse_square=x.falloff == "inverse_square",
                emission_exponent=x.emission,
            )
            for i, x in enumerate(lights)
        ),
        mesh=mesh,
        reflectance=Reflectance(**reflectance),
        sensor=Sensor(bit_depth=8, saturation_level=255),
        stage=Stage(pivot=np.array(pivot, dtype=float)),
        postures=tuple(Posture(elevation_deg=e, rotation_deg=r) for e, r in postures),
    )


def levels(scene, **options):
    """The image of the first light in the first posture, float64."""
    return next(iter(render(scene, threads=2, **options))).lights[0].level.astype(float)


def corners(mesh):
    """Triangles (F, 3, 3) and the normals at their corners, as the reference wants them."""
    triangles = mesh.vertices[mesh.faces]
    if mesh.normals is not None:
        return triangles, mesh.normals[mesh.faces]
    facet = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    facet /= np.linalg.norm(facet, axis=1, keepdims=True)
    return triangles, np.repeat(facet[:, None], 3, axis=1)


def posed_corners(mesh, posture, pivot=(0, 0, 0)):
    triangles, normals = corners(mesh)
    return ref.posed(triangles, *posture, pivot), ref.posed_normals(normals, *posture)


def merged(*meshes):
    """One mesh of several, all with normals or all without."""
    starts = np.cumsum([0] + [len(m.vertices) for m in meshes[:-1]])
    return TriangleMesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.faces + start for m, start in zip(meshes, starts, strict=True)]),
        None if meshes[0].normals is None else np.concatenate([m.normals for m in meshes]),
    )


def plane(half=30.0, *, tilt=0.0, azimuth=0.0, z=0.0):
    """A square through (0, 0, z), facing up, then tilted by degrees about the horizontal axis at an azimuth."""
    square = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=float)
    a, t = np.deg2rad(azimuth), np.deg2rad(tilt)
    k = np.array([np.cos(a), np.sin(a), 0.0])
    square = np.array([p * np.cos(t) + np.cross(k, p) * np.sin(t) + k * (k @ p) * (1 - np.cos(t)) for p in square])
    return TriangleMesh(square + np.array([0, 0, z]), np.array([[0, 1, 2], [0, 2, 3]]), None)


BOX_CORNERS = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
BOX_FACES = np.array(
    [
        *[[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4]],
        *[[2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]],
    ]
)


def box(low, high):
    """A closed box, faceted."""
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    return TriangleMesh(low + BOX_CORNERS * (high - low), BOX_FACES, None)


def sphere(radius=20.0, *, rows=96, centre=(0.0, 0.0, 0.0)):
    """A sphere with its own normals at the vertices, as a grid of latitudes and longitudes."""
    polar = np.linspace(0, np.pi, rows + 1)
    around = np.linspace(0, 2 * np.pi, 2 * rows, endpoint=False)
    p, a = (x.ravel() for x in np.meshgrid(polar, around, indexing="ij"))
    normals = np.stack([np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)], axis=1)
    n = 2 * rows
    i, j = (x.ravel() for x in np.meshgrid(np.arange(rows), np.arange(n), indexing="ij"))
    a, b = i * n + j, i * n + (j + 1) % n
    faces = np.concatenate([np.stack([a, a + n, b], 1)[i > 0], np.stack([b, a + n, b + n], 1)[i < rows - 1]])
    return TriangleMesh(np.asarray(centre) + radius * normals, faces, normals)


def bumps(seed, *, cells=24, half=22.0, height=5.0):
    """A random smooth height field of a few waves, with normals by its exact slopes."""
    rng = np.random.default_rng(seed)
    waves = rng.uniform(-0.35, 0.35, (4, 2))
    phases = rng.uniform(0, 2 * np.pi, 4)
    x, y = (g.ravel() for g in np.meshgrid(*[np.linspace(-half, half, cells + 1)] * 2))
    arguments = np.stack([x, y], 1) @ waves.T + phases
    slopes = (np.cos(arguments) * height / 4) @ waves
    normals = np.concatenate([-slopes, np.ones((len(x), 1))], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    i, j = (g.ravel() for g in np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij"))
    a = i * (cells + 1) + j
    faces = np.concatenate([np.stack([a, a + 1, a + cells + 2], 1), np.stack([a, a + cells + 2, a + cells + 1], 1)])
    z = np.sin(arguments).sum(axis=1) * height / 4
    return TriangleMesh(np.stack([x, y, z], axis=1), faces, normals)


def soup(seed, *, count=120, half=18.0):
    """Random triangles through each other, faceted: backs, gaps and shadows everywhere."""
    rng = np.random.default_rng(seed)
    centres = rng.uniform(-half, half, (count, 1, 3)) * [1, 1, 0.4]
    vertices = (centres + rng.normal(0, 5, (count, 3, 3))).reshape(-1, 3)
    return TriangleMesh(vertices, np.arange(3 * count).reshape(-1, 3), None)


def differ_from_neighbours(values):
    """Pixels that differ from one of the four beside them, of an image (H, W) or (H, W, …) of labels."""
    mask = np.zeros(values.shape[:2], dtype=bool)
    for axis in (0, 1):
        step = np.diff(values, axis=axis) != 0
        step = step.reshape(*step.shape[:2], -1).any(axis=2)
        before = [slice(None), slice(None)]
        after = [slice(None), slice(None)]
        before[axis], after[axis] = slice(None, -1), slice(1, None)
        mask[tuple(before)] |= step
        mask[tuple(after)] |= step
    return mask


def edge_pixels(image, *, crease_deg=15.0):
    """Pixels of a reference image at a silhouette, a crease or a shadow's edge: other than one of the four beside them.

    Where two neighbours see different faces, a jump of the normal or of the distance is a crease or a silhouette.
    """
    shape = image.shadow.shape[:2]
    hits = image.hits
    mask = differ_from_neighbours((hits.front * 2 + hits.back).reshape(shape)) | differ_from_neighbours(image.shadow)
    face = hits.face.reshape(shape)
    normal, point = hits.normal.reshape(*shape, 3), hits.point.reshape(*shape, 3)
    geometric = hits.geometric.reshape(*shape, 3)
    for axis in (0, 1):
        one = tuple(slice(None, -1) if a == axis else slice(None) for a in (0, 1))
        two = tuple(slice(1, None) if a == axis else slice(None) for a in (0, 1))
        turned = np.einsum("ijk,ijk->ij", normal[one], normal[two]) < np.cos(np.deg2rad(crease_deg))
        step = point[two] - point[one]
        rise = np.abs(np.einsum("ijk,ijk->ij", step, geometric[one])) / (np.linalg.norm(step, axis=2) + 1e-300)
        jump = (face[one] != face[two]) & (turned | (rise > np.sin(np.deg2rad(2 * crease_deg))))
        mask[one] |= jump
        mask[two] |= jump
    return mask


def cap(radius=120.0, *, half=25.0, cells=40):
    """The top of a sphere that touches (0, 0, 0), convex and gently curved, with the sphere's own normals."""
    x, y = (g.ravel() for g in np.meshgrid(*[np.linspace(-half, half, cells + 1)] * 2))
    normals = np.stack([x, y, np.sqrt(radius**2 - x**2 - y**2)], axis=1) / radius
    i, j = (g.ravel() for g in np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij"))
    a = i * (cells + 1) + j
    faces = np.concatenate([np.stack([a, a + 1, a + cells + 2], 1), np.stack([a, a + cells + 2, a + cells + 1], 1)])
    return TriangleMesh(radius * normals - np.array([0, 0, radius]), faces, normals)
