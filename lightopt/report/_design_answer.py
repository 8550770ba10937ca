"""The answer of a design: angles, score, proof; and the scores under every objective."""

from collections.abc import Mapping
from typing import Any

from lightopt.core.errors import counted
from lightopt.core.transforms import Posture
from lightopt.design import (
    LEFT_OUT_MEANING,
    DesignOutput,
    DetectabilityObjective,
    ObjectiveResult,
    SetResult,
    angles_of,
    combinations_counted_text,
    gap_text,
    left_out_text,
    near_meaning,
    near_text,
    score_text,
    share_of_whole,
    share_text,
    shares_of,
    shown_text,
    ties_text,
)
from lightopt.rendering import GRAZING_DEG
from lightopt.report._contact_sheet import degrees
from lightopt.report._design_plan import search_text, sets_text
from lightopt.report._page import Answer, Block, Note, Table, Warnings


def answer_blocks(output: DesignOutput) -> list[Block]:
    """The result in a sentence and a table of angles, its proof, and warnings."""
    chosen = output.document.get("chosen_postures")
    blocks: list[Block] = (
        [_answer(result) for result in output.result.results]
        if chosen is None
        else [_plan_answer(chosen, output.document.get("exposures"))]
    )
    header = ["posture", *output.result.candidates.names, "score"]
    rows = [_row(output, result) for result in output.result.results if result.answers[0].nothing is None]
    if rows:
        blocks.append(
            Table(
                header=header,
                rows=rows,
                caption="Of each light its elevation from the table plane and its azimuth about Z from the world's +X "
                "towards +Y.",
            )
        )
    if chosen is None:
        found = [result for result in output.result.results if result.answers[0].nothing is None]
        blocks += [Note(text=_proof(result)) for result in found]
    else:
        blocks.append(Note(text=_plan_proof(chosen)))
    rigs = ", ".join(rig["file"] for rig in output.document["rigs"])
    if rigs:
        blocks.append(Note(text=f"Rig with these angles: {rigs}"))
    return [*blocks, Warnings(texts=output.warnings)]


def scores_table(output: DesignOutput) -> Table:
    """The best set of every objective, scored under all."""
    names = [answer.objective.name for answer in output.result.results[0].answers]
    rows = [
        _scores(output, result, answer, names)
        for result in output.result.results
        for answer in result.answers
        if answer.nothing is None
    ]
    header = ["posture", "best for", *output.result.candidates.names, *names, *COUNTS]
    objectives = [answer.objective for answer in output.result.results[0].answers]
    shares = [f"Shares of {' and '.join(names)}: of {surface}." for surface, names in shares_of(objectives).items()]
    return Table(
        header=header,
        rows=rows,
        numbers_from=2,
        caption=f"{' '.join(shares)} {_sentence(LEFT_OUT_MEANING)} {_sentence(near_meaning(objectives))} ranking.csv "
        "lists the best combinations, result.json has all numbers.",
    )


COUNTS = ("left out", "runner-up", "ties / near best", "combinations")  # columns beside the scores


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


def postures_text(result: SetResult) -> str:
    """The postures of a set, short."""
    if len(result.postures) == 1:
        return f"posture {result.postures[0]}"
    return f"all {len(result.postures)} postures"


def _answer(result: SetResult) -> Answer:
    best = result.answers[0]
    where = postures_text(result)
    if best.nothing is not None:
        return Answer(figure="No answer", text=f"{where}: {best.nothing}")
    share = share_of_whole(best.objective, best.found.best.score, result.area)
    score = shown_text(best.found.best.score, best.objective, result)
    if share is None:
        return Answer(figure=score, text=f"by {best.objective.name}, {where}")
    surface = "surface × defects (by weight)" if isinstance(best.objective, DetectabilityObjective) else "surface"
    added = ", added up" * (len(result.postures) > 1)
    return Answer(
        figure=share_text(share, result.grain),
        text=f"of the {surface} that the camera sees in {where}{added}, but for {left_out_text(result)} that it sees "
        f"at more than {GRAZING_DEG:g}° to the normal: {score} by {best.objective.name}",
    )


