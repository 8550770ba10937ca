"""Postures, exposures and tolerances of a plan on the terminal: sections of result.json, as the report has them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightopt.cli._terminal import echo, show_table, together
from lightopt.core.errors import counted

if TYPE_CHECKING:
    from lightopt.design import PlanResult

Section = Mapping[str, Any]


def show_plan(result: PlanResult, folder: Path, *, verbose: bool) -> None:
    """The plan, and the commands that carry it out; with `verbose` also what the figures mean and how far they hold."""
    from lightopt.design import plan_document, share_text
    from lightopt.report import exposure_table, tolerance_table

    document = plan_document(result)
    if "chosen_postures" in document:
        _show_postures(document["chosen_postures"], verbose=verbose)
    if "exposures" in document:
        planned = document["exposures"]
        table = exposure_table(planned)
        show_table(table.header, table.rows)
        _explain_exposures(planned, partial(share_text, grain=planned["grain"]))
        if verbose and "chosen_postures" not in document:
            echo(f"shares of exposures: of {planned['shares_of']}")
    if result.tolerances:
        table = tolerance_table(document["tolerances"], [together(one.postures) for one in result.tolerances])
        show_table(table.header, table.rows)
    if result.commands:
        echo(f"to carry the plan out, in {folder}:")
        for command in document["commands"]:
            echo(f"  {command}")
        if verbose:
            _show_rounds(document["rounds"])


def _show_postures(chosen: Section, *, verbose: bool) -> None:
    from lightopt.core.transforms import Posture
    from lightopt.design import share_text
    from lightopt.report import posture_table

    patches = chosen["patches"]
    text = partial(share_text, grain=patches["grain"])
    table = posture_table(chosen, with_exposures=len(chosen["bounds_with_any_of_exposures"]) > 1)
    show_table(table.header, table.rows)
    number, images = counted(len(chosen["postures"]), "posture"), counted(chosen["min_images"], "image")
    echo(
        f"{number} of {chosen['candidates']} show {text(chosen['share'])} of the surface × defects in {images} or "
        "more, all planned images together and no others"
    )
    _show_spare(chosen, text)
    _show_proof(chosen, text, verbose=verbose)
    if not verbose:
        return
    for out in chosen["left_out"]:
        echo(f"left out: posture {Posture.from_dict(out)}: {out['reason']}")
    echo(f"shares of postures and exposures: of {chosen['shares_of']}")
    echo(
        f"that surface is {text(chosen['inspectable_share_of_surface'])} of the part's, and "
        f"{text(chosen['left_out_share_of_surface'])} is left out since the camera sees it at a grazing angle only; of "
        f"{patches['all']:,} patches with edges up to {patches['max_edge_mm']:.3g} mm, each seen or not as its middle "
        f"is: shares may be off by some {100.0 * patches['grain']:.1g} points"
    )
    if chosen["min_images"] > 1:
        k = chosen["min_images"]
        echo(
            f"adds: images new to a pair of patch and defect, up to {k} of each; together: pairs with {k} images or "
            "more"
        )
    echo(f"stage, in one round: {_travel(chosen)} of travel {chosen['travel_pace']}")


def _show_rounds(rounds: Sequence[Section]) -> None:
    # of several commands: each begins at (0°, 0°) and takes its own postures
    if len(rounds) < 2:
        return
    for number, one in enumerate(rounds, start=1):
        echo(f"stage, capture {number}: {_travel(one)} of travel")
    total = sum(one["travel_s"] for one in rounds)
    echo(f"together {total:.1f} s of travel, without the ways back to (0°, 0°)")


def _travel(way: Section) -> str:
    from lightopt.core.transforms import Posture

    order = " → ".join(str(Posture.from_dict(one)) for one in way["order_of_travel"])
    return f"{order}, {way['travel_s']:.1f} s"


def _show_spare(chosen: Section, text: partial[str]) -> None:
    # fewer postures than were requested, and postures that hardly add anything
    count, sufficient = len(chosen["postures"]), chosen["postures_to_a_tenth_of_a_point"]
    if chosen["requested"] is not None and count < chosen["requested"] and chosen["target"] is None:
        why = "there are no others" if count == chosen["candidates"] else "no other adds anything with these lights"
        echo(f"{chosen['requested']} postures were asked for: {why}")
    if sufficient < count:
        share = text(chosen["postures"][sufficient - 1]["share"])
        echo(
            f"the first {sufficient} chosen show {share}, the others less than 0.1 points more: "
            f"--choose-postures {sufficient} does nearly as well"
        )


def _show_proof(chosen: Section, text: partial[str], *, verbose: bool) -> None:
    from lightopt.report import search_text, sets_text

    number = counted(len(chosen["postures"]), "posture")
    exposures = chosen["bounds_with_any_of_exposures"]
    levels = ", ".join(f"{exposure:.9g}" for exposure in exposures)
    whatever = f", at any of the exposures {levels}" * (len(exposures) > 1)
    if chosen["optimum"] == "proven":
        echo(f"proven of these patches: no {number} show more{whatever}")
    else:
        local = "a local optimum: " if chosen["iterations"] else ""
        bound = f"with these lights {sets_text(chosen)} more"
        bound += (
            whatever
            if chosen["proven_with_these_lights"]
            else f" than {text(chosen['bound'])}{whatever}, so that these have {text(chosen['greedy_guarantee'])} of "
            "the best at least"
        )
        echo(f"{local}{bound}" + "; other lights with other postures may show more" * bool(chosen["iterations"]))
    if not verbose:
        return
    echo(f"all {chosen['candidates']} postures with these lights show {text(chosen['all_candidates'])}{whatever}")
    if chosen["fewest_possible"] is not None and chosen["target"] is not None:
        needed = counted(chosen["fewest_possible"], "posture")
        echo(f"{100.0 * chosen['target']:.9g} % takes at least {needed} with these lights")
    if not chosen["iterations"]:
        return
    best = "; proven: in these postures no other positions show more" * chosen["lights_best_for_postures"]
    echo(f"lights: the same for all postures, placed together with them {search_text(chosen)}{best}")
    initial = chosen["lights_as_they_stand"]
    if initial is not None:
        echo(
            f"the lights as they stood show {text(initial['share'])} in {counted(initial['postures'], 'posture')} "
            f"chosen for them, on {chosen['patches']['drawn']:,} patches, at exposure 1"
        )


def _explain_exposures(planned: Section, text: partial[str]) -> None:
    shots = planned["shots"]
    why = {shot["planned_for"] for shot in shots}
    adding = f"{100.0 * planned['least_gain']:g} % or more"
    adding += ", or two that add twice that together" * ("pair" in why)
    adding += ", or needed for the target" * ("target" in why)
    number = counted(sum(shot["planned"] for shot in shots), "further exposure")
    echo(
        f"{number} planned, each adding {adding}: {text(planned['share_without'])} of the surface × defects becomes "
        f"{text(planned['share'])}"
    )
