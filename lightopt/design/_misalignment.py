"""Scores of lights and parts that are misaligned, from images that are computed once.

Each image is of a posture, with the part off by so much, under one light that is off by so much; the scores of all
combinations are composed of them. Lights are moved as bodies: channels of one light together, and lights that a
programme shows in one image. An offset turns a body about the origin: in elevation towards the zenith, in azimuth about
Z. Within 5° of the zenith or the nadir, where the azimuth hardly moves a light, it is tilted sideways instead.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product
from typing import Any, Literal

import numpy as np

from lightopt.config import RigConfig
from lightopt.core.arrays import Bool, Int64
from lightopt.core.threads import available_processors, in_threads, threads_each
from lightopt.core.transforms import Posture, azimuth_tangent, elevation_tangent, rotation_from_vector
from lightopt.design._candidates import Place, bodies_of, panels_of
from lightopt.design._tolerances import EXACT, Offset, Offsets
from lightopt.design.objectives._objective import Objective
from lightopt.design.postures._light_positions import combination_sums
from lightopt.design.responses._evidence import spare_units
from lightopt.design.responses._image_evaluator import ImageEvaluator, scattered_flags
from lightopt.design.responses._luminance_matrix import Levels, LevelThresholds, LuminanceMatrix, flags_alike
from lightopt.design.responses._pairs import Counts, add_units
from lightopt.geometry import face_normals
from lightopt.lights import PanelLight
from lightopt.rendering import PatchTable, camera_visibility, hidden_by
from lightopt.scene import obstructions, view_from_part

NEAR_ZENITH = math.cos(math.radians(85.0))  # cosine of elevations within 5° of the zenith or the nadir

_ImageKey = tuple[int, Offset, int, Offset]  # a posture, the offset of the part, a body of lights, and its offset


@dataclass(frozen=True)
class Setup:
    """Postures that are evaluated together, and the positions of the lights in them."""

    rig: RigConfig
    postures: tuple[Posture, ...]
    places: tuple[tuple[Place, ...], ...]  # of each light, posture by posture
    exposures: tuple[tuple[float, ...], ...]  # posture by posture, 1 among them
    points: int | Literal["auto"] | None = None  # point lights per panel, instead of the rig's

    def only(self, posture: int) -> "Setup":
        one = slice(posture, posture + 1)
        return replace(self, postures=self.postures[one], places=self.places[one], exposures=self.exposures[one])

    def panels(self, posture: int) -> tuple[PanelLight, ...]:
        return tuple(self.panel(posture, light, EXACT) for light in range(len(self.rig.lights)))

    @cached_property
    def bodies(self) -> tuple[tuple[int, ...], ...]:
        return bodies_of(self.rig)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the bodies: of their lights in the rig's file."""
        lights = ([self.rig.lights[i] for i in own] for own in self.bodies)
        parts = ([one for light in own for one, _ in light.mixture or ((light, 1.0),)] for own in lights)
        return tuple(" + ".join(dict.fromkeys(one.entry_name for one in own)) for own in parts)

    def panel(self, posture: int, light: int, offset: Offset) -> PanelLight:
        """A light that is off by so much with its body, world frame."""
        panel = panels_of(self.rig, light, [self.places[posture][light]], self.points)[0]
        if offset == EXACT:
            return panel
        first = next(own[0] for own in self.bodies if light in own)
        elevation, azimuth = np.radians(self.places[posture][first][:2])
        upright = elevation_tangent(elevation=elevation, azimuth=azimuth)
        sideways = upright if abs(math.cos(elevation)) < NEAR_ZENITH else np.array([0.0, 0.0, 1.0])
        raised = rotation_from_vector(-math.radians(offset[0]) * azimuth_tangent(azimuth=azimuth))
        return panel.moved(rotation_from_vector(math.radians(offset[1]) * sideways) @ raised, np.zeros(3))


@dataclass(frozen=True)
class _BodyImages:
    """What the images of a body's lights in a posture show of the evaluator's patches."""

    found: Any  # as the assessment needs it
    levels: Any  # delivered at exposure 1, shape (lights, p) or those of the posture's patches
    hidden: Bool | None = None  # patches that the body hides from the camera, shape (p,); None for none


