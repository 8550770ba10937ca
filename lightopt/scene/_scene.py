"""The scene, and camera and lights as the part sees them in a posture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.transforms import Posture
from lightopt.defects import PlacedDefect, Waviness
from lightopt.geometry import TriangleMesh, transformed
from lightopt.lights import PanelLight, SurfaceLight
from lightopt.optics import Reflectance, Sensor
from lightopt.scene._camera import PinholeCamera, project
from lightopt.scene._stage import Stage


@dataclass(frozen=True, eq=False, kw_only=True)
class Placement:
    """Where the mesh file's coordinates are in the part frame: x_part = rotation·x_file + translation."""

    rotation: Float64 = field(default_factory=lambda: np.eye(3))
    translation: Float64 = field(default_factory=lambda: np.zeros(3))  # [mm], shape (3,)

    def to_part(self, point: Float64) -> Float64:
        """A point of the file [mm], shape (3,), in the part frame."""
        return self.rotation @ point + self.translation

    def to_file(self, point: Float64) -> Float64:
        """A point of the part frame [mm], shape (3,), in the file's coordinates."""
        return self.rotation.T @ (point - self.translation)


@dataclass(frozen=True, kw_only=True)
class PartRegion:
    name: str  # as the part file has it
    reflectance: Reflectance


@dataclass(frozen=True, eq=False, kw_only=True)
class Housings:
    """Rectangles with the lights in their middle, which the part mirrors in place of the surroundings."""

    level: float  # under a light of gain 1 [grey level]
    # of each its middle [mm], its unit normal, and the directions of its sides over half their lengths [1/mm],
    # shape (h, 4, 3)
    rectangles: Float64

    def moved(self, rotation: Float64, translation: Float64) -> Housings:
        """The housings after x' = rotation·x + translation, of shapes (3, 3) and (3,)."""
        rectangles = self.rectangles @ rotation.T
        rectangles[:, 0] += translation
        return replace(self, rectangles=rectangles)


@dataclass(frozen=True, eq=False, kw_only=True)
class Motion:
    """How the part moves while the camera exposes; in the middle of an exposure it is in its posture."""

    velocity: Float64  # world frame [mm/s], shape (3,)
    turn_deg_per_s: float  # of the rotary axis [°/s]
    exposure_s: float  # exposure time of exposure 1 [s]


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A part on its stage, the lights around it, the camera above it."""

    # world frame
    camera: PinholeCamera
    lights: tuple[PanelLight, ...]
    # the part at posture (0, 0), world frame [mm]; its faces' materials are 0 for `reflectance` and then those of the
    # regions, from 1
    mesh: TriangleMesh
    reflectance: Reflectance  # of the surface that is in no region
    regions: tuple[PartRegion, ...] = ()  # with reflectances of their own
    sensor: Sensor
    stage: Stage  # how postures move the part, world frame
    postures: tuple[Posture, ...]
    warnings: tuple[str, ...] = ()
    # from the mesh file's coordinates, in mm, to those of the mesh
    placement: Placement = field(default_factory=Placement)
    defects: tuple[PlacedDefect, ...] = ()  # on the part, frame of the mesh; images show them, the mesh does not
    waviness: Waviness | None = None  # of good parts; None for smooth ones
    freedoms: int = 3  # degrees of freedom of the part on its stage: 3 on the plate, 6 with height and tilt
    bounces: int = 0  # how often light goes from the part to the part in images
    environment: float = 0.0  # level of what surrounds the rig under a light of gain 1 [grey level]
    housings: Housings | None = None  # of the lights, world frame; None for none that differ from the surroundings
    motion: Motion | None = None  # of the part during an exposure; None for a part at rest

    @property
    def reflectances(self) -> tuple[Reflectance, ...]:
        """By the materials of the mesh's faces."""
        return (self.reflectance, *(region.reflectance for region in self.regions))

    @property
    def shown(self) -> tuple[Reflectance, ...]:
        """Those that the surface has anywhere."""
        if self.mesh.material is None:
            return self.reflectances
        return tuple(self.reflectances[number] for number in np.unique(self.mesh.material))

    @property
    def sharpest(self) -> Reflectance:
        """The reflectance with the narrowest specular lobe."""
        return min(self.shown, key=lambda one: one.sigma if one.R_s > 0.0 else math.inf)

    @property
    def panels_only(self) -> bool:
        """Whether none of the lights has channels and a surface of another kind, of which each pixel takes longer."""
        return not any(isinstance(light, SurfaceLight) for light in self.lights)

    @property
    def is_surrounded(self) -> bool:
        """Whether light comes from what surrounds the part."""
        return self.environment > 0.0 or (self.housings is not None and self.housings.level > 0.0)

    @property
    def pivot(self) -> Float64:
        """A point of the stage's rotary axis at tilt 0, world frame [mm], shape (3,)."""
        return self.stage.pivot


