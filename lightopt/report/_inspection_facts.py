"""How an inspection was made: files, detector, limits, and what was found of the part's place and the brightness."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lightopt.config import InspectionConfig
from lightopt.core.errors import counted, percent
from lightopt.inspection import InspectionResult, Verdict
from lightopt.report._inspection_tables import placement_told
from lightopt.report._page import Facts


def inspection_facts(result: InspectionResult, verdict: Verdict, provenance: Mapping[str, Any]) -> Facts:
    """What the figures of an inspection depend on.

    Parameters
    ----------
    result, verdict
        Of one set of images.
    provenance
        From :func:`lightopt.inspection.inspection_provenance`.
    """
    inputs: Mapping[str, Any] = provenance["inputs"]
    options: Mapping[str, Any] = provenance["options"]
    seen_by: int = options["seen_by"]
    fewer = any(len(p.view.lights) < seen_by for p in result.postures)
    shows = f"a defect shows in {counted(seen_by, 'image')}"
    rows = [
        ("rig", f"{inputs['rig']['file']}, sha256 {inputs['rig']['sha256'][:16]}"),
        ("part", f"{inputs['part']['file']}, sha256 {inputs['part']['sha256'][:16]}"),
        ("detector", f"{options['detector']}, {shows}{', or in all where there are fewer' if fewer else ''}"),
        ("image without highlights", options["fusion"] or "none"),
        ("false alarms asked for", _rate(options["false_alarms"], calibrated="calibration" in inputs)),
        ("limits", _limits(verdict.limits)),
        ("calibration", inputs.get("calibration", {}).get("file", "none: by the noise of the sensor")),
    ]
    if result.placement is not None:
        place = placement_told(result.placement) or "cannot be determined; assumed as in the part file"
        rows.append(("the part lies off its place by", place))
    for posture in result.postures:
        view = posture.view
        gains = ", ".join(f"{name} ×{view.photometry.gains[name]:.4f}" for name in view.lights)
        told = f"threshold {posture.threshold:.2f}; brightness found: {gains}"
        rows.append((f"posture {view.posture}", f"{told}; dark {view.photometry.dark:+.2f} levels"))
    return Facts(rows=rows)


def _limits(limits: InspectionConfig) -> str:
    return (
        f"{counted(limits.most_defects, 'defect')} allowed; one counts from {limits.least_size_mm:g} mm and a contrast "
        f"of {percent(limits.least_contrast)} on; {percent(limits.least_inspected)} of the visible surface or more to "
        "be inspected"
    )


def _rate(rate: float, *, calibrated: bool) -> str:
    return f"in a posture, on a share of {rate:g} of good parts" if calibrated else f"{rate:g} per posture"