class _Assessment(ABC):
    """Scores of combinations of offsets, from images that are computed once: a `ScoreFunction`.

    The patches of the evaluator stay the same; which of them are visible does not.
    """

    def __init__(self, evaluator: ImageEvaluator, setup: Setup) -> None:
        self.evaluator, self.setup = evaluator, setup
        self.patches = evaluator.patches
        self.images: dict[_ImageKey, _BodyImages] = {}
        self._facets = face_normals(evaluator.scene.mesh)[evaluator.table.patches.face[self.patches]]

    def __call__(self, pose: Offset, lights: Offsets) -> Int64:
        # images of other poses than this one and the exact one are not needed again
        self.images = {key: image for key, image in self.images.items() if key[1] in (pose, EXACT)}
        postures, threads = range(len(self.setup.postures)), self.evaluator.threads
        evaluator = replace(self.evaluator, threads=threads_each(len(postures), threads))
        in_threads(lambda posture: self._compute_images(evaluator, posture, pose, lights), postures, threads)
        return self.scores(pose, lights)

    @abstractmethod
    def scores(self, pose: Offset, lights: Offsets) -> Int64:
        """Scores of all combinations, the last body's offsets varying fastest."""

    @abstractmethod
    def keep(self, matrices: Sequence[LuminanceMatrix], lights: Sequence[int], at: int) -> _BodyImages:
        """The stored part of a posture's images: row `at` of a body's lights, in matrices of all exposures."""

    def hidden(self, posture: Posture, lights: Sequence[PanelLight]) -> Bool | None:
        """Patches that a body's lights, world frame, hide from the camera, shape (p,); None where that is left out."""
        del posture, lights
        return None

    def _compute_images(self, evaluator: ImageEvaluator, posture: int, pose: Offset, lights: Offsets) -> None:
        # the images that are not known yet, those of all lights in one go
        keys = ([(posture, pose, body, offset) for offset in offsets] for body, offsets in enumerate(lights))
        missing = [[key[-1] for key in some if key not in self.images] for some in keys]
        if not any(missing):
            return
        nominal, bodies = self.setup.postures[posture], self.setup.bodies
        there = Posture(nominal.elevation_deg + pose[0], nominal.rotation_deg + pose[1])
        offsets_of = {light: missing[body] for body, own in enumerate(bodies) for light in own}
        panels = [[self.setup.panel(posture, i, one) for one in offsets_of[i]] for i in range(len(offsets_of))]
        evaluator = replace(evaluator, table=self._table(there, posture))
        matrices = evaluator.matrices(there, panels, exposures=self.setup.exposures[posture])
        for body, own in enumerate(bodies):
            for at, offset in enumerate(missing[body]):
                hidden = self.hidden(there, [panels[i][at] for i in own])
                self.images[posture, pose, body, offset] = replace(self.keep(matrices, own, at), hidden=hidden)

    def in_parts(self, lights: Offsets, apart: Sequence[bool], score: Callable[[Offsets], Int64]) -> Int64:
        """Scores of all combinations, for a `score` that can take only one offset of each body that is `apart`."""
        found = np.empty([len(offsets) for offsets in lights], np.int64)
        rows = (range(len(offsets)) if one else [None] for offsets, one in zip(lights, apart, strict=True))
        for chosen in product(*rows):
            part = tuple(slice(None) if k is None else slice(k, k + 1) for k in chosen)
            some = [offsets[own] for offsets, own in zip(lights, part, strict=True)]
            found[part] = score(some).reshape([len(offsets) for offsets in some])
        return found.ravel()

    def _table(self, posture: Posture, at: int) -> PatchTable:
        table = self.evaluator.table
        visible, grazing = np.zeros((2, 1, len(table.patches)), np.bool_)
        points, normals = table.patches.centroids[self.patches], table.patches.normals[self.patches]
        view = view_from_part(self.evaluator.scene, posture)
        sight = camera_visibility(points, normals, self._facets, view, self.evaluator.caster)
        visible[0, self.patches], grazing[0, self.patches] = sight
        # edges hardly move within the tolerances
        nominal = table.postures.index(self.setup.postures[at])
        return replace(table, postures=(posture,), visible=visible, grazing=grazing | table.grazing[nominal])


