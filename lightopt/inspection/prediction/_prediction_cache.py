"""What a batch reuses from set to set: meshes, predictions, their derivatives with respect to the placement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from lightopt.core.transforms import Posture
from lightopt.estimate.registration import Observation, Placement, Registration
from lightopt.geometry import RayCaster
from lightopt.inspection.prediction._derivatives import Slopes, node_steps, prediction_slopes, shifted
from lightopt.inspection.prediction._placement_offset import (
    LOOSE,
    TIGHT,
    Known,
    NearbyPlace,
    Sample,
    fit_place,
    sample_of,
)
from lightopt.inspection.prediction._predict import Prediction, SurfaceMap, map_surface, predict
from lightopt.rendering import cast_rays_at
from lightopt.scene import Scene

Key = tuple[Posture, tuple[str, ...]]

SAME_PLACE_MM = 0.002
SAME_TURN_RAD = 5e-5
"""A part that was found this near to the one before takes over its prediction as it is."""

MOST_BYTES = 1 << 30
"""Slopes of predictions are kept up to this size: six images for each image of a set. Where they are larger, parts are
looked for anew."""


@dataclass
class Predictions:
    """The part inspected last where it lay, for the next ones.

    Attributes
    ----------
    nominal
        Scenes with the part where its file has it, by postures and lights.
    placement
        Where that part lay.
    scene
        With it there.
    caster
        Of that scene's part.
    by_posture
        What was rendered, by posture and lights.
    slopes
        How that changes with the part's place.
    registration
        That part's; None where it was not looked for.
    misfit
        Of that part's images to its predictions, by the postures and lights of its set.
    samples
        Pixels that tell the place, by posture and lights, light, and whether slopes are known.
    surface
        Patches of the surface, by postures.
    """

    nominal: dict[tuple[tuple[Posture, ...], tuple[str, ...]], Scene] = field(default_factory=dict)
    placement: Placement | None = None
    scene: Scene | None = None
    caster: RayCaster | None = None
    by_posture: dict[Key, Prediction] = field(default_factory=dict)
    slopes: dict[Key, Slopes] = field(default_factory=dict)
    registration: Registration | None = None
    misfit: float | None = None
    samples: dict[tuple[Key, str, bool], Sample] = field(default_factory=dict)
    surface: dict[tuple[Posture, ...], SurfaceMap] = field(default_factory=dict)

    def moved_to(self, scene: Scene, placement: Placement) -> tuple[Scene, Placement]:
        """The scene and place to predict with: the part lies where the one before lay, if that is the same place.

        Postures and lights stay those of `scene`: sets of one batch may show different ones.
        """
        if self.placement is not None and self.scene is not None and _same(self.placement, placement):
            return replace(self.scene, postures=scene.postures, lights=scene.lights), self.placement
        self.placement, self.scene, self.caster, self.misfit = placement, scene, None, None
        for kept in (self.by_posture, self.slopes, self.samples, self.surface):
            kept.clear()
        return scene, placement

    def of(
        self, scene: Scene, posture: Posture, lights: Sequence[str], *, threads: int | None = None
    ) -> Prediction:
        """The prediction of a posture under some lights, rendered where it is not kept.

        Parameters
        ----------
        scene
            From :meth:`moved_to`.
        posture, lights
            To predict.
        threads
            Number of threads; the result does not depend on it.
        """
        key = posture, tuple(lights)
        if key not in self.by_posture:
            self.by_posture[key] = predict(
                scene, posture, self._caster(scene), lights=lights, threads=threads
            )
        return self.by_posture[key]

    def shifted(
        self,
        scene: Scene,
        posture: Posture,
        lights: Sequence[str],
        off: NDArray[np.float64],
        *,
        threads: int | None,
    ) -> Prediction:
        """The prediction of a posture for a part that lies a little off the one before, by :meth:`nearby`."""
        key = posture, tuple(lights)
        return shifted(self.by_posture[key], self.slopes[key], off * node_steps(scene), threads=threads)

    def nearby(
        self, nominal: Scene, observations: Sequence[Observation], *, threads: int | None = None
    ) -> tuple[Scene, Placement, NDArray[np.float64]] | None:
        """Where a part lies that lies nearly where the one before lay; None where it does not, or none was before.

        The scene of the predictions, the part's place, and how many node steps off the predictions that is, shape (3,).
        What the images do not determine is as for the part before.

        Parameters
        ----------
        nominal
            The part where its file has it, with the postures and lights of the set.
        observations
            The images.
        threads
            Number of threads; the result does not depend on it.
        """
        if self.placement is None or self.scene is None or self.misfit is None:
            return None
        scene = replace(self.scene, postures=nominal.postures, lights=nominal.lights)
        keys = _keys(scene, observations)
        if any(key not in self.by_posture for key in keys.values()):
            return None
        if any(key not in self.slopes for key in keys.values()):
            pixels = sum(len(key[1]) for key in keys.values()) * scene.camera.width * scene.camera.height
            if 6 * 4 * pixels > MOST_BYTES:
                return None
            found, misfit = self._fit(scene, observations, keys, moves=True)
            if not found.near or misfit > LOOSE * self.misfit:
                return None
            for key in keys.values():
                if key not in self.slopes:
                    self.slopes[key] = prediction_slopes(
                        scene,
                        self.placement,
                        key[0],
                        self.by_posture[key],
                        self._caster(scene),
                        threads=threads,
                    )
        found, misfit = self._fit(scene, observations, keys, moves=True)
        if not found.near or misfit > TIGHT * self.misfit:
            return None
        return scene, found.placement(scene, self.placement), found.off

    def measure_misfit(self, scene: Scene, observations: Sequence[Observation]) -> None:
        """Remember how well a part's images fit the predictions that were made for it."""
        if self.misfit is None:
            keys = _keys(scene, observations)
            self.misfit = self._fit(scene, observations, keys, moves=False)[1]

    def surface_of(self, scene: Scene, asked: Sequence[Posture] = ()) -> SurfaceMap | None:
        """Patches of the surface and the pixels that see them; None for a single posture.

        Parameters
        ----------
        scene
            With the postures that there are images of.
        asked
            Those that there should be images of.
        """
        postures = tuple(dict.fromkeys((*scene.postures, *asked)))
        if len(postures) < 2:
            return None
        if postures not in self.surface:
            self.surface[postures] = map_surface(replace(scene, postures=postures), self._caster(scene))
        return self.surface[postures]

    def _caster(self, scene: Scene) -> RayCaster:
        if self.caster is None:
            self.caster = cast_rays_at(scene)
        return self.caster

    def _fit(
        self, scene: Scene, observations: Sequence[Observation], keys: dict[Posture, Key], *, moves: bool
    ) -> tuple[NearbyPlace, float]:
        assert self.placement is not None
        place = self.placement
        samples: list[Sample] = []
        for o in observations:
            key = keys[o.posture]
            slopes = self.slopes.get(key)
            mine = key, o.light, slopes is not None
            if mine not in self.samples:
                self.samples[mine] = sample_of(scene, place, Known(self.by_posture[key], slopes), o.light)
            samples.append(self.samples[mine])
        return fit_place(scene, place, observations, samples, moves=moves)


def lights_of(scene: Scene, observations: Sequence[Observation]) -> tuple[str, ...]:
    """Names of the lights that there are images of, in the scene's order."""
    return tuple(light.name for light in scene.lights if any(o.light == light.name for o in observations))


def _keys(scene: Scene, observations: Sequence[Observation]) -> dict[Posture, Key]:
    # of each posture, the lights that the set has for it in the rig's order
    return {
        posture: (posture, lights_of(scene, [o for o in observations if o.posture == posture]))
        for posture in scene.postures
    }


def _same(a: Placement, b: Placement) -> bool:
    apart = max(abs(a.x - b.x), abs(a.y - b.y))
    return apart <= SAME_PLACE_MM and abs(a.turn - b.turn) <= SAME_TURN_RAD
