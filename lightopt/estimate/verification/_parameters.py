"""The faults that a rig may have as parameters of its images, and the rig with these faults.

Parameters are in one vector, shape (K,): 0 is the rig as its file has it. Faults come in groups, such as the three
shifts of a camera, which are found together.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace

import numpy as np

from lightopt.config import RigConfig
from lightopt.core.arrays import Float64
from lightopt.core.errors import refuse
from lightopt.core.transforms import Posture, rotation_from_vector
from lightopt.estimate.registration import Placement
from lightopt.estimate.rig_calibration import displaced, read_covariance, square_root
from lightopt.lights import PanelLight
from lightopt.scene import PartView, PinholeCamera, Scene, Stage, project, view_from_part

_DEG = math.pi / 180.0

# kind: parameters, step of differences, prior, name of the limit; lengths in mm, angles in rad, shares, sensor levels
_FAULTS = {
    "exposure": (1, 0.0, 0.3, "exposure"),
    "black": (1, 0.0, 10.0, "black"),
    "part_shift": (3, 0.02, 1.0, "part_mm"),
    "part_turn": (3, 0.03 * _DEG, 1.0 * _DEG, "part_deg"),
    "camera_shift": (3, 0.05, 3.0, "camera_mm"),
    "camera_turn": (3, 0.005 * _DEG, 0.3 * _DEG, "camera_deg"),
    "gain": (1, 0.0, 0.3, "gain"),
    "panel_shift": (3, 0.5, 15.0, "panel_mm"),
    "panel_turn": (2, 0.3 * _DEG, 5.0 * _DEG, "panel_deg"),
}
_OF_LIGHTS = ("gain", "panel_shift", "panel_turn")
NUISANCE = {"ln R_s": 0.03, "ln sigma": 0.03, "blur [px²]": 2.0}
"""What a calibrated reflectance may still be off, and the focus, with the standard deviations. R_d is that of the part
file, since a change of both coefficients is a change of the exposure."""
SIGMA_STEP = 0.01


@dataclass(frozen=True, kw_only=True)
class VerifyLimits:
    """Greatest departures that are within tolerance; all above 0.

    gain, exposure: Shares of the brightness of one light, and of all of them.
    """

    gain: float = 0.03
    exposure: float = 0.02
    black: float = 1.0  # [sensor level]
    part_mm: float = 0.05
    part_deg: float = 0.1
    camera_mm: float = 0.15
    camera_deg: float = 0.02
    panel_mm: float = 2.0
    panel_deg: float = 2.0
    blur_px: float = 1.0  # standard deviation of the blur of the image beyond that of the pixel

    def __post_init__(self) -> None:
        problems = [
            f"limit {name}: expected a number above 0, found {value:g}"
            for name, value in self.as_dict().items()
            if not 0.0 < value < math.inf
        ]
        refuse(problems)

    def as_dict(self) -> dict[str, float]:
        return asdict(self)


@dataclass(frozen=True, kw_only=True)
class Group:
    """Parameters of one fault.

    first, size: Place in the vector of parameters.
    """

    kind: str  # ``gain``, ``exposure``, ``black``, ``part_shift``, …
    light: str = ""  # whose fault it is; empty where it is no light's
    first: int
    size: int
    step: float  # for differences [unit of the parameter]; 0 where the derivative has a closed form
    prior: float  # standard deviation of the parameters of a rig with that fault
    limit: float  # within tolerance up to this norm

    @property
    def where(self) -> slice:
        """Its parameters."""
        return slice(self.first, self.first + self.size)


@dataclass(frozen=True)
class Parameters:
    """All parameters of a scene."""

    lights: tuple[str, ...]
    groups: tuple[Group, ...]
    middle: Float64  # about which the part turns, world frame at posture (0, 0) [mm], shape (3,)

    @staticmethod
    def of(scene: Scene, limits: VerifyLimits) -> Parameters:
        """The parameters of a scene's camera, lights and part."""
        lights = tuple(light.name for light in scene.lights)
        groups: list[Group] = []
        first = 0
        for kind, (size, step, prior, name) in _FAULTS.items():
            limit = limits.as_dict()[name] * (_DEG if name.endswith("_deg") else 1.0)
            for light in lights if kind in _OF_LIGHTS else ("",):
                groups.append(
                    Group(kind=kind, light=light, first=first, size=size, step=step, prior=prior, limit=limit)
                )
                first += size
        return Parameters(lights, tuple(groups), 0.5 * np.sum(scene.mesh.bounds, axis=0))

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

    def view(self, scene: Scene, posture: Posture, theta: Float64) -> PartView:
        """Camera and lights of the rig with these faults, in the frame of the part's mesh."""

        def of(kind: str, light: str = "") -> Float64:
            return theta[self.group(kind, light).where]

        camera, lights = scene.camera, scene.lights
        camera = _moved_camera(camera, of("camera_shift"), of("camera_turn"))
        lights = tuple(_moved_panel(p, of("panel_shift", p.name), of("panel_turn", p.name)) for p in lights)
        view = view_from_part(replace(scene, camera=camera, lights=lights), posture)
        # the part moved at posture (0, 0), x' = R·x + t, inverted
        back = rotation_from_vector(of("part_turn")).T
        shift = self.middle - back @ (self.middle + of("part_shift"))
        return replace(
            view, camera=view.camera.moved(back, shift), lights=tuple(light.moved(back, shift) for light in view.lights)
        )


