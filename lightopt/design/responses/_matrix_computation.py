"""The luminance matrix of a scene (paper, section 5.2, step 1): one layer of delivered levels per candidate position.

Rays go from the centroid of every inspectable patch, one that the camera sees and not at a grazing angle
(:data:`lightopt.rendering.GRAZING_DEG`), to the point lights of every candidate panel. The panel's light is computed as
for images, then exposed at exposure 1 without noise: a level here is what the camera would deliver for the patch. With
``points: auto`` each patch's own five rays decide on shadows, since patches have no neighbours in a grid.

Where images are tested for defects, the same rays decide which defects each image shows.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from lightopt.core.arrays import Float32, Index
from lightopt.core.errors import InputError, counted
from lightopt.core.run_context import Share, WorkCounter
from lightopt.core.threads import Task, available_processors, run_all
from lightopt.core.transforms import Posture
from lightopt.design.responses._detection import DetectionModel, PatchDetection
from lightopt.design.responses._luminance_matrix import Levels, LuminanceMatrix
from lightopt.design.responses._packed_bits import Words
from lightopt.design.responses._visibility import Visibility
from lightopt.geometry import RayCaster, face_normals
from lightopt.optics import expose
from lightopt.rendering import PatchTable, SurfacePoints, converged_panel, shade_converged, shade_points, shadow_targets
from lightopt.scene import PanelLight, Scene, view_from_part

BLOCK_PATCHES = 1 << 15  # patches that a thread works on at once

# of the levels that are held at a time: with a part of some hundred thousand triangles, its patches and the search the
# process then stays below 2 GB
MOST_BYTES = 1_000_000_000


def patch_points(scene: Scene, table: PatchTable, posture: Posture) -> tuple[SurfacePoints, Index]:
    """The inspectable patches of a posture as surface points in the part's frame, and their indices."""
    patches = table.patches
    seen = table.inspectable(posture)
    eye = view_from_part(scene, posture).camera.position
    views = eye - patches.centroids[seen]
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    surface = SurfacePoints(
        patches.centroids[seen],
        patches.normals[seen],
        face_normals(scene.mesh)[patches.face[seen]],
        views,
        np.ones(len(seen), np.bool_),
    )
    return surface, seen


def luminance_matrix(
    scene: Scene,
    table: PatchTable,
    posture: Posture,
    panels: Sequence[Sequence[PanelLight]],
    *,
    caster: RayCaster,
    detection: DetectionModel | None = None,
    shadows: bool = True,
    threads: int | None = None,
    most_bytes: int = MOST_BYTES,
    progress: Share | None = None,
) -> LuminanceMatrix:
    """Delivered levels of the inspectable patches under every candidate panel of every light, at exposure 1.

    scene, table, posture: The scene, its patches, and one of their postures. The scene's own lights are ignored.
    panels: Per light, the panels at its candidate positions; world frame.
    detection: The defects whose visibility in the same images is wanted; None for levels alone.
    most_bytes: Limit for the levels and the defects' bits.
    Raises InputError: More positions than memory is meant for.
    """
    return luminance_matrices(
        scene,
        table,
        posture,
        panels,
        exposures=(1.0,),
        caster=caster,
        detection=detection,
        shadows=shadows,
        threads=threads,
        most_bytes=most_bytes,
        progress=progress,
    )[0]


