"""The placement of a part on the stage, as the part file has it, and light of single pixels under any placement."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from lightopt import rendering
from lightopt.config import PlacementConfig
from lightopt.core.arrays import Bool, Float64, Index, Int32
from lightopt.core.threads import in_threads, threads_each
from lightopt.core.transforms import Posture, rotation_from_vector, rotation_z
from lightopt.estimate.registration._observations import Observation
from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight, SurfaceLight
from lightopt.rendering import PosturePixels, SurfacePoints
from lightopt.scene import PartView, Scene, lens_share, move_part, pixel_footprint, view_from_part

# reach of the search from the file placement: along x and y the larger of both, and about the vertical axis
GREATEST_SHIFT_MM, GREATEST_SHIFT_PX, GREATEST_TURN_RAD = 5.0, 16.0, math.radians(6.0)
# the same in z and in tilt: it lies on the stage
GREATEST_LIFT_MM, GREATEST_TILT_RAD = 3.0, math.radians(3.0)
LIFT_PIXELS = 8.0  # a shift along the view changes the image by parallax and by highlights alone
# a shift or a rotation is determined where its standard error is below this
MOST_ERROR_PX, MOST_LIFT_ERROR_MM, MOST_TURN_ERROR_RAD = 1.0, 0.5, math.radians(0.5)
NAMES = ("x", "y", "turn", "z", "tilt_x", "tilt_y")
"""The degrees of freedom of a part; the first three keep it on the stage's plate."""
_LENGTHS = ("x", "y", "z")


@dataclass(frozen=True, kw_only=True)
class Placement:
    """How a part lies on the stage, from where rig and part file have it."""

    # shift in the plane of the stage's plate, world axes at posture (0, 0) [mm]
    x: float = 0.0
    y: float = 0.0
    turn: float = 0.0  # about the stage's own axis [rad]
    z: float = 0.0  # shift along that axis [mm]
    # rotation vector of the part's tilt after its turn, about the pivot [rad]
    tilt_x: float = 0.0
    tilt_y: float = 0.0
    # standard errors of the first three or of all six, in the order of `NAMES`; 0 where not known
    errors: tuple[float, ...] = (0.0, 0.0, 0.0)
    # whether the images determine each of them; what they do not is as in the part file. Where they leave a direction
    # between two of them open, these have large errors.
    observable: tuple[bool, ...] = (True, True, True)

    @property
    def rotation(self) -> Float64:
        """R of the part's motion p' = R·p + t, shape (3, 3)."""
        turn = rotation_z(self.turn)
        if self.tilt_x == 0.0 == self.tilt_y:
            return turn
        return rotation_from_vector(np.array([self.tilt_x, self.tilt_y, 0.0])) @ turn

    def shift(self, pivot: Float64) -> Float64:
        """T of the part's motion, shape (3,) [mm]; pivot: of the stage, shape (3,)."""
        return pivot - self.rotation @ pivot + np.array([self.x, self.y, self.z])

    def as_dict(self) -> dict[str, float | list[str]]:
        names = NAMES[: len(self.observable)]
        observable = [name for name, seen in zip(names, self.observable, strict=True) if seen]
        found: dict[str, float | list[str]] = {"observable": observable}
        values = {name: getattr(self, name) for name in names}
        known = dict(zip(names, self.errors, strict=True))
        for digits, suffix, numbers in ((6, "", values), (3, "_error", known)):
            for name in names:
                unit, value = ("mm", numbers[name]) if name in _LENGTHS else ("deg", math.degrees(numbers[name]))
                found[f"{name}{suffix}_{unit}"] = float(f"{value:.{digits}g}")
        return found


def place_part(scene: Scene, placement: Placement) -> Scene:
    """Move the part of a scene to its placement."""
    return move_part(scene, placement.rotation, placement.shift(scene.pivot))


