"""The files of a verification, and the table of all verifications of a rig over time."""

import csv
import json
import math
from datetime import datetime
from pathlib import Path
from typing import Any

from lightopt.config import PartConfig, RigConfig, input_hashes
from lightopt.core.errors import InputError
from lightopt.core.provenance import provenance
from lightopt.estimate.verification._parameters import VerifyLimits
from lightopt.estimate.verification._verify import Verification
from lightopt.images import ImageSet, ResultFolder, csv_text, make_folder, write_text_atomic

REPORT_NAME, HISTORY_NAME = "report.html", "history.csv"


def plan_limits(path: Path, rig: RigConfig) -> dict[str, float]:
    """Fields of :class:`VerifyLimits` from the tolerances of a plan: the narrowest of the lights, and of the part.

    path: ``result.json`` of ``lightopt optimize --light-tolerance`` or ``--pose-tolerance``
    Raises InputError: It cannot be read, has no tolerances, or one of 0
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        widest = [(str(w["what"]), str(w["angle"]), float(w["degrees"])) for w in found["tolerances"][-1]["widest"]]
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}; give result.json of a plan") from error
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise InputError(
            f"{path}: no tolerance analysis in it; expected result.json of lightopt optimize --light-tolerance or "
            "--pose-tolerance"
        ) from error
    if zero := [what for what, _, degrees in widest if degrees <= 0.0]:
        raise InputError(
            f"{path}: the plan has a tolerance of 0° for {zero[0]}, which no rig keeps; give limits instead"
        )
    distances = {light.entry_name: light.distance_mm for light in rig.lights}  # whose channels move together
    panels = [distances[what] * math.tan(math.radians(angle)) for what, _, angle in widest if what in distances]
    part = [degrees for what, _, degrees in widest if what == "part"]
    return {**({"panel_mm": min(panels)} if panels else {}), **({"part_deg": min(part)} if part else {})}


def verify_folder(
    folder: Path,
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    *,
    baseline: ImageSet | None,
    limits: VerifyLimits,
    register: bool,
    force: bool,
) -> ResultFolder:
    """Open a folder that a verification is written to.

    Raises InputError: The folder holds a verification of other inputs, and `force` is False
    """
    inputs: dict[str, Any] = {**input_hashes(rig, part), "image_sets": [image_set.fingerprint]}
    if baseline is not None:
        inputs["baseline"] = baseline.fingerprint
    made_from = provenance(inputs=inputs, options={"limits": limits.as_dict(), "register": register})
    form = "lightopt-verification/1"
    return ResultFolder(folder, made_from, name="verify.json", format=form, what="a verification", force=force)


def append_history(folder: Path, result: Verification, *, name: str, when: datetime) -> list[dict[str, str]]:
    """Add a verification as a row of ``history.csv`` in a folder, and return all rows, the oldest first.

    name: Of the set.
    Raises InputError: The folder cannot be written to, or its table is another
    """
    row: dict[str, Any] = {"time": when.isoformat(), "set": name, "within_tolerances": result.within_tolerances}
    for one in result.findings:
        fault = one.kind if one.kind == "swap" else f"{one.kind} {one.light}".strip()
        row[fault] = round(one.parts.get("", one.size), 6)
        if one.limit:
            row[f"{fault}/limit"] = round(one.size / one.limit, 4)
    for light in result.lights:
        values = light.as_dict()
        row |= {f"{light.light} {key}": values[key] for key in ("overlap", "offset_px", "offset_deg", "residual")}
    path = folder / HISTORY_NAME
    rows = _read_history(path) if path.exists() else []
    rows.append({key: "" if value is None else str(value) for key, value in row.items()})
    columns = list(dict.fromkeys(key for one in rows for key in one))
    make_folder(folder)
    write_text_atomic(path, csv_text([columns, *([one.get(column, "") for column in columns] for one in rows)]))
    return rows


def _read_history(path: Path) -> list[dict[str, str]]:
    rows = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines(), restval=""))
    try:
        numbers = [row[key] for row in rows for key in row if key not in ("time", "set", "within_tolerances")]
        _ = [float(number) for number in numbers if number], [row["time"] for row in rows]
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{path}: no table of lightopt verify, or damaged; remove it") from None
    return rows