def _plan_answer(chosen: Mapping[str, Any], exposures: Mapping[str, Any] | None) -> Answer:
    images = counted(chosen["min_images"], "image")
    postures = ", ".join(str(Posture.from_dict(one)) for one in chosen["order_of_travel"])
    text = (
        f"of the surface × defects is seen in {images} or more, by all planned images together, in {postures}; the "
        "surface is what the camera sees in any posture to choose from"
    )
    share, grain = chosen["share"], chosen["patches"]["grain"]
    if exposures is not None:
        share = exposures["share"]
        planned = any(shot["planned"] for shot in exposures["shots"])
        alone = f"With exposure 1 alone {share_text(exposures['share_without'], grain)}"
        text += f". {alone if planned else 'No further exposure adds enough to be planned'}"
    return Answer(figure=share_text(share, grain), text=text)


def _plan_proof(chosen: Mapping[str, Any]) -> str:
    if chosen["optimum"] == "proven":
        number = counted(len(chosen["postures"]), "posture")
        return f"Proven of these patches: no {number} of the {chosen['candidates']} show more."
    sets = sets_text(chosen, of=f" of the {chosen['candidates']}")
    more = (
        "" if chosen["proven_with_these_lights"] else f" than {share_text(chosen['bound'], chosen['patches']['grain'])}"
    )
    whatever = ", at any of the exposures offered" * (len(chosen["bounds_with_any_of_exposures"]) > 1)
    bound = f"Proven: with these lights {sets} more{more}{whatever}."
    if not chosen["iterations"]:
        return f"{bound} No light moves."
    if chosen["lights_best_for_postures"]:
        bound += " Proven: in these postures no other positions of the lights show more."
    return (
        f"{bound} A local optimum: other postures with other lights may show more; the lights were placed for the "
        f"postures, and the postures chosen for the lights, {search_text(chosen)}."
    )


def _row(output: DesignOutput, result: SetResult) -> list[str]:
    best = result.answers[0]
    return [postures_text(result), *_angles(output, best), score_text(best.found.best.score, best.objective, result)]


def _angles(output: DesignOutput, answer: ObjectiveResult) -> list[str]:
    return [
        f"{degrees(elevation)},\u00a0{degrees(azimuth)}"
        for elevation, azimuth in angles_of(output.result.candidates, answer.found.best)
    ]


def _proof(result: SetResult) -> str:
    best = result.answers[0]
    found, objective = best.found, best.objective
    total = counted(found.scored + found.excluded + found.left, "combination")
    if found.proven and found.complete:
        text = f"proven, none of {total} scores more"
    elif found.proven:
        text = f"none of {total} scores more, but one that was not looked at may score the same"
    else:
        text = f"not proven; {found.left:,} of {total} were left, and none scores more than "
        text += shown_text(found.bound, objective, result)
    runner_up = "there is no other"
    if found.gap is not None:
        runner_up = f"the runner-up: {gap_text(best, result)}"
    if found.ties or not found.complete:
        runner_up += f"; ties: {ties_text(best)}, decided by the sum of usable levels"
    runner_up += f"; {near_text(best)} other combinations near the best"
    return f"{postures_text(result).capitalize()}: {text}; {runner_up}."


def _scores(output: DesignOutput, result: SetResult, answer: ObjectiveResult, names: list[str]) -> list[str]:
    objectives = {other.objective.name: other.objective for other in result.answers}
    return [
        postures_text(result),
        answer.objective.name,
        *_angles(output, answer),
        *(_unbroken(score_text(answer.scores[name], objectives[name], result)) for name in names),
        left_out_text(result),
        _unbroken(gap_text(answer, result)),
        ties_text(answer) if answer.proven_of is not None else f"{ties_text(answer)} / {near_text(answer)}",
        combinations_counted_text(answer),
    ]


def _unbroken(score: str) -> str:
    # a line may end between a score and its share only
    return score.replace(" mm²", "\u00a0mm²").replace(" %", "\u00a0%")