def part_file_placement(scene: Scene, placement: Placement, file: PlacementConfig) -> PlacementConfig:
    """``placement`` of a part file that puts the part at its measured placement, with the anchor that `file` has.

    The anchor uses the bounding box of the rotated part, so that the translation takes back what the anchor moves.

    scene: With the part at its file placement.
    """
    # the anchor uses the bounding box of the rotated part: the translation takes back what the anchor moves
    moved = placement.rotation
    turned = scene.mesh.vertices @ moved.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    middle = 0.5 * (low + high)
    if file.anchor == "rest_on_table":
        anchored = np.array([middle[0], middle[1], low[2]])
    elif file.anchor == "centred":
        anchored = middle
    else:
        anchored = moved @ np.array(file.translate_mm, dtype=np.float64)
    shift = placement.shift(scene.pivot) + anchored
    about_x, about_y, about_z = file.rotate_deg
    if placement.tilt_x == 0.0 == placement.tilt_y:
        angles = about_x, about_y, math.remainder(about_z + math.degrees(placement.turn), 360.0)
    else:
        # of R = Rz·Ry·Rx
        r = moved @ scene.placement.rotation
        about = math.atan2(r[2, 1], r[2, 2]), math.asin(max(-1.0, min(1.0, -r[2, 0]))), math.atan2(r[1, 0], r[0, 0])
        angles = math.degrees(about[0]), math.degrees(about[1]), math.degrees(about[2])
    return file.model_copy(update={"rotate_deg": angles, "translate_mm": tuple(shift.tolist())})


@dataclass(frozen=True)
class PoseFrame:
    """Poses are shifts of the part's middle in x and y [mm] and a rotation about it [rad], from nominal, shape (3,).

    In six degrees of freedom, shape (6,), they go on with the shift in z [mm] and the two tilts [rad]. A placement
    rotates the part about the stage's axis. About the part's own middle shift and rotation hardly depend on each other:
    of a body of revolution that stands off the axis, the rotation alone is undetermined.
    """

    middle: Float64  # of the part from the stage's pivot, shape (3,) [mm]
    radius: float  # of the part about its middle, seen along Z [mm]
    pixel: float
    freedoms: int = 3  # 3 or 6

    @staticmethod
    def of(scene: Scene) -> "PoseFrame":
        """The frame of a scene's part at its file placement."""
        own = scene.mesh.vertices - scene.pivot
        middle = 0.5 * (own.min(axis=0) + own.max(axis=0))
        radius = float(np.sqrt(np.max(np.sum(np.square(own[:, :2] - middle[:2]), axis=1))))
        distance = float(np.linalg.norm(scene.camera.position - scene.pivot))
        pixel = pixel_footprint(scene.camera, distance)
        return PoseFrame(middle.astype(np.float64), max(radius, 1e-3), pixel, scene.freedoms)

    @property
    def reach(self) -> Float64:
        """Greatest distance from nominal, shape (freedoms,)."""
        shift = max(GREATEST_SHIFT_MM, GREATEST_SHIFT_PX * self.pixel)
        return np.array([shift, shift, GREATEST_TURN_RAD, GREATEST_LIFT_MM, *[GREATEST_TILT_RAD] * 2])[: self.freedoms]

    @property
    def pixel_steps(self) -> Float64:
        """Shifts [mm] and rotations [rad] that move the image of the part's rim by a pixel, seen from some side."""
        turn = self.pixel / self.radius
        return np.array([self.pixel, self.pixel, turn, LIFT_PIXELS * self.pixel, turn, turn])[: self.freedoms]

    @property
    def resolution(self) -> Float64:
        """Standard errors from which on a pose is not determined, shape (freedoms,)."""
        shift = MOST_ERROR_PX * self.pixel
        errors = np.array([shift, shift, MOST_TURN_ERROR_RAD, MOST_LIFT_ERROR_MM, *[MOST_TURN_ERROR_RAD] * 2])
        return errors[: self.freedoms]

    def pose(self, placement: Placement) -> Float64:
        """The pose of a placement, shape (freedoms,)."""
        p = placement
        x, y, z = p.rotation @ self.middle - self.middle + np.array([p.x, p.y, p.z])
        return np.array([x, y, p.turn, z, p.tilt_x, p.tilt_y])[: self.freedoms]

    def placement(self, pose: Float64, covariance: Float64 | None = None) -> Placement:
        """The placement of a pose, with standard errors where its covariance, shape (freedoms, freedoms), is given."""
        x, y, turn, z, tilt_x, tilt_y = (*pose.tolist(), *[0.0] * (6 - self.freedoms))
        place = Placement(turn=turn, tilt_x=tilt_x, tilt_y=tilt_y)
        rotated = place.rotation @ self.middle
        x, y, z = (np.array([x, y, z]) + self.middle - rotated).tolist()
        place = replace(place, x=x, y=y, z=z)
        if covariance is None:
            return place
        # rotations move the pivot, too; to first order in the tilts
        slopes = np.eye(6)
        along = [0, 1, 3]
        for column, axis in ((2, 2), (4, 0), (5, 1)):
            slopes[along, column] = -np.cross(np.eye(3)[axis], rotated)
        slopes = slopes[: self.freedoms, : self.freedoms]
        errors = np.sqrt(np.maximum(np.diag(slopes @ covariance @ slopes.T), 0.0))
        return replace(place, errors=tuple(errors.tolist()))

    def distance_px(self, a: Placement, b: Placement) -> float:
        """How far the part's image moves from one placement to another, at most [px]."""
        off = np.abs(self.pose(a) - self.pose(b)) / self.pixel_steps
        return float(np.hypot(off[0], off[1]) + np.sum(off[2:]))


