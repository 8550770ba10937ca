"""A set of images with its part registered: for each posture the images beside the predicted good part.

Also what a batch reuses from set to set, and the way back from where the part lies to where its file has it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lightopt.config import PartConfig, RigConfig
from lightopt.core.arrays import Float64, Int32
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture, rotation_z
from lightopt.estimate.registration import (
    Observation,
    Placement,
    Registration,
    observed_postures,
    place_part,
    read_observations,
    register,
)
from lightopt.geometry import RayCaster
from lightopt.images import ImageSet
from lightopt.inspection.prediction._nearby_placement import (
    LOOSE,
    TIGHT,
    PixelSample,
    PlacementDerivatives,
    PlacementOffset,
    difference_steps,
    fit_placement_offset,
    placement_derivatives,
    sample_pixels,
    shift_prediction,
)
from lightopt.inspection.prediction._posture_view import PostureView, posture_view
from lightopt.inspection.prediction._predict import Prediction, SurfaceMap, map_surface, predict
from lightopt.rendering import cast_rays_at
from lightopt.scene import Scene, build_scene, project, view_from_part

# by light the exposure and the number of frames of each image
ExposuresByLight = dict[str, tuple[tuple[float, int], ...]]

Key = tuple[Posture, tuple[str, ...]]  # a posture and the lights that there are images of

SAME_PLACE_MM = 0.002
SAME_TURN_RAD = 5e-5  # a part that was found this near to the previous one takes over its prediction as it is

# Derivatives are stored up to this size: six images for each image of a set. Where they are larger, each part is
# searched for.
MOST_BYTES = 1 << 30


@dataclass
class PredictionCache:
    """The part inspected last where it lay, for the next sets of a batch.

    nominal_scenes: scenes with the part where its file has it, by postures and lights.
    placement, scene: where the last part lay, and the scene with it there.
    rendered: predictions with the part there.
    samples: pixels that determine the placement, by posture and lights, light, and whether derivatives are known.
    """

    nominal_scenes: dict[tuple[tuple[Posture, ...], tuple[str, ...]], Scene] = field(default_factory=dict)
    placement: Placement | None = None
    scene: Scene | None = None
    caster: RayCaster | None = None
    rendered: dict[Key, Prediction] = field(default_factory=dict)
    derivatives: dict[Key, PlacementDerivatives] = field(default_factory=dict)
    registration: Registration | None = None
    misfit: float | None = None
    samples: dict[tuple[Key, str, bool], PixelSample] = field(default_factory=dict)
    surface_maps: dict[tuple[Posture, ...], SurfaceMap] = field(default_factory=dict)

    def use_placement(self, scene: Scene, placement: Placement) -> tuple[Scene, Placement]:
        """The scene and placement to predict with: those of the previous part, if that lay in the same place.

        Postures and lights stay those of `scene`: sets of one batch may show different ones.
        """
        before = self.placement
        if before is not None and self.scene is not None:
            distance = max(abs(before.x - placement.x), abs(before.y - placement.y))
            if distance <= SAME_PLACE_MM and abs(before.turn - placement.turn) <= SAME_TURN_RAD:
                return replace(self.scene, postures=scene.postures, lights=scene.lights), before
        self.placement, self.scene, self.caster, self.misfit = placement, scene, None, None
        for cached in (self.rendered, self.derivatives, self.samples, self.surface_maps):
            cached.clear()
        return scene, placement

    def prediction(
        self, scene: Scene, posture: Posture, lights: Sequence[str], *, threads: int | None = None
    ) -> Prediction:
        """The prediction of a posture under some lights, for a scene from :meth:`use_placement`."""
        key = posture, tuple(lights)
        if key not in self.rendered:
            self.rendered[key] = predict(scene, posture, self._caster(scene), lights=lights, threads=threads)
        return self.rendered[key]

    def shifted_prediction(
        self, scene: Scene, posture: Posture, lights: Sequence[str], offset: Float64, *, threads: int | None
    ) -> Prediction:
        """The prediction of a posture for a part that lies a little off the previous one: :meth:`nearby_placement`."""
        key = posture, tuple(lights)
        moved = offset * difference_steps(scene)
        return shift_prediction(self.rendered[key], self.derivatives[key], moved, threads=threads)

    def nearby_placement(
        self, nominal: Scene, observations: Sequence[Observation], *, threads: int | None = None
    ) -> tuple[Scene, Placement, Float64] | None:
        """Where a part lies that lies nearly where the previous one lay; None where it does not, or none was before.

        The scene of the predictions, the part's placement, and its offset from the predictions in steps of the
        derivatives, shape (3,). What the images do not determine is as for the previous part.

        nominal: the part where its file has it, with the postures and lights of the set.
        """
        if self.placement is None or self.scene is None or self.misfit is None:
            return None
        scene = replace(self.scene, postures=nominal.postures, lights=nominal.lights)
        keys = _keys(scene, observations)
        if not self.rendered.keys() >= set(keys.values()):
            return None
        if lacking := [key for key in keys.values() if key not in self.derivatives]:
            pixels = sum(len(key[1]) for key in keys.values()) * scene.camera.width * scene.camera.height
            if 6 * 4 * pixels > MOST_BYTES:
                return None
            found = self._fit(scene, observations, keys, moves=True)
            if not found.near or found.misfit > LOOSE * self.misfit:
                return None
            for key in lacking:
                self.derivatives[key] = placement_derivatives(
                    scene, self.placement, key[0], self.rendered[key], self._caster(scene), threads=threads
                )
        found = self._fit(scene, observations, keys, moves=True)
        if not found.near or found.misfit > TIGHT * self.misfit:
            return None
        return scene, found.placement(scene, self.placement), found.offset

    def measure_misfit(self, scene: Scene, observations: Sequence[Observation]) -> None:
        """Remember how well a part's images fit the predictions that were made for it."""
        if self.misfit is None:
            self.misfit = self._fit(scene, observations, _keys(scene, observations), moves=False).misfit

    def surface_map(self, scene: Scene, expected: Sequence[Posture] = ()) -> SurfaceMap | None:
        """Patches of the surface and the pixels that see them; None for a single posture.

        expected: postures that there should be images of.
        """
        postures = tuple(dict.fromkeys((*scene.postures, *expected)))
        if len(postures) < 2:
            return None
        if postures not in self.surface_maps:
            self.surface_maps[postures] = map_surface(replace(scene, postures=postures), self._caster(scene))
        return self.surface_maps[postures]

    def _caster(self, scene: Scene) -> RayCaster:
        if self.caster is None:
            self.caster = cast_rays_at(scene)
        return self.caster

    def _fit(
        self, scene: Scene, observations: Sequence[Observation], keys: dict[Posture, Key], *, moves: bool
    ) -> PlacementOffset:
        assert self.placement is not None
        samples: list[PixelSample] = []
        for o in observations:
            key = keys[o.posture]
            derivatives = self.derivatives.get(key)
            mine = key, o.light, derivatives is not None
            if mine not in self.samples:
                self.samples[mine] = sample_pixels(scene, self.placement, self.rendered[key], derivatives, o.light)
            samples.append(self.samples[mine])
        return fit_placement_offset(scene, self.placement, observations, samples, moves=moves)