def with_reflectances(scene: Scene, reflectances: Sequence[Reflectance]) -> Scene:
    """The same scene with other reflectances, in the order of :attr:`Scene.reflectances`."""
    first, *others = reflectances
    regions = tuple(replace(region, reflectance=own) for region, own in zip(scene.regions, others, strict=True))
    return replace(scene, reflectance=first, regions=regions)


def scene_of_region(scene: Scene, number: int) -> Scene:
    """The same scene with the reflectance of a region, from 1, as its first one."""
    assert scene.mesh.material is not None
    order = np.arange(len(scene.reflectances), dtype=np.uint8)
    order[[0, number]] = number, 0
    regions = list(scene.regions)
    chosen, regions[number - 1] = regions[number - 1], PartRegion(name="", reflectance=scene.reflectance)
    brushing = scene.mesh.brushing
    swapped = tuple(brushing[i] for i in order.tolist()) if brushing else ()
    mesh = replace(scene.mesh, material=order[scene.mesh.material], brushing=swapped)
    return replace(scene, mesh=mesh, reflectance=chosen.reflectance, regions=tuple(regions))


def move_part(scene: Scene, rotation: Float64, translation: Float64) -> Scene:
    """The scene with its part elsewhere, and what is on it with it: p' = R·p + t at posture (0, 0).

    rotation, translation: World frame, shapes (3, 3) and (3,) [mm]
    """
    place = scene.placement
    return replace(
        scene,
        mesh=transformed(scene.mesh, rotation, translation),
        placement=Placement(rotation=rotation @ place.rotation, translation=rotation @ place.translation + translation),
        defects=tuple(
            replace(
                one,
                position=rotation @ one.position + translation,
                normal=rotation @ one.normal,
                along=rotation @ one.along,
            )
            for one in scene.defects
        ),
    )


@dataclass(frozen=True, kw_only=True)
class PartView:
    """Camera and lights as the part sees them in a posture, so that one ray caster serves all postures."""

    # part frame: the world frame at posture (0, 0)
    camera: PinholeCamera
    lights: tuple[PanelLight, ...]
    housings: Housings | None = None
    # part frame to world frame: x_world = rotation·x_part + translation; shapes (3, 3) and (3,) [mm]
    rotation: Float64
    translation: Float64

    def seen_from(self, rotation: Float64, translation: Float64) -> PartView:
        """The view after camera and lights have moved, x' = rotation·x + translation, of shapes (3, 3) and (3,)."""
        return replace(self, **_moved(self, rotation, translation))

    def of_scene(self, scene: Scene) -> Scene:
        """The scene with camera and lights where this view has them."""
        return replace(scene, **_moved(self, self.rotation, self.translation))


def _moved(own: Scene | PartView, rotation: Float64, translation: Float64) -> dict[str, Any]:
    # what does not move with the part
    return {
        "camera": own.camera.moved(rotation, translation),
        "lights": tuple(light.moved(rotation, translation) for light in own.lights),
        "housings": None if own.housings is None else own.housings.moved(rotation, translation),
    }


def view_from_part(scene: Scene, posture: Posture, *, seconds: float = 0.0) -> PartView:
    """The scene's camera and lights in the part's own frame at a posture: the stage's motion, inverted.

    seconds: After the middle of an exposure, for a part that moves [s]
    """
    motion = scene.motion
    if motion is None or seconds == 0.0:
        rotation, translation = scene.stage.transform(posture)
    else:
        turned = replace(posture, rotation_deg=posture.rotation_deg + motion.turn_deg_per_s * seconds)
        rotation, translation = scene.stage.transform(turned)
        translation = translation + motion.velocity * seconds
    back = rotation.T
    return PartView(**_moved(scene, back, -back @ translation), rotation=rotation, translation=translation)


_SHORT = 1e-3  # share of the exposure time in which a path is straight
MOST_MOTION_PX = 1.0  # in the image during an exposure, above which it is worth a warning


def motion_blur(scene: Scene, posture: Posture, points: Float64) -> Float64:
    """How far points of a part that moves do so in the image during exposure 1 [px], shape (k,).

    points: Part frame [mm], shape (k, 3)
    """
    assert scene.motion is not None
    ends = [0.5 * side * _SHORT * scene.motion.exposure_s for side in (-1.0, 1.0)]
    before, after = (project(view_from_part(scene, posture, seconds=end).camera, points)[:2] for end in ends)
    return np.hypot(*np.subtract(after, before)) / _SHORT


def at_rest_warnings(scene: Scene, exposure: float) -> tuple[str, ...]:
    """That a part moves which a computation takes to be at rest; none where it moves little during this exposure."""
    if scene.motion is None:
        return ()
    corners = scene.mesh.box_corners
    paths = [float(motion_blur(scene, posture, corners).max()) for posture in scene.postures]
    path = exposure * max(paths, default=0.0)
    if path <= MOST_MOTION_PX:
        return ()
    return (f"the part moves by up to {path:.3g} px in the image during exposure {exposure:g}: here it is at rest",)
