"""The files of a verification, and the table of all verifications of a rig over time."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from lightopt.config import PartConfig, RigConfig, input_hashes
from lightopt.core.errors import InputError
from lightopt.core.provenance import provenance
from lightopt.estimate.verification._limits import VerifyLimits
from lightopt.estimate.verification._verify import Verification
from lightopt.images import ImageSet, ResultFolder, make_folder, write_text_atomic

VERIFY_NAME, REPORT_NAME = "verify.json", "report.html"
RUN_FORMAT = "lightopt-verification-run/1"


def verify_provenance(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    *,
    baseline: ImageSet | None,
    limits: VerifyLimits,
    register: bool,
) -> dict[str, Any]:
    """What a verification depends on, in the layout of :mod:`lightopt.core.provenance`."""
    inputs: dict[str, Any] = {**input_hashes(rig, part), "image_sets": [image_set.fingerprint]}
    if baseline is not None:
        inputs["baseline"] = baseline.fingerprint
    return provenance(inputs=inputs, options={"limits": limits.as_dict(), "register": register})


class VerifyFolder(ResultFolder):
    """A folder that a verification is written to.

    made_from: From :func:`verify_provenance`.
    Raises InputError: the folder holds a verification of other inputs, and `force` is False.
    """

    def __init__(self, folder: Path, made_from: Mapping[str, Any], *, force: bool) -> None:
        super().__init__(
            folder, made_from, name=VERIFY_NAME, format="lightopt-verification/1", what="a verification", force=force
        )


@dataclass(frozen=True)
class History:
    """Verifications of a rig, the oldest first.

    columns: Names of the values; rows: A value for each column and run, None where a run has none.
    shares: By column, size over limit of each run; only of faults that have a limit.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]
    shares: dict[str, tuple[float, ...]]

    def csv(self) -> str:
        """The table as CSV."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([self.columns, *self.rows])
        return text.getvalue()


def append_history(folder: Path, result: Verification, *, name: str, when: datetime) -> History:
    """Add a verification to those in a folder, and write the table of all of them, ``history.csv``.

    name: Of the set.
    Raises InputError: the folder cannot be written to, or a file in it is no verification.
    """
    make_folder(folder)
    stamp = when.strftime("%Y%m%dT%H%M%S.%fZ")
    content = {"format": RUN_FORMAT, "time": when.isoformat(), "set": name, **result.as_dict()}
    path = folder / f"run-{stamp}.json"
    write_text_atomic(path, json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    history = read_history(folder)
    write_text_atomic(folder / "history.csv", history.csv())
    return history


def read_history(folder: Path) -> History:
    """All verifications in a folder.

    Raises InputError: a file is no verification.
    """
    runs = [_read_run(path) for path in sorted(folder.glob("run-*.json"))]
    lights = list(dict.fromkeys(light["light"] for run in runs for light in run["lights"]))
    faults = sorted({key for run in runs for key in _sizes(run)})
    of_lights = ("overlap", "offset_px", "offset_deg", "residual")
    columns = [
        "time",
        "set",
        "within_tolerances",
        *faults,
        *(f"{light} {key}" for light in lights for key in of_lights),
    ]
    rows: list[tuple[Any, ...]] = []
    for run in runs:
        sizes, by_light = _sizes(run), {light["light"]: light for light in run["lights"]}
        values = [by_light.get(light, {}).get(key) for light in lights for key in of_lights]
        rows.append(
            (
                run["time"],
                run["set"],
                run["within_tolerances"],
                *(sizes.get(key, (0.0, None))[0] for key in faults),
                *values,
            )
        )
    limits = {key: limit for run in runs for key, (_, limit) in _sizes(run).items() if limit}
    shares = {
        key: tuple(abs(_sizes(run).get(key, (0.0, None))[0]) / limit for run in runs) for key, limit in limits.items()
    }
    return History(tuple(columns), tuple(rows), shares)


def _read_run(path: Path) -> dict[str, Any]:
    try:
        run: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if run["format"] != RUN_FORMAT:
            raise ValueError
        _sizes(run)
        for key in ("time", "set", "within_tolerances", "lights"):
            run[key]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path}: no run of lightopt verify, or damaged; expected JSON of format {RUN_FORMAT}; remove it"
        ) from error
    return run


def _sizes(run: Mapping[str, Any]) -> dict[str, tuple[float, float | None]]:
    # by fault: its size, signed where it is one number, and its limit
    found: dict[str, tuple[float, float | None]] = {}
    findings: Sequence[Mapping[str, Any]] = run["findings"]
    for finding in findings:
        light = "" if finding["kind"] == "swap" else finding["light"]
        key = f"{finding['kind']} {light}".strip()
        found[key] = float(finding["components"].get("value", finding["size"])), finding["limit"]
    return found
