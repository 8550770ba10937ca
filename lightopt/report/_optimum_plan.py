"""What was planned beside the lights, as result.json has it: defects seen, blind spots, postures, exposures, trust."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from lightopt.errors import counted
from lightopt.optimize import Draft
from lightopt.report._page import Block, Facts, Note, Table
from lightopt.transforms import Posture

__all__ = ["blind_tables", "defect_blocks", "exposure_blocks", "posture_blocks", "trust_blocks"]


def defect_blocks(draft: Draft) -> list[Block]:
    """The share of each kind of defect that is seen, and the directions of walls that are seen worst."""
    answers = [
        (group["postures"], answer)
        for group in draft.document["results"]
        for answer in group["objectives"]
        if "defects" in answer and answer["lights"] is not None
    ]
    if not answers:
        return []
    names = list(answers[0][1]["defects"])
    rows = [
        [
            _postures(postures),
            *(_percent(answer["defects"][name]) for name in names),
            str(answer["worst_defect"]),
            f"{answer['worst_direction_deg']:g}°" if "worst_direction_deg" in answer else "-",
        ]
        for postures, answer in answers
    ]
    images = counted(answers[0][1]["seen_in"], "image")
    caption = f"Shares of the surface that the camera sees on which {images} or more of the posture show the defect."
    header = ["posture", *names, "seen worst", "walls that lean to"]
    return [Table(header=header, rows=rows, caption=caption)]


def blind_tables(draft: Draft) -> list[Block]:
    """How much of the surface × defects stays invisible, and why."""
    spots = draft.document.get("blind_spots")
    if spots is None:
        return []
    groups = [("all postures", spots)] if len(spots["postures"]) != 1 else []
    groups += [(f"posture {_posture(one['posture'])}", one) for one in spots["postures"]]
    sides = (("chosen", "as found"), ("any_position", "wherever they can stand"))
    entries = [(name, lights, group[key]) for name, group in groups for key, lights in sides]
    reasons = list(dict.fromkeys(one["reason"] for *_, facts in entries for one in facts["blind"]))
    rows: list[list[str]] = []
    for name, lights, facts in entries:
        shares = {one["reason"]: one["share"] for one in facts["blind"]}
        lost = [_percent(shares.get(reason, 0.0)) for reason in reasons]
        rows.append([name, lights, _percent(facts["seen"]), *lost])
    images = counted(spots["seen_in"], "image")
    caption = f"Shares of {spots['shares_of']}; seen: in {images} or more, of a posture or of all."
    header = ["posture", "lights", "seen", *reasons]
    return [Table(header=header, rows=rows, numbers_from=2, caption=caption)]


def posture_blocks(draft: Draft) -> list[Block]:
    """The postures that were chosen, what each adds, and what is proven about the choice."""
    chosen = draft.document.get("chosen_postures")
    if chosen is None:
        return []
    rows = [[str(_posture(one)), _percent(one["gain"]), _percent(one["share"])] for one in chosen["postures"]]
    facts = [
        ("chosen from", f"{counted(chosen['candidates'], 'posture')} that the stage reaches"),
        ("the same number of others shows at most", _percent(chosen["bound"])),
        ("all candidates together show", _percent(chosen["all_candidates"])),
        ("with the lights as they stood", _percent(chosen["lights_as_they_stand"])),
        (
            "the camera sees, in some posture",
            f"{_percent(chosen['visible_share_of_surface'])} of the surface",
        ),
        (
            "order of least travel",
            f"{' → '.join(str(_posture(one)) for one in chosen['order_of_travel'])}, {chosen['travel_s']:.1f} s",
        ),
    ]
    k = chosen["seen_in"]
    if k == 1:
        guarantee = f"{_percent(chosen['greedy_guarantee'])} of the best"
        facts.append(("a greedy choice has at least", guarantee))
    if chosen["target"] is not None and chosen["fewest_possible"] is not None:
        needed = counted(chosen["fewest_possible"], "posture")
        facts.append((f"{_percent(chosen['target'])} takes at least", needed))
    caption = (
        "Of the surface × defects: what each posture shows that those before it do not, and what it shows with them."
        if k == 1
        else f"Of the surface × defects: adds, images new to a patch and defect, up to {k} of each; together, what "
        f"is seen in {k} images or more."
    )
    blocks: list[Block] = [
        Table(header=["posture", "adds", "together"], rows=rows, caption=caption),
        Facts(rows=facts),
    ]
    if chosen["left_out"]:
        left = [[str(_posture(one)), one["reason"]] for one in chosen["left_out"]]
        blocks.append(Table(header=["posture", "left out since"], rows=left, numbers_from=2))
    return [*blocks, *_commands(draft.document)]


def exposure_blocks(draft: Draft) -> list[Block]:
    """Which further exposures pay."""
    planned = draft.document.get("exposures")
    if planned is None:
        return []
    rows = [
        [
            str(_posture(shot["posture"])),
            f"{shot['exposure']:g}",
            _percent(shot["gain"], digits=2),
            "yes" if shot["planned"] else "no",
        ]
        for shot in planned["shots"]
    ]
    text = (
        f"With the planned exposures {_percent(planned['share'])} of the surface × defects is seen, with exposure 1 "
        f"alone {_percent(planned['share_without'])}. One is planned where it adds "
        f"{_percent(planned['least_gain'], digits=2)} or more."
    )
    blocks: list[Block] = [
        Note(text=text),
        Table(header=["posture", "exposure", "adds", "planned"], rows=rows),
    ]
    return blocks if "chosen_postures" in draft.document else [*blocks, *_commands(draft.document)]


def trust_blocks(draft: Draft) -> list[Block]:
    """How far the score falls when angles are off, and how wide each may be."""
    trust = draft.document.get("trust")
    if not trust:
        return []
    header = ["off by the tolerance", *(_postures(one["postures"]) for one in trust)]
    rows = [
        ["worst corner keeps", *(_percent(one["worst_corner"]["share_of_score"]) for one in trust)],
        ["95 % of draws keep", *(_percent(one["quantile_5_percent"]) for one in trust)],
    ]
    for index, widest in enumerate(trust[0]["widest"]):
        cells = [
            f"{'≥ ' if one['widest'][index]['or_more'] else ''}{one['widest'][index]['degrees']:.2f}°"
            for one in trust
        ]
        rows.append([f"widest: {widest['what']} {widest['angle']}", *cells])
    return [Table(header=header, rows=rows, caption="Shares of the score.")]


def _commands(document: Mapping[str, Any]) -> list[Block]:
    return [Note(text=command) for command in document.get("commands", ())]


def _posture(facts: Mapping[str, Any]) -> Posture:
    return Posture(facts["elevation_deg"], facts["rotation_deg"])


def _postures(postures: Sequence[Mapping[str, Any]]) -> str:
    if len(postures) == 1:
        return f"posture {_posture(postures[0])}"
    return f"all {len(postures)} postures"


def _percent(share: float, *, digits: int = 1) -> str:
    return f"{100.0 * share:.{digits}f} %"
