"""Postures, exposures and tolerances of a plan as tables on the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lightopt.cli._terminal import say, show_table
from lightopt.errors import counted, percent

if TYPE_CHECKING:
    from lightopt.plan import Brackets, ChosenPostures, PlanResult, TrustOf

__all__ = ["show_plan"]


def show_plan(result: PlanResult, folder: Path) -> None:
    """The plan, and the commands that carry it out."""
    if result.chosen is not None:
        _show_postures(result.chosen)
    if result.brackets is not None:
        _show_brackets(result.brackets)
    if result.trust:
        _show_trust(result.trust)
    if result.commands:
        say(f"to carry the plan out, in {folder}:")
        for command in result.commands:
            say(f"  {command}")


def _show_postures(chosen: ChosenPostures) -> None:
    cover = chosen.choice.cover
    total = max(1, cover.total)
    for out in chosen.left_out:
        say(f"left out: posture {out.posture}: {out.reason}")
    show_table(
        ("posture", "adds", "together"),
        [
            (str(posture), percent(step.gain / (cover.k * total)), percent(step.reached / total))
            for posture, step in zip(chosen.choice.postures, cover.steps, strict=True)
        ],
    )
    number, images = counted(len(cover.steps), "posture"), counted(chosen.least, "image")
    say(
        f"{number} of {chosen.offered} show {percent(cover.share)} of the surface × defects in {images} or more, all "
        "postures together"
    )
    if len(chosen.exposures) > 1:
        levels = ", ".join(f"{exposure:.9g}" for exposure in chosen.exposures)
        say(
            f"an image shows what it shows with one of the exposures {levels}; which of them are planned, below"
        )
    if cover.k > 1:
        say(
            f"adds: images new to a pair of patch and defect, up to {cover.k} of each; together: pairs with {cover.k} "
            "images or more"
        )
    # the greedy choice is bounded in what it adds; in what it reaches only where one image is enough
    greedy = f"; a greedy choice has at least {percent(cover.guarantee)} of the best" if cover.k == 1 else ""
    say(
        f"with these lights no {number} show more than {percent(cover.bound_share)}, and all {chosen.offered} show "
        f"{percent(cover.all_reached / total)}{greedy}"
    )
    if cover.least is not None and chosen.target is not None:
        say(f"{percent(chosen.target)} takes at least {counted(cover.least, 'posture')} with these lights")
    if chosen.choice.lights is not None:
        from lightopt.optimize import patches_text

        tried = "every combination" if chosen.choice.exact else "one light moved at a time"
        where = patches_text(chosen.drawn, chosen.patches, on_all=chosen.choice.on_all)
        proven = "; in these postures no other positions show more" * (
            chosen.choice.exact and chosen.choice.settled
        )
        say(
            f"lights: the same for all postures, placed together with them in {counted(chosen.choice.turns, 'turn')} "
            f"({tried}) {where}{proven}"
        )
        say(f"the lights as they stood show {percent(chosen.choice.before)} of the {chosen.drawn:,} patches")
    say(
        f"the surface is what the camera sees in any of these postures, {percent(chosen.visible_share)} of the part's"
    )
    say(f"stage: {' → '.join(map(str, chosen.order))}, {chosen.travel_s:.1f} s of travel")


def _show_brackets(brackets: Brackets) -> None:
    show_table(
        ("posture", "exposure", "adds", "planned"),
        [
            (str(shot.posture), f"{shot.exposure:g}", percent(shot.gain, 2), "yes" if shot.planned else "no")
            for shot in brackets.shots
        ],
    )
    planned = sum(shot.planned for shot in brackets.shots)
    say(
        f"{counted(planned, 'further exposure')} planned, each adding {percent(brackets.least_gain, 2)} or more: "
        f"{percent(brackets.before)} of the surface × defects becomes {percent(brackets.after)}"
    )


def _show_trust(trust: tuple[TrustOf, ...]) -> None:
    widest = [f"{w.what} {w.angle}" for w in trust[0].trust.widest]
    show_table(
        ("off by the tolerance", *(", ".join(map(str, one.postures)) for one in trust)),
        [
            ("worst corner keeps", *(percent(_share(one, one.trust.worst)) for one in trust)),
            ("95 % of draws keep", *(percent(_share(one, one.trust.quantile)) for one in trust)),
            *((f"widest: {name}", *(_degrees(one, i) for one in trust)) for i, name in enumerate(widest)),
        ],
    )


def _share(one: TrustOf, score: int) -> float:
    return score / max(1, one.trust.score)


def _degrees(one: TrustOf, index: int) -> str:
    widest = one.trust.widest[index]
    return f"{'≥ ' if widest.open_ended else ''}{widest.degrees:.2f}°"
