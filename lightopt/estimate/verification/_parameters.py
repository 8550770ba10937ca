"""The faults that a rig may have as parameters of its images, the rig with these faults, and coarse images of it.

Parameters are in one vector, shape (K,): 0 is the rig as its file has it. Faults come in groups, such as the three
shifts of a camera, which are found together.

Coarse images are means over square blocks of pixels: those of a camera of larger pixels. Blocks have less noise, and
there are fewer rays to cast.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import ndimage

from lightopt.config import RigConfig
from lightopt.core.arrays import Bool, Float32, Float64
from lightopt.core.errors import refuse
from lightopt.core.run_context import RunContext
from lightopt.core.threads import in_threads, threads_each
from lightopt.core.transforms import Posture, rotation_from_vector
from lightopt.estimate.registration import Observation, Placement
from lightopt.estimate.rig_calibration import read_covariance, rig_deviations, square_root
from lightopt.lights import PanelLight
from lightopt.rendering import cast_rays_at, mask_pixels, render_posture
from lightopt.scene import PartView, PinholeCamera, Scene, Stage, project, view_from_part, with_reflectances

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


@dataclass(frozen=True, kw_only=True)
class VerifyLimits:
    """Greatest departures that are within tolerance; all above 0."""

    gain: float = 0.03  # share of the brightness of one light
    exposure: float = 0.02  # share of that of all of them
    black: float = 1.0  # [sensor level]
    part_mm: float = 0.05
    part_deg: float = 0.1
    camera_mm: float = 0.15
    camera_deg: float = 0.02
    panel_mm: float = 2.0
    panel_deg: float = 2.0
    blur_px: float = 1.0  # standard deviation of the blur of the image beyond that of the pixel

    def __post_init__(self) -> None:
        wrong = [(name, value) for name, value in vars(self).items() if not 0.0 < value < math.inf]
        refuse(f"limit {name}: expected a number above 0, found {value:g}" for name, value in wrong)


@dataclass(frozen=True, kw_only=True)
class Group:
    kind: str  # ``gain``, ``exposure``, ``black``, ``part_shift``, …
    light: str = ""  # whose fault it is; empty where it is no light's
    first: int  # place in the vector of parameters
    size: int
    step: float  # for differences [unit of the parameter]; 0 where the derivative has a closed form
    prior: float  # standard deviation of the parameters of a rig with that fault
    limit: float  # within tolerance up to this norm

    @property
    def where(self) -> slice:
        return slice(self.first, self.first + self.size)


@dataclass(frozen=True)
class Parameters:
    lights: tuple[str, ...]
    groups: tuple[Group, ...]
    middle: Float64  # about which the part turns, world frame at posture (0, 0) [mm], shape (3,)

    @staticmethod
    def of(scene: Scene, limits: VerifyLimits) -> "Parameters":
        lights = tuple(light.name for light in scene.lights)
        groups: list[Group] = []
        first = 0
        for kind, (size, step, prior, name) in _FAULTS.items():
            limit = vars(limits)[name] * (_DEG if name.endswith("_deg") else 1.0)
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
        return next(group for group in self.groups if (group.kind, group.light) == (kind, light))

    def part_groups(self, freedoms: int) -> tuple[Group, ...]:
        """The part's shift and turn in the freedoms of its registration: on the stage's plate, or all six."""
        shift, turn = self.group("part_shift"), self.group("part_turn")
        if freedoms == 6:
            return shift, turn
        return replace(shift, size=2), replace(turn, first=turn.first + 2, size=1)

    def at_placement(self, scene: Scene, placement: Placement) -> Float64:
        """The parameters of a rig whose part lies at a placement, shape (K,)."""
        theta = np.zeros(self.size)
        turn = rotation_from_vector(np.array([0.0, 0.0, placement.turn]))
        shift = scene.pivot + turn @ (self.middle - scene.pivot) + np.array([placement.x, placement.y, 0.0])
        theta[self.group("part_shift").where] = shift - self.middle
        theta[self.group("part_turn").where] = (0.0, 0.0, placement.turn)
        return theta

    def camera_instead(self, scene: Scene, theta: Float64) -> Float64:
        """The parameters of a rig whose camera has turned so that it sees a part that has moved about as well."""
        group, found = self.group("camera_turn"), np.zeros(self.size)
        points = _some_vertices(scene)
        target = self.seen(scene, points, theta)
        steps = group.step * np.eye(self.size)[group.where]
        for _ in range(3):
            now = self.seen(scene, points, found)
            slopes = np.array([self.seen(scene, points, found + step) - now for step in steps]) / group.step
            known = np.isfinite(now) & np.isfinite(target)
            found[group.where] += np.linalg.lstsq(slopes[:, known].T, (target - now)[known], rcond=None)[0]
        return found

    def seen(self, scene: Scene, points: Float64, theta: Float64) -> Float64:
        """Where some points of the part lie in the images of all postures, shape (postures, 2, n) [px]."""
        cameras = [self.view(scene, posture, theta).camera for posture in scene.postures]
        return np.array([project(camera, points)[:2] for camera in cameras])

    def values(self, theta: Float64, kind: str, light: str = "") -> Float64:
        """Those of a group, shape (1,) to (3,)."""
        return theta[self.group(kind, light).where]

    def moved(self, scene: Scene, theta: Float64) -> Scene:
        """The scene with camera and lights moved; lights without parameters stay."""

        def moved_light_of(light: PanelLight) -> PanelLight:
            if light.name not in self.lights:
                return light
            shift, turn = (self.values(theta, kind, light.name) for kind in ("panel_shift", "panel_turn"))
            return moved_light(light, shift, turn)

        camera = moved_camera(scene.camera, self.values(theta, "camera_shift"), self.values(theta, "camera_turn"))
        return replace(scene, camera=camera, lights=tuple(map(moved_light_of, scene.lights)))

    def lobe_factors(self, theta: Float64) -> tuple[float, float]:
        """By which R_s and σ are multiplied."""
        log_s, log_sigma = theta[self.nuisance[:2]]
        return math.exp(log_s), math.exp(log_sigma)

    def reflecting(self, scene: Scene, theta: Float64) -> Scene:
        """The scene with R_s and σ of all its surfaces changed."""
        r_s, sigma = self.lobe_factors(theta)
        changed = [replace(one, R_s=one.R_s * r_s, sigma=one.sigma * sigma) for one in scene.reflectances]
        return with_reflectances(scene, changed)

    def view(self, scene: Scene, posture: Posture, theta: Float64) -> PartView:
        """Camera and lights of the rig with these faults, in the frame of the part's mesh."""
        view = view_from_part(self.moved(scene, theta), posture)
        # the part moved at posture (0, 0), x' = R·x + t, inverted
        back = rotation_from_vector(self.values(theta, "part_turn")).T
        shift = self.middle - back @ (self.middle + self.values(theta, "part_shift"))
        return view.seen_from(back, shift)


