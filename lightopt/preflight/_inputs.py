"""The rig and scene under test, and samples of what the camera sees."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lightopt.config import PartConfig, RigConfig
from lightopt.core.transforms import Posture
from lightopt.geometry import Hits, RayCaster
from lightopt.rendering import SurfacePoints, cast_rays_at, trace_samples
from lightopt.scene import (
    PanelLight,
    PartView,
    PinholeCamera,
    Scene,
    build_camera,
    build_lights,
    screen_window,
    view_from_part,
)

SAMPLES = 60_000
"""Camera rays per posture at most: counts of pixels are estimates from these."""


@dataclass(frozen=True)
class RigSubject:
    """A rig and what it amounts to; world frame."""

    rig: RigConfig
    camera: PinholeCamera
    lights: tuple[PanelLight, ...]

    def at_light(self, index: int) -> str:
        """Where a light stands in the rig file."""
        return self.rig.source.at("lights", index)


@dataclass(frozen=True)
class Look:
    """What the camera sees of the part in a posture, at every `step`-th pixel of rows and columns; part frame."""

    posture: Posture
    view: PartView
    step: int
    hits: Hits
    surface: SurfacePoints


@dataclass(frozen=True)
class SceneSubject:
    """A rig with a part on it."""

    rig: RigConfig
    part: PartConfig
    scene: Scene
    caster: RayCaster
    looks: tuple[Look, ...]

    def at_posture(self, index: int) -> str:
        """Where a posture stands in the part file."""
        return self.part.source.at("postures", index)


def rig_subject(rig: RigConfig) -> RigSubject:
    """Place the rig's camera and lights."""
    return RigSubject(rig, build_camera(rig), build_lights(rig))


def scene_subject(rig: RigConfig, part: PartConfig, scene: Scene) -> SceneSubject:
    """Cast a grid of camera rays in each posture of a scene."""
    caster = cast_rays_at(scene)
    return SceneSubject(rig, part, scene, caster, tuple(_look(scene, p, caster) for p in scene.postures))


def _look(scene: Scene, posture: Posture, caster: RayCaster) -> Look:
    view = view_from_part(scene, posture)
    left, top, right, bottom = screen_window(view.camera, scene.mesh)
    step = max(1, math.ceil(math.sqrt((right - left) * (bottom - top) / SAMPLES)))
    columns, rows = np.meshgrid(
        np.arange(left + step // 2, right, step, dtype=np.float64) + 0.5,
        np.arange(top + step // 2, bottom, step, dtype=np.float64) + 0.5,
    )
    hits, surface = trace_samples(caster, scene.mesh, view.camera, columns.ravel(), rows.ravel())
    return Look(posture, view, step, hits, surface)