LEAST_R_D, LEAST_R_S = 0.1, 1e-3
"""What R_d and R_s of almost nothing count as, so that they can be changed by factors."""
# additive recurrences that fill a pixel evenly: Roberts's R₂, by the plastic number, and quadratic irrationals
_LATTICE = np.array([0.7548776662466927, 0.5698402909980532])
_OFFSETS = np.array([0.6180339887498949, 0.4142135623730951])


@dataclass(frozen=True, kw_only=True)
class PixelSet:
    """Pixels of one posture, shape (n,), and what was measured there."""

    posture: Posture
    row: Int32
    column: Int32
    images: tuple[Observation, ...]
    levels: Float64  # sensor levels above black, one row per image, shape (images, n)
    saturated: Bool  # where those are lower bounds, same shape
    rays: int = 1  # per pixel: 1 for one at its centre, more for a mean over its area

    @staticmethod
    def look_up(
        posture: Posture, row: Int32, column: Int32, images: Sequence[Observation], black: float, *, rays: int = 1
    ) -> "PixelSet":
        return PixelSet(
            posture=posture,
            row=row,
            column=column,
            images=tuple(images),
            levels=np.stack([image.levels[row, column] - black for image in images]).astype(np.float64),
            saturated=np.stack([image.saturated[row, column] for image in images]),
            rays=rays,
        )

    def some(self, most: int) -> "PixelSet":
        """So many of them at most, at random."""
        at = random_some(np.arange(len(self.row)), most)
        levels, saturated = self.levels[:, at], self.saturated[:, at]
        return replace(self, row=self.row[at], column=self.column[at], levels=levels, saturated=saturated)

    @property
    def positions(self) -> tuple[Float64, Float64]:
        """Columns and rows of the rays [px], pixel after pixel; shape (n · rays,)."""
        if self.rays == 1:
            return self.column.astype(np.float64) + 0.5, self.row.astype(np.float64) + 0.5
        # a lattice shifted from pixel to pixel: an edge along rows meets its rays one after another and not in threes
        x, y = (np.arange(self.rays)[:, None] * _LATTICE).T
        along, down = (np.arange(len(self.row))[:, None] * _OFFSETS).T[:, :, None]
        return (self.column[:, None] + (x + along) % 1.0).ravel(), (self.row[:, None] + (y + down) % 1.0).ravel()


def random_some(index: Index, most: int) -> Index:
    """So many entries at most of ascending ones, at random, the same ones each time."""
    if len(index) <= most:
        return index
    return np.sort(np.random.default_rng(0).choice(index, most, replace=False))


