"""A design as JSON and CSV."""

from collections.abc import Mapping, Sequence
from typing import Any

from lightopt.core.arrays import Bool
from lightopt.design import _result
from lightopt.design._candidates import Candidates, Place, place_dict
from lightopt.design._result import Way
from lightopt.design.objectives._objective import NEAR_PER_MILLE
from lightopt.design.postures._exposures import Brackets
from lightopt.design.search._exact_search import Ranked
from lightopt.images import Overlap, csv_text

# what the share of the initial light positions is of
INITIAL_SHARE_OF = "the drawn patches, in postures chosen for these lights, at exposure 1"


def _between_dict(answer: _result.ObjectiveResult, area: int) -> dict[str, Any] | None:
    between = answer.between
    if between is None:
        return None
    share = answer.objective.share_of_whole(between.bound, area)
    return {
        "bound": between.bound,
        "share_of_inspectable_area": None if share is None else round(share, 6),
        "excess_between": round(between.excess, 6),
    }


def result_document(
    result: _result.DesignResult, listed: Mapping[str, Sequence[Mapping[str, Any]]], overlaps: Sequence[Overlap]
) -> dict[str, Any]:
    """What result.json says; `listed` has its lists of files, `overlaps` go with those of overlap maps."""
    thresholds, choice = result.thresholds, result.all_candidates
    return {
        "format": "lightopt-optimum/1",
        "provenance": dict(result.provenance),
        "thresholds": {
            "black": thresholds.black,
            "shaded_below": thresholds.shade,
            "saturated_from": thresholds.saturation,
        },
        "candidates": [
            {"light": name, "positions_deg": [list(at[:2]) for at in places]}
            | ({"distances_mm": [at[2] for at in places]} if len(places[0]) > 2 else {})
            for name, places in zip(choice.names, choice.places, strict=True)
        ],
        "left_out": [out.as_dict() for out in choice.left_out],
        "results": [
            {
                "postures": [posture.as_dict() for posture in one.postures],
                "inspectable_patches": one.patches,
                "inspectable_area_um2": one.area,
                "grazing_area_um2": one.grazing_area,
                "left_out_of_visible_area": round(one.left_out, 6),
                "grain": round(one.grain, 6),
                "objectives": [_answer_dict(answer, one, result.candidates) for answer in one.answers],
                "lights_as_they_stand": _initial_dict(one),
                "curves": [curve.as_dict() for curve in one.curves],
            }
            for one in result.results
        ],
        **({} if result.blind is None else {"blind_spots": result.blind.as_dict()}),
        **plan_document(result.plan),
        "rigs": listed["rigs"],
        "files": listed["files"],
        "images": listed["images"],
        "overlaps": [
            {**where, **overlap.as_dict()} for where, overlap in zip(listed["overlaps"], overlaps, strict=True)
        ],
    }


def _initial_dict(result: _result.SetResult) -> dict[str, Any] | None:
    if result.initial_score is None:
        return None
    objective = result.answers[0].objective
    share = objective.share_of_whole(result.initial_score, result.area)
    share = None if share is None else round(share, 6)
    return {"objective": objective.name, "score": result.initial_score, "share_of_inspectable_area": share}


def _answer_dict(answer: _result.ObjectiveResult, result: _result.SetResult, candidates: Candidates) -> dict[str, Any]:
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
    near = None
    if answer.proven_of is None:
        of = "the best score" if answer.objective.share_of is None else "the inspectable area"
        near = {"combinations": found.near, "at_least": not found.near_exact, "within": NEAR_PER_MILLE / 1000, "of": of}
    share = answer.objective.share_of_whole(found.best.score, result.area)

    def lights_of(ranked: Ranked) -> list[dict[str, Any]]:
        return _lights(candidates.names, _result.places_of(candidates, ranked))

    return {
        **facts,
        "lights": lights_of(found.best),
        "score": found.best.score,
        "share_of_inspectable_area": None if share is None else round(share, 6),
        "share_of": answer.objective.share_of,
        "usable_sum": found.best.usable,
        "runner_up": None if runner_up is None else {"lights": lights_of(runner_up), "score": runner_up.score},
        "gap": found.gap,
        "ties": found.ties if answer.proven_of is None else None,
        "near_best": near,
        "combinations": combinations if answer.proven_of is None else None,
        "bound": found.bound,
        "between_candidates": _between_dict(answer, result.area),
        "proven": found.proven,
        **({"complete": found.complete} if answer.proven_of is None else {"proven_of": answer.proven_of}),
        "scores_under": dict(answer.scores),
        **answer.details,
    }


def _lights(names: Sequence[str], places: Sequence[Place]) -> list[dict[str, Any]]:
    return [{"light": name, **place_dict(place)} for name, place in zip(names, places, strict=True)]


def plan_document(result: _result.PlanResult) -> dict[str, Any]:
    """The sections of a plan in result.json; terminal and report show them."""
    sections: dict[str, Any] = {}
    if result.chosen is not None:
        sections["chosen_postures"] = _chosen_dict(result.chosen)
    if result.brackets is not None:
        shares_of = _result.SHARES_OF if result.chosen else _result.OWN_SHARES_OF
        sections["exposures"] = _brackets_dict(result.brackets, shares_of)
        if result.defects:
            sections["exposures"]["defects"] = dict(result.defects)
    if result.tolerances:
        sections["tolerances"] = [_tolerance_dict(one) for one in result.tolerances]
    if result.commands:
        sections["commands"] = [command.text for command in result.commands]
        sections["rounds"] = [
            {"command": command.text, **_way_dict(command.way)} for command in result.commands if command.way
        ]
    return sections


