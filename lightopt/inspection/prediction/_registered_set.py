"""A set of images with its part registered: for each posture the images and the prediction of the good part.

Also the way back from where the part lies to where its file has it: mesh file coordinates and nominal pixels.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from lightopt.config import PartConfig, RigConfig
from lightopt.core.arrays import Float64, Int32
from lightopt.core.run_context import RunContext
from lightopt.core.threads import side_by_side
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import (
    Observation,
    Placement,
    Registration,
    dark_as_predicted,
    observed_postures,
    place_part,
    read_observations,
    register as register_placement,
)
from lightopt.images import ImageSet
from lightopt.inspection.prediction._neighbourhood import LEAST_PX, neighbourhood_px
from lightopt.inspection.prediction._posture_view import PostureView, posture_view
from lightopt.inspection.prediction._predict import ReferenceName
from lightopt.inspection.prediction._prediction_cache import PredictionCache, observed_lights
from lightopt.rendering import cast_rays_at
from lightopt.scene import Scene, build_catalogue, build_scene, project, view_from_part

# by light the exposure and the number of frames of each image
ExposuresByLight = dict[str, tuple[tuple[float, int], ...]]


DARK = (
    "the images of a good part are predicted to be black, and these are: they cannot say where the part is, so it is "
    "taken to lie where its file has it; defects are placed as exactly as the part"
)


@dataclass(frozen=True)
class RegisteredSet:
    """A set of images with its part registered."""

    nominal: Scene  # the scene with the part where its file has it
    placement: Placement
    scene: Scene  # the predicted scene: the part lies where it was found, or nearly there
    # of each posture, in the set's order, made one at a time; with the exposures of its images
    views: Iterator[tuple[PostureView, ExposuresByLight]]
    # that found the part, or the part that it lies near; None for a part that is not searched for, or cannot be found
    registration: Registration | None = None
    warnings: tuple[str, ...] = ()
    # width of the neighbourhood that a place is compared with where that is the reference
    neighbourhood_px: float = LEAST_PX


def register_set(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    *,
    register: bool,
    reference: ReferenceName = "model",
    cache: PredictionCache,
    run: RunContext,
) -> RegisteredSet:
    """Find the part of a set, and predict the good part for its images; takes what :func:`inspect_set` takes."""
    threads = run.threads
    nominal, observations = nominal_scene(rig, part, image_set, scenes=cache.nominal_scenes, threads=threads)
    if reference == "model":
        nominal = cache.adjusted(rig, nominal, observations, register=register, run=run)
    dark = register and dark_as_predicted(nominal, observations, threads=threads)
    register = register and not dark
    scene, placement, offset = _find(nominal, observations, cache, run, register=register)

    def views() -> Iterator[tuple[PostureView, ExposuresByLight]]:
        for number, posture in enumerate(scene.postures):
            if (report := run.stage(f"posture {posture}")) is not None:
                report(number / len(scene.postures))
            mine = [o for o in observations if o.posture == posture]
            lights = observed_lights(scene, mine)
            exposures = {name: [o.exposure for o in mine if o.light == name] for name in lights}
            prediction = cache.prediction(scene, posture, exposures, threads=threads)
            if offset is not None:
                prediction = cache.shifted_prediction(scene, posture, lights, offset, threads=threads)
            where = str(image_set.folder)
            exact = reference == "model"
            view = posture_view(scene, mine, prediction, where=where, exact=exact, threads=threads)
            yield view, {x: tuple(sorted((o.exposure, o.frames) for o in mine if o.light == x)) for x in view.lights}
        if register and offset is None:
            cache.measure_misfit(scene, observations, threads=threads)

    registration = cache.registration if register else None
    return RegisteredSet(
        nominal=nominal,
        placement=placement,
        scene=scene,
        views=views(),
        registration=registration,
        warnings=(DARK,) if dark else () if registration is None else registration.warnings,
        neighbourhood_px=neighbourhood_px(nominal, build_catalogue(part)),
    )


def nominal_scene(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    *,
    scenes: dict[tuple[tuple[Posture, ...], tuple[str, ...]], Scene] | None = None,
    threads: int | None = None,
) -> tuple[Scene, tuple[Observation, ...]]:
    """The part without defects at its nominal placement, under the lights and in the postures of a set, and the images.

    scenes: Of the same rig and part by postures and lights, to reuse and to add to: reading a mesh takes time.
    """
    used = {entry.light for entry in image_set.images}
    names = tuple(light.name for light in rig.lights if light.name in used)
    key = observed_postures(image_set), names
    scenes = {} if scenes is None else scenes

    def read() -> tuple[Observation, ...]:
        return read_observations(image_set, rig, part, threads=threads)

    if key in scenes:
        return scenes[key], read()
    # a STEP file is read by another process
    scenes[key], observations = side_by_side(
        lambda: build_scene(rig, part, postures=key[0], lights=names, defects=False, bounces=part.inspection.bounces),
        read,
    )
    return scenes[key], observations


def _find(
    nominal: Scene, observations: Sequence[Observation], cache: PredictionCache, run: RunContext, *, register: bool
) -> tuple[Scene, Placement, Float64 | None]:
    # the scene to predict with, where the part lies, and its offset from that scene in steps of the derivatives
    if not register:
        return *cache.use_placement(nominal, Placement()), None
    nearby = cache.nearby_placement(nominal, observations, threads=run.threads)
    if nearby is not None:
        return nearby
    found = register_placement(nominal, observations, caster=cast_rays_at(nominal), run=run)
    scene, placement = cache.use_placement(place_part(nominal, found.placement), found.placement)
    cache.registration = found
    return scene, placement, None


def exposures_text(exposures: ExposuresByLight) -> str:

    def one(exposure: float, frames: int) -> str:
        return f"×{exposure:g}" + (f" of {frames} frames" if frames > 1 else "")

    return "; ".join(f"{light} {', '.join(one(*shot) for shot in images)}" for light, images in exposures.items())


def world_to_mesh_file(
    points: Float64, scene: Scene, placement: Placement, posture: Posture, *, direction: bool = False
) -> Float64:
    """World points of a placed part in a posture, shape (k, 3), in the coordinates of the mesh file [mm].

    scene, placement: where the part's file has the part, and where it lies from there.
    direction: whether `points` are directions, which are rotated only.
    """
    file = scene.placement
    if direction:
        view = view_from_part(scene, posture)
        return points @ view.rotation @ placement.rotation @ file.rotation
    nominal = _world_to_nominal_part(points, scene, placement, posture)
    return (nominal - file.translation) @ file.rotation


def nominal_pixels(view: PostureView, scene: Scene, placement: Placement) -> Int32:
    """For each pixel the one that shows its place at nominal placement: flat index or −1, shape (H, W).

    scene: With the part where its file has it.
    placement: Where it lies from there.
    """
    geometry = view.prediction.images.geometry
    index = np.full(geometry.hit.shape, -1, np.int32)
    camera = view_from_part(scene, view.posture).camera
    points = geometry.points[geometry.hit].astype(np.float64)
    column, row, depth = project(camera, _world_to_nominal_part(points, scene, placement, view.posture))
    inside = (depth > 0.0) & (column >= 0.0) & (column < camera.width) & (row >= 0.0) & (row < camera.height)
    pixel = np.full(len(column), -1, np.int32)
    pixel[inside] = np.floor(row[inside]).astype(np.int32) * camera.width
    pixel[inside] += np.floor(column[inside]).astype(np.int32)
    index[geometry.hit] = pixel
    return index


def _world_to_nominal_part(points: Float64, scene: Scene, placement: Placement, posture: Posture) -> Float64:
    # world points of the placed part in the part frame, with the part where its file has it
    view = view_from_part(scene, posture)
    on_stage = (points - view.translation) @ view.rotation
    return (on_stage - placement.shift(scene.pivot)) @ placement.rotation
