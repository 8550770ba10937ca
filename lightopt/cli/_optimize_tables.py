"""The answers of ``lightopt optimize`` as tables on the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from lightopt.cli._terminal import say, show_table
from lightopt.errors import counted

if TYPE_CHECKING:
    from lightopt.optimize import Answer, BlindReport, Optimum, SetResult
    from lightopt.overlap import Overlap

__all__ = ["show_blind_spots", "show_optimum", "show_overlaps"]


def show_optimum(found: Optimum) -> None:
    """Candidates, the best sets with every objective's score, overlaps, and where the files are."""
    candidates = found.candidates
    for out in candidates.left_out:
        say(
            f"left out: {out.light} at elevation {out.elevation_deg:g}°, azimuth {out.azimuth_deg:g}°: it {out.reason}"
        )
    if found.patches is not None:
        say(found.patches)
    if found.reused:
        matrices = "matrix" if found.reused == 1 else "matrices"
        say(f"{found.reused} kept luminance {matrices} reused")
    _show_best(found)
    if found.blind is not None:
        _show_defects(found)
        show_blind_spots(found.blind)
    if found.written.overlaps:
        show_overlaps(found.written.overlaps)
    rigs = [path for path, _ in found.written.rigs]
    report = [] if found.written.report is None else [found.written.report]
    for path in (found.written.result, found.written.ranking, *found.written.files, *rigs, *report):
        say(f"{path}")


def _show_best(found: Optimum) -> None:
    names = [answer.objective.name for answer in found.results[0].answers]
    header = ["posture", "best for", *found.candidates.names, *names, "runner-up", "ties", "combinations"]
    rows: list[list[str]] = []
    for result in found.results:
        posture = ", ".join(map(str, result.postures))
        for answer in result.answers:
            rows.append([posture, answer.objective.name, *_cells(answer, result, found)])
            posture = ""
    show_table(header, rows, numbers_from=2)
    say("shares are of the surface that the camera sees in the posture")


def _cells(answer: Answer, result: SetResult, found: Optimum) -> list[str]:
    from lightopt.optimize import angles_of, gap_text, looked_text, score_text, ties_text

    best = answer.found
    looked = looked_text(best)
    if answer.nothing is not None:
        blank = ["-"] * (len(found.candidates.names) + len(result.answers))
        return [*blank, "-", "all 0", looked]
    angles = [
        f"{elevation:g}°, {azimuth:g}°" for elevation, azimuth in angles_of(found.candidates, best.best)
    ]
    objectives = {other.objective.name: other.objective for other in result.answers}
    scores = [score_text(value, objectives[name], result.area) for name, value in answer.scores.items()]
    return [*angles, *scores, gap_text(best, answer.objective), ties_text(best), looked]


def _show_defects(found: Optimum) -> None:
    for result in found.results:
        for answer in result.answers:
            facts = answer.details
            if "worst_defect" not in facts or answer.nothing is not None:
                continue
            kinds = ", ".join(f"{name} {100.0 * share:.1f} %" for name, share in facts["defects"].items())
            worst = facts.get("worst_direction_deg")
            least = (
                ""
                if worst is None
                else (
                    f"; walls that lean to {worst:g}° least, {100.0 * facts['directions_deg'][f'{worst:g}']:.1f} %"
                )
            )
            say(
                f"{', '.join(map(str, result.postures))}: best for {answer.objective.name} shows {kinds}{least}"
            )


def show_blind_spots(blind: BlindReport) -> None:
    """What the chosen lights show of the defects, over all postures and in each, and why the rest stays invisible."""
    from lightopt.optimize import blind_text

    parts = blind.parts() if len(blind.postures) > 1 else blind.parts()[:1]
    codes = sorted({code for _, *both in parts for spots in both for code in spots.by_reason()})
    # where nothing was left to choose, what the lights can do is what they do
    both = any(chosen.by_reason() != possible.by_reason() for _, chosen, possible in parts)
    rows = [
        [
            "all" if posture is None else str(posture),
            lights,
            f"{100.0 * spots.seen:.1f} %",
            *(f"{100.0 * spots.by_reason().get(code, 0.0):.1f} %" for code in codes),
        ]
        for posture, chosen, possible in parts
        for lights, spots in (("chosen", chosen), ("any position", possible))[: 2 if both else 1]
    ]
    header = ["posture", "lights", "seen", *(blind_text(code, blind.lights) for code in codes)]
    show_table(header, rows, numbers_from=2)
    images = counted(blind.objective.seen_in, "image")
    own = "; a posture's own images in its row, those of all postures in all" if len(parts) > 1 else ""
    say(f"shares of the part's whole surface × defects, seen in {images} or more{own}")


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
