"""What an optimisation assumed: everything that its figures depend on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lightopt.core.errors import counted
from lightopt.design import DIRECTIONS, Draft, defect_hypotheses
from lightopt.rendering import GRAZING_DEG
from lightopt.report._page import Block, Facts, Table
from lightopt.scene import PanelLight, build_catalogue


def fact_blocks(draft: Draft) -> list[Block]:
    """Thresholds, sensor, reflectance, patches, options, versions and hashes; and the positions left out."""
    blocks: list[Block] = [
        Facts(rows=[*_physics(draft), *_search(draft)]),
        Facts(rows=_provenance(draft)),
    ]
    if draft.offered.left_out:
        blocks.append(
            Table(
                header=["light", "position", "left out since it"],
                rows=[
                    [out.light, f"{out.elevation_deg:g}°, {out.azimuth_deg:g}°", out.reason]
                    for out in draft.offered.left_out
                ],
                numbers_from=3,
            )
        )
    return blocks


def _physics(draft: Draft) -> list[tuple[str, str]]:
    sensor, reflectance, thresholds = draft.scene.sensor, draft.scene.reflectance, draft.thresholds
    shot = (
        "no shot noise"
        if sensor.electrons_per_level is None
        else f"{sensor.electrons_per_level:g} electrons per level"
    )
    levels = (
        f"{sensor.bit_depth} bit, black level {sensor.black_level:g}; shaded below {thresholds.shade}, saturated from "
        f"{thresholds.saturation} on; at exposure 1, without noise"
    )
    shadows: bool = draft.document["provenance"]["options"]["shadows"]
    coefficients = f"R_d {reflectance.R_d:g}, R_s {reflectance.R_s:g}, σ {reflectance.sigma:g} rad"
    return [
        ("levels", levels),
        ("sensor noise", f"read noise {sensor.read_noise_levels:g} levels, {shot}; {_use_of_noise(draft)}"),
        ("reflectance", f"{coefficients}, of full scale {reflectance.full_scale:g}; only direct light"),
        ("lights", "; ".join(dict.fromkeys(map(_light, draft.scene.lights)))),
        ("shadows", "cast by the part" if shadows else "none (--no-shadows)"),
        ("patches", draft.table.message),
        ("left out", f"what the camera sees at more than {GRAZING_DEG:g}° to the normal"),
    ]


def _use_of_noise(draft: Draft) -> str:
    if "threshold" in draft.document["provenance"]["options"]:
        return "what a defect has to be seen against, and no part of other scores"
    return "not part of the score"


def _light(light: PanelLight) -> str:
    width, height = (f"{side:g}" for side in light.size)
    points = "continuous (auto)" if light.points == "auto" else f"{light.points}, {light.normalisation}"
    falloff = "inverse square" if light.inverse_square else "none"
    return (
        f"panel of {width} × {height} mm at {light.distance:g} mm, point lights: {points}, gain {light.gain:g}, "
        f"falloff: {falloff}, emission exponent {light.emission_exponent:g}"
    )


def _search(draft: Draft) -> list[tuple[str, str]]:
    options = draft.document["provenance"]["options"]
    positions = " × ".join(str(len(angles)) for angles in draft.offered.angles)
    ties = [
        text
        for key, text in (
            ("common_elevation", "all lights at one elevation"),
            ("common_lights", "the same for all postures"),
        )
        if options[key]
    ]
    return [
        ("positions", f"{positions}, step {options['step_deg']:g}°{''.join(f', {text}' for text in ties)}"),
        ("objectives", ", ".join(options["objectives"])),
        ("defects", "none on the part: scores are of a good part"),
        *_looked_for(draft),
        *_tolerances(options),
    ]


def _looked_for(draft: Draft) -> list[tuple[str, str]]:
    options = draft.document["provenance"]["options"]
    if "threshold" not in options:
        return []
    entries = build_catalogue(draft.part)
    trials = counted(len(defect_hypotheses(entries)), "trial")
    images = counted(options["seen_in"], "image")
    visible = (
        f"where the level changes by {options['threshold']:g} times the noise or more (--threshold), in {images} or "
        "more (--seen-in)"
    )
    return [
        ("defects looked for", f"{', '.join(entry.name for entry in entries)}: {trials}"),
        ("directions of walls", f"{DIRECTIONS}, evenly around"),
        ("a defect is seen", visible),
    ]


def _tolerances(options: Mapping[str, Any]) -> list[tuple[str, str]]:
    asked = options.get("tolerances")
    if asked is None:
        return []
    text = (
        f"lights {asked['light_deg']:g}°, part {asked['pose_deg']:g}°; {counted(asked['draws'], 'draw')} of seed "
        f"{asked['seed']}; the widest keep {100.0 * asked['target']:g} % of the score"
    )
    return [("tolerances", text)]


def _provenance(draft: Draft) -> list[tuple[str, str]]:
    found = draft.document["provenance"]
    inputs = found["inputs"]
    return [
        ("rig", f"{inputs['rig']['file']}, SHA-256 {inputs['rig']['sha256']}"),
        ("part", f"{inputs['part']['file']}, SHA-256 {inputs['part']['sha256']}"),
        ("mesh", f"{draft.part.mesh.file}, SHA-256 {inputs['mesh']['sha256']}"),
        ("code", f"lightopt {found['lightopt']}, SHA-256 {found['code_sha256']}"),
        ("versions", ", ".join(f"{name} {number}" for name, number in found["versions"].items())),
    ]
