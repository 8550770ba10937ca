"""Warnings of an inspection: what was missing, unknown or not judged."""

from __future__ import annotations

from collections.abc import Sequence

from lightopt.config import RigConfig
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import DARK_SPREAD
from lightopt.inspection._options import InspectOptions
from lightopt.inspection._results import InspectedPosture

MOST_DARK_SHARE = 0.01
"""A black level that is further off than this share of the sensor's range is reported."""


def inspection_warnings(
    rig: RigConfig,
    postures: Sequence[InspectedPosture],
    options: InspectOptions,
    *,
    expected: Sequence[Posture] = (),
    registration: Sequence[str] = (),
    calibrated: bool = False,
) -> tuple[str, ...]:
    """Warnings of an inspection; `expected` are the postures that there should be images of."""
    there = {p.view.posture for p in postures}
    return (
        *_of_options(rig, options, calibrated=calibrated),
        *registration,
        *(warning for p in postures for warning in _of_posture(rig, p, options)),
        *(
            f"posture {posture}: no images; what only it shows was not inspected"
            for posture in expected
            if posture not in there
        ),
    )


def _of_options(rig: RigConfig, options: InspectOptions, *, calibrated: bool) -> list[str]:
    warnings: list[str] = []
    sensor = rig.camera.sensor
    if options.detector == "template" and not calibrated:
        warnings.append(
            "--detector template: its rate of false alarms is that of an image of even texture; on this part it is "
            "known only with --calibration"
        )
    if not calibrated and sensor.read_noise_levels == 0.0 and not sensor.electrons_per_level:
        warnings.append(
            f"{rig.source.at('camera', 'sensor')}: no read_noise_levels and no electrons_per_level, so that rounding "
            "is all the noise there is; good parts may show regions; give what the sensor has"
        )
    return warnings


def _of_posture(rig: RigConfig, inspected: InspectedPosture, options: InspectOptions) -> list[str]:
    view, warnings = inspected.view, list[str]()
    sensor, dark = rig.camera.sensor, view.photometry.dark
    if abs(dark) > max(DARK_SPREAD, MOST_DARK_SHARE * 2**sensor.bit_depth):
        side = "above" if dark > 0.0 else "below"
        warnings.append(
            f"posture {view.posture}: black is {abs(dark):.3g} sensor levels {side} the rig's black_level of "
            f"{sensor.black_level:g}; judged with that taken out; correct the rig file, or keep other light off "
            "the part"
        )
    missing = [light.name for light in rig.lights if light.name not in view.lights]
    if missing:
        warnings.append(f"posture {view.posture}: no image under {', '.join(missing)}; judged without")
    if len(view.lights) < options.seen_by:
        warnings.append(
            f"posture {view.posture}: fewer images than the {options.seen_by} that a defect must show in; what "
            "shows in all there are counts"
        )
    if not view.clean.any():
        warnings.append(
            f"posture {view.posture}: no pixel shows the part off its edges; nothing was inspected"
        )
    elif inspected.coverage.inspected == 0.0:
        warnings.append(
            f"posture {view.posture}: no pixel is reached by light and unsaturated in any image; nothing "
            "was inspected"
        )
    return warnings
