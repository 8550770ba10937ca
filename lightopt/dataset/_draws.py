"""What is random in a dataset: poses, and the samples that share each of them, drawn from one seed."""

import json
import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from lightopt.config import PartConfig, RangesConfig, RigConfig
from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.defects import DEFAULT_FALSE_ALARMS, CatalogueEntry, false_alarms_problem
from lightopt.estimate.registration import Placement, place_part
from lightopt.inspection import FUSIONS, Fusion
from lightopt.scene import Scene, build_scene, with_reflectances

SPLITS = ("train", "val", "test")
STACK, FUSED = "stack", "fused"
MOST_SAMPLES = 1_000_000
LEAST_R_D = 1e-6  # a trace of diffuse light, far below what a camera detects: it is where a light reaches

Range = tuple[float, float]
_END = int | float | None  # of an interval; None where the fit does not determine it


@dataclass(frozen=True, kw_only=True)
class DatasetOptions:
    images: int  # number of samples, each of one image per light
    seed: int = 0  # of all random numbers
    exposure: float = 1.0  # relative exposure of lights to which the rig's programme gives none
    fusion: Fusion | None = "paper"  # rule of the fused image; None for no such image
    stacks: bool = False  # whether an HDF5 file per pose is written
    false_alarms: float = DEFAULT_FALSE_ALARMS  # per posture, at which a defect counts as visible

    def problems(self) -> list[str]:
        found: list[str] = []
        if not 1 <= self.images <= MOST_SAMPLES:
            found.append(f"option 'images': expected 1 to {MOST_SAMPLES:,} samples, found {self.images}")
        if self.seed < 0:
            found.append(f"option 'seed': expected 0 or more, found {self.seed}")
        if not (self.exposure > 0.0 and math.isfinite(self.exposure)):
            found.append(f"option 'exposure': expected a number above 0, found {self.exposure:g}")
        if self.fusion is not None and self.fusion not in FUSIONS:
            found.append(f"option 'fusion': expected {', '.join(FUSIONS)} or none, found \"{self.fusion}\"")
        if problem := false_alarms_problem(self.false_alarms):
            found.append(problem)
        return found


@dataclass(frozen=True)
class Factors:
    """Limits of factors on what the files say: diffuse and specular light, width of the lobe, gain by light."""

    R_d: Range
    R_s: Range
    sigma: Range
    gains: dict[str, Range]


def factors_of(ranges: RangesConfig, rig: RigConfig, part: PartConfig) -> Factors:
    """Limits by the intervals of a fit and of a calibrated rig, else the ranges'; InputError for a wrong fit."""
    fit = {} if ranges.fit is None else _read_fit(ranges.source.resolve(ranges.fit))
    values, fitted_gains = fit.get("values") or {}, fit.get("gains") or {}
    own = part.reflectance
    calibrated = {} if rig.calibration is None else rig.calibration.intervals

    def limits(name: str, found: object, value: float, default: Range) -> Range:
        ends: Any = found.get("interval_95") if isinstance(found, dict) else found
        if ends is None or value <= 0.0:
            return default
        well_formed = isinstance(ends, list | tuple) and len(ends) == 2 and all(isinstance(one, _END) for one in ends)
        low, high = ends if well_formed else (None, None)
        if not well_formed or (low is not None and high is not None and not 0.0 <= high >= low):
            raise InputError(
                f"{ranges.source.path}: {ranges.fit}: {name}: expected interval_95: [low, high], found {ends}"
            )
        return default if low is None or high is None else (max(0.0, low / value), high / value)

    gains = {
        light.name: limits(
            f"gain of {light.name}",
            fitted_gains.get(light.name) or calibrated.get(f"{light.name} gain"),
            light.gain,
            ranges.gain,
        )
        for light in rig.lights
    }
    widths = {"sigma_rad": own.sigma_rad, "alpha": own.alpha, "width_factor": own.width_factor if own.table else None}
    key, width = next((key, width) for key, width in widths.items() if width is not None)
    return Factors(
        R_d=limits("R_d", values.get("R_d"), own.R_d, ranges.R_d),
        R_s=limits("R_s", values.get("R_s"), own.R_s, ranges.R_s),
        sigma=limits(key, values.get(key), width, ranges.sigma),
        gains=gains,
    )


