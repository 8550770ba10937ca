"""The result of a fit, and its files: the part and the rig with the fitted values, and all figures as JSON."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from lightopt.config import PartConfig, PlacementConfig, ReflectanceConfig, RigConfig, copied_text, input_hashes
from lightopt.core.provenance import provenance
from lightopt.estimate.reflectance._estimate import Estimate, Interval, profile_regions
from lightopt.estimate.reflectance._paper import PaperDiffuse, PaperSpecular
from lightopt.estimate.reflectance._quality import MeasuredNoise, Quality, convergence_warnings
from lightopt.estimate.reflectance._validation import LeftOut, ModelRow, PointsRow
from lightopt.estimate.reflectance._vector import DARK, FIRST_GAIN, LOG_R_S, LOG_SIGMA, R_D, significant
from lightopt.estimate.registration import Placement, Registration
from lightopt.images import ImageSet, ResultFolder
from lightopt.optics import LAMBERT, DiffuseForm, SpecularModel
from lightopt.scene import Scene

PART_NAME = "part.fitted.yaml"
RIG_NAME = "rig.fitted.yaml"
FIT_NAME = "fit.json"
# keys of part files, by the form of the diffuse component that a fit is asked for
DIFFUSE_KEYS = {"exponent": "diffuse_exponent", "oren-nayar": "oren_nayar_roughness"}


@dataclass(frozen=True)
class FittedValue:
    # ``R_d``, ``R_s``, ``sigma_rad``, or ``half_angle_rad``, the angle at which the highlight of a point light stops
    # being saturated
    name: str
    value: float  # in the part file's unit
    standard_error: float = 0.0  # 0, null in the JSON form, for a value that was held or by a method that knows none
    # 95 %, from the profile of the criterion, None for an end that the images do not bound; None for a value that was
    # held or by a method that knows none
    interval: Interval | None = None
    # those that the interval joins where values between them are excluded; none where there is only one
    regions: tuple[Interval, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        facts: dict[str, Any] = {
            "value": significant(self.value, 8),
            "standard_error": significant(self.standard_error or None, 4),
            "interval_95": None if self.interval is None else [significant(end, 8) for end in self.interval],
        }
        regions = [[significant(end, 8) for end in region] for region in self.regions]
        return facts | ({"regions_95": regions} if regions else {})


@dataclass(frozen=True, kw_only=True)
class FitResult:
    kind: Literal["diffuse", "specular"]
    method: Literal["likelihood", "paper"]
    model: SpecularModel  # the specular lobe
    diffuse: DiffuseForm = LAMBERT
    points: int | Literal["auto"]  # point lights per panel, or ``"auto"``
    values: tuple[FittedValue, ...]
    fitted: tuple[str, ...]  # names of the values that were fitted and belong in the part file
    # gain of each light for the rig file, where gains were freed; the first light's is held
    gains: Mapping[str, FittedValue] | None = None
    dark: FittedValue | None = None  # black level for the rig file [sensor level], where it was freed
    noise: MeasuredNoise | None = None
    write_noise: bool = False  # whether `noise` belongs in the rig file
    # measured placement, and the same as values of the part file, where it was freed
    registration: Registration | None = None
    file_placement: PlacementConfig | None = None
    # only of a diffuse fit: that of the whole model, which locates the highlights
    highlight_fit: Estimate | None = None
    correlation: float | None = None  # of ln R_s and ln σ; None where they were not both fitted
    # number of levels that were used, and of their pixels
    observations: int = 0
    pixels: int = 0
    quality: Quality | None = None
    warnings: tuple[str, ...] = ()
    estimate: Estimate | None = None
    left_out: tuple[LeftOut, ...] = ()  # validation, one entry per light
    rows: tuple[PointsRow, ...] = ()  # one per number of points that was tried
    models: tuple[ModelRow, ...] = ()  # what decided between forms of the lobe
    regions: "tuple[RegionFit, ...]" = ()  # of the part, in its order
    paper: PaperDiffuse | PaperSpecular | None = None

    def value(self, name: str) -> float:
        return next(v.value for v in self.values if v.name == name)

    @property
    def converged(self) -> bool:
        """Whether every fit, those of validation among them, and the search for the part's place did."""
        fits = [found for found in (self.highlight_fit, self.estimate) if found is not None]
        of_regions = all(region.result.converged for region in self.regions if region.result is not None)
        placed = self.registration is None or self.registration.converged
        validated = all(left.converged for left in self.left_out)
        unsettled = [text for found in fits for text in convergence_warnings(found)]
        return placed and validated and of_regions and not unsettled

    @property
    def placement(self) -> Placement | None:
        return None if self.registration is None else self.registration.placement

    @property
    def highlights(self) -> tuple[float, float] | None:
        """R_s [grey level] and σ [rad] by which a diffuse fit knew where the highlights are; None in other fits."""
        return None if self.highlight_fit is None else (self.highlight_fit.R_s, self.highlight_fit.sigma)

    @property
    def not_left_out(self) -> tuple[str, ...]:
        """Parameters that validation takes from all images, also from those of the light that is left out."""
        freed = {"its own gain": self.gains, "the black level": self.dark, "the part's placement": self.placement}
        form = (name for name in self.fitted if name in DIFFUSE_KEYS.values())
        return (*(name for name, value in freed.items() if value is not None), *form)

    def as_dict(self) -> dict[str, Any]:
        found = self.estimate
        scan = () if found is None else found.scan
        best = max((point.value for point in scan), default=0.0)

        def facts(part: Any) -> dict[str, Any] | None:
            return None if part is None else part.as_dict()

        return {
            "kind": self.kind,
            "method": self.method,
            "model": self.model.name,
            "diffuse": {"exponent": self.diffuse.exponent, "oren_nayar_roughness": self.diffuse.roughness},
            "points": self.points,
            "fitted": list(self.fitted),
            "values": {v.name: v.as_dict() for v in self.values},
            "highlights_by": self.highlights
            and {"R_s": significant(self.highlights[0], 6), "sigma_rad": significant(self.highlights[1], 6)},
            "correlation_ln_R_s_ln_sigma": self.correlation,
            "gains": None if self.gains is None else {k: v.as_dict() for k, v in self.gains.items()},
            "black_level": facts(self.dark),
            "noise": facts(self.noise),
            "placement": facts(self.placement),
            "registration": facts(self.registration),
            "criterion": None if found is None else ("likelihood" if found.describes else "least squares"),
            "uncertainty_from": None if found is None else (found.scatter or "profile likelihood"),
            "converged": self.converged,
            "optima": [] if found is None else [optimum.as_dict() for optimum in found.optima],
            "observations": self.observations,
            "pixels": self.pixels,
            "quality": facts(self.quality),
            "warnings": list(self.warnings),
            "ridge": [point.as_dict(best) for point in scan],
            "left_out": [left.as_dict() for left in self.left_out],
            "not_left_out": list(self.not_left_out) if self.left_out else [],
            "by_points": [row.as_dict() for row in self.rows],
            "by_model": [row.as_dict() for row in self.models],
            "paper": facts(self.paper),
            "regions": [region.as_dict() for region in self.regions],
        }


