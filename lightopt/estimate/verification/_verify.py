"""Verify a rig: from rig, part and images to the faults that explain what the images show instead of the prediction.

Also the files of a verification, and the table of all verifications of a rig over time.
"""

import csv
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lightopt.config import PartConfig, RigConfig, input_hashes
from lightopt.core.arrays import Float32, Float64
from lightopt.core.errors import InputError, refuse
from lightopt.core.provenance import provenance
from lightopt.core.run_context import RunContext
from lightopt.core.threads import in_threads
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import Observation, observed_postures, read_observations
from lightopt.estimate.verification import _comparison, _findings
from lightopt.estimate.verification._comparison import LightComparison
from lightopt.estimate.verification._findings import Finding
from lightopt.estimate.verification._fit import FitOptions, alternatives, fit_faults
from lightopt.estimate.verification._parameters import Parameters, VerifyLimits, Work, calibrated_deviations
from lightopt.images import ImageSet, ResultFolder, csv_text, make_folder, write_text_atomic
from lightopt.scene import Scene, at_rest_warnings, build_scene

_MANY_SPOTS = (
    "the images differ from the prediction in more places than dust explains: check that the part file's mesh and "
    "reflectance are those of the part, or give a known good set (option 'baseline')"
)


@dataclass(frozen=True, eq=False, kw_only=True)
class Verification:
    """How captured images differ from those predicted, and why."""

    findings: tuple[Finding, ...]  # those that exceed their limits first
    lights: tuple[LightComparison, ...]  # predicted against captured
    unseen: tuple[str, ...]  # faults that these images would not show at their limits, in words
    warnings: tuple[str, ...]
    limits: VerifyLimits
    registered: bool  # whether the part was searched for
    # by posture, light and exposure, measured minus predicted in standard deviations of noise and of what a model is
    # off, without and with the faults in the prediction, shape (2, h, w)
    differences: Mapping[tuple[Posture, str, float], Float32]

    @property
    def within_tolerances(self) -> bool:
        return not any(finding.exceeds for finding in self.findings)

    @property
    def answer(self) -> str:
        beyond = [f"{f.cause}: {f.amount}" for f in self.findings if f.exceeds]
        if beyond:
            return f"the rig has left its tolerances: {'; '.join(beyond)}"
        return "the rig is within its tolerances"

    def as_dict(self) -> dict[str, Any]:
        return {
            "within_tolerances": self.within_tolerances,
            "answer": self.answer,
            "findings": [finding.as_dict() for finding in self.findings],
            "lights": [light.as_dict() for light in self.lights],
            "not_observable": list(self.unseen),
            "registered": self.registered,
            "warnings": list(self.warnings),
        }


def verify_set(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    *,
    baseline: ImageSet | None = None,
    limits: VerifyLimits | None = None,
    register: bool = True,
    run: RunContext | None = None,
) -> Verification:
    """Compare a set of images with what rig and part files predict, and name the causes of what differs.

    baseline: A known good set of the same part, postures, lights and exposures: changes since then are reported, and
        what the model is off does not count.
    limits: Within which the rig is in tolerance.
    register: Whether the part is searched for where it does not lie near its nominal placement.
    Raises InputError: images that are not the rig's or not the part's.
    """
    run = run or RunContext()
    used = {entry.light for entry in image_set.images}
    names = tuple(light.name for light in rig.lights if light.name in used)
    observations = read_observations(image_set, rig, part, threads=run.threads)
    scene = build_scene(rig, part, postures=observed_postures(image_set), lights=names, defects=False)
    moves = at_rest_warnings(scene, max(entry.exposure for entry in image_set.images))
    refuse(f"{image_set.folder}: {text}, and the blur would count as faults; take the set at rest" for text in moves)
    good = None if baseline is None else read_observations(baseline, rig, part, threads=run.threads)
    limits = limits or VerifyLimits()
    deviations = calibrated_deviations(rig, scene, Parameters.of(scene, limits))
    how: dict[str, Any] = {"baseline": good, "limits": limits, "register": register, "where": str(image_set.folder)}
    return verify_observations(scene, observations, deviations=deviations, run=run, **how)


