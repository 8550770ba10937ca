"""The faults that a rig may have as parameters of its images, and the rig with these faults.

Parameters are in one vector, shape (K,): 0 is the rig as its file has it. Faults come in groups, such as the three
shifts of a camera, which are found together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.transforms import Posture, rotation_from_vector
from lightopt.estimate.registration import Placement
from lightopt.estimate.verification._limits import VerifyLimits
from lightopt.lights import PanelLight
from lightopt.scene import PartView, PinholeCamera, Scene, view_from_part


@dataclass(frozen=True, kw_only=True)
class Group:
    """Parameters of one fault.

    kind: ``gain``, ``exposure``, ``black``, ``part_shift``, …
    light: Whose fault it is; empty where it is no light's.
    first, size: Place in the vector of parameters.
    step: For differences [unit of the parameter].
    prior: Standard deviation of the parameters of a rig with that fault.
    limit: Within tolerance up to this norm.
    """

    kind: str
    light: str = ""
    first: int
    size: int
    step: float
    prior: float
    limit: float

    @property
    def name(self) -> str:
        """Kind and light, which identify it."""
        return f"{self.kind} {self.light}".strip()

    @property
    def where(self) -> slice:
        """Its parameters."""
        return slice(self.first, self.first + self.size)


_DEG = math.pi / 180.0

# kind: parameters, step of differences, prior; lengths in mm, angles in rad, shares, sensor levels
_COMMON = {
    "exposure": (1, 0.0, 0.3),
    "black": (1, 0.0, 10.0),
    "part_shift": (3, 0.02, 1.0),
    "part_turn": (3, 0.03 * _DEG, 1.0 * _DEG),
    "camera_shift": (3, 0.05, 3.0),
    "camera_turn": (3, 0.005 * _DEG, 0.3 * _DEG),
}
_OF_LIGHT = {"gain": (1, 0.0, 0.3), "panel_shift": (3, 0.5, 15.0), "panel_turn": (2, 0.3 * _DEG, 5.0 * _DEG)}

NUISANCE = {"ln R_s": 0.03, "ln sigma": 0.03, "blur [px²]": 2.0}
"""What a calibrated reflectance may still be off, and the focus, with the standard deviations. R_d is that of the part
file, since a change of both coefficients is a change of the exposure. The blur is measured at the outline."""

SIGMA_STEP = 0.01


@dataclass(frozen=True)
class Parameters:
    """All parameters of a scene.

    middle: About which the part turns, world frame at posture (0, 0) [mm], shape (3,).
    """

    lights: tuple[str, ...]
    groups: tuple[Group, ...]
    middle: Float64

    @staticmethod
    def of(scene: Scene, limits: VerifyLimits) -> Parameters:
        """The parameters of a scene's camera, lights and part."""
        groups: list[Group] = []
        fixed = {
            "gain": limits.gain,
            "exposure": limits.exposure,
            "black": limits.black,
            "part_shift": limits.part_mm,
            "part_turn": limits.part_deg * _DEG,
            "camera_shift": limits.camera_mm,
            "camera_turn": limits.camera_deg * _DEG,
            "panel_turn": limits.panel_deg * _DEG,
        }
        distances = {light.name: float(np.linalg.norm(light.centre)) for light in scene.lights}
        named = [(kind, "", facts) for kind, facts in _COMMON.items()]
        named += [(kind, light.name, facts) for kind, facts in _OF_LIGHT.items() for light in scene.lights]
        first = 0
        for kind, light, (size, step, prior) in named:
            limit = limits.panel(light, distances[light]) if kind == "panel_shift" else fixed[kind]
            groups.append(Group(kind=kind, light=light, first=first, size=size, step=step, prior=prior, limit=limit))
            first += size
        low, high = scene.mesh.bounds
        return Parameters(tuple(light.name for light in scene.lights), tuple(groups), 0.5 * (low + high))

    @property
    def size(self) -> int:
        """Number of parameters, with those of the reflectance, which come last."""
        return self.groups[-1].where.stop + len(NUISANCE)

    @property
    def priors(self) -> Float64:
        """Standard deviations, shape (K,)."""
        own = [np.full(group.size, group.prior) for group in self.groups]
        return np.concatenate([*own, np.array(list(NUISANCE.values()))])

    @property
    def nuisance(self) -> list[int]:
        """Places of ln R_s, ln σ and the blur."""
        return list(range(self.size - len(NUISANCE), self.size))

    def group(self, kind: str, light: str = "") -> Group:
        """A group by its kind and light."""
        return next(group for group in self.groups if (group.kind, group.light) == (kind, light))

    def at_placement(self, scene: Scene, placement: Placement) -> Float64:
        """The parameters of a rig whose part lies at a placement, shape (K,)."""
        theta = np.zeros(self.size)
        turn = rotation_from_vector(np.array([0.0, 0.0, placement.turn]))
        shift = scene.pivot + turn @ (self.middle - scene.pivot) + np.array([placement.x, placement.y, 0.0])
        theta[self.group("part_shift").where] = shift - self.middle
        theta[self.group("part_turn").where] = (0.0, 0.0, placement.turn)
        return theta

    def part_motion(self, theta: Float64) -> tuple[Float64, Float64]:
        """How the part is moved at posture (0, 0), x' = R·x + t: rotation (3, 3) and translation (3,) [mm]."""
        rotation = rotation_from_vector(theta[self.group("part_turn").where])
        return rotation, self.middle + theta[self.group("part_shift").where] - rotation @ self.middle

    def rig_at(self, scene: Scene, theta: Float64) -> Scene:
        """The scene with its camera and panels moved; the part stays."""
        camera = _moved_camera(
            scene.camera, theta[self.group("camera_shift").where], theta[self.group("camera_turn").where]
        )
        lights = tuple(
            _moved_panel(
                light,
                theta[self.group("panel_shift", light.name).where],
                theta[self.group("panel_turn", light.name).where],
            )
            for light in scene.lights
        )
        return replace(scene, camera=camera, lights=lights)

    def view(self, scene: Scene, posture: Posture, theta: Float64) -> PartView:
        """Camera and lights of the rig with these faults, in the frame of the part's mesh."""
        view = view_from_part(self.rig_at(scene, theta), posture)
        rotation, translation = self.part_motion(theta)
        back = rotation.T
        shift = -back @ translation
        return replace(
            view, camera=view.camera.moved(back, shift), lights=tuple(light.moved(back, shift) for light in view.lights)
        )


