"""The answers of ``lightopt optimize`` as tables on the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from lightopt.cli._terminal import echo, show_table, together
from lightopt.core.errors import counted

if TYPE_CHECKING:
    from lightopt.design import BlindSpotSummary, DesignOutput, DesignResult, Objective, ObjectiveResult, SetResult
    from lightopt.images import Overlap


def show_design(output: DesignOutput, *, verbose: bool) -> None:
    """The best sets with every objective's score, and the files; with `verbose` all other tables as well."""
    result = output.result
    _show_best(result, verbose=verbose)
    if verbose:
        _show_inputs(result)
    if result.blind is not None:
        if verbose:
            _show_defects(result)
            show_blind_spots(result.blind)
        else:
            _summarise_blind_spots(result.blind)
    if output.overlaps and verbose:
        show_overlaps(output.overlaps)
    for path in output.paths:
        echo(f"{path}")


def _show_inputs(result: DesignResult) -> None:
    for out in result.all_candidates.left_out:
        echo(
            f"left out: {out.light} at elevation {out.elevation_deg:g}°, azimuth {out.azimuth_deg:g}°: it {out.reason}"
        )
    if result.patches is not None:
        echo(result.patches.message)
    if result.reused:
        matrices = "matrix" if result.reused == 1 else "matrices"
        echo(f"{result.reused} stored luminance {matrices} reused")


def _show_best(found: DesignResult, *, verbose: bool) -> None:
    names = [answer.objective.name for answer in found.results[0].answers]
    counts = ("left out", "runner-up", "ties", "near best", "combinations")
    header = ["posture", "best for", *found.candidates.names, *names, *counts]
    rows: list[list[str]] = []
    for result in found.results:
        posture = together(result.postures)
        for answer in result.answers:
            rows.append([posture, answer.objective.name, *_cells(answer, result, found)])
            posture = ""
    show_table(header, rows, numbers_from=2)
    if verbose:
        _explain([answer.objective for answer in found.results[0].answers])


def _explain(objectives: Sequence[Objective]) -> None:
    """What the columns of the table are, and what the shares of scores are shares of, a line for each surface."""
    from lightopt.design import LEFT_OUT_MEANING, near_meaning, shares_of

    for surface, names in shares_of(objectives).items():
        echo(f"shares of {' and '.join(names)}: of {surface}")
    echo(LEFT_OUT_MEANING)
    echo(near_meaning(objectives))
    echo("of each light its elevation and its azimuth about Z from +X")


def _cells(answer: ObjectiveResult, result: SetResult, found: DesignResult) -> list[str]:
    from lightopt.design import (
        angles_of,
        combinations_counted_text,
        gap_text,
        left_out_text,
        near_text,
        score_text,
        ties_text,
    )

    best = answer.found
    counted_text = combinations_counted_text(answer)
    if answer.nothing is not None:
        blank = ["-"] * (len(found.candidates.names) + len(result.answers))
        return [*blank, left_out_text(result), "-", "all 0", "all 0", counted_text]
    angles = [f"{elevation:g}°, {azimuth:g}°" for elevation, azimuth in angles_of(found.candidates, best.best)]
    objectives = {other.objective.name: other.objective for other in result.answers}
    scores = [score_text(value, objectives[name], result) for name, value in answer.scores.items()]
    counts = [gap_text(answer, result), ties_text(answer), near_text(answer), counted_text]
    return [*angles, *scores, left_out_text(result), *counts]


def _show_defects(found: DesignResult) -> None:
    from lightopt.design import share_text

    for result in found.results:
        for answer in result.answers:
            facts = answer.details
            if "worst_defect" not in facts or answer.nothing is not None:
                continue
            kinds = ", ".join(f"{name} {share_text(share, result.grain)}" for name, share in facts["defects"].items())
            worst = facts.get("worst_direction_deg")
            least = (
                ""
                if worst is None
                else (
                    f"; walls that lean to {worst:g}° (from the mesh file's X axis, as direction_deg of defects) "
                    f"least, {share_text(facts['directions_deg'][f'{worst:g}'], result.grain)}"
                )
            )
            which = f"{together(result.postures)}{' postures' * (len(result.postures) > 1)}"
            echo(
                f"{which}: best for {answer.objective.name} shows {kinds}{least}; shares as those of "
                f"{answer.objective.name}"
            )


def _summarise_blind_spots(blind: BlindSpotSummary) -> None:
    """What the chosen lights show of the defects over all postures, in one line."""
    from lightopt.design import BLIND_SHARES_OF, blind_text, share_text

    _, chosen, _ = blind.parts()[0]
    reasons = "; ".join(
        f"{blind_text(code, blind.lights)} {share_text(share, chosen.grain)}"
        for code, share in sorted(chosen.by_reason().items())
    )
    echo(f"seen {share_text(chosen.seen, chosen.grain)} of {BLIND_SHARES_OF}; {reasons}")


def show_blind_spots(blind: BlindSpotSummary) -> None:
    """What the chosen lights show of the defects, over all postures and in each, and why the rest stays invisible."""
    from lightopt.design import BLIND_LIGHTS, BLIND_SHARES_OF, blind_text, share_text

    parts = blind.parts() if len(blind.postures) > 1 else blind.parts()[:1]
    codes = sorted({code for _, *both in parts for spots in both for code in spots.by_reason()})
    # where nothing was left to choose, what the lights can do is what they do
    both = any(chosen.by_reason() != possible.by_reason() for _, chosen, possible in parts)
    rows = [
        [
            "all" if posture is None else str(posture),
            lights,
            *(
                share_text(share, spots.grain)
                for share in (spots.seen, *(spots.by_reason().get(code, 0.0) for code in codes), spots.left_out)
            ),
        ]
        for posture, chosen, possible in parts
        for lights, spots in tuple(zip(BLIND_LIGHTS, (chosen, possible), strict=True))[: 2 if both else 1]
    ]
    header = ["posture", "lights", "seen", *(blind_text(code, blind.lights) for code in codes), "left out"]
    show_table(header, rows, numbers_from=2)
    images = counted(blind.objective.min_images, "image")
    own = "; a posture's own images in its row, those of all postures in all" if len(parts) > 1 else ""
    echo(f"shares of {BLIND_SHARES_OF}, seen in {images} or more{own}")
    echo("left out: of the whole surface, what the camera sees at a grazing angle only")
    if both:
        echo(
            f"{BLIND_LIGHTS[1]}: every light wherever it shows that defect; no one set of positions need show all of it"
        )


def show_overlaps(overlaps: Sequence[Overlap]) -> None:
    """Saturated pixels of each light and pair of lights, a line per posture and exposure."""
    rows: list[list[str]] = []
    for overlap in overlaps:
        pairs = [f"{a} & {b}: {pixels:,}" for (a, b), pixels in overlap.pairs.items() if pixels]
        rows.append(
            [
                str(overlap.posture),
                f"{overlap.exposure:g}",
                ", ".join(f"{light} {pixels:,}" for light, pixels in overlap.saturated.items()),
                f"{overlap.pixels:,}",
                ", ".join(pairs) or "none",
            ]
        )
    show_table(["posture", "exposure", "saturated px", "in two or more", "overlaps"], rows, numbers_from=9)