def matrix_bytes(scene: Scene, patches: int, exposures: int, detection: DetectionModel | None) -> int:
    """Memory of :func:`luminance_matrices` for one position of a light: levels, and the defects' bits."""
    level = 1 if scene.sensor.bit_depth <= 8 else 2
    width = 0 if detection is None else -(-len(detection.hypotheses) // 64)
    return patches * exposures * (level + 8 * width)


def luminance_matrices(
    scene: Scene,
    table: PatchTable,
    posture: Posture,
    panels: Sequence[Sequence[PanelLight]],
    *,
    exposures: Sequence[float],
    caster: RayCaster,
    detection: DetectionModel | None = None,
    shadows: bool = True,
    threads: int | None = None,
    most_bytes: int = MOST_BYTES,
    progress: Share | None = None,
) -> tuple[LuminanceMatrix, ...]:
    """As :func:`luminance_matrix`, one for each exposure; the rays are cast once."""
    surface, seen = patch_points(scene, table, posture)
    part_view = view_from_part(scene, posture)
    surface = replace(surface, outside=caster.is_outside(part_view.camera.position))
    dtype = np.uint8 if scene.sensor.bit_depth <= 8 else np.uint16
    positions = sum(len(some) for some in panels)
    width = 0 if detection is None else -(-len(detection.hypotheses) // 64)
    size = positions * matrix_bytes(scene, len(seen), len(exposures), detection)
    if size > most_bytes:
        raise InputError(
            f"luminance matrix: {counted(positions, 'position')} × {len(seen):,} patches are {size / 1e9:.2f} GB, and "
            f"there is room for {most_bytes / 1e9:.2f} GB a posture; raise option 'step_deg' or lower option "
            "'patch_budget'"
        )
    levels: list[list[Levels]] = [[np.zeros((len(some), len(seen)), dtype) for some in panels] for _ in exposures]
    words: list[list[Words]] = [
        [np.zeros((len(some), len(seen), width), np.uint64) for some in panels] for _ in exposures
    ]
    view = None if detection is None else PatchDetection(scene, surface, posture, detection)
    blocks = [
        (start, surface.take(slice(start, start + BLOCK_PATCHES))) for start in range(0, len(seen), BLOCK_PATCHES)
    ]
    # the candidates as the part sees them
    moved = view_from_part(replace(scene, lights=tuple(p for some in panels for p in some)), posture).lights
    places = [(light, k) for light, some in enumerate(panels) for k in range(len(some))]
    blocker = caster if shadows else None

    def shade(place: tuple[int, int], panel: PanelLight, start: int, block: SurfacePoints) -> None:
        light, k = place
        here = slice(start, start + len(block))
        if view is None:
            level = _levels(scene, block, panel, caster, blocker)
        else:
            level, bits = view.evaluate(block, panel, here, caster, blocker, exposures)
            for index, some in enumerate(bits):
                words[index][light][k, here] = some
        for index, exposure in enumerate(exposures):
            levels[index][light][k, here] = expose(
                level[None, :], sensor=scene.sensor, exposure=exposure, full_scale=scene.reflectance.full_scale
            )[0]

    work = WorkCounter(len(places) * len(blocks), progress)

    def count() -> None:
        work.add(1)
        work.report()

    def tasks() -> Iterator[Task]:
        for place, panel in zip(places, moved, strict=True):
            if shadows:
                caster.map_blockers(shadow_targets(panel), rays=len(seen), threads=1)
            for start, block in blocks:
                yield shade, (place, panel, start, block)

    run_all(tasks(), threads=threads or available_processors(), done=count)
    areas, grazing = table.patches.areas[seen], table.left_out(posture)
    return tuple(
        LuminanceMatrix(
            levels=tuple(levels[index]),
            areas=areas,
            grazing_mm2=float(table.patches.areas[grazing].sum()),
            visibility=None
            if view is None
            else Visibility(
                hypotheses=view.detection.hypotheses,
                words=tuple(words[index]),
                areas=areas,
                patch=seen.astype(np.int32),
                grazing=grazing.astype(np.int32),
                exposure=exposure,
            ),
        )
        for index, exposure in enumerate(exposures)
    )


def _levels(
    scene: Scene, surface: SurfacePoints, panel: PanelLight, caster: RayCaster, blocker: RayCaster | None
) -> Float32:
    reflectance = scene.reflectance
    if panel.points == "auto":
        diffuse, specular, _ = shade_converged(
            surface,
            converged_panel(panel, centre=caster.centre, radius=caster.radius),
            # every second place of a row: no patch is another's neighbour
            sample=2 * np.arange(len(surface)),
            shape=(1, 2 * len(surface)),
            reflectance=reflectance,
            caster=blocker,
        )
    else:
        diffuse, specular = shade_points(surface, panel, points=panel.points, sigma=reflectance.sigma, caster=blocker)
    # images are stored as float32, and a level is rounded from what is stored
    return (reflectance.R_d * diffuse + reflectance.R_s * specular).astype(np.float32)
