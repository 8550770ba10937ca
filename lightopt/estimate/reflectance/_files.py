"""The files of a fit: the part and the rig with the fitted values, and all figures as JSON."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lightopt.config import PartConfig, PlacementConfig, RigConfig, Source, copied_text, input_hashes
from lightopt.core.errors import InputError
from lightopt.core.provenance import provenance
from lightopt.estimate.reflectance._result import FitResult
from lightopt.images import ImageSet, ResultFolder

PART_NAME = "part.fitted.yaml"
RIG_NAME = "rig.fitted.yaml"
FIT_NAME = "fit.json"


def fit_provenance(rig: RigConfig, part: PartConfig, image_set: ImageSet, options: Mapping[str, Any]) -> dict[str, Any]:
    """What a fit depends on, in the layout of :mod:`lightopt.core.provenance`."""
    return provenance(inputs={**input_hashes(rig, part), "image_sets": [image_set.fingerprint]}, options=options)


class FitFolder(ResultFolder):
    """A folder that a fit is written to.

    folder: Made where it does not exist.
    made_from: From :func:`fit_provenance`.
    Raises InputError: the folder holds a fit of other inputs, and `force` is False.
    """

    def __init__(self, folder: Path, made_from: Mapping[str, Any], *, force: bool) -> None:
        names = {"name": FIT_NAME, "format": "lightopt-fit/1", "what": "a fit"}
        super().__init__(folder, made_from, **names, also=(PART_NAME, RIG_NAME), force=force)

    def write(self, result: FitResult, rig: RigConfig, part: PartConfig) -> list[Path]:
        """Write the part, where gains, the dark level or the noise are written the rig, and at last ``fit.json``.

        Raises InputError: a file cannot be written.
        """
        texts = {PART_NAME: _part_text(self.folder, result, part)}
        values = _rig_values(result, rig)
        if result.gains is not None or values:
            _check_text(rig.source)
            texts[RIG_NAME] = copied_text(rig, self.folder, values)
        written = [self.write_text(name, text) for name, text in texts.items()]
        return [self.finish(result.as_dict()), *written]


def _part_text(folder: Path, result: FitResult, part: PartConfig) -> str:
    values: dict[tuple[str | int, ...], str] = {
        ("reflectance", name): f"{result.value(name):.6g}" for name in result.fitted
    }
    if result.file_placement is not None:
        values |= _placement_values(part, result.file_placement)
    _check_text(part.source)
    return copied_text(part, folder, values)


def _placement_values(part: PartConfig, found: PlacementConfig) -> dict[tuple[str | int, ...], str]:
    vectors = {"rotate_deg": found.rotate_deg, "translate_mm": found.translate_mm}
    lists = {key: "[" + ", ".join(f"{value:.6g}" for value in vector) + "]" for key, vector in vectors.items()}
    lines = part.source.lines
    if ("placement",) not in lines:
        inside = ", ".join(f"{key}: {text}" for key, text in lists.items())
        return {("placement",): f"{{anchor: {found.anchor}, {inside}}}"}
    values: dict[tuple[str | int, ...], str] = {}
    for key, vector in vectors.items():
        if ("placement", key) in lines:
            values |= {("placement", key, i): f"{value:.6g}" for i, value in enumerate(vector)}
        else:
            values["placement", key] = lists[key]
    return values


def _rig_values(result: FitResult, rig: RigConfig) -> dict[tuple[str | int, ...], str]:
    values: dict[tuple[str | int, ...], str] = {}
    for index, light in enumerate(rig.lights):
        gain = None if result.gains is None else result.gains.get(light.name)
        if gain is not None and gain.interval is not None:  # the one that is held keeps its line in the file
            values["lights", index, "gain"] = f"{gain.value:.6g}"
    if result.dark is not None:
        values["camera", "sensor", "black_level"] = f"{max(result.dark.value, 0.0):.6g}"
    noise = result.noise if result.write_noise else None
    figures = {} if noise is None else {"read_noise_levels": noise.read_noise, "electrons_per_level": noise.electrons}
    for key, figure in figures.items():
        if figure is not None:
            values["camera", "sensor", key] = f"{figure:.4g}"
    return values


def _check_text(source: Source) -> None:
    if not source.text:
        raise InputError(
            f"{source.path}: built in code, so that there is no file to write the fitted values into; load it from one"
        )
