"""The paper's procedure (sections 4.2 and 4.3), with its misprints read as they must have been meant.

Equations 5 and 7 as printed scale R_d the wrong way; measured over simulated is used. Step 4 of section 4.3 as printed
would start over for ever; σ is swept over its range, at each σ the saturated pixels are brought to the measured number
by equation 10, and the σ is kept whose total specular brightness is closest to the measured one.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError
from lightopt.core.run_context import Share, ignore
from lightopt.estimate.reflectance._samples import Samples
from lightopt.estimate.reflectance._vector import significant

MOST_ITERATIONS = 500
MOST_R_S = 1e15
MOST_STEPS = 1000
WIDE_RANGE = 1.5  # where the σ of the sweep within λ_s2 reach over more than this factor, it is reported


@dataclass(frozen=True, kw_only=True)
class PaperOptions:
    """Thresholds and starting values; the paper prints no threshold and no step."""

    lambda_d: float = 0.01  # λ_d: difference of the mean brightness that is small enough [grey level]
    lambda_s1: float = 0.005  # λ_s1: likewise of the number of saturated pixels, as a share of the measured number
    lambda_s2: float = 0.05  # λ_s2: likewise of the total specular brightness, as a share of the measured one
    sigma_step: float = 0.0025  # σ_step [rad]; the rows of Table 1 are multiples of 0.0025
    sigma_start: float = 0.01  # where the sweep starts [rad] (section 4.3), and its range
    sigma_least: float = 0.001
    sigma_most: float = 0.2
    R_d_start: float = 10.0  # starting values [grey level]
    R_s_start: float = 255.0  # the saturation level
    away: float = math.radians(20.0)  # pixels with a normal so far from all half vectors count as diffuse only [rad]

    def problems(self) -> tuple[str, ...]:
        found = [
            f"option '{name}': expected a number above 0, found {value:g}"
            for name, value in vars(self).items()
            if not (math.isfinite(value) and value > 0.0)
        ]
        if found:
            return tuple(found)
        least, start, most = self.sigma_least, self.sigma_start, self.sigma_most
        if not least <= start <= most:
            found.append(f"option 'sigma_start': expected {least:g} to {most:g} rad, found {start:g}")
        least_step = (most - least) / MOST_STEPS
        if self.sigma_step < least_step:
            found.append(f"option 'sigma_step': expected {least_step:.2g} rad or more, found {self.sigma_step:g}")
        if self.away >= math.pi / 2.0:
            found.append(f"option 'away': expected less than 90°, found {math.degrees(self.away):g}")
        return tuple(found)


@dataclass(frozen=True, kw_only=True)
class PaperDiffuse:
    """R_d by section 4.2."""

    R_d: float  # [grey level]
    image: str
    pixels: int
    iterations: tuple[tuple[float, float, float], ...]  # (R_d, B_r, D) of each [grey level]

    def as_dict(self) -> dict[str, Any]:
        rows = [{"R_d": r, "B_r": b, "D": d} for r, b, d in self.iterations]
        return {"R_d": self.R_d, "image": self.image, "pixels": self.pixels, "iterations": rows}


@dataclass(frozen=True, kw_only=True)
class SigmaStep:
    sigma: float
    R_s: float  # where N_s came close enough to N_m [grey level]
    reached: bool
    brightness: float  # total specular brightness of the simulated image over the measured one
    iterations: tuple[tuple[float, int], ...]

    def as_dict(self) -> dict[str, Any]:
        rounds = [{"R_s": r_s, "N_s": n_s} for r_s, n_s in self.iterations]
        facts = {"sigma_rad": significant(self.sigma, 6), "R_s": self.R_s, "reached": self.reached}
        return {**facts, "brightness_ratio": self.brightness, "iterations": rounds}


@dataclass(frozen=True)
class PaperSpecular:
    """R_s and σ by section 4.3."""

    R_s: float
    sigma: float
    image: str
    saturated: int
    steps: tuple[SigmaStep, ...]
    # the σ at which both the count and the brightness come within λ_s1 and λ_s2, ascending [rad]
    matching_sigmas: tuple[float, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        facts = {"R_s": self.R_s, "sigma_rad": self.sigma, "image": self.image, "N_m": self.saturated}
        sweep = [step.as_dict() for step in self.steps]
        return {**facts, "alike_sigma_rad": list(self.matching_sigmas), "sweep": sweep}

    def warnings(self) -> Iterator[str]:
        """Warn where the procedure hardly determines σ."""
        found = self.matching_sigmas
        if found and found[-1] > WIDE_RANGE * found[0]:
            yield (
                f"{len(found)} σ of the sweep, from {found[0]:g} to {found[-1]:g} rad, come within λ_s2 of the "
                f"measured brightness of {self.image}: section 4.3 hardly determines σ here, nor R_s with it"
            )


def paper_diffuse(samples: Samples, options: PaperOptions) -> PaperDiffuse:
    """R_d from the mean brightness of the pixels without specular reflection (paper, section 4.2)."""
    if problems := options.problems():
        raise InputError(*problems)
    plain = (samples.deflection[samples.sample] >= options.away) & ~samples.saturated
    plain &= samples.diffuse[samples.sample] > 0.0
    counts = np.bincount(samples.image[plain], minlength=len(samples.images))
    if not counts.any():
        raise InputError("no diffuse-only pixel: add images under other lights, or lower option 'away'")
    # the image without specular reflection, or with the least of it: that with the largest share of such pixels
    share = counts / np.maximum(np.bincount(samples.image, minlength=len(samples.images)), 1)
    image = int(np.argmax(share))
    name = samples.images[image].name
    mine = plain & (samples.image == image)
    factor = float(samples.facts.factor[image])
    measured = float(np.mean((samples.level[mine] - samples.sensor.black_level) / factor))
    unit = float(np.mean(samples.diffuse[samples.sample[mine]]))
    if measured <= 0.0:
        raise InputError(f"{name}: all diffuse-only pixels are black; expose longer")
    r_d = options.R_d_start
    iterations: list[tuple[float, float, float]] = []
    for _ in range(MOST_ITERATIONS):
        simulated = r_d * unit
        iterations.append((r_d, simulated, abs(simulated - measured)))  # (6)
        if iterations[-1][2] <= options.lambda_d:
            return PaperDiffuse(R_d=r_d, image=name, pixels=int(mine.sum()), iterations=tuple(iterations))
        r_d *= measured / simulated  # (5), (7), measured over simulated
    raise InputError(f"section 4.2 does not converge in {MOST_ITERATIONS} rounds: λ_d = {options.lambda_d:g}, raise it")


def paper_specular(samples: Samples, options: PaperOptions, *, R_d: float, progress: Share = ignore) -> PaperSpecular:
    """R_s and σ from the saturated pixels and the total specular brightness of one image (paper, section 4.3)."""
    if problems := options.problems():
        raise InputError(*problems)
    counts = np.bincount(samples.image[samples.saturated], minlength=len(samples.images))
    image = int(np.argmax(counts))
    measured = int(counts[image])
    if measured == 0:
        raise InputError(
            "no saturated pixel in any image, and the method compares them: expose longer, or use the default method"
        )
    mine = samples.select(samples.image == image)
    factor = float(mine.facts.factor[image])
    diffuse = factor * R_d * mine.diffuse[mine.sample]
    room = mine.sensor.saturated_from - mine.sensor.black_level
    bright = np.minimum(mine.level - mine.sensor.black_level, room) - np.minimum(diffuse, room)
    total = float(bright.sum())
    steps: list[SigmaStep] = []
    # from the start upwards, then the rest of the range below it
    up = np.arange(options.sigma_start, options.sigma_most + 1e-9, options.sigma_step)
    down = np.arange(options.sigma_start - options.sigma_step, options.sigma_least - 1e-9, -options.sigma_step)
    sigmas = [float(round(value, 9)) for value in (*up, *down) if value > 0.0]
    for sigma in sigmas:
        light = factor * mine.specular(sigma)[mine.sample]
        steps.append(_match_area(light, diffuse, room, measured, total, sigma, options))
        progress(len(steps) / len(sigmas))
    reached = [step for step in steps if step.reached]
    if not reached:
        within = f"within λ_s1 = {options.lambda_s1:g} of the {measured} measured"
        reason = f"at no σ does the number of saturated pixels come {within}"
        raise InputError(f"section 4.3 does not converge: {reason}; raise λ_s1, or use the default method")
    best = min(reached, key=lambda step: abs(step.brightness - 1.0))  # S_2
    if (off := abs(best.brightness - 1.0)) > options.lambda_s2:
        reason = f"the total specular brightness stays {100.0 * off:.1f} % off, and λ_s2 = {options.lambda_s2:g}"
        raise InputError(f"section 4.3 does not converge: {reason}; raise it, or use the default method")
    alike = sorted(step.sigma for step in reached if abs(step.brightness - 1.0) <= options.lambda_s2)
    name = samples.images[image].name
    return PaperSpecular(best.R_s, best.sigma, name, measured, tuple(steps), matching_sigmas=tuple(alike))


def _match_area(
    light: Float64, diffuse: Float64, room: float, measured: int, total: float, sigma: float, options: PaperOptions
) -> SigmaStep:
    # rounding half up makes a pixel saturated from half a level below
    needed = np.where(light > 0.0, (room - 0.5 - diffuse) / np.where(light > 0.0, light, 1.0), np.inf)
    ordered = np.sort(needed)
    r_s = options.R_s_start
    iterations: list[tuple[float, int]] = []
    reached = False
    for _ in range(MOST_ITERATIONS):
        simulated = int(np.searchsorted(ordered, r_s, side="right"))  # N_s
        iterations.append((r_s, simulated))
        if abs(measured - simulated) <= max(options.lambda_s1 * measured, 0.5):  # (8)
            reached = True
            break
        # (9), (10); the ratio is not defined before any pixel is saturated
        r_s *= 2.0 if simulated == 0 else measured / simulated
        if r_s > MOST_R_S:
            break
    specular = np.minimum(diffuse + r_s * light, room) - np.minimum(diffuse, room)
    ratio = float(specular.sum()) / total if total > 0.0 else math.inf
    return SigmaStep(sigma=sigma, R_s=r_s, reached=reached, brightness=ratio, iterations=tuple(iterations))