def observed_lights(scene: Scene, observations: Sequence[Observation]) -> tuple[str, ...]:
    """Names of the lights that there are images of, in the scene's order."""
    return tuple(light.name for light in scene.lights if any(o.light == light.name for o in observations))


def _keys(scene: Scene, observations: Sequence[Observation]) -> dict[Posture, Key]:
    # of each posture, the lights that the set has for it in the rig's order
    return {
        posture: (posture, observed_lights(scene, [o for o in observations if o.posture == posture]))
        for posture in scene.postures
    }


@dataclass(frozen=True)
class RegisteredSet:
    """A set of images with its part registered.

    nominal: the scene with the part where its file has it.
    scene: the predicted scene: the part lies where it was found, or nearly there.
    views: of each posture, in the set's order, made one at a time; with the exposures of its images.
    registration: that found the part, or the part that it lies near; None for a part that is not searched for.
    """

    nominal: Scene
    placement: Placement
    scene: Scene
    views: Iterator[tuple[PostureView, ExposuresByLight]]
    registration: Registration | None = None


def register_set(
    rig: RigConfig, part: PartConfig, image_set: ImageSet, *, register: bool, cache: PredictionCache, run: RunContext
) -> RegisteredSet:
    """Find the part of a set, and predict the good part for its images; takes what :func:`inspect_set` takes."""
    threads = run.threads
    nominal, observations = nominal_scene(rig, part, image_set, scenes=cache.nominal_scenes, threads=threads)
    scene, placement, offset = _find(nominal, observations, cache, run, register=register)

    def views() -> Iterator[tuple[PostureView, ExposuresByLight]]:
        for number, posture in enumerate(scene.postures):
            if (report := run.stage(f"posture {posture}")) is not None:
                report(number / len(scene.postures))
            mine = [o for o in observations if o.posture == posture]
            lights = observed_lights(scene, mine)
            prediction = cache.prediction(scene, posture, lights, threads=threads)
            if offset is not None:
                prediction = cache.shifted_prediction(scene, posture, lights, offset, threads=threads)
            where = str(image_set.folder)
            view = posture_view(scene, mine, prediction, where=where, threads=threads)
            yield view, {x: tuple(sorted((o.exposure, o.frames) for o in mine if o.light == x)) for x in view.lights}
        if register and offset is None:
            cache.measure_misfit(scene, observations)

    return RegisteredSet(nominal, placement, scene, views(), cache.registration if register else None)


