"""The files of a fit: the part and the rig with the fitted values, and all figures as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from lightopt import __version__
from lightopt.config import PartConfig, RigConfig, Source, relocated, with_values
from lightopt.errors import InputError
from lightopt.fit._result import FitResult
from lightopt.images import ImageSet, file_sha256, write_text_atomic

__all__ = ["FIT_NAME", "PART_NAME", "RIG_NAME", "check_folder", "provenance", "write_fit"]

PART_NAME = "part.fitted.yaml"
RIG_NAME = "rig.fitted.yaml"
FIT_NAME = "fit.json"


def provenance(
    rig: RigConfig, part: PartConfig, image_set: ImageSet, options: Mapping[str, Any]
) -> dict[str, Any]:
    """What a fit was made from: versions, hashes of the inputs, options.

    Names only, so that the same files give the same bytes wherever they lie.
    """
    return {
        "lightopt": __version__,
        "versions": {name: version(name) for name in ("embreex", "numba", "numpy")},
        "rig": {"file": rig.source.path.name, "sha256": rig.source.sha256},
        "part": {"file": part.source.path.name, "sha256": part.source.sha256},
        "mesh_sha256": file_sha256(part.source.resolve(part.mesh.file)),
        "images": [
            {**entry.as_dict(), "sha256": {**entry.sha256} or _hashes(image_set, entry.png, entry.exr)}
            for entry in image_set.images
        ],
        "options": dict(options),
    }


def check_folder(folder: Path, made_from: Mapping[str, Any], *, force: bool) -> None:
    """Refuse a folder that holds a fit of other inputs.

    Raises
    ------
    InputError
        With the way out.
    """
    path = folder / FIT_NAME
    taken = [name for name in (FIT_NAME, PART_NAME, RIG_NAME) if (folder / name).exists()]
    if force or not taken:
        return
    try:
        old = json.loads(path.read_text(encoding="utf-8"))["provenance"]
    except (OSError, ValueError, KeyError, TypeError):
        old = None
    if old != json.loads(json.dumps(made_from)):
        raise InputError(
            f"{folder} already has {', '.join(taken)} of a fit with other inputs or options; use --force to replace "
            "them, or choose another folder"
        )


def write_fit(
    folder: Path, result: FitResult, rig: RigConfig, part: PartConfig, made_from: Mapping[str, Any]
) -> list[Path]:
    """Write ``fit.json``, ``part.fitted.yaml`` and, where gains or the dark level were freed, ``rig.fitted.yaml``.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    written = [folder / FIT_NAME, folder / PART_NAME]
    content = {"format": "lightopt-fit/1", **result.as_dict(), "provenance": dict(made_from)}
    texts = {PART_NAME: _part_text(folder, result, part)}
    if result.gains is not None or result.dark is not None:
        texts[RIG_NAME] = _rig_text(folder, result, rig)
        written.append(folder / RIG_NAME)
    for name, text in texts.items():
        write_text_atomic(folder / name, text)
    write_text_atomic(
        folder / FIT_NAME, json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    )
    return written


def _part_text(folder: Path, result: FitResult, part: PartConfig) -> str:
    values: dict[tuple[str | int, ...], str] = {
        ("reflectance", name): f"{result.value(name):.6g}" for name in result.fitted
    }
    return with_values(_text(part.source), values | relocated(part, folder))


def _rig_text(folder: Path, result: FitResult, rig: RigConfig) -> str:
    values = relocated(rig, folder)
    for index, light in enumerate(rig.lights):
        # the reference keeps its gain, and its line in the file
        if result.gains is not None and abs(result.gains.get(light.name, light.gain) - light.gain) > 1e-9:
            values["lights", index, "gain"] = f"{result.gains[light.name]:.6g}"
    if result.dark is not None:
        values["camera", "sensor", "black_level"] = f"{max(result.dark, 0.0):.6g}"
    return with_values(_text(rig.source), values)


def _text(source: Source) -> str:
    return source.path.read_bytes().decode("utf-8-sig")


def _hashes(image_set: ImageSet, *names: str | None) -> dict[str, str]:
    return {Path(n).suffix[1:]: file_sha256(image_set.path(n)) for n in names if n is not None}
