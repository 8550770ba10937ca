"""The report of ``lightopt optimize``: the answer first, then what it is based on, last what all figures depend on."""

from collections.abc import Mapping
from typing import Any

from lightopt import design
from lightopt.core.errors import counted
from lightopt.core.transforms import Posture
from lightopt.lights import PanelLight
from lightopt.optics import Reflectance
from lightopt.rendering import GRAZING_DEG
from lightopt.report._page import Answer, Block, Facts, Note, Page, Section, Table, Warnings, page_html
from lightopt.report.design import _plan
from lightopt.report.design._pictures import capture_text, curve_blocks, image_blocks, setting_blocks
from lightopt.report.design._surface import surface_blocks
from lightopt.scene import build_catalogue


def design_report(output: design.DesignOutput) -> str:
    """The report of an optimisation as HTML; for :func:`lightopt.design.finish_design`."""
    return page_html(design_page(output))


def design_page(output: design.DesignOutput) -> Page:
    sections = [
        Section(heading="Set the lights", blocks=setting_blocks(output), own_page=True),
        Section(heading="What the images show", blocks=surface_blocks(output)),
        Section(heading="Blind spots", blocks=_plan.blind_tables(output.document)),
        Section(heading="Defects", blocks=_plan.defect_tables(output.document)),
        Section(heading="Postures", blocks=_plan.posture_blocks(output)),
        Section(heading="Exposures", blocks=_plan.exposure_blocks(output)),
        Section(heading="Images of the best set", blocks=image_blocks(output)),
        Section(heading="Score against the angles", blocks=curve_blocks(output)),
        Section(heading="Tolerances of the angles", blocks=_plan.tolerance_blocks(output)),
        Section(heading="Scores", blocks=[best_table(output)]),
        Section(heading="Assumptions", blocks=fact_blocks(output)),
    ]
    rig, part = output.result.rig.name, output.result.part.name
    subtitle = f"{part} on {rig}, lightopt {output.document['provenance']['lightopt']}"
    return Page(title=f"Light positions: {part}", subtitle=subtitle, lead=answer_blocks(output), sections=sections)


def answer_blocks(output: design.DesignOutput) -> list[Block]:
    """The result in a sentence and a table of angles, its proof, and warnings."""
    chosen = output.document.get("chosen_postures")
    plan = [] if chosen is None else [_plan_answer(chosen, output.document.get("exposures"))]
    blocks: list[Block] = [*(plan or map(_answer, output.result.results))]
    header = ["posture", *output.result.candidates.names, "score"]
    found = [(result, result.answers[0]) for result in output.result.results if result.answers[0].nothing is None]
    rows: list[list[str]] = []
    for result, best in found:
        score = result.score_text(best.found.best.score, best.objective)
        rows.append([_plan.postures_text(result.postures), *_angles(output, best), score])
    if rows:
        caption = (
            "Place of each light: elevation from the table plane, azimuth about Z from the world's +X towards +Y, and "
            "the distance from the origin where it has a range."
        )
        blocks.append(Table(header=header, rows=rows, caption=caption))
    proofs = [_proof(result) for result, _ in found] if chosen is None else [_plan.plan_proof(chosen)]
    blocks += [Note(text=f"{gain[0].upper()}{gain[1:]}.") for result, _ in found if (gain := result.gain_text)]
    blocks += [Note(text=proof) for proof in proofs]
    between = [text for result, _ in found if (text := result.between_text)]
    blocks += [Note(text=f"{text[0].upper()}{text[1:]}.") for text in between]
    if between:
        blocks.append(Note(text=f"{design.BETWEEN_MEANING[0].upper()}{design.BETWEEN_MEANING[1:]}."))
    if found:
        blocks.append(Note(text=f"Capture: {capture_text(output.result)}."))
    rigs = ", ".join(rig["file"] for rig in output.document["rigs"])
    if rigs:
        blocks.append(Note(text=f"Rig file with these angles: {rigs}"))
    return [*blocks, Warnings(texts=output.warnings)]


