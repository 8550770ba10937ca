"""The part file with the planned postures: the part's own text, comments and all."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from lightopt.config import PartConfig, copied_text, with_list
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.design._rig_file import degrees_text

PLANNED_PART_NAME = "part.planned.yaml"


def planned_text(part: PartConfig, postures: Sequence[Posture], *, folder: Path, comment: str) -> str:
    """Text of a part file with other postures in the place of its own.

    Parameters
    ----------
    part
        Read from a file.
    postures
        In the order in which they stand.
    folder
        That the text will lie in: the mesh is named relative to it.
    comment
        To stand above the postures.

    Raises
    ------
    InputError
        The part was not read from a file, or its file is written so that its postures cannot be replaced.
    """
    if not part.source.text:
        raise InputError(
            f"{part.source.path}: the part was built in code, so that there is no file to write the planned postures "
            "into; load it from one"
        )
    try:
        text = copied_text(part, folder)
        return with_list(
            text,
            "postures",
            [
                f"{{elevation_deg: {degrees_text(p.elevation_deg)}, rotation_deg: {degrees_text(p.rotation_deg)}}}"
                for p in postures
            ],
            comment=comment,
            replace=True,
        )
    except InputError as error:
        raise InputError(*(f"{part.source.path}: {text}" for text in error.messages)) from None