def axes_of(group: Group) -> Sequence[str]:
    """Names of a group's parameters, for tables."""
    if group.kind.startswith("part"):
        return ("x", "y", "z")
    if group.kind.startswith("camera"):
        return ("right", "up", "ahead")
    return ("across", "along", "outward")[: group.size] if group.size > 1 else ("",)


def _moved_camera(camera: PinholeCamera, shift: Float64, turn: Float64) -> PinholeCamera:
    # along its own axes, and about its own pinhole
    axes = np.stack([camera.right, camera.up, camera.forward], axis=1)
    rotation = rotation_from_vector(axes @ turn)
    return replace(
        camera,
        position=camera.position + axes @ shift,
        right=rotation @ camera.right,
        up=rotation @ camera.up,
        forward=rotation @ camera.forward,
    )


def _moved_panel(light: PanelLight, shift: Float64, turn: Float64) -> PanelLight:
    # along its own axes, and about its own centre
    axes = np.stack([light.across, light.along, light.outward], axis=1)
    rotation = rotation_from_vector(axes[:, :2] @ turn)
    return replace(
        light,
        centre=light.centre + axes @ shift,
        across=rotation @ light.across,
        along=rotation @ light.along,
        outward=rotation @ light.outward,
        reference_distance=light.reference_distance or light.distance,
    )