def view_of_placed(scene: Scene, posture: Posture, placement: Placement) -> PartView:
    """Camera and lights as a part sees them that was moved on the stage.

    The part's own frame stays, so that one ray caster serves all placements.
    """
    view = view_from_part(scene, posture)
    # x_placed = R·x + t, inverted
    back = placement.rotation.T
    shift = -back @ placement.shift(scene.pivot)
    return view.seen_from(back, shift)


def light_at(
    scene: Scene,
    pixels: PixelSet,
    view: PartView,
    caster: RayCaster,
    *,
    sigmas: Sequence[float] = (),
    shares: Float64 | None = None,
    threads: int | None = None,
) -> tuple[Float64, Float64]:
    """Diffuse and specular light of each pixel under the light of each image, per unit of R_d and R_s.

    shares: Of each light that each ray sees, as :func:`shares_seen` of a view that hardly differs has them: no shadow
        rays are cast.

    These, and σ, are those of the scene's first reflectance; where they change, those of regions change with them by
    the same factors. A first R_d or R_s of almost nothing counts as `LEAST_R_D` or `LEAST_R_S`.

    Arrays of shape (images, n) and (sigmas, images, n). Light is 0 where a ray misses the part or no light arrives, NaN
    where only some of a panel is seen.
    """
    columns, _ = pixels.positions
    ray, some = _trace(scene, pixels, view, caster)
    light = np.zeros((1 + len(sigmas), len(pixels.images), len(columns)))

    def shade(images: Sequence[Sequence[int]], group: Sequence[PanelLight], threads_of_group: int) -> None:
        if shares is not None:
            own = shares[:, [numbers[0] for numbers in images]][..., ray]
        else:
            own = _panel_shares(some, group, caster)
        found = np.concatenate([own[:1], *[own[1:]] * len(sigmas)])
        lit = np.flatnonzero((own > 0.0).any(axis=(0, 1)))
        seen_by = caster if shares is None else None
        found[..., lit] *= _layers(scene, some.surface.take(lit), group, sigmas, caster, seen_by, threads_of_group)
        for numbers, level in zip(images, found.swapaxes(0, 1), strict=True):
            for number in numbers:
                light[:, number, ray] = level

    _by_group(pixels, view, shade, threads)
    passed = lens_share(view.camera, *pixels.positions)
    if passed is not None:
        light *= passed
    if pixels.rays > 1:
        light = light.reshape(*light.shape[:2], len(pixels.row), -1).mean(axis=3)
    return light[0], light[1:]


def shares_seen(
    scene: Scene,
    pixels: PixelSet,
    view: PartView,
    caster: RayCaster,
    *,
    sigma: float | None,
    threads: int | None = None,
) -> Float64:
    """The shares of each light that reach the point of each ray, of diffuse and of specular light.

    Shape (2, images, n · rays). Of panels 0 or 1, and NaN where the point sees only some of one. 0 where a ray misses
    the part.

    sigma: Of the lobe [rad]. None if no light is to be worked out: of lights that are no panels the share of the
        surface is given then, for both.
    """
    columns, _ = pixels.positions
    ray, some = _trace(scene, pixels, view, caster)
    shares = np.zeros((2, len(pixels.images), len(columns)))

    def find(images: Sequence[Sequence[int]], group: Sequence[PanelLight], threads_of_group: int) -> None:
        own = _panel_shares(some, group, caster)
        if isinstance(group[0], SurfaceLight):
            if sigma is None:
                own[:] = rendering.visible_shares(some, group, caster, moving=True, threads=threads_of_group)
            else:
                whole, seen = (
                    _layers(scene, some.surface, group, (sigma,), caster, seen_by, threads_of_group)
                    for seen_by in (None, caster)
                )
                np.divide(seen, whole, out=own, where=whole > 0.0)
                # pieces of an element are integrated by other nodes than the element
                np.clip(own, 0.0, 1.0, out=own)
        for numbers, share in zip(images, own.swapaxes(0, 1), strict=True):
            for number in numbers:
                shares[:, number, ray] = share

    _by_group(pixels, view, find, threads)
    return shares


