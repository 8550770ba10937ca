"""The files of an optimisation: result.json, ranking.csv, rigs with the new angles, images and overlap maps."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lightopt.config import PartConfig, RigConfig, load_rig, with_values
from lightopt.errors import InputError
from lightopt.images import posture_folder, read_image_set, write_text_atomic
from lightopt.optimize._candidates import Candidates
from lightopt.optimize._earlier import remove_stale
from lightopt.optimize._matrix import Thresholds
from lightopt.optimize._options import OptimizeOptions
from lightopt.optimize._overlap import Overlap, find_overlaps, overlap_map_name, write_overlap_map
from lightopt.optimize._result import SetResult, angles_of, ranking_csv, result_dict
from lightopt.rendering import RenderOptions, render_image_set
from lightopt.transforms import Posture

__all__ = ["RESULT_NAME", "Written", "write_outputs"]

RESULT_NAME, RANKING_NAME, RIG_NAME, IMAGES_NAME = (
    "result.json",
    "ranking.csv",
    "rig.optimized.yaml",
    "images",
)


@dataclass(frozen=True, kw_only=True)
class Written:
    """The files of an optimisation.

    Attributes
    ----------
    result, ranking
        result.json and ranking.csv.
    rigs
        Rig files with the new angles, and the postures that each is for.
    images
        Folders of image sets.
    overlaps
        Saturated regions of these images, in the order of the postures.
    """

    result: Path
    ranking: Path
    rigs: tuple[tuple[Path, tuple[Posture, ...]], ...]
    images: tuple[Path, ...]
    overlaps: tuple[Overlap, ...]


def write_outputs(
    folder: Path,
    rig: RigConfig,
    part: PartConfig,
    results: tuple[SetResult, ...],
    candidates: Candidates,
    thresholds: Thresholds,
    *,
    provenance: Mapping[str, Any],
    options: OptimizeOptions,
    force: bool,
    warn: Callable[[str], None],
) -> Written:
    """Write all files, result.json last: where it is, the others are complete.

    Parameters
    ----------
    folder
        Made where it does not exist.
    rig, part
        As they were read.
    results, candidates, thresholds
        What was found.
    provenance
        Versions, hashes and options, JSON.
    options
        As they were asked for.
    force
        Replace files that are there and differ.
    warn
        Called with warnings of the rendering.

    Raises
    ------
    InputError
        The folder cannot be written, or holds other results and `force` is False.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be made: {error.strerror or error}; choose an output folder that can be written"
        ) from error
    ranking = folder / RANKING_NAME
    write_text_atomic(ranking, ranking_csv(results, candidates), overwrite=force)
    rigs = _write_rigs(folder, rig, results, candidates, force)
    images: list[Path] = []
    overlaps: list[Overlap] = []
    maps: list[Path] = []
    if options.images:
        for path, postures in rigs:
            images.append(path.parent / IMAGES_NAME)
            overlaps += _render(path, part, images[-1], postures, options, force, warn)
            maps += [images[-1] / overlap_map_name(overlap) for overlap in overlaps[len(maps) :]]
    document = {
        "format": "lightopt-optimum/1",
        **provenance,
        "thresholds": {
            "black": thresholds.black,
            "shaded_below": thresholds.shade,
            "saturated_from": thresholds.saturation,
        },
        "candidates": [
            {"light": name, "positions_deg": [list(at) for at in angles]}
            for name, angles in zip(candidates.names, candidates.angles, strict=True)
        ],
        "left_out": [vars(out) for out in candidates.left_out],
        "results": result_dict(results, candidates),
        "rigs": [
            {"file": path.relative_to(folder).as_posix(), "postures": [p.as_dict() for p in postures]}
            for path, postures in rigs
        ],
        "overlaps": [
            {"map": path.relative_to(folder).as_posix(), **overlap.as_dict()}
            for path, overlap in zip(maps, overlaps, strict=True)
        ],
    }
    result = folder / RESULT_NAME
    if force:
        remove_stale(result, [*(path for path, _ in rigs), *maps])
    text = json.dumps(document, indent=1, ensure_ascii=False) + "\n"
    write_text_atomic(result, text, overwrite=force)
    return Written(result=result, ranking=ranking, rigs=rigs, images=tuple(images), overlaps=tuple(overlaps))


def _write_rigs(
    folder: Path, rig: RigConfig, results: tuple[SetResult, ...], candidates: Candidates, force: bool
) -> tuple[tuple[Path, tuple[Posture, ...]], ...]:
    # one rig where the same positions are best for all postures, else one per posture
    answered = [(result, result.answers[0]) for result in results if result.answers[0].nothing is None]
    sets = [
        (
            angles_of(candidates, answer.found.best),
            result.postures,
            folder / posture_folder(result.postures[0]),
        )
        for result, answer in answered
    ]
    if sets and len(answered) == len(results) and len({angles for angles, _, _ in sets}) == 1:
        together = tuple(posture for _, postures, _ in sets for posture in postures)
        sets = [(sets[0][0], together, folder)]
    elif len(results) == 1:
        sets = [(angles, postures, folder) for angles, postures, _ in sets]
    written: list[tuple[Path, tuple[Posture, ...]]] = []
    text = _rig_text(rig) if sets else ""
    for angles, postures, home in sets:
        values: dict[tuple[str | int, ...], str] = {}
        for index, (light, (elevation, azimuth)) in enumerate(zip(rig.lights, angles, strict=True)):
            if light.elevation_range_deg is not None:
                values["lights", index, "elevation_deg"] = _degrees(elevation)
            if light.azimuth_range_deg is not None:
                values["lights", index, "azimuth_deg"] = _degrees(azimuth)
        edited = with_values(text, values)
        home.mkdir(parents=True, exist_ok=True)
        write_text_atomic(home / RIG_NAME, edited, overwrite=force)
        written.append((home / RIG_NAME, postures))
    return tuple(written)


def _degrees(angle: float) -> str:
    # at most nine decimals, which is finer than any stage, and no exponent
    return f"{round(angle, 9):.9f}".rstrip("0").rstrip(".")


def _rig_text(rig: RigConfig) -> str:
    try:
        return rig.source.path.read_bytes().decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"{rig.source.path}: cannot be read again to write the new angles into a copy: {error}; load the rig from "
            "a file that stays where it is"
        ) from error


def _render(
    rig: Path,
    part: PartConfig,
    folder: Path,
    postures: tuple[Posture, ...],
    options: OptimizeOptions,
    force: bool,
    warn: Callable[[str], None],
) -> tuple[Overlap, ...]:
    render_image_set(
        load_rig(rig),
        part,
        folder,
        options=RenderOptions(
            postures=postures,
            points=options.points,
            shadows=options.shadows,
            patch_budget=options.patch_budget,
            threads=options.threads,
        ),
        force=force,
        warn=warn,
    )
    overlaps = find_overlaps(read_image_set(folder))
    for overlap in overlaps:
        write_overlap_map(overlap, folder / overlap_map_name(overlap), overwrite=force)
    return overlaps
