"""The part file that names scattered defects: the part's own text, and a list at its end."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from pathlib import Path

from lightopt.config import PartConfig, copied_text, with_list
from lightopt.errors import InputError
from lightopt.images import write_text_atomic
from lightopt.scatter._scatter import ScatteredDefect

__all__ = ["defects_text", "write_defects"]

_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")


def defects_text(part: PartConfig, defects: Sequence[ScatteredDefect], *, folder: Path, comment: str) -> str:
    """Text of a part file with defects: the part's own, comments and all, and the list at its end.

    Parameters
    ----------
    part
        Read from a file that names no defects.
    defects
        To be named.
    folder
        That the text will lie in: the mesh is named relative to it.
    comment
        Of the list.

    Raises
    ------
    InputError
        The part names defects already, or its file is written so that nothing can be added to it.
    """
    if ("defects",) in part.source.lines:
        raise InputError(
            f"{part.source.at('defects')}: this part names defects already; take the list out, or start from the good "
            "part"
        )
    text = copied_text(part, folder)
    return with_list(text, "defects", [_entry(defect) for defect in defects], comment=comment)


def write_defects(path: Path, text: str, *, force: bool) -> None:
    """Write the part file.

    Raises
    ------
    InputError
        Something else is there, and `force` is not given; or the file cannot be written.
    """
    if path.is_dir():
        raise InputError(f"{path}: expected the name of a part file to write, found a folder")
    if path.exists() and not force and path.read_bytes() != text.encode():
        raise InputError(
            f"{path}: already there and different; use --force to replace it, or choose another name"
        )
    write_text_atomic(path, text)


def _entry(defect: ScatteredDefect) -> str:
    shape = defect.entry.shape
    name = defect.name if _PLAIN.fullmatch(defect.name) else json.dumps(defect.name, ensure_ascii=False)
    size = f"{shape.length:g}" if shape.length == shape.width else f"[{shape.length:g}, {shape.width:g}]"
    values = [
        f"name: {name}",
        f"kind: {shape.kind}",
        f"at_mm: [{', '.join(f'{x:.4f}' for x in defect.at_mm)}]",
        f"size_mm: {size}",
    ]
    if shape.slope > 0.0:
        values.append(f"slope_deg: {math.degrees(shape.slope):.6g}")
    if shape.kind == "stain":
        values.append(f"R_d_factor: {shape.R_d_factor:.6g}")
    if shape.kind == "haze":
        values.append(f"sigma_factor: {shape.sigma_factor:.6g}")
    if shape.length != shape.width:
        values.append(f"direction_deg: {defect.direction_deg:g}")
    return f"{{{', '.join(values)}}}"
