"""lightopt from mesh in memory to float images, against bare embreex: one BVH and a replay of the same rays."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh as EmbreeMesh
from numpy.typing import NDArray

from benchmarks._case import Size, case_scene
from benchmarks._report import Report, Table, ratio_text, ratios, rounds
from lightopt.geometry import RayCaster
from lightopt.geometry._caster import _begins, _primary_rays, _rays_of_pairs  # pyright: ignore[reportPrivateUsage]
from lightopt.rendering import PostureImages, cast_rays_at, rays_of_images, render_posture
from lightopt.scene import Scene

THREADS = 2
BLOCK_SIZES = (2_048, 8_192, 32_768, 131_072, 524_288)
TARGET = 0.4

Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class RecordedRays:
    """What Embree was given in a run, in its own units, in the order of a run on one thread.

    Attributes
    ----------
    vertices, faces
        The mesh, shapes (n, 3) and (m, 3).
    camera, shadow
        Origins and directions of the camera rays and of the shadow rays, shape (k, 3) each.
    """

    vertices: Float32
    faces: NDArray[np.int32]
    camera: tuple[Float32, Float32]
    shadow: tuple[Float32, Float32]

    @property
    def count(self) -> int:
        """Number of rays."""
        return len(self.camera[0]) + len(self.shadow[0])

    def blocks(self, size: int) -> Iterator[tuple[str, Float32, Float32, Float32]]:
        """The rays in blocks of at most `size`: query, origins, directions, and how far each ray reaches."""
        for query, (origins, directions), far in (("INTERSECT", self.camera, np.inf), ("OCCLUDED", self.shadow, 1.0)):
            reach = np.full(len(origins), far, np.float32)
            for start in range(0, len(origins), size):
                part = slice(start, start + size)
                yield query, origins[part], directions[part], reach[part]


class RecordingCaster(RayCaster):
    """A ray caster that keeps the rays to what cameras and surface points see, also those that are proven free."""

    def __init__(self, vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> None:
        super().__init__(vertices, faces)
        self.camera: list[tuple[Float32, Float32]] = []
        self.shadow: list[tuple[Float32, Float32]] = []

    def first_hit(self, origin: Any, directions: Any, **how: Any) -> Any:
        self.camera.append(_primary_rays(self._local(origin), directions))
        return super().first_hit(origin, directions, **how)

    def visible(self, points: Any, normals: Any, targets: Any, *, candidates: Any, **how: Any) -> Any:
        begins = _begins(points, normals, self.centre, self.radius)
        point, target = (index.astype(np.int32) for index in np.nonzero(candidates.T))
        self.shadow.append(_rays_of_pairs(begins, self._local(targets), point, target))
        return super().visible(points, normals, targets, candidates=candidates, **how)


def record_rays(scene: Scene) -> RecordedRays:
    """Render once on one thread and record every ray that Embree is given."""
    caster = RecordingCaster(scene.mesh.vertices, scene.mesh.faces)
    render_posture(scene, scene.postures[0], caster=caster, threads=1)
    local = ((scene.mesh.vertices - caster.centre) / caster.radius).astype(np.float32)
    camera, shadow = (
        (np.concatenate([o for o, _ in batches]), np.concatenate([d for _, d in batches]))
        for batches in (caster.camera, caster.shadow)
    )
    return RecordedRays(local, np.ascontiguousarray(scene.mesh.faces, np.int32), camera, shadow)


def replay(rays: RecordedRays, *, block: int, threads: int = THREADS) -> Callable[[], tuple[int, int]]:
    """A task that builds the BVH and casts the rays again; it returns how many hit and how many are blocked.

    All arrays are made beforehand: the task does nothing but ask Embree.
    """
    blocks = list(rays.blocks(block))

    def task() -> tuple[int, int]:
        scene = rtcore_scene.EmbreeScene(robust=True)
        mesh = EmbreeMesh(scene, rays.vertices, rays.faces)
        scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))  # commits the scene: the build
        with ThreadPoolExecutor(threads) as pool:
            found = list(pool.map(lambda b: (b[0], scene.run(b[1], b[2], b[3], query=b[0])), blocks))
        del mesh
        hits = sum(int((answer >= 0).sum()) for query, answer in found if query == "INTERSECT")
        blocked = sum(int((answer >= 0).sum()) for query, answer in found if query == "OCCLUDED")
        return hits, blocked

    return task


def render_from_mesh(scene: Scene, *, threads: int = THREADS) -> PostureImages:
    """From the mesh in memory to float images of every light: the build of the BVH included."""
    caster = cast_rays_at(scene, rays=rays_of_images(scene))
    return render_posture(scene, scene.postures[0], caster=caster, threads=threads)


def run(size: Size) -> Report:
    """Measure the ratio of the two."""
    scene = case_scene(size)
    rays = record_rays(scene)
    images = render_from_mesh(scene)
    hits, blocked = replay(rays, block=BLOCK_SIZES[2])()
    if hits != int(images.geometry.hit.sum()):
        raise AssertionError(f"the replay hits {hits} times, the run {int(images.geometry.hit.sum())}")

    by_block = rounds({str(block): replay(rays, block=block) for block in BLOCK_SIZES}, min(2, size.repeats))
    best = min(BLOCK_SIZES, key=lambda block: min(by_block[str(block)]))
    seconds = rounds(
        {"bare embreex": replay(rays, block=best), "lightopt": lambda: render_from_mesh(scene)}, size.repeats
    )
    single = rounds(
        {
            "bare embreex, 1 thread": replay(rays, block=best, threads=1),
            "lightopt, 1 thread": lambda: render_from_mesh(scene, threads=1),
        },
        max(1, size.repeats // 2),
    )
    least, median = ratios(seconds["lightopt"], seconds["bare embreex"])
    possible = hits * sum(int(light.points) for light in scene.lights)
    return Report(
        "bare",
        [
            _table(
                seconds, "bare embreex", f"{THREADS} threads, {size.repeats} rounds (target ≤ {TARGET})", rays.count
            ),
            _table(single, "bare embreex, 1 thread", "1 thread", rays.count),
        ],
        {
            "triangles": len(scene.mesh.faces),
            "image": [scene.camera.width, scene.camera.height],
            "pixels_hit": hits,
            "camera_rays": len(rays.camera[0]),
            "shadow_rays": len(rays.shadow[0]),
            "shadow_rays_blocked": blocked,
            "shadow_rays_not_cast": possible - len(rays.shadow[0]),
            "block_seconds": by_block,
            "best_block": best,
            "seconds": {**seconds, **single},
            "ratio_of_least": least,
            "median_ratio": median,
        },
        [
            f"{scene.camera.width} × {scene.camera.height} px, {hits:,} of them see the part",
            f"{len(scene.mesh.faces):,} triangles",
            f"{len(scene.lights)} lights of {scene.lights[0].points} points",
            f"{len(rays.camera[0]):,} camera rays, {len(rays.shadow[0]):,} shadow rays, of which {blocked:,} blocked",
            f"{possible - len(rays.shadow[0]):,} shadow rays below the horizon not cast",
            f"bare embreex is fastest in blocks of {best:,} rays",
        ],
    )


def _table(seconds: dict[str, list[float]], base: str, how: str, rays: int) -> Table:
    return Table(
        f"from mesh in memory to float images, {how}",
        ("", "least s", "median s", "Mray/s", "ratio of least", "median ratio"),
        [
            (
                name,
                f"{min(times):.2f}",
                f"{np.median(times):.2f}",
                f"{rays / min(times) / 1e6:.1f}",
                *ratio_text(times, seconds[base]),
            )
            for name, times in seconds.items()
        ],
    )