def best_table(output: design.DesignOutput) -> Table:
    """The best set of every objective, scored under all."""
    names = [answer.objective.name for answer in output.result.results[0].answers]
    answers = [(one, answer) for one in output.result.results for answer in one.answers if answer.nothing is None]
    rows = [_scores(output, one, answer, names) for one, answer in answers]
    counts = ("left out", "runner-up", "ties / near best", "combinations")
    header = ["posture", "best for", *output.result.candidates.names, *names, *counts]
    objectives = [answer.objective for answer in output.result.results[0].answers]
    shares = [
        f"Shares of {' and '.join(names)}: of {surface}." for surface, names in design.shares_of(objectives).items()
    ]
    meanings = [f"{text[0].upper()}{text[1:]}." for text in (design.LEFT_OUT_MEANING, design.near_meaning(objectives))]
    files = "ranking.csv lists the best combinations, result.json has all numbers."
    return Table(header=header, rows=rows, numbers_from=2, caption=" ".join([*shares, *meanings, files]))


def _answer(result: design.SetResult) -> Answer:
    best = result.answers[0]
    where = _plan.postures_text(result.postures)
    if best.nothing is not None:
        return Answer(figure="No answer", text=f"{where}: {best.nothing}")
    share = best.objective.share_of_whole(best.found.best.score, result.area)
    score = result.format_score(best.found.best.score, best.objective)
    if share is None:
        return Answer(figure=score, text=f"by {best.objective.name}, {where}: {best.objective.meaning}")
    added = ", added up" * (len(result.postures) > 1)
    return Answer(
        figure=design.share_text(share, result.grain),
        text=f"{best.objective.meaning} ({score} by {best.objective.name}). The surface is what the camera sees in "
        f"{where}{added}, without the {result.left_out_text} that it sees at more than {GRAZING_DEG:g}° to the normal.",
    )


def _plan_answer(chosen: Mapping[str, Any], exposures: Mapping[str, Any] | None) -> Answer:
    postures = ", ".join(str(Posture.from_dict(one)) for one in chosen["order_of_travel"])
    found = design.finding_text(chosen["min_images"], chosen["false_alarms"])
    text = f"{found}, in {postures}. The surface is what the camera sees in any candidate posture"
    share, grain = chosen["share"], chosen["patches"]["grain"]
    if exposures is not None:
        share = exposures["share"]
        planned = any(shot["planned"] for shot in exposures["shots"])
        alone = f"With exposure 1 alone {design.share_text(exposures['share_without'], grain)}"
        text += f". {alone if planned else 'No further exposure adds enough to be planned'}"
    return Answer(figure=design.share_text(share, grain), text=f"{text}.")


def _angles(output: design.DesignOutput, answer: design.ObjectiveResult) -> list[str]:
    return [
        design.place_text(place).replace(" ", "\u00a0").replace("-", "−")
        for place in design.places_of(output.result.candidates, answer.found.best)
    ]


def _proof(result: design.SetResult) -> str:
    best = result.answers[0]
    found, objective = best.found, best.objective
    total = counted(found.scored + found.excluded + found.left, "combination")
    if found.proven and found.complete:
        text = f"proven, none of {total} scores more"
    elif found.proven:
        text = f"none of {total} scores more, but one that was not scored may score the same"
    else:
        text = f"not proven; {found.left:,} of {total} were not searched, and none of them scores more than "
        text += result.format_score(found.bound, objective)
    runner_up = "there is no other"
    if found.gap is not None:
        runner_up = f"the runner-up: {result.gap_text(best)}"
    if found.ties or not found.complete:
        runner_up += f"; ties: {best.ties_text}, decided by the sum of usable levels"
    runner_up += f"; {best.near_text} other combinations near the best"
    return f"{_plan.postures_text(result.postures).capitalize()}: {text}; {runner_up}."


def _scores(
    output: design.DesignOutput, result: design.SetResult, answer: design.ObjectiveResult, names: list[str]
) -> list[str]:
    objectives = {other.objective.name: other.objective for other in result.answers}
    return [
        _plan.postures_text(result.postures),
        answer.objective.name,
        *_angles(output, answer),
        *(_unbroken(result.score_text(answer.scores[name], objectives[name])) for name in names),
        result.left_out_text,
        _unbroken(result.gap_text(answer)),
        answer.ties_text if answer.proven_of is not None else f"{answer.ties_text} / {answer.near_text}",
        answer.combinations_text,
    ]


def _unbroken(score: str) -> str:
    # a line may end between a score and its share only
    return score.replace(" mm²", "\u00a0mm²").replace(" %", "\u00a0%")


def fact_blocks(output: design.DesignOutput) -> list[Block]:
    """LevelThresholds, sensor, reflectance, patches, options, versions and hashes; and the positions left out."""
    blocks: list[Block] = [Facts(rows=[*_physics(output), *_search(output)]), Facts(rows=_provenance(output))]
    excluded = output.result.all_candidates.left_out
    left_out = [[one.light, design.place_text(one.place), one.reason] for one in excluded]
    if left_out:
        blocks.append(Table(header=["light", "position", "left out because it"], rows=left_out, numbers_from=3))
    return blocks


