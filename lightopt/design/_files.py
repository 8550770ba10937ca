"""The files of a design: result.json, ranking.csv, rigs with the new angles, images, overlap maps, blind spots.

Rig and part files are the user's own text with new angles and postures, comments kept. The report shows what is
written, and result.json says that all is there: :func:`finish_design` writes these two.

While a run writes its files, ``unfinished.json`` lists those that it will write, and those of a previous run that it
removes; it goes when ``result.json`` is there. So a folder never has a ``result.json`` beside files that contradict
it, and what an interrupted run left is known to the next one.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lightopt import images
from lightopt.config import PartConfig, RigConfig, copied_text, load_rig, with_list
from lightopt.core.arrays import UInt8
from lightopt.core.errors import InputError
from lightopt.core.provenance import differences
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture, vector_of_rotation
from lightopt.design._blind_spots import BLIND_CSV, BLIND_NAMES, BLIND_PLY, BLIND_PNG, blind_csv, blind_ply
from lightopt.design._candidates import Place, panels_of, place_dict, place_of
from lightopt.design._result import PLANNED_PART_NAME, RIG_NAME, DesignResult, decimal_text, places_of
from lightopt.design._result_json import ranking_csv, result_document
from lightopt.rendering import PatchTable, RenderOptions, render_image_set

RESULT_NAME = "result.json"
REPORT_NAME = "report.html"
RANKING_NAME = "ranking.csv"
IMAGES_NAME = "images"
UNFINISHED_NAME = "unfinished.json"

# files that a result may list beside images; with option `force` no others are removed
_OWN_NAMES = (REPORT_NAME, PLANNED_PART_NAME, RIG_NAME, "overlap*.png", *BLIND_NAMES)

# the files that list what a run writes, and their formats
_KINDS = {RESULT_NAME: "lightopt-optimum", UNFINISHED_NAME: "lightopt-unfinished"}

# a rig file with the new places, relative to the output folder; the postures that it is for, and its text
RigFile = tuple[Path, tuple[Posture, ...], str]
_Pictures = Mapping[Posture, UInt8]


def refuse_other_result(folder: Path, provenance: Mapping[str, Any]) -> None:
    """Raise an :class:`InputError` where a folder holds a result of other inputs, or one that cannot be read.

    `provenance` is that of the run to come, or the part of it that is known already.
    """
    path = folder / RESULT_NAME
    if not path.exists():
        return
    found = images.read_listing(path, _KINDS[RESULT_NAME])
    advice = "use option 'force' to replace it, or choose another output folder"
    if found is None:
        raise InputError(f"{path}: exists and is not a result of lightopt optimize; {advice}")
    other = found.get("provenance")
    if changes := differences(other if isinstance(other, dict) else {}, provenance, partly=True):
        raise InputError(f"{path}: the result of another run ({changes}); {advice}")


def begin_writing(folder: Path, listed: Mapping[str, Any], *, force: bool) -> bool:
    """List the files to come and, with `force`, remove result.json and then all that previous runs list.

    Removed are files inside the folder only, and image sets by their manifests; captured images, kept matrices and what
    no list names stay. `listed` is as in result.json.

    Returns whether a report that is there is of a previous run.
    """
    previous = [
        found for name, kind in _KINDS.items() if (found := images.read_listing(folder / name, kind)) is not None
    ]
    lists = {key: [one for document in (listed, *previous) for one in _entries(document, key)] for key in listed}
    _write_json(folder / UNFINISHED_NAME, {"format": "lightopt-unfinished/1", **lists})
    if force:
        images.remove_file(folder / RESULT_NAME)
        for document in previous:
            keys = (("overlaps", "map"), ("files", "file"), ("rigs", "file"))
            names = [str(entry.get(name)) for key, name in keys for entry in _entries(document, key)]
            images.remove_listed(folder, [name for name in names if any(map(Path(name).match, _OWN_NAMES))])
            for home in images.paths_inside(folder, [entry.get("folder") for entry in _entries(document, "images")]):
                images.remove_image_set(home)
                for emptied in (home, home.parent):
                    with suppress(OSError):  # something else is in it, or it is gone
                        emptied.rmdir()
    return any({"file": REPORT_NAME} in _entries(document, "files") for document in previous)


def _entries(document: Mapping[str, Any], key: str) -> list[dict[str, Any]]:
    found = document.get(key)
    return [entry for entry in found if isinstance(entry, dict)] if isinstance(found, list) else []


def _write_json(path: Path, document: Mapping[str, Any], *, overwrite: bool = True) -> None:
    images.write_text_atomic(path, json.dumps(document, indent=1, ensure_ascii=False) + "\n", overwrite=overwrite)


def check_editable(rig: RigConfig) -> None:
    """Refuse a rig whose lights cannot be moved in its file: built in code, or with anchors and aliases."""
    _rig_text(rig, [place_of(light) for light in rig.lights], rig.source.path.parent)


def _rig_files(design: DesignResult) -> list[RigFile]:
    # one rig where the same positions are best for all postures, else one per posture
    sets: list[tuple[tuple[Place, ...], tuple[Posture, ...], Path]] = []
    for result in design.results:
        if (answer := result.answers[0]).nothing is None:
            home = Path(images.posture_folder(result.postures[0]))
            sets.append((places_of(design.candidates, answer.found.best), result.postures, home))
    if sets and len(sets) == len(design.results) and len({places for places, _, _ in sets}) == 1:
        sets = [(sets[0][0], tuple(posture for _, postures, _ in sets for posture in postures), Path())]
    text = partial(_rig_text, design.rig)
    return [(home / RIG_NAME, postures, text(places, design.folder / home)) for places, postures, home in sets]


def _rig_text(rig: RigConfig, places: Sequence[Place], home: Path) -> str:
    values: dict[tuple[str | int, ...], str | None] = {}
    moved = [light.name for light, place in zip(rig.lights, places, strict=True) if place != place_of(light)]
    for index, (light, place) in enumerate(zip(rig.lights, places, strict=True)):
        if light.pose is not None:
            if light.name in moved:
                values |= _moved_pose(rig, index, place)
            continue
        ranges = light.elevation_range_deg, light.azimuth_range_deg, light.distance_range_mm
        for (key, value), ends in zip(place_dict(place).items(), ranges, strict=False):
            if ends is not None:
                values["lights", index, key] = decimal_text(value)
    values |= _no_longer_measured(rig, moved)
    return _edited(rig, "the rig", "the new places", lambda: copied_text(rig, home, values))


def _moved_pose(rig: RigConfig, index: int, place: Place) -> dict[tuple[str | int, ...], str]:
    panel = panels_of(rig, index, [place], None)[0]
    rotation = np.stack([panel.across, panel.along, panel.outward], axis=1)
    pose = {"centre_mm": panel.centre, "rotation_vector_deg": np.degrees(vector_of_rotation(rotation))}
    values = ((key, i, float(value)) for key, vector in pose.items() for i, value in enumerate(vector))
    return {("lights", index, "pose", key, i): f"{round(value, 6)}" for key, i, value in values}


def _no_longer_measured(rig: RigConfig, moved: Sequence[str]) -> dict[tuple[str | int, ...], str | None]:
    # the places of lights that move; their gains stay. A covariance without intervals is that of all values
    if rig.calibration is None or not moved:
        return {}
    known = rig.calibration.intervals
    lost = [name for name in known if name.partition(" ")[0] in moved and not name.endswith(" gain")]
    if len(lost) == len(known):
        return {("calibration",): None}
    return {("calibration", "intervals", name): None for name in lost}


def _edited(config: RigConfig | PartConfig, kind: str, what: str, edit: Callable[[], str]) -> str:
    path = config.source.path
    if not config.source.text:
        raise InputError(
            f"{path}: {kind} was built in code, so there is no file to write {what} into; load it from one"
        )
    try:
        return edit()
    except InputError as error:
        raise InputError(*(f"{path}: {text}" for text in error.messages)) from None


def planned_part_text(part: PartConfig, postures: Sequence[Posture], *, folder: Path, comment: str) -> str:
    """Text of a part file with other postures, below a comment; the mesh is named relative to `folder`."""
    angles = [(decimal_text(p.elevation_deg), decimal_text(p.rotation_deg)) for p in postures]
    entries = [f"{{elevation_deg: {elevation}, rotation_deg: {rotation}}}" for elevation, rotation in angles]

    def edit() -> str:
        return with_list(copied_text(part, folder), "postures", entries, comment=comment, replace=True)

    return _edited(part, "the part", "the planned postures", edit)


@dataclass(frozen=True, eq=False, kw_only=True)
class DesignOutput:
    """A design whose files are written, except its report and result.json."""

    result: DesignResult
    document: Mapping[str, Any]  # what result.json will say
    overlaps: tuple[images.Overlap, ...]  # saturated regions of the images, in the order of the postures
    warnings: tuple[str, ...]
    paths: tuple[Path, ...]  # result.json, ranking.csv, further files, rigs, report: those to come, too
    force: bool  # whether files that are there and differ are replaced
    replace_report: bool  # whether a report that is there is replaced

    @property
    def patches(self) -> PatchTable:
        assert self.result.patches is not None
        return self.result.patches


def write_design(
    result: DesignResult, blind_pictures: _Pictures | None = None, *, force: bool = False, run: RunContext | None = None
) -> DesignOutput:
    """Write the files of a design except its report and result.json; :func:`finish_design` must follow.

    `blind_pictures` has a picture of shape (height, width, 3) for each posture. With `force`, a previous result.json
    goes first, then all that it lists.

    Raises InputError: The folder cannot be written, or holds other results and `force` is False.
    """
    folder, run = result.folder, run or RunContext()
    images.make_folder(folder)
    rigs = _rig_files(result)
    files = dict(_further_files(result, blind_pictures or {}))
    sets = _image_sets(rigs, result) if result.options.images else []
    listed = _listed(rigs, sets, overlaps=len(result.candidates.names) > 1)
    report = [REPORT_NAME] if result.options.report else []
    listed["files"] = [{"file": name} for name in (*files, *report)]
    report_is_ours = begin_writing(folder, listed, force=force)
    ranking = ranking_csv(result.results, result.candidates)
    for name, content in ((RANKING_NAME, ranking), *((path, text) for path, _, text in rigs), *files.items()):
        _write(folder / name, content, force)
    overlaps: list[images.Overlap] = []
    for image_set in sets:
        overlaps += _render(image_set, result, force, run)
    names = (RESULT_NAME, RANKING_NAME, *files, *(path for path, _, _ in rigs), *report)
    return DesignOutput(
        result=result,
        document=result_document(result, listed, overlaps),
        overlaps=tuple(overlaps),
        warnings=tuple(dict.fromkeys((*result.warnings, *run.warnings))),
        paths=tuple(folder / name for name in names),
        force=force,
        replace_report=force or report_is_ours,
    )


def finish_design(output: DesignOutput, report: str | None = None) -> None:
    """Write the report, if the options request it, and result.json last: then all files are complete."""
    folder = output.result.folder
    if (report is not None) != output.result.options.report:
        raise ValueError("a report is given where, and only where, the options ask for one")
    if report is not None:
        images.write_text_atomic(folder / REPORT_NAME, report, overwrite=output.replace_report)
    _write_json(folder / RESULT_NAME, output.document, overwrite=output.force)
    images.remove_file(folder / UNFINISHED_NAME)


def _further_files(result: DesignResult, blind_pictures: _Pictures) -> Iterator[tuple[str, str | bytes | UInt8]]:
    """Names in the folder and contents; the names must be known to :mod:`lightopt.design._files`."""
    if result.blind is not None and result.patches is not None:
        yield BLIND_CSV, blind_csv(result.blind)
        yield BLIND_PLY, blind_ply(result.blind, result.patches.patches, result.scene.placement)
        for posture, picture in blind_pictures.items():
            yield f"{images.posture_folder(posture)}/{BLIND_PNG}", picture
    if result.plan.commands:
        comment = f"planned by: {result.command}"
        text = planned_part_text(result.part, result.scene.postures, folder=result.folder, comment=comment)
        yield PLANNED_PART_NAME, text


def _write(path: Path, content: str | bytes | UInt8, force: bool) -> None:
    images.make_folder(path.parent)
    if isinstance(content, str):
        images.write_text_atomic(path, content, overwrite=force)
    elif isinstance(content, bytes):
        images.write_bytes_atomic(path, content, overwrite=force)
    else:
        images.write_png(path, content, metadata={}, overwrite=force)


class _Images(NamedTuple):
    """An image set to render: of one rig, with the same exposures in all postures; paths in the output folder."""

    folder: Path
    rig: Path
    postures: tuple[Posture, ...]
    exposures: tuple[float, ...]

    @property
    def shots(self) -> list[tuple[Posture, float]]:
        return list(product(self.postures, self.exposures))


def _image_sets(rigs: Sequence[RigFile], result: DesignResult) -> list[_Images]:
    # images, images-2, …: an image set has every posture at every exposure
    sets: list[_Images] = []
    for path, postures, _ in rigs:
        groups: dict[tuple[float, ...], list[Posture]] = {}
        for posture in postures:
            groups.setdefault(result.plan.exposures_of(posture), []).append(posture)
        for number, (exposures, some) in enumerate(groups.items(), start=1):
            home = path.parent / (IMAGES_NAME if number == 1 else f"{IMAGES_NAME}-{number}")
            sets.append(_Images(home, path, tuple(some), exposures))
    return sets


def _listed(rigs: Sequence[RigFile], sets: Sequence[_Images], *, overlaps: bool) -> dict[str, list[dict[str, Any]]]:
    # the files to come, as result.json lists them
    maps = [one.folder / images.overlap_map_name(*shot) for one in sets for shot in one.shots if overlaps]
    return {
        "rigs": [{"file": path.as_posix(), "postures": [one.as_dict() for one in some]} for path, some, _ in rigs],
        "images": [{"folder": one.folder.as_posix(), "exposures": list(one.exposures)} for one in sets],
        "overlaps": [{"map": path.as_posix()} for path in maps],
    }


def _render(image_set: _Images, result: DesignResult, force: bool, run: RunContext) -> list[images.Overlap]:
    # returns overlaps in the order in which they are listed; of one light there are none
    rig, folder = load_rig(result.folder / image_set.rig), result.folder / image_set.folder
    same = {name: getattr(result.options, name) for name in ("points", "shadows", "patch_budget")}
    options = RenderOptions(postures=image_set.postures, exposures=image_set.exposures, defects=False, **same)
    quiet = RunContext(threads=run.threads, warn=run.warn)
    render_image_set(rig, result.part, folder, options=options, force=force, run=quiet)
    if len(result.candidates.names) == 1:
        return []
    overlaps = images.find_overlaps(images.read_image_set(folder))
    found = {(overlap.posture, overlap.exposure): overlap for overlap in overlaps}
    overlaps = [found[shot] for shot in image_set.shots]
    for overlap in overlaps:
        name = images.overlap_map_name(overlap.posture, overlap.exposure)
        images.write_overlap_map(overlap, folder / name, overwrite=force)
    return overlaps
