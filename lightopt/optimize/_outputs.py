"""The files of an optimisation: result.json, ranking.csv, rigs with the new angles, images and overlap maps."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lightopt.config import PartConfig, RigConfig, load_rig
from lightopt.images import make_folder, read_image_set, write_text_atomic
from lightopt.optimize._candidates import Candidates
from lightopt.optimize._earlier import RESULT_NAME, RIG_NAME, begin_writing, end_writing
from lightopt.optimize._matrix import Thresholds
from lightopt.optimize._options import OptimizeOptions
from lightopt.optimize._result import SetResult, ranking_csv, result_dict
from lightopt.optimize._rig_text import rig_texts
from lightopt.overlap import Overlap, find_overlaps, overlap_map_name, write_overlap_map
from lightopt.rendering import RenderOptions, render_image_set
from lightopt.transforms import Posture

__all__ = ["Written", "write_outputs"]

RANKING_NAME = "ranking.csv"
IMAGES_NAME = "images"


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

    With `force`, an earlier result.json goes first, then all that it lists.

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
    make_folder(folder)
    rigs = tuple(
        (folder / path, postures, text)
        for path, postures, text in rig_texts(rig, results, candidates, folder=folder)
    )
    listed = _listed(folder, rigs, options)
    begin_writing(folder, listed, force=force)
    ranking = folder / RANKING_NAME
    write_text_atomic(ranking, ranking_csv(results, candidates), overwrite=force)
    for path, _, text in rigs:
        make_folder(path.parent)
        write_text_atomic(path, text, overwrite=force)
    images = tuple(path.parent / IMAGES_NAME for path, _, _ in rigs) if options.images else ()
    overlaps: list[Overlap] = []
    for home, (path, postures, _) in zip(images, rigs, strict=False):
        overlaps += _render(path, part, home, postures, options, force, warn)
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
        "rigs": listed["rigs"],
        "images": listed["images"],
        "overlaps": [
            {**where, **overlap.as_dict()}
            for where, overlap in zip(listed["overlaps"], overlaps, strict=True)
        ],
    }
    result = folder / RESULT_NAME
    text = json.dumps(document, indent=1, ensure_ascii=False) + "\n"
    write_text_atomic(result, text, overwrite=force)
    end_writing(folder)
    return Written(
        result=result,
        ranking=ranking,
        rigs=tuple((path, postures) for path, postures, _ in rigs),
        images=images,
        overlaps=tuple(overlaps),
    )


def _listed(
    folder: Path, rigs: Sequence[tuple[Path, tuple[Posture, ...], str]], options: OptimizeOptions
) -> dict[str, list[dict[str, Any]]]:
    # the files to come, as result.json lists them
    homes = [(path.parent.relative_to(folder), postures) for path, postures, _ in rigs]
    pictured = [(home / IMAGES_NAME, postures) for home, postures in homes] if options.images else []
    return {
        "rigs": [
            {"file": (home / RIG_NAME).as_posix(), "postures": [p.as_dict() for p in postures]}
            for home, postures in homes
        ],
        "images": [{"folder": home.as_posix()} for home, _ in pictured],
        "overlaps": [
            {"map": (home / overlap_map_name(posture)).as_posix()}
            for home, postures in pictured
            for posture in postures
        ],
    }


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
        write_overlap_map(
            overlap, folder / overlap_map_name(overlap.posture, overlap.exposure), overwrite=force
        )
    return overlaps
