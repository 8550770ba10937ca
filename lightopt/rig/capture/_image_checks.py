"""Check the images of a run: dark frames must be dark, the others lit by their light, a repeated one as the first.

An image is compared at low resolution with a prediction for each light of the rig. Gains and reflectance need not be
right: only which prediction it correlates with most counts, and by how much.
"""

from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float32, Float64
from lightopt.core.errors import HardwareError
from lightopt.core.least_squares import HUBER, Limits, linear_problem, solve
from lightopt.core.transforms import Posture
from lightopt.geometry import RayCaster
from lightopt.optics import Sensor
from lightopt.rendering import cast_rays_at, render_posture
from lightopt.rig.capture._acquisition import AcquiredImage, Dark, ExposureImage, exposure_mismatch
from lightopt.scene import Scene, with_reflectances

AMBIENT_LEVELS = 0.5  # ambient light that shifts levels by more than this causes a warning [sensor level]
# images are compared at about this width, at which a small displacement of the part does not matter
COARSE_COLUMNS = 200
STAYED_DARK = 0.03  # an image darker than this share of the prediction is not lit
CLEARLY_MORE = 0.06  # another light is reported only if its correlation is higher by this much
RESEMBLES = 0.5  # below this correlation no light is reported: the part is not the one predicted, or is not there
LEAST_CELLS = 50
PIXELS_OF_CELL = 4  # of a larger cell about 4 × 4 pixels are used: the next exposure waits for the result
PLAIN = 0.8  # correlation of the prediction with itself under noise; below it a low correlation proves nothing
FLAT = 0.1  # a prediction whose deviation is below this share of its mean has too little pattern for any conclusion
# a frame without light that has this share of a light's image more than the first one shows that it is on
LEFT_ON = 0.05


@dataclass(frozen=True, kw_only=True)
class PredictedImages:
    """Coarse prediction of the image of each light in one posture."""

    sensor: Sensor
    cell: int  # side of a cell [px]
    levels: Mapping[str, Float64]  # linear, at exposure 1 above black [sensor level], by light; shape (rows, columns)
    part: Bool  # cells that show the part, shape (rows, columns)

    @property
    def room(self) -> float:
        """From black to saturation [sensor level]."""
        return self.sensor.saturated_from - self.sensor.black_level


@dataclass(frozen=True, kw_only=True)
class LightCheck:
    problem: str | None = None  # message about what is wrong
    brightness: float = 0.0  # mean brightness of the part above dark, as a share of the prediction
    resemblance: float = 0.0  # correlation with the prediction of the light
    next_best: tuple[str, float] | None = None  # the other light that it resembles most, and the correlation
    undecided: str | None = None  # why the image allows no decision

    def as_dict(self) -> dict[str, Any]:
        facts: dict[str, Any] = {"brightness": round(self.brightness, 4), "resemblance": round(self.resemblance, 4)}
        if self.next_best is not None:
            light, resemblance = self.next_best
            facts["next_best"] = {"light": light, "resemblance": round(resemblance, 4)}
        if self.undecided:
            facts["undecided"] = self.undecided
        return facts