def verify_observations(
    scene: Scene,
    observations: Sequence[Observation],
    *,
    baseline: Sequence[Observation] | None = None,
    deviations: Float64 | None = None,
    limits: VerifyLimits | None = None,
    register: bool = True,
    where: str = "images",
    run: RunContext | None = None,
) -> Verification:
    """As :func:`verify_set`, of images that are read, and the scene with their postures and lights.

    deviations: By which the rig may differ from its file, of one standard deviation each, as columns of `Parameters`.
    where: The set, for messages.
    """
    limits = limits or VerifyLimits()
    work = Work(scene, Parameters.of(scene, limits), run or RunContext())
    good = None
    deviations = np.zeros((work.parameters.size, 0)) if deviations is None else deviations
    how: dict[str, Any] = {"options": FitOptions(deviations=deviations), "register": register}
    if baseline is not None:
        known = work.blocks(_matching(observations, baseline))
        good = fit_faults(work, known, where="the known good set", **how)
    images = work.blocks(observations)
    exchanged = _comparison.exchanged_lights(work.coarse, images, work.predict(np.zeros(work.parameters.size)))
    fit = fit_faults(work, _comparison.renamed(images, exchanged), good, where=where, **how)

    p, theta = work.parameters, fit.theta
    origin = np.zeros(p.size) if good is None else good.theta
    # the rig file with the part where it was found
    plain = origin.copy()
    for kind in ("part_shift", "part_turn"):
        plain[p.group(kind).where] = theta[p.group(kind).where]
    predictions = work.predict(plain)
    compare = partial(_comparison.compare_image, work, fit, good)
    # rendered before threads need them
    found = fit.predictions
    if good is not None:
        _ = good.predictions
    numbers, threads = range(len(images)), work.run.threads
    before = in_threads(lambda number: compare(number, plain, predictions), numbers, threads)
    after = in_threads(lambda number: compare(number, theta, found), numbers, threads)
    spots, many = _comparison.find_spots(work, fit, after)
    blur = p.nuisance[-1]
    blur_error = float(np.sqrt(fit.covariance[blur, blur]))
    own, known_good = ([i.source for i in one.images] if one else () for one in (fit, good))
    findings = [
        *_findings.swap_findings(exchanged),
        *(
            _findings.group_finding(group, fit.faults, fit.covariance, alternatives(fit.evidence, fit.chosen, group))
            for group in fit.chosen
        ),
        *_findings.dark_findings(own, known_good, limits.black),
        *_findings.focus_findings(float(fit.faults[blur]), blur_error, limits.blur_px),
        *_findings.spot_findings(spots, work.side),
    ]
    hidden = [group for group in p.groups if group not in fit.chosen and not fit.evidence.visible(group)]
    unseen = [_findings.fault_name(group.kind, group.light) for group in hidden]
    return Verification(
        findings=tuple(sorted(findings, key=lambda f: not f.exceeds)),
        lights=_comparison.compare_lights(work, before, after, predictions),
        unseen=(*unseen, *(("focus",) if _findings.SURE * blur_error > limits.blur_px**2 else ())),
        warnings=(_MANY_SPOTS,) if many else (),
        limits=limits,
        registered=fit.registered,
        differences={
            (o.posture, o.light, o.exposure): np.stack([b.deviation, a.deviation])
            for o, b, a in zip(own, before, after, strict=True)
        },
    )


def _matching(observations: Sequence[Observation], good: Sequence[Observation]) -> tuple[Observation, ...]:
    # the images of a known good set in the order of the others
    by_key = {(o.light, o.posture, round(o.exposure, 6)): o for o in good}
    found = [by_key.get((o.light, o.posture, round(o.exposure, 6))) for o in observations]
    missing = [o.name for o, other in zip(observations, found, strict=True) if other is None]
    if missing:
        more = f" (and {len(missing) - 1} more)" if len(missing) > 1 else ""
        raise InputError(f"{good[0].source.parent}: the known good set has no image {missing[0]}{more}; capture it")
    return tuple(one for one in found if one is not None)


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
            f"{path}: no tolerance analysis in it; expected result.json of lightopt optimize "
            "--light-tolerance or --pose-tolerance"
        ) from error
    if zero := [what for what, _, degrees in widest if degrees <= 0.0]:
        raise InputError(f"{path}: the plan has a tolerance of 0° for {zero[0]}; give limits instead")
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
    made_from = provenance(inputs=inputs, options={"limits": vars(limits), "register": register})
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
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    rows = list(csv.DictReader(text.splitlines(), restval=""))
    try:
        numbers = [one[key] for one in rows for key in one if key not in ("time", "set", "within_tolerances")]
        _ = [float(number) for number in numbers if number], [one["time"] for one in rows]
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{path}: no table of lightopt verify, or damaged; remove it") from None
    rows.append({key: "" if value is None else str(value) for key, value in row.items()})
    columns = list(dict.fromkeys(key for one in rows for key in one))
    make_folder(folder)
    write_text_atomic(path, csv_text([columns, *([one.get(column, "") for column in columns] for one in rows)]))
    return rows
