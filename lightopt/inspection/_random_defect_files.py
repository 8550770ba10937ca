"""The part file that lists random defects: the part's own text with a list at its end."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lightopt.config import PartConfig, RigConfig, copied_text, input_hashes, with_list
from lightopt.core.errors import InputError
from lightopt.core.provenance import differences, provenance
from lightopt.images import write_text_atomic
from lightopt.inspection._random_defects import RandomDefect

_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
_PROVENANCE = "provenance: "


def random_defect_provenance(rig: RigConfig, part: PartConfig, *, count: int, seed: int) -> dict[str, Any]:
    """What random defects depend on, in the layout of :mod:`lightopt.core.provenance`."""
    return provenance(input_hashes(rig, part), {"seed": seed, "count": count})


def random_defects_text(
    part: PartConfig,
    defects: Sequence[RandomDefect],
    *,
    folder: Path,
    comment: str,
    made_from: Mapping[str, Any],
) -> str:
    """Text of a part file with defects: the part's own, comments and all, and the list at its end.

    part: Read from a file that names no defects.
    folder: That the text will lie in: the mesh is named relative to it.
    comment: Of the list.
    made_from: From :func:`random_defect_provenance`: a second line of comment, as JSON.

    Raises InputError: the part names defects already, or its file is written so that nothing can be added to it.
    """
    if ("defects",) in part.source.lines:
        raise InputError(
            f"{part.source.at('defects')}: this part names defects already; take the list out, or start from the good "
            "part"
        )
    text = copied_text(part, folder)
    comment = f"{comment}\n{_PROVENANCE}{json.dumps(made_from, ensure_ascii=False)}"
    return with_list(text, "defects", [_entry(defect) for defect in defects], comment=comment)


def write_random_defects(path: Path, text: str, *, force: bool) -> None:
    """Write the part file.

    Raises InputError: something else is there, and `force` is not given; or the file cannot be written.
    """
    if path.is_dir():
        raise InputError(f"{path}: expected the name of a part file to write, found a folder")
    if path.exists() and not force and path.read_bytes() != text.encode():
        changed = differences(_provenance(path.read_text("utf-8", errors="replace")), _provenance(text))
        raise InputError(
            f"{path}: already there and different{f' ({changed})' if changed else ''}; use --force to replace it, or "
            "choose another name"
        )
    write_text_atomic(path, text)


def _provenance(text: str) -> dict[str, Any]:
    # of the defects of a part file; empty where it has none
    line = re.search(rf"^# {_PROVENANCE}(.*)$", text, re.MULTILINE)
    try:
        found = json.loads(line[1]) if line else {}
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _entry(defect: RandomDefect) -> str:
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
