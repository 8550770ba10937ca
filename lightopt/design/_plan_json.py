"""How a plan reads as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from lightopt.design._commands import Way
from lightopt.design._plan_result import SHARES_OF, ChosenPostures, PlanResult, TrustOf
from lightopt.design.exposures._brackets import Brackets
from lightopt.design.tolerances._tolerances import Offset

STOOD_OF = "the drawn patches, in postures chosen for these lights, at exposure 1"
"""What the share of the lights as they stood is of."""


def plan_dict(result: PlanResult, names: Sequence[str]) -> dict[str, Any]:
    """The sections of result.json.

    Parameters
    ----------
    result
        What was planned.
    names
        Of the lights.
    """
    sections: dict[str, Any] = {}
    if result.chosen is not None:
        sections["chosen_postures"] = _chosen_dict(result.chosen)
    if result.brackets is not None:
        sections["exposures"] = _brackets_dict(result.brackets, result.shares_of)
    if result.trust:
        sections["trust"] = [_trust_dict(one, names) for one in result.trust]
    if result.commands:
        sections["commands"] = [command.text for command in result.commands]
        sections["rounds"] = [
            {"command": command.text, **_way_dict(command.way)} for command in result.commands if command.way
        ]
    return sections


def _way_dict(way: Way) -> dict[str, Any]:
    return {
        "order_of_travel": [posture.as_dict() for posture in way.order],
        "travel_s": round(way.seconds, 3),
    }


def _chosen_dict(chosen: ChosenPostures) -> dict[str, Any]:
    cover = chosen.choice.cover
    total = max(1, cover.total)
    before = chosen.choice.initial_if_moved
    return {
        "seen_in": chosen.least,
        "asked": chosen.asked,
        "target": chosen.target,
        "share": round(cover.share, 6),
        "shares_of": SHARES_OF,
        "optimum": "proven" if chosen.proven else "local",
        "bound": round(cover.bound_share, 6),
        "best_of_sets": cover.sets,
        "proven_with_these_lights": cover.proven,
        "greedy_guarantee": round(cover.guarantee, 6),
        "fewest_possible": cover.min_size,
        "all_candidates": round(cover.all_covered / total, 6),
        "lights_as_they_stand": None
        if before is None
        else {"share": round(before.share, 6), "postures": before.postures, "share_of": STOOD_OF},
        "postures": [
            {
                **posture.as_dict(),
                "exposures": list(chosen.exposures_of(posture)),
                "gain": round(step.gain / (cover.k * total), 6),
                "share": round(step.covered / total, 6),
            }
            for posture, step in zip(chosen.choice.postures, cover.steps, strict=True)
        ],
        "postures_to_a_tenth_of_a_point": chosen.telling,
        **_way_dict(chosen.way),
        "travel_pace": chosen.pace,
        "candidates": chosen.offered,
        "left_out": [
            {**out.posture.as_dict(), "kind": out.kind, "reason": out.reason} for out in chosen.left_out
        ],
        "turns": chosen.choice.iterations,
        "starts": chosen.choice.starts,
        "every_combination_tried": chosen.choice.exact,
        "turns_on_all_patches": chosen.choice.on_all_patches,
        "lights_best_for_postures": chosen.choice.exact and chosen.choice.converged,
        "patches": {
            "drawn": chosen.drawn,
            "all": chosen.patches,
            "max_edge_mm": round(chosen.max_edge, 6),
            "footprint_mm": round(chosen.footprint, 6),
            "grain": round(chosen.grain, 6),
        },
        "inspectable_share_of_surface": round(chosen.inspectable_share, 6),
        "left_out_share_of_surface": round(chosen.left_out_share, 6),
        "bounds_with_any_of_exposures": list(chosen.exposures),
    }


def _brackets_dict(brackets: Brackets, shares_of: str) -> dict[str, Any]:
    return {
        "shares_of": shares_of,
        "share_without": round(brackets.before, 6),
        "share": round(brackets.after, 6),
        "least_gain": brackets.least_gain,
        "grain": round(brackets.grain, 6),
        "shots": [
            {
                "posture": shot.posture.as_dict(),
                "exposure": shot.exposure,
                "gain": round(shot.gain, 6),
                "planned": shot.planned,
                "planned_for": shot.reason,
            }
            for shot in brackets.further
        ],
    }


def _trust_dict(one: TrustOf, names: Sequence[str]) -> dict[str, Any]:
    trust = one.trust

    def share(score: int) -> float:
        return round(score / max(1, trust.score), 6)

    return {
        "postures": [posture.as_dict() for posture in one.postures],
        "patches": one.patches,
        "grain": round(one.grain, 6),
        "score": trust.score,
        "unit": one.unit,
        "worst_corner": {
            "share_of_score": share(trust.worst),
            "part": _offset_dict(trust.worst_pose, "tilt_deg", "rotation_deg"),
            "lights": [
                {"light": name, **_offset_dict(offset, "elevation_deg", "azimuth_deg")}
                for name, offset in zip(names, trust.worst_lights, strict=True)
            ],
        },
        "quantile_5_percent": share(trust.quantile),
        "least_drawn": share(trust.least_drawn),
        "widest": [
            {
                "what": widest.what,
                "angle": widest.angle,
                "degrees": round(widest.degrees, 4),
                "or_more": widest.open_ended,
            }
            for widest in trust.widest
        ],
    }


def _offset_dict(offset: Offset, first: str, second: str) -> dict[str, float]:
    return {first: offset[0], second: offset[1]}
