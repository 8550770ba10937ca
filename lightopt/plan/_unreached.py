"""Why a target cannot be reached."""

from __future__ import annotations

from lightopt.errors import counted, percent
from lightopt.optimize import Shown, Thresholds, blind_spots, blind_text, shown_by
from lightopt.plan._choose import Choice
from lightopt.plan._survey import Survey

__all__ = ["unreached"]

NEAR_SHARE = 0.01
"""Postures that come this near to all of them are told where a target cannot be reached."""


def unreached(target: float, choice: Choice, survey: Survey, *, least: int) -> str:
    """What can be reached, by how many postures, and why no more.

    Parameters
    ----------
    target
        Share of the pairs that was asked for.
    choice
        That falls short of it.
    survey
        The part in all candidate postures.
    least
        Images that must show a pair.
    """
    cover, offered = choice.cover, len(survey.table.postures)
    most = cover.all_reached / max(1, cover.total)
    if most >= target:
        return (
            f"--target: {counted(len(cover.steps), 'posture')} show {percent(cover.share)} of the surface × defects, "
            f"and no {len(cover.steps)} of {offered} show more than {percent(cover.bound_share)} with these lights; "
            f"{percent(target)} was asked for. Raise --choose-postures or leave it out"
        )
    near = next(
        (i for i, step in enumerate(cover.steps, 1) if step.reached >= (most - NEAR_SHARE) * cover.total),
        len(cover.steps),
    )
    return (
        f"--target: {percent(target)} of the surface × defects cannot be reached: with the best lights found, all "
        f"{offered} postures together show {percent(most)}, and {counted(near, 'posture')} come within "
        f"{100 * NEAR_SHARE:g} point of that. Of what stays unseen, {_reasons(choice, survey, least)}. Ask for less, "
        "plan --choose-postures, or change what stands in the way"
    )


def _reasons(choice: Choice, survey: Survey, least: int) -> str:
    # over all candidate postures, under the chosen lights
    thresholds = Thresholds.of_sensor(
        shade_share=0.0,
        max_level=survey.scene.sensor.max_level,
        saturated_from=survey.scene.sensor.saturated_from,
        black_level=survey.scene.sensor.black_level,
    )
    seen: list[Shown] = []
    for posture in survey.table.postures:
        matrices = survey.matrices(posture, [[panel] for panel in choice.panels], exposures=survey.exposures)
        seen.append(shown_by(matrices, thresholds, least=least))
    lost = blind_spots(survey.table.patches.areas, seen).by_reason()
    whole = max(sum(lost.values()), 1e-12)
    names = [panel.name for panel in choice.panels]
    ordered = sorted(lost.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(
        f"{percent(share / whole, 0)} {blind_text(code, names)}" for code, share in ordered if share > 0.0
    )
