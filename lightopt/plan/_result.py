"""What was planned, and how it reads as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from lightopt.plan._brackets import Brackets
from lightopt.plan._choice import Choice
from lightopt.plan._commands import Command, Way
from lightopt.plan._grid import LeftOutPosture
from lightopt.plan._tolerances import Offset
from lightopt.plan._trust import Trust
from lightopt.transforms import Posture

__all__ = ["SHARES_OF", "ChosenPostures", "PlanResult", "TrustOf", "plan_dict"]

SHARES_OF = "the surface that the camera sees in any posture to choose from × defects by weight"
"""What the shares of a plan are shares of."""

TELLING_SHARE = 0.001
"""Of the pairs: what postures add together that are not worth an image."""

STOOD_OF = "the drawn patches, in postures chosen for these lights, at exposure 1"
"""What the share of the lights as they stood is of."""

OWN_SHARES_OF = "the surface that the camera sees in any of the postures × defects by weight"
"""The same of exposures for a part's own postures."""


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
    way
        Through the chosen ones, were all captured in one round.
    pace
        How fast the stage goes, and who says so.
    least
        Images that must show a pair.
    asked, target
        Number of postures and share that were asked for; None for what was not.
    drawn, patches
        Patches that the first turns of postures and lights were taken on, and those of the last ones and all figures.
    max_edge, footprint
        Longest edge of these, and side of a pixel's footprint on the part where it is smallest [mm].
    grain
        How far shares may be off since a patch counts as its middle does: see :class:`lightopt.rendering.PatchTable`.
    visible_share
        Of the part's surface, by area, what the camera sees in one candidate posture or more.
    exposures
        That were offered, 1 among them.
    brackets
        Which of them are planned; None where there was no offer.
    """

    choice: Choice
    offered: int
    left_out: tuple[LeftOutPosture, ...]
    way: Way
    pace: str
    least: int
    asked: int | None
    target: float | None
    drawn: int
    patches: int
    max_edge: float
    footprint: float
    grain: float
    visible_share: float
    exposures: tuple[float, ...] = (1.0,)
    brackets: Brackets | None = None

    def exposures_of(self, posture: Posture) -> tuple[float, ...]:
        """That are planned for a posture, the longest first."""
        return (1.0,) if self.brackets is None else self.brackets.of(posture)

    @property
    def proven(self) -> bool:
        """Whether no other postures with no other lights show more: then there is nothing that turns could miss."""
        cover = self.choice.cover
        return cover.reached == cover.total or (self.choice.turns == 0 and cover.proven)

    @property
    def telling(self) -> int:
        """How many of the postures, in the order in which they were chosen, come within a tenth of a point of all."""
        steps = self.choice.cover.steps
        enough = (steps[-1].reached if steps else 0) - TELLING_SHARE * self.choice.cover.total
        return next((i for i, step in enumerate(steps, start=1) if step.reached >= enough), len(steps))


@dataclass(frozen=True, kw_only=True)
class TrustOf:
    """How far a score falls, of one posture or of several together.

    Attributes
    ----------
    postures
        Which.
    trust
        What becomes of their score.
    unit
        Of the score.
    patches
        Patches that it was worked out on.
    """

    postures: tuple[Posture, ...]
    trust: Trust
    unit: str
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
    commands: tuple[Command, ...] = ()

    def exposures_of(self, posture: Posture) -> tuple[float, ...]:
        """That are planned for a posture, the longest first."""
        return (1.0,) if self.brackets is None else self.brackets.of(posture)

    @property
    def shares_of(self) -> str:
        """What the shares of exposures and postures are shares of."""
        return OWN_SHARES_OF if self.chosen is None else SHARES_OF


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
    before = chosen.choice.before
    return {
        "seen_in": chosen.least,
        "asked": chosen.asked,
        "target": chosen.target,
        "share": round(cover.share, 6),
        "shares_of": SHARES_OF,
        "optimum": "proven" if chosen.proven else "local",
        "bound": round(cover.bound_share, 6),
        "greedy_guarantee": round(cover.guarantee, 6),
        "fewest_possible": cover.least,
        "all_candidates": round(cover.all_reached / total, 6),
        "lights_as_they_stand": None
        if before is None
        else {"share": round(before.share, 6), "postures": before.postures, "share_of": STOOD_OF},
        "postures": [
            {
                **posture.as_dict(),
                "exposures": list(chosen.exposures_of(posture)),
                "gain": round(step.gain / (cover.k * total), 6),
                "share": round(step.reached / total, 6),
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
        "turns": chosen.choice.turns,
        "starts": chosen.choice.starts,
        "every_combination_tried": chosen.choice.exact,
        "turns_on_all_patches": chosen.choice.on_all,
        "lights_best_for_postures": chosen.choice.exact and chosen.choice.settled,
        "patches": {
            "drawn": chosen.drawn,
            "all": chosen.patches,
            "max_edge_mm": round(chosen.max_edge, 6),
            "footprint_mm": round(chosen.footprint, 6),
            "grain": round(chosen.grain, 6),
        },
        "visible_share_of_surface": round(chosen.visible_share, 6),
        "bounds_with_any_of_exposures": list(chosen.exposures),
    }


def _brackets_dict(brackets: Brackets, shares_of: str) -> dict[str, Any]:
    return {
        "shares_of": shares_of,
        "share_without": round(brackets.before, 6),
        "share": round(brackets.after, 6),
        "least_gain": brackets.least_gain,
        "shots": [
            {
                "posture": shot.posture.as_dict(),
                "exposure": shot.exposure,
                "gain": round(shot.gain, 6),
                "planned": shot.planned,
                "planned_for": shot.why,
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