def _moved_camera(camera: PinholeCamera, shift: Float64, turn: Float64) -> PinholeCamera:
    # along its own axes, and about its own pinhole
    axes = np.stack([camera.right, camera.up, camera.forward], axis=1)
    right, up, forward = (rotation_from_vector(axes @ turn) @ axes).T
    return replace(camera, position=camera.position + axes @ shift, right=right, up=up, forward=forward)


def _moved_panel(light: PanelLight, shift: Float64, turn: Float64) -> PanelLight:
    # along its own axes, and about its own centre
    axes = np.stack([light.across, light.along, light.outward], axis=1)
    across, along, outward = (rotation_from_vector(axes[:, :2] @ turn) @ axes).T
    reference = light.reference_distance or light.distance
    return replace(
        light,
        centre=light.centre + axes @ shift,
        across=across,
        along=along,
        outward=outward,
        reference_distance=reference,
    )


def calibrated_deviations(rig: RigConfig, scene: Scene, p: Parameters) -> Float64:
    """Independent deviations of one standard deviation each, as columns, shape (K, D); none for a rig as designed.

    Raises InputError: The covariance that the rig file names cannot be read
    """
    names, covariance = read_covariance(rig)
    at = {name: i for i, name in enumerate(names)}
    own = [i for name, i in at.items() if name.startswith(("camera.", "tilt_axis.", "rotary_axis."))]
    of_rig = [displaced(scene.camera, scene.stage, names, column) for column in _root_of(covariance, own).T]
    to_faults = np.zeros((p.size, len(names)))
    for light in scene.lights:
        axes = np.stack([light.across, light.along, light.outward])
        for k, axis in enumerate("xyz"):
            if (i := at.get(f"{light.name} centre {axis} [mm]")) is not None:
                to_faults[p.group("panel_shift", light.name).where, i] = axes[:, k]
        for k, axis in enumerate(("across", "along")):
            if (i := at.get(f"{light.name} rotation about {axis} [rad]")) is not None:
                to_faults[p.group("panel_turn", light.name).first + k, i] = 1.0
        if (i := at.get(f"{light.name} gain")) is not None:
            to_faults[p.group("gain", light.name).where, i] = 1.0 / light.gain
    columns = [_as_camera(scene, p, of_rig), square_root(to_faults @ covariance @ to_faults.T)]
    return np.concatenate(columns, axis=1) if names else np.zeros((p.size, 0))


def _root_of(covariance: Float64, some: list[int]) -> Float64:
    # deviations of some of the values, shape (n, D)
    found = np.zeros((len(covariance), len(some)))
    found[some] = square_root(covariance[np.ix_(some, some)])
    return found


def _as_camera(scene: Scene, p: Parameters, rigs: list[tuple[PinholeCamera, Stage]]) -> Float64:
    # The shift and turn of the camera that move the part's image as each rig does, shape (K, rigs). Lens and axes have
    # no faults of their own, and over a part they act as a camera that has moved.
    rows = [*range(p.size)[p.group("camera_shift").where], *range(p.size)[p.group("camera_turn").where]]
    points = scene.mesh.vertices[:: max(1, len(scene.mesh.vertices) // 200)]

    def image(world: Scene, theta: Float64) -> Float64:
        cameras = [p.view(world, posture, theta).camera for posture in scene.postures]
        return np.concatenate([np.ravel(project(camera, points)[:2]) for camera in cameras])

    still, unit = image(scene, np.zeros(p.size)), np.array([g.step for g in p.groups if g.kind.startswith("camera")])
    unit = np.repeat(unit, 3)
    moves = np.array([image(scene, step * np.eye(p.size)[row]) - still for row, step in zip(rows, unit, strict=True)])
    changes = [image(replace(scene, camera=camera, stage=stage), np.zeros(p.size)) - still for camera, stage in rigs]
    found = np.zeros((p.size, len(rigs)))
    if rigs:
        seen = np.isfinite(still)
        found[rows] = unit[:, None] * np.linalg.lstsq(moves[:, seen].T, np.array(changes)[:, seen].T, rcond=None)[0]
    return found
