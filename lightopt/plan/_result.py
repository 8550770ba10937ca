"""A plan as JSON, and as commands that carry it out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lightopt.optimize import degrees_text
from lightopt.plan._choose import Choice
from lightopt.plan._exposures import Brackets
from lightopt.plan._grid import LeftOutPosture
from lightopt.plan._trust import Offset, Trust
from lightopt.transforms import Posture

__all__ = ["ChosenPostures", "PlanResult", "TrustOf", "commands", "plan_dict"]


@dataclass(frozen=True, kw_only=True)
class ChosenPostures:
    """The postures of a plan, and what there was to choose from.

    Attributes
    ----------
    choice
        Postures and lights.
    offered
        Postures to choose from.
    left_out
        Postures that the stage reaches and that are of no use.
    order
        The chosen ones in the order in which the stage travels least.
    travel_s
        Time of that way from (0°, 0°) [s]; at 1 °/s where the rig has no stage device.
    least
        Images that must show a pair.
    target
        Share to be reached; None where a number of postures was asked for.
    drawn, patches
        Patches that the first turns of postures and lights were taken on, and those of the last ones and all figures.
    visible_share
        Of the part's surface, by area, what the camera sees in one candidate posture or more.
    exposures
        That postures and lights were chosen with: an image shows what it shows with one of them.
    """

    choice: Choice
    offered: int
    left_out: tuple[LeftOutPosture, ...]
    order: tuple[Posture, ...]
    travel_s: float
    least: int
    target: float | None
    drawn: int
    patches: int
    visible_share: float
    exposures: tuple[float, ...] = (1.0,)


@dataclass(frozen=True, kw_only=True)
class TrustOf:
    """How far a score falls, of one posture or of several together.

    Attributes
    ----------
    postures
        Which.
    trust
        What becomes of their score.
    patches
        Patches that it was worked out on.
    """

    postures: tuple[Posture, ...]
    trust: Trust
    patches: int


@dataclass(frozen=True, kw_only=True)
class PlanResult:
    """What was planned.

    Attributes
    ----------
    chosen
        Postures; None where the part's own were taken.
    brackets
        Exposures; None where none were offered.
    trust
        Posture by posture, then together where there are several; empty where nobody asked.
    commands
        That carry the plan out; empty where neither postures nor exposures were planned.
    """

    chosen: ChosenPostures | None = None
    brackets: Brackets | None = None
    trust: tuple[TrustOf, ...] = ()
    commands: tuple[str, ...] = ()


def commands(rigs: Mapping[Posture, str], part: str, brackets: Brackets | None) -> tuple[str, ...]:
    """Commands that carry a plan out, in the folder of its files: those that capture it, then those that render it.

    One of each kind for all postures of the same rig file and exposures, into an image set of their own.

    Parameters
    ----------
    rigs
        Rig file of each posture.
    part
        Part file.
    brackets
        Further exposures; None for exposure 1 alone.
    """
    groups: dict[tuple[str, tuple[float, ...]], list[Posture]] = {}
    for posture, rig in rigs.items():
        groups.setdefault((rig, brackets.of(posture) if brackets else (1.0,)), []).append(posture)
    captures: list[str] = []
    renders: list[str] = []
    for number, ((rig, exposures), some) in enumerate(groups.items(), start=1):
        end = "" if len(groups) == 1 else f"-{number}"
        chosen = [
            f"--posture={degrees_text(p.elevation_deg)},{degrees_text(p.rotation_deg)}"
            for p in some
            if len(groups) > 1
        ]
        levels = [f"{exposure:.9g}" for exposure in exposures]
        captures.append(
            " ".join(
                [
                    "lightopt capture",
                    rig,
                    part,
                    *chosen,
                    f"--exposures {','.join(levels)}",
                    f"-o captured{end}",
                ]
            )
        )
        renders.append(
            " ".join(
                [
                    "lightopt render",
                    rig,
                    part,
                    *chosen,
                    *(f"--exposure {x}" for x in levels),
                    f"-o rendered{end}",
                ]
            )
        )
    return (*captures, *renders)


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
        sections["exposures"] = _brackets_dict(result.brackets)
    if result.trust:
        sections["trust"] = [_trust_dict(one, names) for one in result.trust]
    if result.commands:
        sections["commands"] = list(result.commands)
    return sections


def _chosen_dict(chosen: ChosenPostures) -> dict[str, Any]:
    cover = chosen.choice.cover
    total = max(1, cover.total)
    return {
        "seen_in": chosen.least,
        "target": chosen.target,
        "share": round(cover.share, 6),
        "bound": round(cover.bound_share, 6),
        "greedy_guarantee": round(cover.guarantee, 6),
        "fewest_possible": cover.least,
        "all_candidates": round(cover.all_reached / total, 6),
        "lights_as_they_stand": round(chosen.choice.before, 6),
        "postures": [
            {
                **posture.as_dict(),
                "gain": round(step.gain / (cover.k * total), 6),
                "share": round(step.reached / total, 6),
            }
            for posture, step in zip(chosen.choice.postures, cover.steps, strict=True)
        ],
        "order_of_travel": [posture.as_dict() for posture in chosen.order],
        "travel_s": round(chosen.travel_s, 3),
        "candidates": chosen.offered,
        "left_out": [
            {**out.posture.as_dict(), "kind": out.kind, "reason": out.reason} for out in chosen.left_out
        ],
        "turns": chosen.choice.turns,
        "every_combination_tried": chosen.choice.exact,
        "turns_on_all_patches": chosen.choice.on_all,
        "lights_best_for_postures": chosen.choice.exact and chosen.choice.settled,
        "patches": {"drawn": chosen.drawn, "all": chosen.patches},
        "visible_share_of_surface": round(chosen.visible_share, 6),
        "with_any_of_exposures": list(chosen.exposures),
    }


def _brackets_dict(brackets: Brackets) -> dict[str, Any]:
    return {
        "share_without": round(brackets.before, 6),
        "share": round(brackets.after, 6),
        "least_gain": brackets.least_gain,
        "shots": [
            {
                "posture": shot.posture.as_dict(),
                "exposure": shot.exposure,
                "gain": round(shot.gain, 6),
                "planned": shot.planned,
            }
            for shot in brackets.shots
        ],
    }


def _trust_dict(one: TrustOf, names: Sequence[str]) -> dict[str, Any]:
    trust = one.trust

    def share(score: int) -> float:
        return round(score / max(1, trust.score), 6)

    return {
        "postures": [posture.as_dict() for posture in one.postures],
        "patches": one.patches,
        "score": trust.score,
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
