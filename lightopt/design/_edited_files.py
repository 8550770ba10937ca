"""Rig and part files with new angles and postures: the user's own text, comments kept."""

from collections.abc import Sequence
from pathlib import Path

from lightopt.config import PartConfig, RigConfig, copied_text, with_list
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.design._candidates import Candidates
from lightopt.design._commands import degrees_text
from lightopt.design._previous_result import RIG_NAME
from lightopt.design._result import SetResult, angles_of
from lightopt.images import posture_folder


def check_editable(rig: RigConfig) -> None:
    """Refuse a rig whose angles cannot be changed in its file: built in code, or with anchors and aliases."""
    if not rig.source.text:
        raise InputError(
            f"{rig.source.path}: the rig was built in code, so that there is no file to write the new angles into; "
            "load it from one"
        )
    _rig_text(rig, [(light.elevation_deg, light.azimuth_deg) for light in rig.lights], rig.source.path.parent)


def rig_texts(
    rig: RigConfig, results: Sequence[SetResult], candidates: Candidates, *, folder: Path
) -> list[tuple[Path, tuple[Posture, ...], str]]:
    """File, relative to the output `folder`, postures and text of each rig to write.

    One rig where the same positions are best for all postures, else one per posture.
    """
    answered = [(result, result.answers[0]) for result in results if result.answers[0].nothing is None]
    sets = [
        (angles_of(candidates, answer.found.best), result.postures, Path(posture_folder(result.postures[0])))
        for result, answer in answered
    ]
    if sets and len(answered) == len(results) and len({angles for angles, _, _ in sets}) == 1:
        all_postures = tuple(posture for _, postures, _ in sets for posture in postures)
        sets = [(sets[0][0], all_postures, Path())]
    elif len(results) == 1:
        sets = [(angles, postures, Path()) for angles, postures, _ in sets]
    return [(home / RIG_NAME, postures, _rig_text(rig, angles, folder / home)) for angles, postures, home in sets]


def _rig_text(rig: RigConfig, angles: Sequence[tuple[float, float]], home: Path) -> str:
    values: dict[tuple[str | int, ...], str] = {}
    for index, (light, (elevation, azimuth)) in enumerate(zip(rig.lights, angles, strict=True)):
        if light.elevation_range_deg is not None:
            values["lights", index, "elevation_deg"] = degrees_text(elevation)
        if light.azimuth_range_deg is not None:
            values["lights", index, "azimuth_deg"] = degrees_text(azimuth)
    try:
        return copied_text(rig, home, values)
    except InputError as error:
        raise InputError(*(f"{rig.source.path}: {text}" for text in error.messages)) from None


def planned_part_text(part: PartConfig, postures: Sequence[Posture], *, folder: Path, comment: str) -> str:
    """Text of a part file with other postures, below a comment; the mesh is named relative to `folder`.

    Raises InputError: The part was not read from a file, or its file is written so that its postures cannot be
        replaced.
    """
    if not part.source.text:
        raise InputError(
            f"{part.source.path}: the part was built in code, so that there is no file to write the planned postures "
            "into; load it from one"
        )
    entries = [
        f"{{elevation_deg: {degrees_text(p.elevation_deg)}, rotation_deg: {degrees_text(p.rotation_deg)}}}"
        for p in postures
    ]
    try:
        text = copied_text(part, folder)
        return with_list(text, "postures", entries, comment=comment, replace=True)
    except InputError as error:
        raise InputError(*(f"{part.source.path}: {text}" for text in error.messages)) from None
