"""The report of ``lightopt optimize``: the answer first, then what it is based on, last what all figures depend on."""

from collections.abc import Mapping
from typing import Any

from lightopt.core.errors import counted
from lightopt.design import DIRECTIONS, DesignOutput, defect_hypotheses
from lightopt.rendering import GRAZING_DEG
from lightopt.report._design_answer import answer_blocks, scores_table
from lightopt.report._design_pictures import curve_blocks, drawing_blocks, image_blocks
from lightopt.report._design_plan import blind_tables, defect_blocks, exposure_blocks, posture_blocks, tolerance_blocks
from lightopt.report._design_surface import surface_blocks
from lightopt.report._page import Block, Facts, Page, Section, Table
from lightopt.report._page_html import page_html
from lightopt.scene import PanelLight, build_catalogue


def design_report(output: DesignOutput) -> str:
    """The report of an optimisation as HTML; for :func:`lightopt.design.finish_design`."""
    return page_html(design_page(output))


def design_page(output: DesignOutput) -> Page:
    """The report of an optimisation as plain values."""
    sections = [
        Section(heading="What the images show", blocks=surface_blocks(output)),
        Section(heading="Blind spots", blocks=blind_tables(output)),
        Section(heading="Defects", blocks=defect_blocks(output)),
        Section(heading="Postures", blocks=posture_blocks(output)),
        Section(heading="Exposures", blocks=exposure_blocks(output)),
        Section(heading="Images of the best set", blocks=image_blocks(output)),
        Section(heading="Where the lights stand", blocks=drawing_blocks(output)),
        Section(heading="How flat the top is", blocks=curve_blocks(output)),
        Section(heading="How exact the angles must be", blocks=tolerance_blocks(output)),
        Section(heading="Scores", blocks=[scores_table(output)]),
        Section(heading="What was assumed", blocks=fact_blocks(output)),
    ]
    rig, part = output.result.rig, output.result.part
    return Page(
        title=f"Where the lights go: {part.name}",
        subtitle=f"{part.name} on {rig.name}, lightopt {output.document['provenance']['lightopt']}",
        lead=answer_blocks(output),
        sections=[section for section in sections if section.blocks],
    )


def fact_blocks(output: DesignOutput) -> list[Block]:
    """LevelThresholds, sensor, reflectance, patches, options, versions and hashes; and the positions left out."""
    blocks: list[Block] = [Facts(rows=[*_physics(output), *_search(output)]), Facts(rows=_provenance(output))]
    if output.result.all_candidates.left_out:
        blocks.append(
            Table(
                header=["light", "position", "left out since it"],
                rows=[
                    [out.light, f"{out.elevation_deg:g}°, {out.azimuth_deg:g}°", out.reason]
                    for out in output.result.all_candidates.left_out
                ],
                numbers_from=3,
            )
        )
    return blocks


def _physics(output: DesignOutput) -> list[tuple[str, str]]:
    scene, thresholds = output.result.scene, output.result.thresholds
    sensor, reflectance = scene.sensor, scene.reflectance
    shot = (
        "no shot noise" if sensor.electrons_per_level is None else f"{sensor.electrons_per_level:g} electrons per level"
    )
    levels = (
        f"{sensor.bit_depth} bit, black level {sensor.black_level:g}; shaded below {thresholds.shade}, saturated from "
        f"{thresholds.saturation} on; at exposure 1, without noise"
    )
    shadows: bool = output.document["provenance"]["options"]["shadows"]
    coefficients = f"R_d {reflectance.R_d:g}, R_s {reflectance.R_s:g}, σ {reflectance.sigma:g} rad"
    return [
        ("levels", levels),
        ("sensor noise", f"read noise {sensor.read_noise_levels:g} levels, {shot}; {_use_of_noise(output)}"),
        ("reflectance", f"{coefficients}, of full scale {reflectance.full_scale:g}; only direct light"),
        ("lights", "; ".join(dict.fromkeys(map(_light, scene.lights)))),
        ("shadows", "cast by the part" if shadows else "none"),
        ("patches", output.patches.message),
        ("left out", f"what the camera sees at more than {GRAZING_DEG:g}° to the normal"),
    ]


def _use_of_noise(output: DesignOutput) -> str:
    if "threshold" in output.document["provenance"]["options"]:
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


def _search(output: DesignOutput) -> list[tuple[str, str]]:
    options = output.document["provenance"]["options"]
    positions = " × ".join(str(len(angles)) for angles in output.result.all_candidates.angles)
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
        *_defects(output),
        *_tolerances(options),
    ]


def _defects(output: DesignOutput) -> list[tuple[str, str]]:
    options = output.document["provenance"]["options"]
    if "threshold" not in options:
        return []
    entries = build_catalogue(output.result.part)
    trials = counted(len(defect_hypotheses(entries)), "trial")
    images = counted(options["min_images"], "image")
    visible = f"where the level changes by {options['threshold']:g} times the noise or more, in {images} or more"
    return [
        ("defects looked for", f"{', '.join(entry.name for entry in entries)}: {trials}"),
        ("directions of walls", f"{DIRECTIONS}, evenly around"),
        ("a defect is seen", visible),
    ]


def _tolerances(options: Mapping[str, Any]) -> list[tuple[str, str]]:
    tolerances = options.get("tolerances")
    if tolerances is None:
        return []
    text = (
        f"lights {tolerances['light_deg']:g}°, part {tolerances['pose_deg']:g}°; "
        f"{counted(tolerances['draws'], 'draw')} of seed {tolerances['seed']}; the widest keep "
        f"{100.0 * tolerances['target']:g} % of the score"
    )
    return [("tolerances", text)]


def _provenance(output: DesignOutput) -> list[tuple[str, str]]:
    found = output.document["provenance"]
    inputs = found["inputs"]
    return [
        ("rig", f"{inputs['rig']['file']}, SHA-256 {inputs['rig']['sha256']}"),
        ("part", f"{inputs['part']['file']}, SHA-256 {inputs['part']['sha256']}"),
        ("mesh", f"{output.result.part.mesh.file}, SHA-256 {inputs['mesh']['sha256']}"),
        ("code", f"lightopt {found['lightopt']}, SHA-256 {found['code_sha256']}"),
        ("versions", ", ".join(f"{name} {number}" for name, number in found["versions"].items())),
    ]
