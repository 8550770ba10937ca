"""How well the model describes the images, the noise that they show, and warnings and refusals of fits."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError
from lightopt.estimate.reflectance._clipped_least_squares import MOST_MISFIT, image_noise
from lightopt.estimate.reflectance._estimate import Estimate, Interval
from lightopt.estimate.reflectance._likelihood import predicted
from lightopt.estimate.reflectance._samples import Samples
from lightopt.estimate.reflectance._vector import DARK, FIRST_GAIN, LOG_R_S, LOG_SIGMA, R_D, parameter_name, significant
from lightopt.optics import Sensor, SpecularModel

# residuals beyond this many times the sensor's noise, and unexplained pixels beyond this share, are reported
POOR_NOISE, MORE_NOISE, POOR_EPSILON = 3.0, 1.5, 0.02
WIDE_INTERVAL, STRONG_CORRELATION = 0.02, 0.95
# widths of lobes that the model is meant for [rad]: Ward found these on real surfaces (paper, section 4.3)
SIGMA_RANGE = 0.001, 0.2
GGX_SIGMA_RANGE = 0.001, 0.5  # α up to 1, as part files allow
MOST_R_S = 1e11  # beyond this, R_s runs away along the ridge [grey level]
EDGE = 1.01  # a value within this factor of an edge is at it
LEVEL_BINS, LEAST_PER_BIN = 12, 150
# levels nearer than this many deviations to black or to saturation are clipped, and show less noise than there is
CLEAR_OF_ENDS = 4.0
# residuals beyond this many deviations are dust; what is left of a Gaussian's variance within
TRIM, TRIMMED_VARIANCE = 3.0, 0.97334
SIGNIFICANT = 3.0
WELL_KNOWN = 0.3  # a figure is determined where its standard error is no more than this share of it


@dataclass(frozen=True, kw_only=True)
class Quality:
    """Residuals of the pixels of a fit, in sensor levels of the images as they were delivered."""

    rms: float
    typical: float  # median absolute residual times 1.48, which a few unexplained pixels do not move [sensor level]
    # of a typical pixel by the rig's noise figures and the number of frames, with quantisation [sensor level]
    noise: float
    # by the images: typical distance of pixels from the plane through their neighbours [sensor level]
    image_noise: float
    explained: float  # share of the variance of the unsaturated pixels beyond the noise that the model explains
    epsilon: float  # share of outliers
    tau: float  # deviation beside the sensor's noise [sensor level]
    saturated: float  # share of the observations that are saturated
    # residual of least squares over the noise, both rms, at the worst exposure; 0 where that was not tested
    misfit: float = 0.0
    # whether the model describes the images within that; else values are those of least squares, and intervals come
    # from the scatter between lights
    describes: bool = True

    @property
    def floor(self) -> float:
        """Deviation of a typical pixel that no model explains, by the rig or by the images [sensor level]."""
        return max(self.noise, self.image_noise)

    @property
    def poor(self) -> bool:
        return self.epsilon > POOR_EPSILON or self.typical > POOR_NOISE * self.floor

    def as_dict(self) -> dict[str, float | bool | None]:
        return {name: value if isinstance(value, bool) else significant(value, 6) for name, value in vars(self).items()}


def assess_quality(samples: Samples, found: Estimate) -> Quality:
    sensor = samples.sensor
    mean = mean_levels(samples, found)
    level = samples.level.astype(np.float64)
    seen = ~samples.saturated & (mean < sensor.saturated_from)
    residual = (level - np.maximum(mean, 0.0))[seen]
    frames = samples.facts.frames[samples.image[seen]]
    variance = sensor.noise_variance(mean[seen] - sensor.black_level, frames=frames)
    noise = math.sqrt(float(np.median(variance))) if seen.any() else 0.0
    shown = image_noise(samples)
    spread = float(np.var(level[seen])) - max(noise, shown) ** 2 if seen.any() else 0.0
    missed = float(np.mean(residual**2)) - max(noise, shown) ** 2 if seen.any() else 0.0
    return Quality(
        rms=math.sqrt(float(np.mean(residual**2))) if len(residual) else 0.0,
        typical=1.4826 * float(np.median(np.abs(residual))) if seen.any() else 0.0,
        noise=noise,
        image_noise=shown,
        explained=1.0 - max(missed, 0.0) / spread if spread > 0.0 else 1.0,
        epsilon=found.unexplained,
        tau=found.tau,
        saturated=float(np.mean(samples.saturated)),
        misfit=found.misfit,
        describes=found.describes,
    )


def mean_levels(samples: Samples, found: Estimate) -> Float64:
    """Sensor levels, not clipped, that a fit predicts for the observations, shape (N,)."""
    return predicted(samples, samples.specular(found.sigma), found.x)


def fit_warnings(
    found: Estimate, quality: Quality, interval: Interval | None, *, shorter: bool, placed: bool
) -> Iterator[str]:
    """Warnings about a fit of R_s and σ.

    interval: 95 % of R_s [grey level].
    shorter: Whether the images have more than one exposure already.
    """
    yield from poor_fit_warnings(found, quality, placed=placed)
    if LOG_R_S in found.free and LOG_SIGMA in found.free:
        low, high = interval or (found.R_s, found.R_s)
        width = math.log(high / max(low, 1e-9)) if low is not None and high is not None else math.inf
        correlation = found.correlation(LOG_R_S, LOG_SIGMA)
        if quality.saturated == 0.0:
            what = "images with highlights elsewhere on the part: other postures, or other positions of the lights"
        else:
            what = "a still shorter exposure" if shorter else "a shorter exposure, such as 1/16 of this one"
        if math.isinf(width):
            side = "upper" if high is None else "lower"
            yield f"R_s has no {side} bound: images of other R_s and σ look the same; add {what}"
        elif abs(correlation) > STRONG_CORRELATION and width > WIDE_INTERVAL and found.describes:
            yield (
                f"these images hardly separate R_s from σ (correlation {correlation:.3f}, R_s between {low:.4g} and "
                f"{high:.4g}): add {what}"
            )
        if quality.saturated == 0.0:
            yield "no pixel is saturated: R_s and σ come from the flanks and the peak of the highlight alone"
    if R_D not in found.free:
        # the slope of the criterion may contradict the value at which R_d was held
        here = found.maximum.evaluation
        curvature = float(here.curvature[R_D, R_D])
        step = float(here.gradient[R_D]) / max(curvature, 1e-300)
        if abs(step) >= 0.02 * max(found.R_d, 1e-9) and abs(step) * math.sqrt(curvature) >= 5.0:
            yield (
                f"R_d is held at {found.R_d:.4g}, but these images indicate a {'larger' if step > 0.0 else 'smaller'} "
                "value. This biases R_s and σ: run fit-diffuse first, or fit R_d as well"
            )


def poor_fit_warnings(found: Estimate, quality: Quality, *, placed: bool = False) -> Iterator[str]:
    """Warn where the model does not describe the images, or the rig file their noise.

    placed: Whether the part's placement is excluded as a cause: it was fitted, or no other explains the residual.
    """
    if quality.image_noise > MORE_NOISE * quality.noise:
        yield (
            f"the noise of the images is about {quality.image_noise:.2g} sensor levels, but {quality.noise:.2g} by the "
            "rig file: give read_noise_levels and electrons_per_level of the sensor"
        )
    if not quality.describes:
        left = (
            f"the model describes these images badly: its best fit leaves {quality.misfit:.1f} times the noise "
            f"({quality.rms:.3g} sensor levels rms)"
            if quality.misfit > MOST_MISFIT
            else f"the residual of the fit ({quality.rms:.3g} sensor levels rms) is not much larger than the noise, "
            "but is neither noise nor dust"
        )
        yield (
            f"{left}. The values are those of least squares over all pixels taken, which predict such images best, and "
            f"the intervals come from the scatter between {found.scatter}. {_reasons(found, placed=placed)}"
        )
    elif quality.poor:
        yield (
            f"the model describes these images badly: {100.0 * quality.epsilon:.1f} % of the pixels are outliers, "
            f"and the residual is {quality.rms:.3g} sensor levels rms, where the noise is {quality.floor:.2g}. "
            f"{_reasons(found, placed=placed)}"
        )


def _reasons(found: Estimate, *, placed: bool) -> str:
    # other possible causes, without what was fitted already
    samples = found.criterion.samples
    lights = set(samples.facts.light[samples.image].tolist())
    reasons = [
        "another shape of the lobe or of the diffuse reflection",
        "dirt",
        "the mesh's normals",
        "camera or lights elsewhere than the rig file says (lightopt verify tells)",
    ]
    if not placed:
        reasons.append("the part's placement (register the part)")
    # of one light alone R_d and R_s are its gain
    if len(lights) > 1 and not any(FIRST_GAIN <= p < found.criterion.size - 2 for p in found.free):
        reasons.append("a light's gain (fit the gains)")
    if DARK not in found.free:
        reasons.append("the dark level (fit it)")
    reasons.append("light from the part to itself, which fits leave out (lightopt check says how much it mirrors)")
    reasons.append("the number of points of the panels")
    return f"Possible reasons: {', '.join(reasons)}"


def refuse_out_of_range(found: Estimate, brightest: float, model: SpecularModel) -> None:
    """Refuse a `brightest` specular light [grey level] that determines nothing, and values that no real surface has."""
    if brightest < 1.0:
        raise InputError("no highlight in any image: add images under other lights, or at a longer exposure")
    low, high = SIGMA_RANGE if model.name != "ggx" else GGX_SIGMA_RANGE
    width = f"{found.sigma:.3g} rad" if model.name != "ggx" else f"{found.sigma:.3g} rad (α {2.0 * found.sigma:.3g})"
    if found.sigma < low * EDGE:
        raise InputError(
            f"σ: the best fit is at {width}, at or below the lower end {low:g} of the range: the "
            "highlights are as sharp as mirror images of the panels, so the images give no lower bound. Check the "
            "panels' sizes, the part's shape and its placement, or add images at a shorter exposure"
        )
    if found.sigma > high / EDGE:
        raise InputError(
            f"σ: the best fit is at {width}, at or beyond the upper end {high:g} of the range: the "
            "images show no highlight, or a haze wider than any lobe of the model. Add images under lights that the "
            "surface mirrors into the camera, and check the part's shape and its placement"
        )
    if found.R_s > MOST_R_S:
        raise InputError(f"R_s: the best fit is at {found.R_s:.2g} grey levels, without an upper bound: expose shorter")


def convergence_warnings(found: Estimate) -> Iterator[str]:
    if not found.maximum.converged:
        lights = found.criterion.samples.lights
        names = [parameter_name(place, lights) for place in found.maximum.unsettled]
        along = f" along {', '.join(names)}" if names else ""
        yield (
            f"the fit did not converge: after {found.maximum.steps} steps it still improves{along}; its values and "
            "intervals are not those of an optimum. Other images, or fewer free parameters, may help"
        )
        return
    if found.unsettled_refits:
        yield (
            f"{found.unsettled_refits} of the fits without one of the {found.scatter} each did not converge: the "
            "intervals, which come from their scatter, may be wrong"
        )
    best = max((optimum.top.value for optimum in found.optima if optimum.top.converged), default=-math.inf)
    for optimum in found.optima:
        if not optimum.top.converged and optimum.top.value >= best:
            yield (
                f"the optimisation that started at σ {optimum.start_sigma:.3g} rad stopped at σ "
                f"{optimum.top.sigma:.3g} rad before convergence, with a result not worse than the best: there may be "
                "another optimum"
            )


@dataclass(frozen=True, kw_only=True)
class MeasuredNoise:
    """Noise of the camera, from the variance of measured minus predicted level over the level."""

    # deviation without light, and its standard error [sensor level]; None where not determined
    read_noise_levels: float | None = None
    read_noise_standard_error: float | None = None
    # photo-electrons per level and their standard error; None where not determined
    electrons_per_level: float | None = None
    electrons_standard_error: float | None = None
    hindrance: str = ""  # why something is not determined, or empty

    def as_dict(self) -> dict[str, Any]:
        numbers = {name: significant(value, 4) for name, value in vars(self).items() if name != "hindrance"}
        return {**numbers, "hindrance": self.hindrance or None}


def measure_noise(samples: Samples, mean: Float64, *, describes: bool = True) -> MeasuredNoise:
    """Read noise, and shot noise where the variance grows with the level (EMVA Standard 1288, photon transfer)."""
    if not describes:
        return MeasuredNoise(hindrance="the model does not describe these images, and its error is not noise")
    typical = image_noise(samples)
    # by the level that is predicted: that of a pixel itself would be chosen along with its noise
    clear = (mean > CLEAR_OF_ENDS * typical) & (mean < samples.sensor.saturated_from - CLEAR_OF_ENDS * typical)
    clear &= (samples.diffuse[samples.sample] > 0.0) & ~samples.saturated
    # a mean of N frames has an N-th of the variance
    frames = samples.facts.frames[samples.image][clear]
    signal = np.maximum(mean - samples.sensor.black_level, 0.0)[clear]
    residual = (samples.level[clear] - mean[clear]) * np.sqrt(frames)
    if len(signal) < 2 * LEAST_PER_BIN:
        return MeasuredNoise(hindrance="too few lit pixels that are neither black nor saturated")
    order = np.argsort(signal, kind="stable")
    bins = np.array_split(order, min(LEVEL_BINS, len(order) // LEAST_PER_BIN))
    rounding = float(np.mean(frames)) / 12.0
    at = np.array([float(np.mean(signal[b])) for b in bins])
    variance = np.array([_variance(residual[b]) for b in bins]) - rounding
    error = (variance + rounding) * np.sqrt(2.0 / np.array([len(b) for b in bins]))
    if np.median(variance) < rounding:
        return MeasuredNoise(hindrance="the noise is less than that of rounding to whole levels")
    return _photon_transfer(at, variance, error, samples.sensor)


def noise_warnings(noise: MeasuredNoise) -> Iterator[str]:
    if noise.read_noise_levels is None and noise.electrons_per_level is None:
        yield f"the noise is not written: {noise.hindrance}"
    elif noise.hindrance:
        yield f"only a part of the noise is written: {noise.hindrance}"


def _photon_transfer(signal: Float64, variance: Float64, error: Float64, sensor: Sensor) -> MeasuredNoise:
    # the line through variance over level: read noise squared at 0, levels per electron its slope
    design = np.stack([np.ones(len(signal)), signal], axis=1) / error[:, None]
    inverse = np.linalg.pinv(design.T @ design)
    line = inverse @ design.T @ (variance / error)
    freedom = max(1, len(signal) - 2)
    spread = max(1.0, float(np.sum((design @ line - variance / error) ** 2)) / freedom)
    a, b = (float(value) for value in line)
    a_error, b_error = (math.sqrt(spread * float(inverse[k, k])) for k in (0, 1))
    own = 0.0 if sensor.electrons_per_level is None else 1.0 / sensor.electrons_per_level
    shot = MeasuredNoise(hindrance="" if own else "no shot noise is seen beside the read noise")
    if b > SIGNIFICANT * b_error and b_error < WELL_KNOWN * b:
        shot = MeasuredNoise(electrons_per_level=1.0 / b, electrons_standard_error=b_error / b**2)
    elif abs(own - b) > SIGNIFICANT * b_error:
        most = b + SIGNIFICANT * b_error
        least = f": there are at least {1.0 / most:.3g} electrons per level" if most > 0.0 else ""
        return MeasuredNoise(
            hindrance=f"the images show less shot noise than the rig file's electrons_per_level gives{least}"
            if own > b
            else "the noise changes with the level, but not significantly enough to separate read noise from shot "
            "noise; add images of other levels"
        )
    else:
        weight = 1.0 / error**2
        a = float(np.sum(weight * (variance - own * signal)) / np.sum(weight))
        a_error = math.sqrt(spread / float(np.sum(weight)))
    if a <= 0.0 or 0.5 * a_error > WELL_KNOWN * a:
        return replace(shot, hindrance="shot noise hides the read noise; add darker images")
    read = math.sqrt(a)
    return replace(shot, read_noise_levels=read, read_noise_standard_error=0.5 * a_error / read)


def _variance(values: Float64) -> float:
    # without the tails: edges and dust
    spread = max(1.4826 * float(np.median(np.abs(values))), 0.2)
    for _ in range(2):
        inside = values[np.abs(values) <= TRIM * spread]
        spread = math.sqrt(float(np.mean(inside**2)) / TRIMMED_VARIANCE)
    return spread**2
