"""Tables of lights, CSV: one row per photograph, with its light, where that stood, exposure and posture."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture

_DIRECTION, _POSITION = ("x", "y", "z"), ("x_mm", "y_mm", "z_mm")
_COLUMNS = ("image", "light", *_DIRECTION, *_POSITION, "exposure", "intensity", "posture")
_SAME = {"file": "image", "filename": "image", "name": "light", "gain": "intensity"}
_UNIT_TOLERANCE = 0.05  # a direction whose length is further off 1 is suspected to be a position
_LEAST = 1e-9  # exposure or intensity


@dataclass(frozen=True)
class TableRow:
    """One photograph.

    where: File and line, for messages
    place: Unit vector to a distant light or, if `near`, where it stands [mm]; shape (3,), frame of the table
    intensity: Brightness of the light, relative to the others
    """

    where: str
    image: str
    light: str
    place: Float64
    near: bool
    exposure: float
    intensity: float
    posture: Posture


def read_light_table(path: Path) -> tuple[TableRow, ...]:
    """Rows of a table of lights.

    Raises InputError: With one message per problem: columns, cells, a light that stands in two places, an image that is
        listed twice
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}; expected a table of lights") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not text in UTF-8; expected a table of lights as CSV") from None
    header = text.partition("\n")[0]
    reader = csv.DictReader(text.splitlines(), delimiter=max(",;\t", key=header.count), skipinitialspace=True)
    names = [name.strip().lower() for name in reader.fieldnames or ()]
    reader.fieldnames = names = [_SAME.get(name, name) for name in names]
    problems = [
        f'{path}:1: unknown column "{name}"; expected some of {", ".join(_COLUMNS)}'
        for name in names
        if name not in _COLUMNS
    ]
    if not set(names) >= {"image", "light"} or not (set(names) >= set(_DIRECTION) or set(names) >= set(_POSITION)):
        problems.append(
            f"{path}:1: expected the columns image, light and x, y, z (direction to the light) or x_mm, y_mm, z_mm "
            f"(position), found {', '.join(names) or 'nothing'}"
        )
    if problems:
        raise InputError(*problems)
    rows: list[TableRow] = []
    for cells in reader:
        row = _row(f"{path}:{reader.line_num}", cells, problems)
        if row is not None:
            rows.append(row)
    problems += _contradictions(rows)
    if not rows and not problems:
        problems.append(f"{path}: expected a row per photograph, found none")
    if problems:
        raise InputError(*problems)
    return tuple(rows)


def _row(where: str, cells: Mapping[str, str | None], problems: list[str]) -> TableRow | None:
    before = len(problems)

    def cell(name: str) -> str:
        return (cells.get(name) or "").strip()

    def read(name: str, default: float, expected: str, least: float = -math.inf) -> float:
        try:
            value = float(Fraction(cell(name))) if "/" in cell(name) else float(cell(name) or default)
        except (ValueError, ZeroDivisionError):
            value = math.nan
        if not (math.isfinite(value) and value >= least):
            problems.append(f'{where}: column {name}: expected {expected}, found "{cell(name)}"')
        return value

    image, light = cell("image"), cell("light")
    if None in cells or any(value is None for value in cells.values()):
        problems.append(f"{where}: expected as many cells as the header has")
    if not image:
        problems.append(f'{where}: light "{light}" without an image; give its file in column image, or remove the row')
    if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,63}", light):
        problems.append(f'{where}: column light: expected a name of letters, digits and . _ -, found "{light}"')
    given = [names for names in (_DIRECTION, _POSITION) if any(cell(name) for name in names)]
    if len(given) != 1:
        found = "both" if given else "neither: an image without light"
        problems.append(f"{where}: expected a direction (x, y, z) or a position (x_mm, y_mm, z_mm), found {found}")
    place = np.array([read(name, math.nan, "a number") for name in (given or [()])[0]])
    length = float(np.linalg.norm(place))
    near = given == [_POSITION]
    if given and not near and abs(length - 1.0) > _UNIT_TOLERANCE:
        problems.append(
            f"{where}: expected a direction of length 1, found {length:.4g}; positions in mm belong in x_mm, y_mm, z_mm"
        )
    exposure = read("exposure", 1.0, "a number or a fraction above 0, such as 1/16", _LEAST)
    intensity = read("intensity", 1.0, "a number above 0", _LEAST)
    angles = re.split(r"[,;\s]+", cell("posture") or "0,0")
    try:
        tilt, rotation = (float(angle) for angle in angles)
    except ValueError:
        tilt = rotation = 0.0
        problems.append(
            f'{where}: column posture: expected tilt and rotation in degrees, such as "0,82", found {angles}'
        )
    if len(problems) > before:
        return None
    return TableRow(
        where=where,
        image=image,
        light=light,
        place=place if near else place / length,
        near=near,
        exposure=exposure,
        intensity=intensity,
        posture=Posture(tilt, rotation),
    )


def _contradictions(rows: list[TableRow]) -> list[str]:
    problems: list[str] = []
    lights: dict[str, TableRow] = {}
    images: dict[object, TableRow] = {}
    for row in rows:
        first = lights.setdefault(row.light.lower(), row)
        if (first.light, first.near, first.intensity) != (row.light, row.near, row.intensity) or not np.allclose(
            first.place, row.place, rtol=0.0, atol=1e-6
        ):
            problems.append(
                f'{row.where}: light "{row.light}" has another place, intensity or spelling than in {first.where}; '
                "rename one of them"
            )
        for key in (row.image, (row.light, row.posture, row.exposure)):
            if (before := images.setdefault(key, row)) is not row:
                what = row.image if key == row.image else f"{row.light} {row.posture}, exposure {row.exposure:g},"
                problems.append(f"{row.where}: {what} is already in {before.where}; expected each once")
    return problems
