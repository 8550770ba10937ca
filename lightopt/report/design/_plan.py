"""What was planned beside the lights, from result.json: defects, blind spots, postures, exposures, tolerances."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from lightopt.core.errors import counted, percent
from lightopt.core.transforms import Posture
from lightopt.design import BLIND_LIGHTS, DesignOutput, share_text
from lightopt.report._page import Block, Facts, Note, Table


def defect_tables(document: Mapping[str, Any]) -> list[Table]:
    """The share of each kind of defect that is found, and the orientation of long defects that is found worst."""
    answers = [
        (group["postures"], answer, group["grain"])
        for group in document["results"]
        for answer in group["objectives"]
        if "defects" in answer and answer["lights"] is not None
    ]
    if not answers:
        return []
    names = list(answers[0][1]["defects"])
    rows: list[list[str]] = []
    for postures, answer, grain in answers:
        turn = f"{answer['worst_direction_deg']:g}°" if "worst_direction_deg" in answer else "-"
        shares = (share_text(answer["defects"][name], grain) for name in names)
        rows.append([_postures(postures), *shares, str(answer["worst_defect"]), turn])
    caption = (
        f"Shares of {answers[0][1]['share_of']}, on which the defect is found. Orientations of long defects are "
        "counted as direction_deg of defects: in the tangent plane, counterclockwise seen from outside, from the X "
        "axis of the mesh file."
    )
    header = ["posture", *names, "kind found worst", "orientation found worst"]
    return [Table(header=header, rows=rows, caption=caption)]


def blind_tables(document: Mapping[str, Any]) -> list[Table]:
    """How much of the surface × defects stays invisible, and why."""
    spots = document.get("blind_spots")
    if spots is None:
        return []
    groups = [("all postures", spots)] if len(spots["postures"]) != 1 else []
    groups += [(f"posture {Posture.from_dict(one['posture'])}", one) for one in spots["postures"]]
    sides = tuple(zip(("chosen", "any_position"), BLIND_LIGHTS, strict=True))
    entries = [(name, lights, group[key]) for name, group in groups for key, lights in sides]
    text = partial(share_text, grain=spots["grain"])
    reasons = list(dict.fromkeys(one["reason"] for *_, facts in entries for one in facts["blind"]))
    rows: list[list[str]] = []
    for name, lights, facts in entries:
        shares = dict.fromkeys(reasons, 0.0) | {one["reason"]: one["share"] for one in facts["blind"]}
        cells = [text(share) for share in (facts["seen"], *shares.values(), facts["left_out_of_surface"])]
        rows.append([name, lights, *cells])
    caption = (
        f"Shares of {spots['shares_of']}. Found: by the images of one posture or of all postures together. "
        f"{BLIND_LIGHTS[1].capitalize()}: every light wherever it shows that defect; no one set of positions need show "
        "all of it. Left out: of the whole surface, what the camera sees at a grazing angle or an edge only."
    )
    header = ["posture", "lights", "found", *reasons, "left out"]
    return [Table(header=header, rows=rows, numbers_from=2, caption=caption)]


def posture_blocks(output: DesignOutput) -> list[Block]:
    """The postures that were chosen, what each adds, and what is proven about the choice."""
    chosen = output.document.get("chosen_postures")
    if chosen is None:
        return []
    blocks: list[Block] = [posture_table(chosen), Facts(rows=posture_facts(chosen, output.document.get("rounds", ())))]
    if chosen["left_out"]:
        left = [[str(Posture.from_dict(one)), one["reason"]] for one in chosen["left_out"]]
        blocks.append(Table(header=["posture", "left out because"], rows=left, numbers_from=2))
    return [*blocks, *_commands(output.document)]


def posture_table(chosen: Mapping[str, Any], *, with_exposures: bool = True) -> Table:
    """The chosen postures in the order of travel, from ``chosen_postures`` of result.json."""
    text = partial(share_text, grain=chosen["patches"]["grain"])
    numbered = {Posture.from_dict(one): (number, one) for number, one in enumerate(chosen["postures"], start=1)}
    rows: list[list[str]] = []
    for posture in map(Posture.from_dict, chosen["order_of_travel"]):
        number, one = numbered[posture]
        exposures = [", ".join(f"{exposure:.9g}" for exposure in one["exposures"])] if with_exposures else []
        rows.append([str(posture), str(number), *exposures, text(one["gain"]), text(one["share"])])
    caption = (
        "In the order of least travel, if all postures are captured in one round. Of the surface × defects: adds, the "
        "evidence that the posture adds to that of the postures chosen before it, as a share of all that is needed; "
        f"together, what is found in them. Shares refer to {chosen['shares_of']}."
    )
    header = ["posture", "chosen as no.", *(["exposures"] if with_exposures else []), "adds", "together"]
    return Table(header=header, rows=rows, caption=caption)


def posture_facts(chosen: Mapping[str, Any], rounds: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """What is known of the choice of postures, from ``chosen_postures`` and ``rounds`` of result.json."""
    patches = chosen["patches"]
    text = partial(share_text, grain=patches["grain"])
    count, sufficient = len(chosen["postures"]), chosen["postures_to_a_tenth_of_a_point"]
    grain = (
        f"{patches['all']:,} patches with edges up to {patches['max_edge_mm']:.3g} mm, where a pixel has "
        f"{patches['footprint_mm']:.3g} mm: shares may be off by some {100.0 * patches['grain']:.1g} points"
    )
    sight = [text(chosen[f"{which}_share_of_surface"]) for which in ("inspectable", "left_out")]
    facts = [
        ("chosen from", f"{counted(chosen['candidates'], 'posture')} that the stage reaches"),
        ("maximum for the same number of postures", _bound(chosen, text(chosen["bound"]))),
        ("all candidates together show", text(chosen["all_candidates"])),
        (
            "the camera sees, in some posture",
            f"{sight[0]} of the surface; {sight[1]} is left out, seen at a grazing angle or an edge only",
        ),
        ("travel from (0°, 0°)", _travel(chosen, rounds)),
        ("resolution", grain),
    ]
    if (initial := chosen["lights_as_they_stand"]) is not None:
        share = f"{text(initial['share'])} in {counted(initial['postures'], 'posture')}, of {initial['share_of']}"
        facts.append(("with the lights in their old positions", share))
    if sufficient < count:
        facts.append((f"the first {sufficient} chosen show", text(chosen["postures"][sufficient - 1]["share"])))
    if chosen["requested"] is not None and chosen["target"] is None and count < chosen["requested"]:
        facts.append(("postures requested", str(chosen["requested"])))
    if not chosen["proven_with_these_lights"]:
        guarantee = f"{text(chosen['greedy_guarantee'])} of the maximum with these lights"
        facts.append(("these postures reach at least", guarantee))
    if chosen["target"] is not None and chosen["fewest_possible"] is not None:
        needed = counted(chosen["fewest_possible"], "posture")
        facts.append((f"{100.0 * chosen['target']:.9g} % needs at least", needed))
    return facts


def exposure_blocks(output: DesignOutput) -> list[Block]:
    planned = output.document.get("exposures")
    if planned is None:
        return []
    blocks: list[Block] = [Note(text=exposure_note(planned)), exposure_table(planned)]
    return blocks if "chosen_postures" in output.document else [*blocks, *_commands(output.document)]


def exposure_note(planned: Mapping[str, Any]) -> str:
    """What the planned exposures show, and what was planned, from ``exposures`` of result.json."""
    text = partial(share_text, grain=planned["grain"])
    why = {shot["planned_for"] for shot in planned["shots"]}
    needed = ", or twice that together with another" * ("pair" in why)
    needed += ", or if the target needs it" * ("target" in why)
    return (
        f"With the planned exposures {text(planned['share'])} of the surface × defects is seen, with exposure 1 "
        f"alone {text(planned['share_without'])}. An exposure is planned if it adds "
        f"{100.0 * planned['least_gain']:g} % or more{needed}."
    )


def exposure_table(planned: Mapping[str, Any]) -> Table:
    """The exposures that were considered, from ``exposures`` of result.json."""
    rows: list[list[str]] = []
    for shot in planned["shots"]:
        gain, is_planned = share_text(shot["gain"], planned["grain"]), "yes" if shot["planned"] else "no"
        rows.append([str(Posture.from_dict(shot["posture"])), f"{shot['exposure']:g}", gain, is_planned])
    return Table(header=["posture", "exposure", "adds", "planned"], rows=rows)


def tolerance_blocks(output: DesignOutput) -> list[Block]:
    """How far the score falls when angles are off, and how wide each may be."""
    tolerances = output.document.get("tolerances")
    if not tolerances:
        return []
    offsets = output.document["provenance"]["options"]["tolerances"]
    caption = (
        f"Shares of the score that remain if lights are off by {offsets['light_deg']:g}° and the part by "
        f"{offsets['pose_deg']:g}° in each of their angles: in the worst corner, and in random draws. Widest: how far "
        f"each angle alone, or those of all lights, may be off, in steps of 0.05°, while at least "
        f"{percent(offsets['target'], 0)} remain."
    )
    return [replace(tolerance_table(tolerances), caption=caption)]


def tolerance_table(tolerances: Sequence[Mapping[str, Any]]) -> Table:
    """What misalignment leaves of the scores, from ``tolerances`` of result.json."""
    corners = [share_text(one["worst_corner"]["share_of_score"], one["grain"]) for one in tolerances]
    draws = [share_text(one["quantile_5_percent"], one["grain"]) for one in tolerances]
    rows = [["worst corner keeps", *corners], ["95 % of draws keep", *draws]]
    for same in zip(*(one["widest"] for one in tolerances), strict=True):
        cells = [f"{'≥ ' * widest['or_more']}{widest['degrees']:.2f}°" for widest in same]
        rows.append([f"widest: {same[0]['what']}, {same[0]['angle']}", *cells])
    return Table(header=["off by the tolerance", *(_postures(one["postures"]) for one in tolerances)], rows=rows)


def plan_proof(chosen: Mapping[str, Any]) -> str:
    """What is proven of the postures and lights, from ``chosen_postures`` of result.json."""
    number = counted(len(chosen["postures"]), "posture")
    if chosen["optimum"] == "proven":
        return f"Proven for these patches: no {number} of the {chosen['candidates']} show more."
    sets = f"no {number} of the {chosen['candidates']} show"
    if chosen["best_of_sets"] is not None:
        sets = f"none of the {chosen['best_of_sets']:,} sets of {number} shows"
    more = (
        "" if chosen["proven_with_these_lights"] else f" than {share_text(chosen['bound'], chosen['patches']['grain'])}"
    )
    whatever = ", at any of the candidate exposures" * (len(chosen["bounds_with_any_of_exposures"]) > 1)
    bound = f"Proven: with these lights {sets} more{more}{whatever}."
    if not chosen["iterations"]:
        return f"{bound} No light moves."
    if chosen["lights_best_for_postures"]:
        bound += " Proven: in these postures no other positions of the lights show more."
    return (
        f"{bound} A local optimum: other postures with other lights may show more; the lights were placed for the "
        f"postures, and the postures chosen for the lights, {_search_text(chosen)}."
    )


def _search_text(chosen: Mapping[str, Any]) -> str:
    """How postures and lights were searched: iterations, starts, patches."""
    tried = "every combination" if chosen["every_combination_tried"] else "one light moved at a time"
    drawn, patches = chosen["patches"]["drawn"], chosen["patches"]["all"]
    where = f"on {drawn:,} of {patches:,} patches"
    if chosen["iterations_on_all_patches"]:
        where = f"on all {patches:,} patches"
        if drawn != patches:
            where = f"on {drawn:,} patches, then {where}"
    iterations, starts = counted(chosen["iterations"], "iteration"), counted(chosen["starts"], "start")
    return f"in {iterations}, the best of {starts} ({tried}) {where}"


def _bound(chosen: Mapping[str, Any], share: str) -> str:
    sets = chosen["best_of_sets"]
    if sets is None:
        return share
    best = "these are the best" if chosen["proven_with_these_lights"] else "the maximum"
    return f"{share}: {best} of all {sets:,} sets with these lights"


def _travel(chosen: Mapping[str, Any], rounds: Sequence[Mapping[str, Any]]) -> str:
    text = f"{chosen['travel_s']:.1f} s {chosen['travel_pace']}"
    if len(rounds) < 2:
        return text
    each = " + ".join(f"{one['travel_s']:.1f}" for one in rounds)
    total = sum(one["travel_s"] for one in rounds)
    ways = "; ".join(" → ".join(str(Posture.from_dict(p)) for p in one["order_of_travel"]) for one in rounds)
    return (
        f"{text}, if all postures are captured in one round; the {len(rounds)} capture commands below take {each} = "
        f"{total:.1f} s, each starting at (0°, 0°): {ways}"
    )


def _commands(document: Mapping[str, Any]) -> list[Block]:
    commands = document.get("commands", ())
    lead = [Note(text="Commands to carry out the plan, to be run in the folder of this report:")] if commands else []
    return [*lead, *(Note(text=command) for command in commands)]


def _postures(postures: Sequence[Mapping[str, Any]]) -> str:
    return postures_text([Posture.from_dict(one) for one in postures])


def postures_text(postures: Sequence[Posture]) -> str:
    return f"posture {postures[0]}" if len(postures) == 1 else f"all {len(postures)} postures"
