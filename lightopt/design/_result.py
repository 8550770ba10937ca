"""What an optimisation found, and how it reads as JSON and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from lightopt.core.transforms import Posture
from lightopt.design.candidates._candidates import Candidates
from lightopt.design.objectives._objective import NEAR_PER_MILLE, Objective, share_of_whole
from lightopt.design.responses._luminance_matrix import Levels
from lightopt.design.search._curves import Curve
from lightopt.design.search._exact_search import SearchResult
from lightopt.design.search._ranking import Ranked


def _no_details() -> Mapping[str, Any]:
    return {}


@dataclass(frozen=True, kw_only=True)
class Answer:
    """The best set of light positions for an objective.

    Attributes
    ----------
    objective
        That was optimised.
    found
        By the search.
    scores
        Score of the best set under every objective, by name.
    details
        What else the objective says of the best set, as JSON.
    nothing
        Why there is no best set: no combination scores at all. None where there is one.
    proven_of
        Where the set was placed before, with what else was chosen: among what `found` proves it to be the best or does
        not; other sets were not counted. None where the search placed it.
    """

    objective: Objective
    found: SearchResult
    scores: Mapping[str, int]
    details: Mapping[str, Any] = field(default_factory=_no_details)
    nothing: str | None = None
    proven_of: str | None = None


@dataclass(frozen=True, kw_only=True)
class SetResult:
    """The answers for postures that share their light positions.

    Attributes
    ----------
    postures
        One, or all of them where the lights stand the same for all.
    patches
        Inspectable patches, summed over the postures.
    area
        Of the inspectable patches, summed over the postures [µm²].
    grazing_area
        That the camera sees at a grazing angle, summed over the postures [µm²]: left out of scores and shares.
    grain
        How far shares of the area may be off since each patch counts as its middle does, 0 to 1.
    answers
        One per objective.
    levels
        Of the best set of the first objective, for each posture: delivered levels of its visible patches under each
        light, shape (lights, p).
    curves
        How the first objective's score goes with one angle; none where nothing scores.
    """

    postures: tuple[Posture, ...]
    patches: int
    area: int
    grazing_area: int
    grain: float
    answers: tuple[Answer, ...]
    levels: tuple[Levels, ...]
    curves: tuple[Curve, ...]

    @property
    def left_out(self) -> float:
        """Of the surface that the camera sees, the share that it sees at a grazing angle."""
        return self.grazing_area / max(1, self.area + self.grazing_area)


def angles_of(candidates: Candidates, ranked: Ranked) -> tuple[tuple[float, float], ...]:
    """Elevation and azimuth of each light in a combination [°]."""
    return tuple(angles[k] for angles, k in zip(candidates.angles, ranked.candidates, strict=True))


def result_dict(results: tuple[SetResult, ...], candidates: Candidates) -> list[dict[str, Any]]:
    """The results as JSON."""
    return [
        {
            "postures": [posture.as_dict() for posture in result.postures],
            "inspectable_patches": result.patches,
            "inspectable_area_um2": result.area,
            "grazing_area_um2": result.grazing_area,
            "left_out_of_visible_area": round(result.left_out, 6),
            "grain": round(result.grain, 6),
            "objectives": [_answer_dict(answer, result, candidates) for answer in result.answers],
            "curves": [curve.as_dict() for curve in result.curves],
        }
        for result in results
    ]


def _answer_dict(answer: Answer, result: SetResult, candidates: Candidates) -> dict[str, Any]:
    found = answer.found
    runner_up = found.runner_up
    combinations = {
        "total": found.scored + found.clashing + found.excluded + found.left,
        "scored": found.scored,
        "excluded_by_bound": found.excluded,
        "colliding": found.clashing,
        "left": found.left,
    }
    facts: dict[str, Any] = {"objective": answer.objective.name, "unit": answer.objective.unit}
    if answer.nothing is not None:
        return {**facts, "lights": None, "score": 0, "reason": answer.nothing, "combinations": combinations}
    share = share_of_whole(answer.objective, found.best.score, result.area)
    return {
        **facts,
        "lights": _lights(candidates, found.best),
        "score": found.best.score,
        "share_of_inspectable_area": None if share is None else round(share, 6),
        "share_of": answer.objective.share_of,
        "usable_sum": found.best.usable,
        "runner_up": None
        if runner_up is None
        else {"lights": _lights(candidates, runner_up), "score": runner_up.score},
        "gap": found.gap,
        "ties": found.ties if answer.proven_of is None else None,
        "near_best": None if answer.proven_of is not None else _near_dict(answer),
        "combinations": combinations if answer.proven_of is None else None,
        "bound": found.bound,
        "proven": found.proven,
        **({"complete": found.complete} if answer.proven_of is None else {"proven_of": answer.proven_of}),
        "scores_under": dict(answer.scores),
        **answer.details,
    }


def _near_dict(answer: Answer) -> dict[str, Any]:
    found = answer.found
    points = answer.objective.share_of is not None
    return {
        "combinations": found.near,
        "at_least": not found.near_exact,
        "within": NEAR_PER_MILLE / 1000,
        "of": "the inspectable area" if points else "the best score",
    }


def _lights(candidates: Candidates, ranked: Ranked) -> list[dict[str, Any]]:
    return [
        {"light": name, "elevation_deg": elevation, "azimuth_deg": azimuth}
        for name, (elevation, azimuth) in zip(candidates.names, angles_of(candidates, ranked), strict=True)
    ]


def ranking_csv(results: tuple[SetResult, ...], candidates: Candidates) -> str:
    """The first combinations of each posture and objective, one a line."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    angles = [f"{name}_{axis}_deg" for name in candidates.names for axis in ("elevation", "azimuth")]
    table.writerow(["postures", "objective", "rank", "score", "usable_sum", *angles])
    for result in results:
        postures = " ".join(f"{p.elevation_deg:g},{p.rotation_deg:g}" for p in result.postures)
        for answer in result.answers:
            if answer.nothing is not None:
                continue
            for rank, ranked in enumerate(answer.found.ranking, start=1):
                flat = [f"{angle:.9g}" for pair in angles_of(candidates, ranked) for angle in pair]
                table.writerow([postures, answer.objective.name, rank, ranked.score, ranked.usable, *flat])
    return text.getvalue()