@dataclass(frozen=True, eq=False)
class Setup:
    """What a dataset is made of."""

    rig: RigConfig
    part: PartConfig
    options: DatasetOptions
    ranges: RangesConfig
    factors: Factors
    catalogue: tuple[CatalogueEntry, ...]
    threads: int | None = None

    @cached_property
    def scene(self) -> Scene:
        """The good part at rest."""
        return build_scene(self.rig, self.part, defects=False, bounces=self.part.inspection.bounces)

    @property
    def lights(self) -> tuple[str, ...]:
        return tuple(light.name for light in self.rig.lights)

    @property
    def views(self) -> tuple[str, ...]:
        """Names of the images of a sample."""
        return (*self.lights, *([FUSED] if self.options.fusion else []))

    @property
    def kinds(self) -> list[str]:
        """Kinds of defects, in the order of their numbers."""
        return list(dict.fromkeys(entry.shape.kind for entry in self.catalogue))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the images [px]."""
        return self.scene.camera.width, self.scene.camera.height


def _read_fit(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as the fit.json of a fit: {error}") from error
    right = isinstance(found, dict) and str(found.get("format", "")).startswith("lightopt-fit/")
    if not right or not all(isinstance(found.get(key) or {}, dict) for key in ("values", "gains")):
        raise InputError(f'{path}: expected the fit.json that a fit wrote, of format "lightopt-fit/1"')
    return found


@dataclass(frozen=True, kw_only=True)
class PoseDraw:
    """A pose of the part, its surface, and the numbers of the samples that share them."""

    number: int
    posture: Posture
    split: str
    placement: Placement
    sigma_factor: float
    waviness_seed: int
    samples: range

    def scene(self, nominal: Scene) -> Scene:
        """The good part in this pose, smooth."""
        own = [
            replace(one, sigma=one.sigma * self.sigma_factor, R_d=max(one.R_d, LEAST_R_D))
            for one in nominal.reflectances
        ]
        return place_part(with_reflectances(nominal, own), self.placement)

    def as_dict(self) -> dict[str, Any]:
        place = self.placement
        return {
            "pose": self.number,
            "posture": self.posture.as_dict(),
            "split": self.split,
            "shift_mm": [round(x, 5) for x in (place.x, place.y, place.z)],
            "rotation_deg": round(math.degrees(place.turn), 5),
            "tilt_deg": [round(math.degrees(x), 5) for x in (place.tilt_x, place.tilt_y)],
            "sigma_factor": round(self.sigma_factor, 6),
        }


def draw_poses(setup: Setup) -> list[PoseDraw]:
    """The poses of a dataset: the postures take turns, and whole poses are divided into the splits."""
    options, ranges, postures = setup.options, setup.ranges, setup.scene.postures
    each = ranges.samples_per_pose
    count = -(-options.images // each)
    ends = np.rint(np.cumsum([getattr(ranges.split, name) for name in SPLITS]) * count)
    place = np.random.default_rng([options.seed, 0]).permutation(count)
    reach, poses = ranges.pose, list[PoseDraw]()
    for number in range(count):
        rng = np.random.default_rng([options.seed, 1, number])
        x, y, turn, z, tilt_x, tilt_y = rng.uniform(-1.0, 1.0, 6).tolist()
        tilt = math.radians(reach.tilt_deg)
        poses.append(
            PoseDraw(
                number=number,
                posture=postures[number % len(postures)],
                split=SPLITS[int(np.searchsorted(ends, place[number], side="right"))],
                placement=Placement(
                    x=x * reach.shift_mm,
                    y=y * reach.shift_mm,
                    turn=turn * math.radians(reach.rotation_deg),
                    z=z * reach.lift_mm,
                    tilt_x=tilt_x * tilt,
                    tilt_y=tilt_y * tilt,
                ),
                sigma_factor=float(rng.uniform(*setup.factors.sigma)),
                waviness_seed=int(rng.integers(1 << 31)),
                samples=range(number * each, min((number + 1) * each, options.images)),
            )
        )
    return poses


@dataclass(frozen=True, eq=False, kw_only=True)
class SampleDraw:
    """One piece in a pose: what is on it, and how bright it is.

    dust: Diameter [mm] and R_d of each particle, shape (n, 2); `places`: shares along the pixels of the part and the
        offsets within a pixel, shape (n, 3)
    """

    number: int
    kinds: tuple[CatalogueEntry, ...]  # of its defects, which are placed with `rng`
    R_d: float
    R_s: float
    gains: tuple[float, ...]
    dust: Float64
    places: Float64
    rng: np.random.Generator


def draw_sample(setup: Setup, number: int) -> SampleDraw:
    """The sample of a number: the same whatever other samples there are."""
    ranges, factors, catalogue = setup.ranges, setup.factors, setup.catalogue
    rng = np.random.default_rng([setup.options.seed, 2, number])
    defective = rng.random() < ranges.defective
    count = int(rng.integers(ranges.defects[0], ranges.defects[1] + 1)) if defective else 0
    kinds = tuple(catalogue[int(rng.integers(len(catalogue)))].at(*rng.random(2).tolist()) for _ in range(count))
    brightness = rng.uniform(*factors.R_d), rng.uniform(*factors.R_s)
    gains = tuple(float(rng.uniform(*factors.gains[name])) for name in setup.lights)
    particles = int(rng.integers(ranges.dust.particles[0], ranges.dust.particles[1] + 1))
    low, high = np.log(ranges.dust.size_mm)
    dust = np.stack([np.exp(rng.uniform(low, high, particles)), rng.uniform(*ranges.dust.R_d, particles)], axis=1)
    return SampleDraw(
        number=number,
        kinds=kinds,
        R_d=float(brightness[0]),
        R_s=float(brightness[1]),
        gains=gains,
        dust=dust,
        places=rng.random((particles, 3)),
        rng=rng,
    )
