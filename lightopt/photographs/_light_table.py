"""Tables of lights, CSV: one row per photograph, with its light, where that stood, exposure and posture."""

import csv
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError, refuse
from lightopt.core.transforms import Posture

_DIRECTION, _POSITION = ("x", "y", "z"), ("x_mm", "y_mm", "z_mm")
_DEFAULTS = {"exposure": 1.0, "intensity": 1.0, "tilt_deg": 0.0, "rotation_deg": 0.0}
_COLUMNS = ("image", "light", *_DIRECTION, *_POSITION, *_DEFAULTS)
_UNIT_TOLERANCE = 0.05  # a direction whose length is further off 1 is suspected to be a position


@dataclass(frozen=True)
class TableRow:
    """One photograph."""

    where: str  # file and line, for messages
    image: str
    light: str
    place: Float64  # unit vector to a distant light or, if `near`, where it stands [mm]; shape (3,)
    near: bool
    exposure: float
    intensity: float  # brightness of the light, relative to the others
    posture: Posture


def read_light_table(path: Path) -> tuple[TableRow, ...]:
    """Rows of a table of lights.

    Raises InputError: With one message per problem: columns, cells, a light that stands in two places, an image that is
        listed twice
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}; expected a table of lights, CSV in UTF-8") from None
    header = text.partition("\n")[0]
    reader = csv.DictReader(text.splitlines(), delimiter=max(",;\t", key=header.count), skipinitialspace=True)
    names = {name.strip() for name in reader.fieldnames or ()}
    if names - {*_COLUMNS} or not names >= {"image", "light"} or not (names >= {*_DIRECTION} or names >= {*_POSITION}):
        raise InputError(
            f"{path}:1: expected the columns image, light and x, y, z (direction to the light) or x_mm, y_mm, z_mm "
            f"(position), and perhaps {', '.join(_DEFAULTS)}, found {', '.join(reader.fieldnames or ()) or 'nothing'}"
        )
    problems: list[str] = []
    rows: list[TableRow] = []
    for cells in reader:
        where = f"{path}:{reader.line_num}"
        if None in cells or None in cells.values():
            problems.append(f"{where}: expected as many cells as the header has")
            continue
        try:
            rows.append(_row(where, {name.strip(): cell.strip() for name, cell in cells.items()}))
        except InputError as error:
            problems += error.messages
    problems += _contradictions(rows)
    if not rows and not problems:
        problems.append(f"{path}: expected a row per photograph, found none")
    refuse(problems)
    return tuple(rows)


def _row(where: str, cells: Mapping[str, str]) -> TableRow:
    problems: list[str] = []

    def number(name: str) -> float:
        try:
            value = float(cells.get(name) or _DEFAULTS.get(name, math.nan))
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or (name in ("exposure", "intensity") and value <= 0.0):
            above = " above 0" if name in ("exposure", "intensity") else ""
            problems.append(f'{where}: column {name}: expected a number{above}, found "{cells.get(name)}"')
        return value

    light = cells["light"]
    if not cells["image"]:
        problems.append(f'{where}: light "{light}" without an image; give its file in column image, or remove the row')
    if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,63}", light):
        problems.append(f'{where}: column light: expected a name of letters, digits and . _ -, found "{light}"')
    near, distant = (any(cells.get(name) for name in names) for names in (_POSITION, _DIRECTION))
    place = np.zeros(3)
    if near == distant:
        found = "both" if near else "neither: an image without light"
        problems.append(f"{where}: expected a direction (x, y, z) or a position (x_mm, y_mm, z_mm), found {found}")
    else:
        place = np.array([number(name) for name in (_POSITION if near else _DIRECTION)])
    length = float(np.linalg.norm(place))
    if distant and abs(length - 1.0) > _UNIT_TOLERANCE:
        problems.append(
            f"{where}: expected a direction of length 1, found {length:.4g}; positions in mm belong in x_mm, y_mm, z_mm"
        )
    exposure, intensity, tilt, rotation = (number(name) for name in _DEFAULTS)
    refuse(problems)
    place = place if near else place / length
    return TableRow(where, cells["image"], light, place, near, exposure, intensity, Posture(tilt, rotation))


def _contradictions(rows: list[TableRow]) -> list[str]:
    problems: list[str] = []
    seen: dict[object, TableRow] = {}
    for row in rows:
        first = seen.setdefault(("light", row.light.lower()), row)
        same = (first.light, first.near, first.intensity) == (row.light, row.near, row.intensity)
        if not same or not np.allclose(first.place, row.place, rtol=0.0, atol=1e-6):
            problems.append(
                f'{row.where}: light "{row.light}" has another place, intensity or spelling than in {first.where}; '
                "rename one of them"
            )
        for key in (row.image, (row.light, row.posture, row.exposure)):
            if (before := seen.setdefault(key, row)) is not row:
                what = row.image if key == row.image else f"{row.light} {row.posture}, exposure {row.exposure:g},"
                problems.append(f"{row.where}: {what} is already in {before.where}; expected each once")
    return problems