def _trace(scene: Scene, pixels: PixelSet, view: PartView, caster: RayCaster) -> tuple[Int32, PosturePixels]:
    # the rays that meet the part, and where
    columns, rows = pixels.positions
    hits, surface = rendering.trace_samples(caster, scene.mesh, view.camera, columns, rows, neighbours=True)
    some = PosturePixels(
        posture=pixels.posture,
        view=view,
        row=np.floor(rows[hits.ray]).astype(np.int32),
        column=np.floor(columns[hits.ray]).astype(np.int32),
        surface=surface,
        clean=surface.front,
        shape=(scene.camera.height, scene.camera.width),
    )
    return hits.ray, some


def _by_group(
    pixels: PixelSet,
    view: PartView,
    work: Callable[[Sequence[Sequence[int]], Sequence[PanelLight], int], None],
    threads: int | None,
) -> None:
    # calls `work` for the channels of each light and for each panel, with the numbers of the images under each, those
    # lights, and a number of threads
    panels = {panel.name: panel for panel in view.lights}
    names = list(dict.fromkeys(image.light for image in pixels.images))
    groups = rendering.channel_groups([panels[name] for name in names])
    threads_of_group = threads_each(len(groups), threads)

    def work_on(number: int) -> None:
        own = [names[i] for i in groups[number]]
        images = [[i for i, image in enumerate(pixels.images) if image.light == name] for name in own]
        work(images, [panels[name] for name in own], threads_of_group)

    in_threads(work_on, range(len(groups)), threads)


def _panel_shares(pixels: PosturePixels, lights: Sequence[PanelLight], caster: RayCaster) -> Float64:
    # the share of each panel that is seen, and 1 of other lights, of diffuse and specular light, shape (2, lights, k)
    if isinstance(lights[0], SurfaceLight):
        return np.ones((2, len(lights), len(pixels.surface)))
    seen = rendering.visibility_of_lights(pixels, lights, caster, moving=True, threads=1)
    share = np.select([seen == rendering.UNLIT, seen == rendering.WHOLE], [0.0, 1.0], np.nan)
    return np.stack([share, share])


def _layers(
    scene: Scene,
    surface: SurfacePoints,
    lights: Sequence[PanelLight],
    sigmas: Sequence[float],
    caster: RayCaster,
    seen_by: RayCaster | None,
    threads: int,
) -> Float64:
    # diffuse light, and specular light for each σ, of channels of a light or of one panel, shape (1 + σ, lights, n);
    # without what the part hides of channels, where `seen_by` is given
    reflectances = scene.reflectances
    first = reflectances[0]
    channels = [light for light in lights if isinstance(light, SurfaceLight)]
    layers = np.empty((1 + len(sigmas), len(lights), len(surface)))
    for index, some, own in surface.by_material(reflectances):
        lobes = [replace(own, sigma=sigma * (own.sigma / first.sigma)) for sigma in sigmas]
        if channels:
            lit = partial(rendering.light_of_channels, some, channels, caster=seen_by, threads=threads)
            # the rays of both are cast once
            first_parts = lit(lobes[0]) if lobes else lit(own.diffuse)[:1]
            parts = [*first_parts, *(lit(lobe, diffuse=False)[1] for lobe in lobes[1:])]
        else:
            layer = rendering.light_layer(some, lights[0], caster, form=own.diffuse, threads=1)
            parts = [layer.diffuse[None], *(layer.specular(lobe, threads=1)[None] for lobe in lobes)]
        shares = own.R_d / max(first.R_d, LEAST_R_D), own.R_s / max(first.R_s, LEAST_R_S)
        for place, part in enumerate(parts):
            layers[place][:, index] = part if own is first else shares[place > 0] * part
    return layers


def sensor_scale(scene: Scene, image: Observation) -> float:
    """Sensor levels per grey level at exposure 1."""
    return image.exposure * scene.sensor.max_level / scene.reflectance.full_scale