class PairAssessment(_Assessment):
    """Weight of the pairs of patch and defect that images find.

    together: Whether evidence of all postures adds up; else each posture finds by itself, and places that fewer images
        light than must show a defect need no more, as in the search
    """

    def __init__(self, evaluator: ImageEvaluator, setup: Setup, *, together: bool = True) -> None:
        super().__init__(evaluator, setup)
        self._together, self._weights, self._needed = together, evaluator.weights, evaluator.needed

    def keep(self, matrices: Sequence[LuminanceMatrix], lights: Sequence[int], at: int) -> _BodyImages:
        """Units of evidence of all of the body's images, of which each is one whatever the number of its exposures."""
        images = (scattered_flags(matrices, self.patches, light=light, place=at) for light in lights)
        seen = matrices[0].visibility
        assert seen is not None
        levels = np.zeros((len(lights), len(self.patches)), matrices[0].levels[0].dtype)
        levels[:, np.searchsorted(self.patches, seen.patch)] = [matrices[0].levels[light][at] for light in lights]
        return _BodyImages(self._weights.sum_counts(images, self._needed), levels)

    def hidden(self, posture: Posture, lights: Sequence[PanelLight]) -> Bool | None:
        """By the lights as they stand."""
        scene = self.evaluator.scene
        standing = obstructions(scene.camera, lights)
        if standing is None:
            return None
        camera = view_from_part(replace(scene, camera=replace(scene.camera, obstructions=standing)), posture).camera
        assert camera.obstructions is not None
        return hidden_by(camera.obstructions, camera.position, self.evaluator.table.patches.centroids[self.patches])

    def scores(self, pose: Offset, lights: Offsets) -> Int64:
        """Add up what is found in each posture, or in all of them together."""
        postures = range(len(self.setup.postures))
        total = np.zeros(int(np.prod([len(offsets) for offsets in lights])), np.int64)
        for own in [postures] if self._together else [[posture] for posture in postures]:
            # what a body hides no image shows
            hides = [
                any(self.images[i, pose, body, offset].hidden is not None for i in own for offset in offsets)
                for body, offsets in enumerate(lights)
            ]
            total += self.in_parts(lights, hides, partial(self._found, own, pose))
        return total

    def _found(self, postures: Sequence[int], pose: Offset, lights: Offsets) -> Int64:
        images = [
            [[self.images[i, pose, body, offset] for offset in offsets] for body, offsets in enumerate(lights)]
            for i in postures
        ]
        totals = [self._weights.zero_counts(self._needed)[None].repeat(len(offsets), axis=0) for offsets in lights]
        for bodies in images:
            hiding = [one.hidden for own in bodies for one in own if one.hidden is not None]
            shown = ~np.logical_or.reduce(hiding) if hiding else None
            for total, own in zip(totals, bodies, strict=True):
                for counts, one in zip(total, own, strict=True):
                    add_units(counts, one.found if shown is None else one.found * shown[:, None].astype(np.uint64))
            if not self._together and (spare := self._spare(bodies, shown)) is not None:
                totals.append(spare[None])
        threads = self.evaluator.threads
        return combination_sums(totals, self._weights, self._needed, benefit=False, threads=threads)[0]

    def _spare(self, bodies: Sequence[Sequence[_BodyImages]], shown: Bool | None) -> Counts | None:
        detection = self.evaluator.detection
        assert detection is not None
        levels = [np.stack(layers) for own in bodies for layers in zip(*(one.levels for one in own), strict=True)]
        units = spare_units(levels, detection.sensor, detection.min_images)
        if units is None:
            return None
        return flags_alike(units if shown is None else units * shown, self._weights.masks.shape[1])


class ObjectiveAssessment(_Assessment):
    """Score of an objective of levels at exposure 1, summed over the postures."""

    def __init__(
        self, evaluator: ImageEvaluator, setup: Setup, *, objective: Objective, thresholds: LevelThresholds
    ) -> None:
        super().__init__(evaluator, setup)
        self._objective, self._thresholds = objective, thresholds

    def keep(self, matrices: Sequence[LuminanceMatrix], lights: Sequence[int], at: int) -> _BodyImages:
        """Levels, and the areas of their patches."""
        return _BodyImages(matrices[0].areas, [matrices[0].levels[light][at] for light in lights])

    def scores(self, pose: Offset, lights: Offsets) -> Int64:
        """All combinations by the objective's own search, which does not know which lights move together."""
        return self.in_parts(lights, [len(own) > 1 for own in self.setup.bodies], partial(self._summed, pose))

    def _summed(self, pose: Offset, lights: Offsets) -> Int64:
        total = np.zeros(int(np.prod([len(offsets) for offsets in lights])), np.int64)
        for posture in range(len(self.setup.postures)):
            levels: dict[int, Levels] = {}
            for body, (own, offsets) in enumerate(zip(self.setup.bodies, lights, strict=True)):
                layers = [self.images[posture, pose, body, offset].levels for offset in offsets]
                levels |= {light: np.stack([layer[k] for layer in layers]) for k, light in enumerate(own)}
            areas = self.images[posture, pose, 0, lights[0][0]].found
            matrix = LuminanceMatrix(levels=tuple(levels[i] for i in range(len(levels))), areas=areas)
            threads, weights = self.evaluator.threads or available_processors(), self._objective.weights(areas)
            total += self._objective.scores(matrix, weights, self._thresholds, threads, None)
        return total