@dataclass(frozen=True, kw_only=True)
class RegionFit:
    name: str
    result: FitResult | None = None  # None where images do not determine its reflectance, which stays as it is
    refused: str | None = None  # why they do not

    @property
    def warnings(self) -> tuple[str, ...]:
        if self.result is not None:
            return self.result.warnings
        return (f"not fitted, it keeps the reflectance of the part file: {self.refused}",)

    def as_dict(self) -> dict[str, Any]:
        fit = None if self.result is None else self.result.as_dict()
        return {"name": self.name, "refused": self.refused, "fit": fit}


def bounded(ends: tuple[float, float], value: Callable[[float], float]) -> Interval:
    """An interval of a parameter as one of what it stands for; None for an infinite end."""
    low, high = (value(end) if math.isfinite(end) else None for end in ends)
    return low, high


def format_interval(interval: Interval) -> str:
    low, high = interval
    if low is None:
        return "no bounds" if high is None else f"up to {high:.6g}, no lower bound"
    return f"from {low:.6g}, no upper bound" if high is None else f"{low:.6g} to {high:.6g}"


def separate_region_warnings(values: Iterable[FittedValue]) -> Iterator[str]:
    """Warn of intervals that join separate regions between which the images do not decide."""
    several = [f"{v.name} {' or '.join(map(format_interval, v.regions))}" for v in values if v.regions]
    if several:
        yield (
            f"the images do not decide between separate ranges ({'; '.join(several)}): the 95 % intervals include all "
            "of these, and values between them fit worse. Images under other lights, or at another exposure, may decide"
        )


