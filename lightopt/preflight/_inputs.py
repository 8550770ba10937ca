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
class CheckedRig:
    """A rig with its camera and lights in the world frame."""

    rig: RigConfig
    camera: PinholeCamera
    lights: tuple[PanelLight, ...]

    def at(self, *keys: str | int) -> str:
        """File, line and key of a setting of the rig."""
        return self.rig.source.at(*keys)


@dataclass(frozen=True)
class PostureSamples:
    """What the camera sees of the part in a posture, at every `step`-th pixel of rows and columns; part frame."""

    posture: Posture
    view: PartView
    step: int
    hits: Hits
    surface: SurfacePoints


@dataclass(frozen=True)
class CheckedScene:
    """A rig with a part on it."""

    rig: RigConfig
    part: PartConfig
    scene: Scene
    caster: RayCaster
    samples: tuple[PostureSamples, ...]

    def at_posture(self, index: int) -> str:
        """File, line and key of a posture of the part."""
        return self.part.source.at("postures", index)


def prepare_rig(rig: RigConfig) -> CheckedRig:
    """Place the rig's camera and lights."""
    return CheckedRig(rig, build_camera(rig), build_lights(rig))


def prepare_scene(rig: RigConfig, part: PartConfig, scene: Scene) -> CheckedScene:
    """Cast a grid of camera rays in each posture of a scene."""
    caster = cast_rays_at(scene)
    return CheckedScene(rig, part, scene, caster, tuple(_sample(scene, p, caster) for p in scene.postures))


def _sample(scene: Scene, posture: Posture, caster: RayCaster) -> PostureSamples:
    view = view_from_part(scene, posture)
    left, top, right, bottom = screen_window(view.camera, scene.mesh)
    step = max(1, math.ceil(math.sqrt((right - left) * (bottom - top) / SAMPLES)))
    columns, rows = np.meshgrid(
        np.arange(left + step // 2, right, step, dtype=np.float64) + 0.5,
        np.arange(top + step // 2, bottom, step, dtype=np.float64) + 0.5,
    )
    hits, surface = trace_samples(caster, scene.mesh, view.camera, columns.ravel(), rows.ravel())
    return PostureSamples(posture, view, step, hits, surface)
