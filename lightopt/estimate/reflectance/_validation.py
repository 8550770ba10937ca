"""Whole images that a fit predicts, compared with measured ones.

Validation leaves one light out, fits the others and predicts its images. The paper's section 4.4 compares saturated
regions for each number of point lights per panel.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.ndimage import binary_erosion
from scipy.spatial import KDTree

from lightopt.core.arrays import Bool, Float32, Float64
from lightopt.estimate.reflectance._estimate import Estimate
from lightopt.estimate.reflectance._fit_samples import refit
from lightopt.estimate.reflectance._samples import Samples, subsample
from lightopt.estimate.reflectance._setup import FitSetup
from lightopt.estimate.reflectance._vector import DARK, FIRST_GAIN, LOG_R_S, LOG_SIGMA, R_D, Coefficients, significant
from lightopt.estimate.registration import Observation
from lightopt.geometry import RayCaster
from lightopt.optics import ModelName, Sensor, saturated_region
from lightopt.rendering import Geometry, render_posture
from lightopt.scene import Scene

BUDGET = 1500  # pixels per octave, light and posture that the fits without a light use
MOST_BORDER_PIXELS = 4000
POOR_SHARE = 5.0 / 255.0  # a prediction that is further off than this share of the sensor's full scale is reported
# gets each image that was left out and the sensor levels that were predicted for it
SavePrediction = Callable[[Observation, Float32], None]


@dataclass(frozen=True, kw_only=True)
class Comparison:
    image: str
    rms: float  # of the clipped residual on the part's pixels [grey level at exposure 1]
    rms_sensor: float  # the same in the image as it was delivered [sensor level]
    iou: float | None  # intersection over union of the saturated areas; None where neither image has any
    border: float | None  # mean distance between the borders of the saturated areas [px]; None where one image has none
    # saturated pixels of the measured and of the predicted image
    area: int
    predicted_area: int

    def as_dict(self) -> dict[str, Any]:
        return {
            "image": self.image,
            "rms_grey_levels": significant(self.rms, 5),
            "rms_sensor_levels": significant(self.rms_sensor, 5),
            "iou": None if self.iou is None else round(self.iou, 5),
            "border_px": significant(self.border, 4),
            "saturated_px": self.area,
            "predicted_saturated_px": self.predicted_area,
        }


def _rounded(found: Coefficients) -> dict[str, float | None]:
    values = {"R_d": found.R_d, "R_s": found.R_s, "sigma_rad": found.sigma}
    return {name: significant(value, 6) for name, value in values.items()}


@dataclass(frozen=True)
class LeftOut(Coefficients):
    """A light whose images were predicted from those of the others; values are those fitted to the others."""

    light: str
    x: Float64
    images: tuple[Comparison, ...]
    converged: bool = True

    def as_dict(self) -> dict[str, Any]:
        images = [image.as_dict() for image in self.images]
        return {"light": self.light, **_rounded(self), "converged": self.converged, "images": images}


def leave_lights_out(
    setup: FitSetup, samples: Samples, found: Estimate, save_prediction: SavePrediction | None = None
) -> tuple[LeftOut, ...]:
    """Predict the images of each light from a fit to those of all others; nothing where there is only one light.

    A freed gain or dark level stays as all images have it, since the others do not determine that of a light.
    """
    used = sorted(set(samples.facts.light.tolist()))
    if len(used) < 2:
        return ()
    scene, progress = setup.scene, setup.run.stage("validating")
    scale = scene.sensor, scene.reflectance.full_scale
    few = subsample(samples, BUDGET)
    results: list[LeftOut] = []
    for done, light in enumerate(used):
        others = few.select(few.facts.light[few.image] != light)
        fitted = refit(others, found, only_reflectance=True)
        mine = [o for o in samples.images if o.light == samples.lights[light]]
        comparisons: list[Comparison] = []
        predicted = predict_images(scene, fitted.x, mine, caster=setup.caster, threads=samples.threads)
        for seen, levels, geometry in predicted:
            regions = None if geometry.material is None else geometry.material > 0
            comparisons.append(compare_image(seen, levels, geometry.hit, *scale, others=regions))
            if save_prediction is not None:
                save_prediction(seen, levels)
        results.append(LeftOut(samples.lights[light], fitted.x, tuple(comparisons), fitted.maximum.converged))
        progress((done + 1) / len(used))
    return tuple(results)


def validation_warnings(left_out: tuple[LeftOut, ...], sensor: Sensor) -> Iterator[str]:
    if not left_out:
        yield "no validation: it leaves out one light, and the images show only one"
        return
    unsettled = [left.light for left in left_out if not left.converged]
    if unsettled:
        yield (
            f"{len(unsettled)} of the {len(left_out)} fits without one light each did not converge (without "
            f"{', '.join(unsettled)}): their prediction errors mean little"
        )
    worst = max((image for left in left_out for image in left.images), key=lambda image: image.rms_sensor)
    if worst.rms_sensor > POOR_SHARE * sensor.max_level:
        yield (
            f"{worst.image}, predicted from the other lights, is {worst.rms_sensor:.3g} sensor levels rms off "
            f"({worst.rms:.3g} grey levels at exposure 1): do not rely on predicted images of this surface"
        )


def compare_image(
    seen: Observation, levels: Float32, hit: Bool, sensor: Sensor, full_scale: float, *, others: Bool | None = None
) -> Comparison:
    """Compare a measured image with the sensor levels predicted for it, not clipped, where the part is; (H, W).

    others: Pixels of regions that are not compared; None for no such
    """
    own = True if others is None else ~others
    top = sensor.saturated_from
    measured = np.minimum(seen.levels, np.float32(top))
    residual = (measured - np.clip(levels, 0.0, top))[hit & own].astype(np.float64)
    full, seen_full = (np.floor(levels + 0.5) >= top) & own, seen.saturated & own
    rms = math.sqrt(float(np.mean(residual**2))) if len(residual) else 0.0
    both, either = int((full & seen_full).sum()), int((full | seen_full).sum())
    border, (a, b) = None, (_border(full), _border(seen_full))
    if len(a) and len(b):
        border = 0.5 * (float(KDTree(b).query(a)[0].mean()) + float(KDTree(a).query(b)[0].mean()))
    return Comparison(
        image=seen.name,
        rms=full_scale / sensor.max_level * rms / seen.exposure,
        rms_sensor=rms,
        iou=both / either if either else None,
        border=border,
        area=int(seen_full.sum()),
        predicted_area=int(full.sum()),
    )


def _border(mask: Bool) -> Float64:
    places = np.argwhere(mask & ~np.asarray(binary_erosion(mask), np.bool_)).astype(np.float64)
    return places[:: max(1, len(places) // MOST_BORDER_PIXELS)]


def predict_images(
    scene: Scene, x: Float64, observations: Sequence[Observation], *, caster: RayCaster, threads: int | None = None
) -> Iterator[tuple[Observation, Float32, Geometry]]:
    """Per observation: itself, the levels that parameters `x`, (K,), predict, not clipped, and what is seen.

    The parameters are those of the scene's first reflectance.
    """
    names = [light.name for light in scene.lights]
    reflectance = replace(scene.reflectance, R_d=float(x[R_D]), R_s=math.exp(x[LOG_R_S]), sigma=math.exp(x[LOG_SIGMA]))
    scale = scene.sensor.max_level / scene.reflectance.full_scale
    for posture in dict.fromkeys(o.posture for o in observations):
        shown = [o for o in observations if o.posture == posture]
        wanted = {o.light for o in shown}
        lights = tuple(light for light in scene.lights if light.name in wanted)
        fitted = replace(scene, lights=lights, reflectance=reflectance)
        images = render_posture(fitted, posture, caster=caster, threads=threads)
        by_name = {image.light: image.level for image in images.lights}
        for o in shown:
            gain = math.exp(x[FIRST_GAIN + names.index(o.light)])
            factor = np.float32(scale * o.exposure * gain)
            offset = np.float32(scene.sensor.black_level + x[DARK])
            yield o, by_name[o.light] * factor + offset, images.geometry


@dataclass(frozen=True, kw_only=True)
class ModelRow:
    """A form of the specular lobe that was tried, and how well it predicts the images of left-out lights."""

    model: ModelName
    # of all left-out images together [sensor level]; two lobes keep the share and the ratio that all images have
    rms: float | None = None
    likelihood: float | None = None  # mean log-likelihood of a level of the fit to all images [nat]
    refused: str | None = None  # why these images do not determine the form, which has neither then

    def as_dict(self) -> dict[str, Any]:
        return {
            "model": self.model,
            "left_out_rms_sensor_levels": significant(self.rms, 5),
            "mean_log_likelihood": significant(self.likelihood, 6),
            "refused": self.refused,
        }


def model_row(model: ModelName, left_out: Sequence[LeftOut], found: Estimate) -> ModelRow:
    squares = [image.rms_sensor**2 for left in left_out for image in left.images]
    return ModelRow(model=model, rms=math.sqrt(float(np.mean(squares))), likelihood=found.mean_log_likelihood)


@dataclass(frozen=True, kw_only=True)
class PointsRow(Coefficients):
    """The fit with one number of points per panel: a row of the paper's Table 1."""

    points: int | Literal["auto"]
    x: Float64
    # saturated pixels of all images together, predicted and measured [px]
    area: int
    measured_area: int
    # of the saturated regions of all images together [px]
    perimeter: float
    measured_perimeter: float
    # mean log-likelihood of a level [nat]; None by a method that knows none. The number of points with the greatest
    # reproduces the images best: area and perimeter of a noisy image hardly separate two numbers of points apart.
    likelihood: float | None

    @property
    def rank(self) -> float:
        """The likelihood or, without one, minus the relative deviations of area and perimeter (paper, section 4.4)."""
        if self.likelihood is not None:
            return self.likelihood
        area = abs(self.area - self.measured_area) / max(self.measured_area, 1)
        return -(area + abs(self.perimeter - self.measured_perimeter) / max(self.measured_perimeter, 1.0))

    def as_dict(self) -> dict[str, Any]:
        return {
            "points": self.points,
            **_rounded(self),
            "area_px": self.area,
            "measured_area_px": self.measured_area,
            "perimeter_px": round(self.perimeter, 1),
            "measured_perimeter_px": round(self.measured_perimeter, 1),
            "mean_log_likelihood": significant(self.likelihood, 6),
        }


def compare_regions(setup: FitSetup, x: Float64, likelihood: float | None) -> PointsRow:
    """Render all images with the parameters `x`, (K,), and compare the saturated regions with the measured ones.

    Both are taken from whole levels, since the camera delivers no others.
    """
    scene, sensor = setup.scene, setup.scene.sensor
    areas, perimeters = np.zeros(2), np.zeros(2)
    for seen, levels, _ in predict_images(scene, x, setup.observations, caster=setup.caster, threads=setup.run.threads):
        delivered = np.clip(np.floor(levels + 0.5), 0.0, sensor.max_level)
        pair: tuple[Float32, Float32] = delivered, seen.levels
        for i, image in enumerate(pair):
            region = saturated_region(image, sensor.saturated_from)
            areas[i] += region.area
            perimeters[i] += region.perimeter
    return PointsRow(
        points=scene.lights[0].points,
        x=x,
        area=int(areas[0]),
        measured_area=int(areas[1]),
        perimeter=float(perimeters[0]),
        measured_perimeter=float(perimeters[1]),
        likelihood=likelihood,
    )
