"""Postures, exposures and tolerances of a plan as tables on the terminal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from lightopt.cli._terminal import say, show_table, together
from lightopt.core.errors import counted

if TYPE_CHECKING:
    from lightopt.design import Brackets, ChosenPostures, PlanResult, ToleranceResult, Way


def show_plan(result: PlanResult, folder: Path) -> None:
    """The plan, and the commands that carry it out."""
    if result.chosen is not None:
        _show_postures(result.chosen)
    if result.brackets is not None:
        _show_brackets(result.brackets)
        if result.chosen is None:
            say(f"shares of exposures: of {result.shares_of}")
    if result.tolerances:
        _show_tolerances(result.tolerances)
    if result.commands:
        say(f"to carry the plan out, in {folder}:")
        for command in result.commands:
            say(f"  {command.text}")
        _show_ways([command.way for command in result.commands if command.way is not None])


def _show_postures(chosen: ChosenPostures) -> None:
    from lightopt.design import SHARES_OF

    cover, text = chosen.choice.cover, _text_of(chosen.grain)
    total = max(1, cover.total)
    for out in chosen.left_out:
        say(f"left out: posture {out.posture}: {out.reason}")
    bracketed = len(chosen.exposures) > 1
    # as they are captured
    steps = zip(chosen.choice.postures, cover.steps, strict=True)
    numbered = {posture: (number, step) for number, (posture, step) in enumerate(steps, start=1)}
    show_table(
        ("posture", "chosen as no.", *(["exposures"] if bracketed else []), "adds", "together"),
        [
            (
                str(posture),
                str(number),
                *([_levels(chosen.exposures_of(posture))] if bracketed else []),
                text(step.gain / (cover.k * total)),
                text(step.covered / total),
            )
            for posture in chosen.way.order
            for number, step in [numbered[posture]]
        ],
    )
    number, images = counted(len(cover.steps), "posture"), counted(chosen.least, "image")
    say(
        f"{number} of {chosen.candidate_count} show {text(cover.share)} of the surface × defects in {images} or more, "
        "all planned images together and no others"
    )
    say(f"shares of postures and exposures: of {SHARES_OF}")
    say(
        f"that surface is {text(chosen.inspectable_share)} of the part's, and "
        f"{text(chosen.left_out_share)} is left out since the camera sees it at a grazing angle only; of "
        f"{chosen.patches:,} patches with edges up to {chosen.max_edge:.3g} mm, each seen or not as its middle is: "
        "shares may be off by some "
        f"{100.0 * chosen.grain:.1g} points"
    )
    _show_spare(chosen)
    if cover.k > 1:
        say(
            f"adds: images new to a pair of patch and defect, up to {cover.k} of each; together: pairs with {cover.k} "
            "images or more"
        )
    _show_proof(chosen)
    say(f"stage, in one round: {_way(chosen.way)} of travel {chosen.pace}")


def _show_ways(ways: Sequence[Way]) -> None:
    # of several commands: each begins at (0°, 0°) and takes its own postures
    if len(ways) < 2:
        return
    for number, way in enumerate(ways, start=1):
        say(f"stage, capture {number}: {_way(way)} of travel")
    say(f"together {sum(way.seconds for way in ways):.1f} s of travel, without the ways back to (0°, 0°)")


def _way(way: Way) -> str:
    return f"{' → '.join(map(str, way.order))}, {way.seconds:.1f} s"


def _show_spare(chosen: ChosenPostures) -> None:
    # fewer postures than were asked for, and postures that hardly add anything
    steps = chosen.choice.cover.steps
    if chosen.requested is not None and len(steps) < chosen.requested and chosen.target is None:
        why = (
            "there are no others"
            if len(steps) == chosen.candidate_count
            else "no other adds anything with these lights"
        )
        say(f"{chosen.requested} postures were asked for: {why}")
    if chosen.sufficient < len(steps):
        text = _text_of(chosen.grain)
        share = text(steps[chosen.sufficient - 1].covered / max(1, chosen.choice.cover.total))
        say(
            f"the first {chosen.sufficient} chosen show {share}, the others less than 0.1 points more: "
            f"--choose-postures {chosen.sufficient} does nearly as well"
        )


def _show_proof(chosen: ChosenPostures) -> None:
    choice, cover, text = chosen.choice, chosen.choice.cover, _text_of(chosen.grain)
    number = counted(len(cover.steps), "posture")
    whatever = f", at any of the exposures {_levels(chosen.exposures)}" * (len(chosen.exposures) > 1)
    if chosen.proven:
        say(f"proven of these patches: no {number} show more{whatever}")
    else:
        local = "a local optimum: " if choice.iterations else ""
        sets = (
            f"no {number} show"
            if cover.sets is None
            else f"none of the {cover.sets:,} sets of {number} shows"
        )
        bound = (
            f"with these lights {sets} more{whatever}"
            if cover.proven
            else f"with these lights {sets} more than {text(cover.bound_share)}{whatever}, so that these have "
            f"{text(cover.guarantee)} of the best at least"
        )
        say(f"{local}{bound}" + "; other lights with other postures may show more" * bool(choice.iterations))
    everything = text(cover.all_covered / max(1, cover.total))
    say(f"all {chosen.candidate_count} postures with these lights show {everything}{whatever}")
    if cover.min_size is not None and chosen.target is not None:
        say(
            f"{100.0 * chosen.target:.9g} % takes at least {counted(cover.min_size, 'posture')} with these lights"
        )
    if not choice.iterations:
        return
    from lightopt.design import patches_text

    tried = "every combination" if choice.exact else "one light moved at a time"
    where = patches_text(chosen.drawn, chosen.patches, on_all_patches=choice.on_all_patches)
    best = "; proven: in these postures no other positions show more" * (choice.exact and choice.converged)
    say(
        f"lights: the same for all postures, placed together with them in {counted(choice.iterations, 'turn')}, "
        f"the best of {counted(choice.starts, 'start')} ({tried}) {where}{best}"
    )
    if choice.initial_if_moved is not None:
        say(
            f"the lights as they stood show {text(choice.initial_if_moved.share)} in "
            f"{counted(choice.initial_if_moved.postures, 'posture')} chosen for them, on {chosen.drawn:,} patches, at "
            "exposure 1"
        )


def _text_of(grain: float) -> Callable[[float], str]:
    # shares to the digits that their patches support
    from lightopt.design import share_text

    return partial(share_text, grain=grain)


def _levels(exposures: Sequence[float]) -> str:
    return ", ".join(f"{exposure:.9g}" for exposure in exposures)


def _show_brackets(brackets: Brackets) -> None:
    text = _text_of(brackets.grain)
    show_table(
        ("posture", "exposure", "adds", "planned"),
        [
            (str(shot.posture), f"{shot.exposure:g}", text(shot.gain), "yes" if shot.planned else "no")
            for shot in brackets.further
        ],
    )
    planned = sum(shot.planned for shot in brackets.further)
    adding = f"{100.0 * brackets.least_gain:g} % or more"
    adding += ", or two that add twice that together" * any(
        shot.reason == "pair" for shot in brackets.further
    )
    adding += ", or needed for the target" * any(shot.reason == "target" for shot in brackets.further)
    say(
        f"{counted(planned, 'further exposure')} planned, each adding {adding}: "
        f"{text(brackets.before)} of the surface × defects becomes {text(brackets.after)}"
    )


def _show_tolerances(tolerances: tuple[ToleranceResult, ...]) -> None:
    widest = [f"{w.what}, {w.angle}" for w in tolerances[0].robustness.widest]
    show_table(
        ("off by the tolerance", *(together(one.postures) for one in tolerances)),
        [
            ("worst corner keeps", *(_share(one, one.robustness.worst) for one in tolerances)),
            ("95 % of draws keep", *(_share(one, one.robustness.quantile) for one in tolerances)),
            *(
                (f"widest: {name}", *(_degrees(one, i) for one in tolerances))
                for i, name in enumerate(widest)
            ),
        ],
    )


def _share(one: ToleranceResult, score: int) -> str:
    return _text_of(one.grain)(score / max(1, one.robustness.score))


def _degrees(one: ToleranceResult, index: int) -> str:
    widest = one.robustness.widest[index]
    return f"{'≥ ' if widest.open_ended else ''}{widest.degrees:.2f}°"
