"""The answers and the plans of ``lightopt optimize`` as tables on the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightopt.cli._terminal import VERBOSE, echo, echo_paths, show_page_table, show_table
from lightopt.core.errors import counted

if TYPE_CHECKING:
    from lightopt import design
    from lightopt.images import Overlap

Section = Mapping[str, Any]  # of result.json, as the report has it

SUMMED_UP_FILES = 3  # so many files beside the main ones, or more, are counted and not listed


def show_design(output: design.DesignOutput) -> None:
    """The best sets with every objective's score, and the main files; of a verbose command all tables and files."""
    from lightopt import design
    from lightopt.report.design import best_table, blind_tables, capture_text, defect_tables

    result, best = output.result, best_table(output)
    if best.rows:
        show_page_table(best)
    if VERBOSE.get():
        echo(best.caption)
    for one in result.results:
        if (gain := one.gain_text) is not None:
            echo(gain if len(result.results) == 1 else f"posture {one.postures[0]}: {gain}")
    if any(one.answers[0].nothing is None for one in result.results):
        echo(f"capture: {capture_text(result)}")
    if VERBOSE.get():
        for out in result.all_candidates.left_out:
            named = zip(design.AXES, design.place_text(out.place).split(", "), strict=False)
            echo(f"left out: {out.light} at {', '.join(map(' '.join, named))}: it {out.reason}")
        if result.patches is not None:
            echo(result.patches.message)
        if result.reused:
            matrices = "matrix" if result.reused == 1 else "matrices"
            echo(f"{result.reused} stored luminance {matrices} reused")
        for table in (*defect_tables(output.document), *blind_tables(output.document)):
            show_page_table(table)
            echo(table.caption)
        if output.overlaps:
            show_overlaps(output.overlaps)
    elif result.blind is not None:
        _, chosen, _ = result.blind.parts[0]
        text = partial(design.share_text, grain=chosen.grain)
        shares = sorted(chosen.by_reason().items())
        reasons = "; ".join(f"{design.blind_text(code, result.blind.lights)} {text(share)}" for code, share in shares)
        echo(f"seen {text(chosen.seen)} of {design.BLIND_SHARES_OF}; {reasons}")
    _show_paths(output)


def _show_paths(output: design.DesignOutput) -> None:
    main = {"report.html", "result.json", "part.planned.yaml"}
    shown = [path for path in output.paths if path.name in main or path.name.startswith("rig.")]
    rest = len(output.paths) - len(shown)
    if VERBOSE.get() or rest < SUMMED_UP_FILES:
        shown, rest = [*output.paths], 0
    echo_paths(*shown)
    if rest:
        echo(f"and {rest} more files in {output.result.folder}; --verbose lists them")


def show_overlaps(overlaps: Sequence[Overlap]) -> None:
    """Saturated pixels of each light and pair of lights, a line per posture and exposure."""
    rows: list[list[str]] = []
    for overlap in overlaps:
        saturated = ", ".join(f"{light} {pixels:,}" for light, pixels in overlap.saturated.items())
        pairs = ", ".join(f"{a} & {b}: {pixels:,}" for (a, b), pixels in overlap.pairs.items() if pixels) or "none"
        rows.append([str(overlap.posture), f"{overlap.exposure:g}", saturated, f"{overlap.pixels:,}", pairs])
    show_table(["posture", "exposure", "saturated px", "in two or more", "overlaps"], rows, numbers_from=9)


def show_plan(result: design.PlanResult) -> None:
    """What a plan shows; of a verbose command also its tables, what the figures mean and how far they hold."""
    from lightopt.design import plan_document
    from lightopt.report.design import exposure_note, exposure_table, tolerance_table

    document = plan_document(result)
    if "chosen_postures" in document:
        _show_postures(document)
    if "exposures" in document:
        planned = document["exposures"]
        if VERBOSE.get():
            show_page_table(exposure_table(planned))
        echo(exposure_note(planned))
        if VERBOSE.get() and "chosen_postures" not in document:
            echo(f"shares of exposures: of {planned['shares_of']}")
    if "tolerances" in document:
        table = tolerance_table(document["tolerances"])
        if VERBOSE.get():
            show_page_table(table)
        else:
            worst, most = (row[-1] for row in table.rows[:2])
            kept = f"the worst corner keeps {worst} of the score, 95 % of random draws keep {most}"
            echo(f"angles off by the tolerances, {table.header[-1]}: {kept}")


def show_commands(result: design.PlanResult, folder: Path) -> None:
    """The commands that carry a plan out; of a verbose command the travel of the stage as well."""
    from lightopt.design import plan_document

    document = plan_document(result)
    if "commands" in document:
        echo(f"commands to carry out the plan, to be run in {folder}:")
        for command in document["commands"]:
            echo(f"  {command}")
        if VERBOSE.get() and len(document["rounds"]) > 1:
            from lightopt.core.transforms import Posture

            for number, one in enumerate(document["rounds"], start=1):
                order = " → ".join(str(Posture.from_dict(posture)) for posture in one["order_of_travel"])
                echo(f"stage, capture {number}: {order}, {one['travel_s']:.1f} s of travel")
            total = sum(one["travel_s"] for one in document["rounds"])
            echo(f"total travel {total:.1f} s, without the returns to (0°, 0°)")


def _show_postures(document: Section) -> None:
    from lightopt.core.transforms import Posture
    from lightopt.design import finding_text, share_text
    from lightopt.report.design import plan_proof, posture_facts, posture_table

    chosen = document["chosen_postures"]
    text = partial(share_text, grain=chosen["patches"]["grain"])
    table = posture_table(chosen, with_exposures=len(chosen["bounds_with_any_of_exposures"]) > 1)
    number = counted(len(chosen["postures"]), "posture")
    meaning = finding_text(chosen["min_images"], chosen["false_alarms"])
    echo(f"{number} of {chosen['candidates']}: {text(chosen['share'])} {meaning}")
    show_page_table(table)
    _show_spare(chosen, text)
    proof = plan_proof(chosen)
    if not VERBOSE.get():
        echo(proof.partition(". ")[0].removesuffix("."))
        return
    echo(proof)
    echo(table.caption)
    for out in chosen["left_out"]:
        echo(f"left out: posture {Posture.from_dict(out)}: {out['reason']}")
    for name, value in posture_facts(chosen, document.get("rounds", ())):
        echo(f"{name}: {value}")


def _show_spare(chosen: Section, text: partial[str]) -> None:
    # fewer postures than were requested, and postures that hardly add anything
    count, sufficient = len(chosen["postures"]), chosen["postures_to_a_tenth_of_a_point"]
    if chosen["requested"] is not None and count < chosen["requested"] and chosen["target"] is None:
        why = "there are no others" if count == chosen["candidates"] else "no other adds anything with these lights"
        echo(f"{counted(chosen['requested'], 'posture')} requested, {count} chosen: {why}")
    if sufficient < count:
        share = text(chosen["postures"][sufficient - 1]["share"])
        echo(f"--choose-postures {sufficient} is nearly as good: these show {share}")