def predict(scene: Scene, posture: Posture, caster: RayCaster, *, supersample: int = 1) -> PredictedImages:
    """Render the image of each light, one pixel for a cell of pixels, with `supersample` rays across it."""
    camera = scene.camera
    cell = max(1, round(camera.width / COARSE_COLUMNS))
    axis = camera.principal_point
    coarse = replace(
        camera,
        width=max(1, camera.width // cell),
        height=max(1, camera.height // cell),
        pixel_size=camera.pixel_size * cell,
        principal_point=axis and (axis[0] / cell, axis[1] / cell),
    )
    images = render_posture(replace(scene, camera=coarse), posture, caster=caster, supersample=supersample)
    scale = scene.sensor.max_level / scene.reflectance.full_scale
    return PredictedImages(
        sensor=scene.sensor,
        cell=cell,
        levels={image.light: image.level.astype(np.float64) * scale for image in images.lights},
        part=images.geometry.hit,
    )


def check_light(
    light: str, image: NDArray[Any], dark: NDArray[Any] | float, *, predictions: PredictedImages, exposure: float
) -> LightCheck:
    """Compare an image with the frame without light and with the predicted image of every light of the rig.

    light: The only light that should have been on.
    image, dark: [sensor level], shape (H, W); the dark may be one level.
    exposure: Relative exposure of the image.
    """
    part, sensor, room = predictions.part, predictions.sensor, predictions.room
    if int(part.sum()) < LEAST_CELLS:
        return LightCheck(undecided="too little of the part is visible")
    seen = _seen(image, dark, predictions)
    alone = {name: np.minimum(level[part] * exposure, room) for name, level in predictions.levels.items()}
    own_light = alone[light]
    expected, power = float(own_light.mean()), _dot(own_light, own_light)
    fitting = own_light * (_dot(seen, own_light) / power if power > 0.0 else 0.0)  # the multiple that fits best
    noise = float(np.std(seen - fitting)) / np.sqrt(seen.size)
    if expected <= 5.0 * max(noise, 0.02):
        return LightCheck(undecided="too dark at this exposure")
    brightness = float(seen.mean()) / expected
    resemblance = {name: _correlation(seen, level) for name, level in alone.items()}
    own = resemblance.pop(light)
    best = max(resemblance.items(), key=lambda item: item[1], default=None)
    levels = predictions.levels
    sums = {name: np.minimum((levels[light] + levels[name])[part] * exposure, room) for name in resemblance}
    together = {name: _correlation(seen, both_lights) for name, both_lights in sums.items()}
    both = max(together.items(), key=lambda item: item[1], default=None)
    clearly = max(RESEMBLES, own + CLEARLY_MORE)
    problem = undecided = None
    if brightness < STAYED_DARK:
        dim = f"the part is {brightness:.1%} as bright as it should be"
        problem = f"{light} stays dark: {dim}; check its plug, its cable and its panel"
    elif best is not None and best[1] >= clearly:
        like = f"{best[0]} (correlation {best[1]:.2f}, with {light} {own:.2f})"
        problem = f"{light} was lit, but the image looks like {like}: check whether their plugs are swapped"
    elif both is not None and both[1] >= clearly and brightness > 1.0 + STAYED_DARK:
        like = f"both (correlation {both[1]:.2f}, with {light} alone {own:.2f})"
        problem = f"{both[0]} is on together with {light}: the image looks like {like}"
    elif own < RESEMBLES and _self_correlation(own_light, sensor, predictions.cell) < PLAIN:
        undecided = "too little pattern at this exposure"
    elif own < RESEMBLES:
        like = f"the part does not look as predicted under any light (correlation with {light} {own:.2f})"
        problem = f"{like}; check that it is the part of the part file, and its placement"
    elif best is not None and best[1] > own - CLEARLY_MORE:
        undecided = f"{light} and {best[0]} make images that look alike"
    return LightCheck(problem=problem, brightness=brightness, resemblance=own, next_best=best, undecided=undecided)


def find_light_left_on(
    dark: NDArray[Any], *, predictions: PredictedImages, exposure: float, before: NDArray[Any] | None = None
) -> str | None:
    """The light that a dark frame (H, W) [sensor level] shows to be on, or None; `before` is one known to be dark."""
    part = predictions.part
    if int(part.sum()) < LEAST_CELLS:
        return None
    seen = _seen(dark, predictions.sensor.black_level if before is None else before, predictions)
    for name, level in predictions.levels.items():
        alone = np.minimum(level[part] * exposure, predictions.room)
        mean = float(alone.mean())
        like = _correlation(seen, alone)
        if mean > 0.5 and seen.mean() > 0.3 * mean and like > 1.0 - 2.0 * CLEARLY_MORE:
            return name
        if before is not None and seen.mean() > max(LEFT_ON * mean, 0.5) and like > RESEMBLES:
            return name
    return None


def cells(image: NDArray[Any], predictions: PredictedImages) -> Float64:
    """Means over the cells of the image's middle, shape of the predictions."""
    cell = predictions.cell
    rows, columns = predictions.part.shape
    top, left = (image.shape[0] - rows * cell) // 2, (image.shape[1] - columns * cell) // 2
    middle = image[top : top + rows * cell, left : left + columns * cell]
    step = max(1, cell // PIXELS_OF_CELL)
    some = middle.reshape(rows, cell, columns, cell)[:, step // 2 :: step, :, step // 2 :: step]
    return some.mean(axis=(1, 3), dtype=np.float64)


def _seen(image: NDArray[Any], dark: NDArray[Any] | float, predictions: PredictedImages) -> Float64:
    """How much brighter the cells of the part are than in the dark, shape (n,)."""
    background = cells(dark, predictions)[predictions.part] if isinstance(dark, np.ndarray) else dark
    return cells(image, predictions)[predictions.part] - background


def _self_correlation(expected: Float64, sensor: Sensor, cell: int) -> float:
    """Correlation of a prediction with itself under the sensor's noise; 0 for one that is nearly flat."""
    pattern = float(np.std(expected))
    if pattern < FLAT * float(expected.mean()):
        return 0.0
    noise = sensor.noise_variance(float(expected.mean())) / cell**2
    return pattern / float(np.sqrt(pattern**2 + noise))


def _correlation(a: Float64, b: Float64) -> float:
    a, b = a - a.mean(), b - b.mean()
    scale = float(np.sqrt(_dot(a, a) * _dot(b, b)))
    return _dot(a, b) / scale if scale > 0.0 else 0.0


def _dot(a: Float64, b: Float64) -> float:
    # not a @ b: its threads take longer to wake, while others render, than the product does
    return float((a * b).sum())


class ImageChecker:
    """Checks images with predictions that are computed while the stage travels; `with_dark`: ambient light is known."""

    def __init__(self, scene: Scene, *, check: bool, with_dark: bool) -> None:
        self._with_dark = with_dark
        self._scene, self._sensor = scene, scene.sensor
        self._caster = cast_rays_at(scene) if check else None  # without it nothing is checked
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="predict")
        self._predicted: dict[Posture, Future[PredictedImages]] = {}
        self._reference: dict[float, Float32] = {}
        self._undecided: set[str] = set()

    def has_dark_reference(self, exposure: float) -> bool:
        return self._caster is None or exposure in self._reference

    def predict(self, posture: Posture) -> None:
        """Predict the images of a posture in another thread; those before are kept for frames not yet checked."""
        if self._caster is not None:
            before = list(self._predicted.items())[-1:]
            predicted = self._worker.submit(predict, self._scene, posture, self._caster)
            self._predicted = dict([*before, (posture, predicted)])

    def set_dark_reference(self, dark: Float32, exposure: float) -> None:
        self._reference.setdefault(exposure, dark)

    def check_dark(self, acquired: AcquiredImage, warn: Callable[[str], None]) -> None:
        """Check that no light is on in a frame without light (HardwareError); the first is the reference."""
        if self._caster is None:
            return
        image, first = acquired.image, self._reference.get(acquired.exposure)
        predictions = self._predicted[acquired.posture].result()
        light = find_light_left_on(image.mean, predictions=predictions, exposure=image.exposure, before=first)
        if light is not None:
            off = f"looks like {light}, although all channels were switched off; check its controller"
            raise HardwareError(f"the frame without light {off}")
        if first is None:
            self._reference[acquired.exposure] = image.mean
            above = float(image.mean.mean()) - self._sensor.black_level
            if not self._with_dark and above > AMBIENT_LEVELS + clipped_mean(self._sensor):
                bright = f"without any light the image is {above:.2g} levels above black at exposure"
                advice = "capture dark frames as well, or darken the room, or correct black_level"
                warn(f"{bright} {acquired.exposure:g}: {advice}")

    def check(
        self, acquired: AcquiredImage, dark: Dark, others: Mapping[float, ExposureImage], warn: Callable[[str], None]
    ) -> dict[str, Any] | None:
        """Findings in JSON form; HardwareError where an image is not lit by its light alone, or unlike its others."""
        if self._caster is None:
            return None
        light, image, own_dark = acquired.light, acquired.image, self._dark(dark, acquired.exposure)
        assert light is not None
        where, predictions = f"{light} {acquired.posture}", self._predicted[acquired.posture].result()
        found = check_light(light, image.mean, own_dark, predictions=predictions, exposure=image.exposure)
        problem = found.problem
        for exposure, other in others.items():
            darks = (own_dark, self._dark(dark, exposure))
            problem = problem or exposure_mismatch(light, image, other, darks=darks, sensor=self._sensor)
        if problem is not None:
            dropped = "The image was not kept; to capture without this check, use option 'check'"
            raise HardwareError(f"{where} at exposure {acquired.exposure:g}: {problem}. {dropped}")
        if found.undecided is not None and not others and light not in self._undecided:
            self._undecided.add(light)  # said once: images of a display look alike in every posture
            warn(f"{where}: the check whether the right light is on is undecided: {found.undecided}")
        return found.as_dict()

    def close(self) -> None:
        """Wait for the prediction that is being computed."""
        self._worker.shutdown(wait=True, cancel_futures=True)

    def _dark(self, dark: Dark, exposure: float) -> Float32 | float:
        return dark.get(exposure, self._reference.get(exposure, self._sensor.black_level))


def clipped_mean(sensor: Sensor) -> float:
    """How far read noise, clipped at level 0, lifts the mean level of a dark frame above black."""
    noise = sensor.read_noise_levels
    z = sensor.black_level / noise if noise else np.inf
    density = np.exp(-0.5 * min(z, 40.0) ** 2) / np.sqrt(2.0 * np.pi)
    return float(noise * density)


STEP_DEG = 0.5  # predictions this far to both sides give the change of the image per degree
FINER = 3  # rays across a cell of the predictions: outlines cross cells
REPORTED_DEG = 0.1  # least angle that is reported
UNOBSERVABLE_DEG = 0.5  # an axis that could deviate by more than this unnoticed is reported as unobservable
CERTAIN = 5.0  # least multiple of its standard error at which an angle is reported: an axis of symmetry shows nothing
LIT = 0.2  # the part's brightness is that of cells predicted brighter than this share of the median
HIGHLIGHT = 1.5  # cells brighter than this multiple of the brightest diffuse light show something else
MOST_DEG = 10.0  # greatest angle that is found: the prediction is linear, from half a degree to both sides
# differences beyond this share of the part's brightness pull no more than these: highlights are not well predicted
BOUNDED = 0.1


@dataclass(frozen=True)
class Repeatability:
    """Rotation of the part between two images, in the sense of elevation (tilt) and rotation (turn) [°].

    A stepper that lost steps does not stand where its driver reports it. Two images of one posture, light and exposure
    then differ, whatever the reflectance and wherever the part lies in its fixture. Angle and axis come from a
    prediction of how the image changes per degree. The angle is rough and rather too small, because edges are never
    exactly where they were predicted.
    """

    tilt_deg: float
    turn_deg: float
    tilt_error_deg: float  # standard error [°]; large where the axis is unobservable
    turn_error_deg: float  # the same
    converged: bool = True  # whether the comparison found its optimum; if not, the angles mean nothing

    @property
    def deviation(self) -> str | None:
        """Message about the axes that certainly deviate; None where none does."""
        if not self.converged:
            return None
        found = (("elevation", self.tilt_deg, self.tilt_error_deg), ("rotation", self.turn_deg, self.turn_error_deg))
        certain = [(axis, angle) for axis, angle, error in found if abs(angle) > max(REPORTED_DEG, CERTAIN * error)]
        return " and ".join(f"its {axis} by roughly {angle:+.1f}°" for axis, angle in certain) or None

    @property
    def unobservable(self) -> str:
        """Axes of which the images would not show `UNOBSERVABLE_DEG`; empty where there is none."""
        errors = (("elevation", self.tilt_error_deg), ("rotation", self.turn_error_deg))
        return " and ".join(name for name, error in errors if CERTAIN * error > UNOBSERVABLE_DEG)

    def as_dict(self) -> dict[str, float | bool]:
        return {name: value if isinstance(value, bool) else float(f"{value:.3g}") for name, value in vars(self).items()}


def measure_repeatability(
    first: NDArray[Any], last: NDArray[Any], *, light: str, posture: Posture, scene: Scene
) -> Repeatability | None:
    """Rotation of the part between two images of the same posture; None where too little of it shows.

    `first` and `last` are of one exposure [sensor level], shape (H, W), both under `light`, which is among the scene's.
    `posture` is what the stage reported for both.
    """
    caster = cast_rays_at(scene)
    # highlights are where the reflectance puts them; diffuse light and outlines are where the part is
    most = max(one.R_d for one in scene.reflectances)
    diffuse = [replace(one, R_d=one.R_d / most if most > 0.0 else 1.0, R_s=0.0) for one in scene.reflectances]
    alone = replace(with_reflectances(scene, diffuse), lights=tuple(one for one in scene.lights if one.name == light))

    def predict_at(tilt_deg: float, turn_deg: float) -> PredictedImages:
        there = Posture(posture.elevation_deg + tilt_deg, posture.rotation_deg + turn_deg)
        return predict(alone, there, caster, supersample=FINER)

    here = predict_at(0.0, 0.0)
    steps = ((STEP_DEG, 0.0), (0.0, STEP_DEG))
    sides = [(predict_at(tilt, turn), predict_at(-tilt, -turn)) for tilt, turn in steps]
    black, room = scene.sensor.black_level, scene.sensor.saturated_from
    before, after = cells(first, here), cells(last, here)
    usable = (cells(first >= room, here) == 0.0) & (cells(last >= room, here) == 0.0)
    shown = usable & here.part
    predicted = here.levels[light]
    lit = shown & (predicted > LIT * float(np.median(predicted[shown]))) if shown.any() else shown
    if int(lit.sum()) < LEAST_CELLS:
        return None
    above = before - black
    typical, share = float(np.median(above[lit])), float(np.median(above[lit] / predicted[lit]))
    if typical < 3.0 * max(1.0, scene.sensor.read_noise_levels):
        return None  # too dark for any conclusion
    usable &= np.maximum(above, after - black) < HIGHLIGHT * max(typical, share * float(predicted.max()))
    slopes = [share * (more.levels[light] - less.levels[light])[usable] / (2.0 * STEP_DEG) for more, less in sides]
    # the lamp may have become a little brighter or darker meanwhile
    columns = np.stack([*slopes, above[usable], np.ones(int(usable.sum()))], axis=1)
    # a few edges, which are steep and nowhere just where they were predicted, would outweigh all the rest
    steep = np.abs(slopes[0]) + np.abs(slopes[1])
    weight = np.minimum(1.0, typical / np.maximum(steep, 1e-12)) ** 2
    return _fit_rotation(columns, (after - before)[usable], weight, typical=typical)


def _fit_rotation(columns: Float64, change: Float64, weight: Float64, *, typical: float) -> Repeatability:
    """Fit changes of level, shape (N,), by columns (N, 4): per degree of tilt and turn, lamp, and offset."""
    unit = BOUNDED * typical / HUBER
    reach = np.array([MOST_DEG, MOST_DEG, 1.0, typical])
    limits = Limits(
        nominal=np.zeros(4),
        reach=reach,
        step=reach,
        # all but nothing, and an error of MOST_DEG for an angle that changes no cell
        prior=np.array([MOST_DEG, MOST_DEG, np.inf, np.inf]),
        # nothing is held at 0: errors show what is observable, and they come from the scatter, not from the bound
        resolution=np.full(4, np.inf),
    )
    problem = linear_problem(columns / unit, change / unit, weight)
    found = solve(problem, limits.nominal, limits, loss="huber", least_spread=1.0)
    (tilt, turn), (tilt_error, turn_error) = found.x[:2].tolist(), found.errors[:2].tolist()
    return Repeatability(tilt, turn, tilt_error, turn_error, converged=found.converged)