def _fitted(
    name: str, value: float, found: Estimate, place: int, of: Callable[[float], float], *, slope: float = 1.0
) -> FittedValue:
    # `of` makes the value of the parameter's coordinate, with about this slope
    if place not in found.free:
        return FittedValue(name=name, value=value)
    regions = tuple(bounded(ends, of) for ends in profile_regions(found, place))
    error, interval = slope * found.standard_error(place), (regions[0][0], regions[-1][1])
    return FittedValue(name, value, error, interval, regions=regions if len(regions) > 1 else ())


def fitted_values(found: Estimate, *, full_scale: float, model: SpecularModel) -> tuple[FittedValue, ...]:
    """R_d, R_s and the lobe's width, with standard errors and intervals.

    Of a Gaussian lobe also the saturated half-angle under a point light.
    """
    factor = model.width_factor
    r_s = _fitted("R_s", found.R_s, found, LOG_R_S, math.exp, slope=found.R_s)
    width = factor * found.sigma
    spread = _fitted(model.width_key, width, found, LOG_SIGMA, lambda end: factor * math.exp(end), slope=width)
    diffuse = _fitted("R_d", found.R_d, found, R_D, float)
    values = [diffuse, r_s, spread]
    if model.name != "torrance-sparrow":
        return tuple(values)
    over = math.log(max(found.R_s / full_scale, 1e-300))
    if over > 0.0:
        angle = found.sigma * math.sqrt(2.0 * over)
        error = 0.0
        if LOG_R_S in found.free and LOG_SIGMA in found.free:
            # d ln(angle) = d ln σ + d ln R_s / (2·ln(wR_s / full scale))
            a, b = found.standard_error(LOG_SIGMA), found.standard_error(LOG_R_S) / (2.0 * over)
            error = angle * math.sqrt(max(a * a + b * b + 2.0 * a * b * found.correlation(LOG_R_S, LOG_SIGMA), 0.0))
        values.append(FittedValue(name="half_angle_rad", value=angle, standard_error=error))
    return tuple(values)


def fitted_names(model: SpecularModel) -> tuple[str, ...]:
    return ("R_s", model.width_key, *(("R_s_wide", "sigma_wide_rad") if model.name == "two-lobe" else ()))


def fitted_gains(scene: Scene, found: Estimate) -> dict[str, FittedValue]:
    """Gain of each light of a scene, its own times what was fitted; that of the light held has no error."""
    gains: dict[str, FittedValue] = {}
    for index, light in enumerate(scene.lights):
        value = light.gain * math.exp(found.x[FIRST_GAIN + index])
        gains[light.name] = _fitted(
            light.name, value, found, FIRST_GAIN + index, lambda end, own=light.gain: own * math.exp(end), slope=value
        )
    return gains


def negative_black_level_warnings(dark: FittedValue | None) -> Iterator[str]:
    if dark is not None and dark.value < 0.0:
        yield (
            f"the fitted black level is {dark.value:.3g}, but a rig file has none below 0: rig.fitted.yaml has 0, and "
            "images predicted from it are too bright by the difference. The camera subtracts more than its black "
            "level: check its offset"
        )


def fitted_dark(scene: Scene, found: Estimate) -> FittedValue:
    """Black level of the sensor [sensor level], its own plus what was fitted."""
    black = scene.sensor.black_level
    return _fitted("black_level", float(black + found.x[DARK]), found, DARK, lambda end: black + end)