def _way_dict(way: Way) -> dict[str, Any]:
    return {"order_of_travel": [posture.as_dict() for posture in way.order], "travel_s": round(way.seconds, 3)}


def _chosen_dict(chosen: _result.ChosenPostures) -> dict[str, Any]:
    cover = chosen.choice.cover
    total = max(1, cover.total)
    initial = None
    if (before := chosen.choice.initial_if_moved) is not None:
        initial = {"share": round(before.share, 6), "postures": len(before.steps), "share_of": INITIAL_SHARE_OF}
    table, detection = chosen.evaluator.table, chosen.evaluator.detection
    assert detection is not None
    inspectable, areas = table.inspectable_anywhere, table.patches.areas

    def area_share(which: Bool) -> float:
        return round(float(areas[which].sum() / areas.sum()), 6)

    return {
        "min_images": detection.min_images,
        "false_alarms": detection.false_alarms,
        "requested": chosen.plan.choose_postures,
        "target": chosen.plan.target,
        "share": round(cover.share, 6),
        "shares_of": _result.SHARES_OF,
        "optimum": "proven" if chosen.proven else "local",
        "bound": round(cover.bound_share, 6),
        "best_of_sets": cover.sets,
        "proven_with_these_lights": cover.proven,
        "greedy_guarantee": round(cover.guarantee, 6),
        "fewest_possible": cover.min_size,
        "all_candidates": round(cover.all_covered / total, 6),
        "lights_as_they_stand": initial,
        "postures": [
            {
                **posture.as_dict(),
                "exposures": list(chosen.choice.exposures_of(posture)),
                "gain": round(step.gain / (cover.k * total), 6),
                "share": round(step.covered / total, 6),
            }
            for posture, step in zip(chosen.choice.postures, cover.steps, strict=True)
        ],
        "postures_to_a_tenth_of_a_point": chosen.sufficient,
        **_way_dict(chosen.way),
        "travel_pace": chosen.pace,
        "candidates": len(table.postures),
        "left_out": [{**out.posture.as_dict(), "kind": out.kind, "reason": out.reason} for out in chosen.left_out],
        "iterations": chosen.choice.iterations,
        "starts": chosen.choice.starts,
        "every_combination_tried": chosen.choice.exact,
        "iterations_on_all_patches": chosen.choice.on_all_patches,
        "lights_best_for_postures": chosen.choice.exact and chosen.choice.converged,
        "patches": {
            "drawn": chosen.drawn,
            "all": len(chosen.evaluator.patches),
            "max_edge_mm": round(table.max_edge, 6),
            "footprint_mm": round(table.footprint, 6),
            "grain": round(table.grain, 6),
        },
        "inspectable_share_of_surface": area_share(inspectable),
        "left_out_share_of_surface": area_share(table.visible.any(axis=0) & ~inspectable),
        "bounds_with_any_of_exposures": list(chosen.plan.all_exposures),
    }


def _brackets_dict(brackets: Brackets, shares_of: str) -> dict[str, Any]:
    return {
        "shares_of": shares_of,
        "share_without": round(brackets.before, 6),
        "share": round(brackets.after, 6),
        "least_gain": brackets.least_gain,
        "grain": round(brackets.grain, 6),
        "shots": [
            {"posture": one.posture.as_dict(), "exposure": one.exposure, "gain": round(one.gain, 6)}
            | {"planned": one.reason is not None, "planned_for": one.reason}
            for one in brackets.further
        ],
    }


def _tolerance_dict(one: _result.ToleranceResult) -> dict[str, Any]:
    robustness = one.robustness

    def share(score: int) -> float:
        return round(score / max(1, robustness.score), 6)

    return {
        "postures": [posture.as_dict() for posture in one.postures],
        "patches": one.patches,
        "grain": round(one.grain, 6),
        "score": robustness.score,
        "unit": one.unit,
        "worst_corner": {
            "share_of_score": share(robustness.worst),
            "part": dict(zip(("tilt_deg", "rotation_deg"), robustness.worst_pose, strict=True)),
            "lights": _lights(robustness.lights, robustness.worst_lights),
        },
        "quantile_5_percent": share(robustness.quantile),
        "least_drawn": share(robustness.least_drawn),
        "widest": [
            {"what": one.what, "angle": one.angle, "degrees": round(one.degrees, 4), "or_more": one.open_ended}
            for one in robustness.widest
        ],
    }


def ranking_csv(results: tuple[_result.SetResult, ...], candidates: Candidates) -> str:
    """The best combinations of each posture and objective, one a line."""
    keys = [
        f"{name}_{key}"
        for name, some in zip(candidates.names, candidates.places, strict=True)
        for key in place_dict(some[0])
    ]
    rows: list[list[object]] = [["postures", "objective", "rank", "score", "usable_sum", *keys]]
    for result in results:
        postures = " ".join(f"{p.elevation_deg:g},{p.rotation_deg:g}" for p in result.postures)
        for answer in result.answers:
            if answer.nothing is not None:
                continue
            for rank, ranked in enumerate(answer.found.ranking, start=1):
                flat = [f"{value:.9g}" for place in _result.places_of(candidates, ranked) for value in place]
                rows.append([postures, answer.objective.name, rank, ranked.score, ranked.usable, *flat])
    return csv_text(rows)