def nominal_scene(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    *,
    scenes: dict[tuple[tuple[Posture, ...], tuple[str, ...]], Scene] | None = None,
    threads: int | None = None,
) -> tuple[Scene, tuple[Observation, ...]]:
    """The part without defects where its file has it, under the lights and in the postures of a set, and the images.

    scenes: Of the same rig and part by postures and lights, to reuse and to add to: reading a mesh takes time.
    """
    observations = read_observations(image_set, rig, part, threads=threads)
    used = {o.light for o in observations}
    names = tuple(light.name for light in rig.lights if light.name in used)
    key = observed_postures(image_set), names
    scenes = {} if scenes is None else scenes
    if key not in scenes:
        scenes[key] = build_scene(rig, part, postures=key[0], lights=names, defects=False)
    return scenes[key], observations


def register_part(
    scene: Scene, observations: Sequence[Observation], *, run: RunContext | None = None
) -> tuple[Scene, Registration]:
    """A nominal scene with its part where the images show it, and how far that is from where its file has it."""
    found = register(scene, observations, caster=cast_rays_at(scene), run=run)
    return place_part(scene, found.placement), found


def _find(
    nominal: Scene, observations: Sequence[Observation], cache: PredictionCache, run: RunContext, *, register: bool
) -> tuple[Scene, Placement, Float64 | None]:
    # the scene to predict with, where the part lies, and its offset from that scene in steps of the derivatives
    if not register:
        return *cache.use_placement(nominal, Placement()), None
    nearby = cache.nearby_placement(nominal, observations, threads=run.threads)
    if nearby is not None:
        return nearby
    scene, found = register_part(nominal, observations, run=run)
    scene, placement = cache.use_placement(scene, found.placement)
    cache.registration = found
    return scene, placement, None


def exposures_text(exposures: ExposuresByLight) -> str:
    """Exposures and numbers of frames for a message."""

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
        return points @ view.rotation @ rotation_z(placement.turn) @ file.rotation
    nominal = _world_to_nominal_part(points, scene, placement, posture)
    return (nominal - file.translation) @ file.rotation


def nominal_pixels(view: PostureView, scene: Scene, placement: Placement) -> Int32:
    """For each pixel the one that shows its place where the part's file has it: flat index or −1, shape (H, W).

    scene, placement: As :func:`world_to_mesh_file` takes them.
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
    shift = np.array([placement.x, placement.y, 0.0])
    return (on_stage - scene.pivot - shift) @ rotation_z(placement.turn) + scene.pivot