def fit_folder(
    folder: Path, rig: RigConfig, part: PartConfig, image_set: ImageSet, options: Mapping[str, Any], *, force: bool
) -> ResultFolder:
    """Open a folder that a fit is written to.

    options: In JSON form
    Raises InputError: the folder holds a fit of other inputs, and `force` is False.
    """
    made_from = provenance(inputs={**input_hashes(rig, part), "image_sets": [image_set.fingerprint]}, options=options)
    names = {"name": FIT_NAME, "format": "lightopt-fit/1", "what": "a fit"}
    return ResultFolder(folder, made_from, **names, also=(PART_NAME, RIG_NAME), force=force)


def write_fit(folder: ResultFolder, result: FitResult, rig: RigConfig, part: PartConfig) -> list[Path]:
    """Write the part, where gains, the dark level or the noise are written the rig, and at last ``fit.json``.

    Raises InputError: a file cannot be written.
    """
    texts = {PART_NAME: _part_text(folder.folder, result, part)}
    values: _Values = {}
    for index, light in enumerate(rig.lights):
        gain = None if result.gains is None else result.gains.get(light.name)
        if gain is not None and gain.interval is not None:  # the one that is held keeps its line in the file
            values["lights", index, "gain"] = f"{gain.value:.6g}"
    if result.dark is not None:
        values["camera", "sensor", "black_level"] = f"{max(result.dark.value, 0.0):.6g}"
    noise = result.noise if result.write_noise else None
    for key in ("read_noise_levels", "electrons_per_level"):
        if (figure := getattr(noise, key, None)) is not None:
            values["camera", "sensor", key] = f"{figure:.4g}"
    if result.gains is not None or values:
        texts[RIG_NAME] = copied_text(rig, folder.folder, values)
    written = [folder.write_text(name, text) for name, text in texts.items()]
    return [folder.finish(result.as_dict()), *written]


def _part_text(folder: Path, result: FitResult, part: PartConfig) -> str:
    # what was not fitted stays as it is, whatever form the fit would have had
    values = _reflectance_values(result, part.reflectance, "reflectance") if result.fitted else {}
    for i, region in enumerate(result.regions):
        if region.result is not None:
            values |= _reflectance_values(region.result, part.regions[i].reflectance, "regions", i, "reflectance")
    if result.file_placement is not None:
        values |= _placement_values(part, result.file_placement)
    return copied_text(part, folder, values)


_Values = dict[tuple[str | int, ...], str | None]


def _reflectance_values(result: FitResult, own: ReflectanceConfig, *keys: str | int) -> _Values:
    values: _Values = {(*keys, name): f"{result.value(name):.6g}" for name in result.fitted}
    if result.model.name != own.model:
        values[(*keys, "model")] = result.model.name
        superseded = [name for name in fitted_names(SpecularModel(name=own.model)) if name not in result.fitted]
        superseded += ["table"] if own.table is not None else []
        values |= {(*keys, name): None for name in superseded}
    across, before = result.model.across_key, SpecularModel(name=own.model).across_key
    if own.sigma_across is not None and result.model.width_key in result.fitted:
        if before != across:
            values[(*keys, before)] = None
        if across not in result.fitted:
            # the lobe stays as many times wider across the brushing
            values[(*keys, across)] = f"{result.model.across_ratio * result.value(result.model.width_key):.6g}"
    if (own.diffuse_exponent or 1.0, own.oren_nayar_roughness or 0.0) != result.diffuse:
        # of another form than that of the fit
        given = [key for key in DIFFUSE_KEYS.values() if getattr(own, key) is not None and key not in result.fitted]
        values |= {(*keys, key): None for key in given}
    return values


def _placement_values(part: PartConfig, found: PlacementConfig) -> _Values:
    vectors = {"rotate_deg": found.rotate_deg, "translate_mm": found.translate_mm}
    lists = {key: "[" + ", ".join(f"{value:.6g}" for value in vector) + "]" for key, vector in vectors.items()}
    lines = part.source.lines
    if ("placement",) not in lines:
        inside = ", ".join(f"{key}: {text}" for key, text in lists.items())
        return {("placement",): f"{{anchor: {found.anchor}, {inside}}}"}
    values: _Values = {}
    for key, vector in vectors.items():
        if ("placement", key) in lines:
            values |= {("placement", key, i): f"{value:.6g}" for i, value in enumerate(vector)}
        else:
            values["placement", key] = lists[key]
    return values