def _coefficients(own: Reflectance) -> str:
    form = "" if own.model.name == "torrance-sparrow" else f"{own.model.name}, "
    return f"{form}R_d {own.R_d:g}, R_s {own.R_s:g}, σ {own.sigma:g} rad"


def _physics(output: design.DesignOutput) -> list[tuple[str, str]]:
    scene, thresholds = output.result.scene, output.result.thresholds
    sensor, reflectance = scene.sensor, scene.reflectance
    electrons = sensor.electrons_per_level
    shot = "no shot noise" if electrons is None else f"{electrons:g} electrons per level"
    levels = (
        f"{sensor.bit_depth} bit, black level {sensor.black_level:g}; shaded below {thresholds.shade}, saturated from "
        f"{thresholds.saturation} on; at exposure 1, without noise"
    )
    options = output.document["provenance"]["options"]
    use, edges = "not part of the score", ""
    if "false_alarms" in options:
        use, edges = "used for detectability only", " or at silhouettes and creases"
    return [
        ("levels", levels),
        ("sensor noise", f"read noise {sensor.read_noise_levels:g} levels, {shot}; {use}"),
        ("reflectance", f"{_coefficients(reflectance)}, of full scale {reflectance.full_scale:g}; only direct light"),
        *((f"region {one.name}", _coefficients(one.reflectance)) for one in scene.regions),
        ("lights", "; ".join(dict.fromkeys(map(_light, scene.lights)))),
        ("shadows", "cast by the part" if options["shadows"] else "none"),
        ("patches", output.patches.message),
        ("left out", f"what the camera sees at more than {GRAZING_DEG:g}° to the normal{edges}"),
    ]


def _light(light: PanelLight) -> str:
    width, height = (f"{side:g}" for side in light.size)
    points = "continuous (auto)" if light.points == "auto" else f"{light.points}, {light.normalisation}"
    falloff = "inverse square" if light.inverse_square else "none"
    return (
        f"panel of {width} × {height} mm at {light.distance:g} mm, point lights: {points}, gain {light.gain:g}, "
        f"falloff: {falloff}, emission exponent {light.emission_exponent:g}"
    )


def _search(output: design.DesignOutput) -> list[tuple[str, str]]:
    options = output.document["provenance"]["options"]
    positions = " × ".join(str(len(places)) for places in output.result.all_candidates.places)
    common = ", all lights at one elevation" * options["common_elevation"]
    common += ", the same for all postures" * options["common_lights"]
    facts = [
        ("positions", f"{positions}, step {options['step_deg']:g}°{common}"),
        ("objectives", ", ".join(options["objectives"])),
        ("defects", "none on the part: the scores are those of a good part"),
    ]
    if "false_alarms" in options:
        entries = build_catalogue(output.result.part)
        hypotheses = f"{len(design.planned_catalogue(entries).defects)} hypotheses"
        found = (
            f"where the expected evidence of all images passes the threshold of {options['false_alarms']:g} false "
            f"alarms per posture; {design.deciding_text(options['min_images'])}"
        )
        names = ", ".join(entry.name for entry in entries)
        facts += [("defect catalogue", f"{names}: {hypotheses}"), ("a defect is found", found)]
    if (tolerances := options.get("tolerances")) is not None:
        text = (
            f"lights {tolerances['light_deg']:g}°, part {tolerances['pose_deg']:g}°; "
            f"{counted(tolerances['draws'], 'draw')} with random seed {tolerances['seed']}; the widest keep "
            f"{100.0 * tolerances['target']:g} % of the score"
        )
        facts.append(("tolerances", text))
    return facts


def _provenance(output: design.DesignOutput) -> list[tuple[str, str]]:
    found = output.document["provenance"]
    inputs = found["inputs"]
    files = {"rig": inputs["rig"]["file"], "part": inputs["part"]["file"], "mesh": output.result.part.mesh.file}
    return [
        *((name, f"{file}, SHA-256 {inputs[name]['sha256']}") for name, file in files.items()),
        ("code", f"lightopt {found['lightopt']}, SHA-256 {found['code_sha256']}"),
        ("versions", ", ".join(f"{name} {number}" for name, number in found["versions"].items())),
    ]