def moved_camera(camera: PinholeCamera, shift: Float64, turn: Float64) -> PinholeCamera:
    # along its own axes, and about its own pinhole
    axes = np.stack([camera.right, camera.up, camera.forward], axis=1)
    right, up, forward = (rotation_from_vector(axes @ turn) @ axes).T
    return replace(camera, position=camera.position + axes @ shift, right=right, up=up, forward=forward)


def moved_light(light: PanelLight, shift: Float64, turn: Float64) -> PanelLight:
    # along its own axes, and about its own centre
    if not (shift.any() or turn.any()):
        return light
    axes = np.stack([light.across, light.along, light.outward], axis=1)
    rotation = rotation_from_vector(axes[:, :2] @ turn)
    return light.moved(rotation, light.centre + axes @ shift - rotation @ light.centre)


def calibrated_deviations(rig: RigConfig, scene: Scene, p: Parameters) -> Float64:
    """Independent deviations of one standard deviation each, as columns, shape (K, D); none for a rig as designed.

    Raises InputError: The covariance that the rig file names cannot be read
    """
    names, covariance = read_covariance(rig)
    at = {name: i for i, name in enumerate(names)}
    of_rig = rig_deviations(scene.camera, scene.stage, names, covariance)
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


def _some_vertices(scene: Scene, count: int = 200) -> Float64:
    return scene.mesh.vertices[:: max(1, len(scene.mesh.vertices) // count)]


def _as_camera(scene: Scene, p: Parameters, rigs: list[tuple[PinholeCamera, Stage]]) -> Float64:
    # The shift and turn of the camera that move the part's image as each rig does, shape (K, rigs). Lens and axes have
    # no faults of their own, and over a part they act as a camera that has moved.
    rows = [*range(p.size)[p.group("camera_shift").where], *range(p.size)[p.group("camera_turn").where]]
    points = _some_vertices(scene)
    image = partial(p.seen, points=points)
    still = image(scene, theta=np.zeros(p.size))
    unit = np.array([g.step for g in p.groups if g.kind.startswith("camera")])
    unit = np.repeat(unit, 3)
    steps = [step * np.eye(p.size)[row] for row, step in zip(rows, unit, strict=True)]
    moves = np.array([image(scene, theta=step) - still for step in steps])
    worlds = [replace(scene, camera=camera, stage=stage) for camera, stage in rigs]
    changes = [image(world, theta=np.zeros(p.size)) - still for world in worlds]
    found = np.zeros((p.size, len(rigs)))
    if rigs:
        seen = np.isfinite(still)
        found[rows] = unit[:, None] * np.linalg.lstsq(moves[:, seen].T, np.array(changes)[:, seen].T, rcond=None)[0]
    return found


COARSE_WIDTH = 540  # about so many columns of a coarse image
PANEL_MM = 10.0  # a panel that has moved by this is as bad as a part that has moved by a block
# rigs that differ by less have the same images: in place [block], and R_s and σ
SAME_BLOCKS, SAME_SHARE = 0.02, 0.005


@dataclass(frozen=True, kw_only=True)
class CoarseImage:
    """An observation in blocks of side² pixels."""

    source: Observation
    levels: Float32  # mean sensor levels, black level included, shape (h, w)
    saturated: Bool  # blocks with a saturated pixel, same shape
    mostly: Bool  # blocks of which most pixels are saturated, same shape
    top: Float32  # level from which a pixel is saturated, less what was subtracted, same shape
    count: int  # frames and pixels that a level is the mean of


@dataclass(frozen=True, kw_only=True)
class CoarsePrediction:
    """What the model has in a posture; levels at exposure 1 [grey level], arrays of shape (h, w)."""

    levels: dict[str, Float32]  # by light
    hit: Bool  # of the part
    clean: Bool  # off silhouettes, creases and grazing views
    points: Float32  # world frame, as the normals, shape (h, w, 3)
    normals: Float32


Predictions = dict[Posture, CoarsePrediction]


class Work:
    """What is the same for all sets of a scene."""

    def __init__(self, scene: Scene, parameters: Parameters, run: RunContext) -> None:
        self.scene, self.parameters, self.run = scene, parameters, run
        camera = scene.camera
        # of blocks [px], the pixels of the coarse camera; what is left at the right and at the bottom is cut off
        self.side = max(1, round(camera.width / COARSE_WIDTH))
        column, row = camera.axis_px
        coarse = replace(
            camera,
            width=camera.width // self.side,
            height=camera.height // self.side,
            pixel_size=camera.pixel_size * self.side,
            principal_point=(column / self.side, row / self.side),
        )
        self.coarse = replace(scene, camera=coarse)
        self.caster = cast_rays_at(scene)
        self._kept: list[tuple[Float64, tuple[CoarsePrediction, ...]]] = []  # sharp, of each posture

    def blocks(self, observations: Sequence[Observation]) -> tuple[CoarseImage, ...]:
        """Block means of images."""

        def one(number: int) -> CoarseImage:
            o, side = observations[number], self.side
            share = _blocks(o.saturated.astype(np.float32), side)
            subtracted = _blocks(np.broadcast_to(np.float32(o.subtracted), o.levels.shape), side)
            return CoarseImage(
                source=o,
                levels=_blocks(o.levels, side),
                saturated=share > 0.0,
                mostly=share >= 0.5,
                top=(self.scene.sensor.saturated_from - subtracted).astype(np.float32),
                count=o.frames * side**2,
            )

        return tuple(in_threads(one, range(len(observations)), self.run.threads))

    def predict(self, theta: Float64) -> Predictions:
        """Images of the rig with some faults; those that were rendered before if they hardly differ."""
        postures, threads = self.scene.postures, self.run.threads
        for there, kept in self._kept:
            if self.alike(theta, there, blocks=SAME_BLOCKS, share=SAME_SHARE):
                sharp = kept
                break
        else:
            render = partial(self._render, theta, threads=threads_each(len(postures), threads))
            sharp = tuple(in_threads(render, postures, threads))
            self._kept.append((theta, sharp))
        width = math.sqrt(max(float(theta[self.parameters.nuisance[-1]]), 0.0)) / self.side
        if width == 0.0:
            return dict(zip(postures, sharp, strict=True))
        images = in_threads(partial(_blurred_prediction, width), sharp, threads)
        return dict(zip(postures, images, strict=True))

    def alike(self, a: Float64, b: Float64, *, blocks: float, share: float) -> bool:
        """Whether sharp images of two rigs differ in place by less than this [block], lobes by less than this share."""
        lobe = np.abs(a - b)[self.parameters.nuisance[:-1]]
        return bool(max(lobe) < share) and self.moved_blocks(a, b) <= blocks

    def _render(self, theta: Float64, posture: Posture, threads: int) -> CoarsePrediction:
        scene = self.coarse
        view = self.parameters.view(scene, posture, theta)
        own = replace(self.parameters.reflecting(scene, theta), defects=(), waviness=None)
        world = view.of_scene(own)
        images = render_posture(world, posture, caster=self.caster, threads=threads)
        masks = mask_pixels(world, posture, self.caster, threads=threads)
        hit = images.geometry.hit
        return CoarsePrediction(
            levels={i.light: i.level for i in images.lights},
            hit=hit,
            clean=np.asarray(ndimage.binary_erosion(masks.clean & hit, border_value=1), np.bool_),
            points=images.geometry.points,
            normals=images.geometry.normals,
        )

    def moved_blocks(self, a: Float64, b: Float64) -> float:
        """By how much the images of two rigs differ, at most [block]: of the part, or of what it mirrors."""
        p = self.parameters
        # [mm] per parameter; a shift along the line of sight changes the size alone, and the level with the fall-off
        levers: dict[tuple[str, str], Float64] = {}
        for light in self.scene.lights:
            half = 0.5 * max(light.size)
            along = 1.0 if light.inverse_square else min(1.0, half / float(np.linalg.norm(light.centre)))
            levers["panel_shift", light.name] = np.array([1.0, 1.0, along])
            levers["panel_turn", light.name] = np.array([half, half])
        groups = ((p.group(*key), lever) for key, lever in levers.items())
        most = max(float(np.max(np.abs(a - b)[g.where] * lever)) for g, lever in groups) / PANEL_MM
        points = _some_vertices(self.scene, 500)
        off = p.seen(self.coarse, points, a) - p.seen(self.coarse, points, b)
        return max(most, float(np.nanmax(np.hypot(off[:, 0], off[:, 1]))))


def _blurred_prediction(width: float, sharp: CoarsePrediction) -> CoarsePrediction:
    return replace(sharp, levels={light: blurred(level, width) for light, level in sharp.levels.items()})


def blurred(image: Float32, width: float) -> Float32:
    """An image after a Gaussian blur of this standard deviation [pixel of the image]."""
    return np.asarray(ndimage.gaussian_filter(image, width), np.float32)


def _blocks(image: Float32, side: int) -> Float32:
    height, width = image.shape[0] // side, image.shape[1] // side
    # by whole slices: a mean over axes of so few elements takes long
    total = np.zeros((height, width), np.float32)
    for y in range(side):
        for x in range(side):
            total += image[y : height * side : side, x : width * side : side]
    total *= np.float32(1.0 / side**2)
    return total
