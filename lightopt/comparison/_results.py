"""What lighting systems show of a part and what they cost: as values, JSON, CSV and a page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lightopt import design, report
from lightopt.config import PartConfig, RigConfig
from lightopt.core.errors import counted, percent
from lightopt.images import csv_text

FORMAT = "lightopt-lighting-comparison/1"
AS_IN_FILE = "as in the file"  # size of the lights of a system
REASONS = 2  # reasons of each system in the table
LEAST_REASON = 0.005  # share of the least of them


@dataclass(frozen=True, kw_only=True)
class SizeResult:
    """What a system of one size of its lights shows."""

    size: str
    folder: Path  # of its design
    share: float  # of the surface × the catalogue's defects that are found


@dataclass(frozen=True, eq=False, kw_only=True)
class SystemResult:
    """What a lighting system shows of the part, adjusted as well as it can be, and what it costs."""

    name: str
    rig: RigConfig
    folder: Path  # of its design, with a report
    share: float  # of the surface × the catalogue's defects that are found
    grain: float  # how far the shares may be off since a patch counts as its middle does
    defects: Mapping[str, float]  # share of each kind of defect
    reasons: Mapping[str, float]  # why the others are not found, as shares of the same
    moved: tuple[str, ...]  # lights that stand elsewhere than their file says
    images: int  # of a part
    seconds: float | None  # for these; None where the rig cannot take them
    size_mm: tuple[float, float, float]  # of the box around the lights along X, Y, Z
    footprint_mm: float  # side of a pixel at the origin
    pictures: tuple[report.Picture, ...]  # of the first posture
    # share that no positions between the candidates exceed; None where none lies between, or that was not computed
    most: float | None = None
    # how far all lights, and the part, may be off while most of the share is kept; None where that was not computed
    mounting: design.WidestTolerance | None = None
    pose: design.WidestTolerance | None = None
    # of its lights, the best of those that its rig file offers, and all that were compared; none where it offers none
    chosen_size: str = ""
    sizes: tuple[SizeResult, ...] = ()

    @property
    def cost(self) -> float:
        """What it is compared by beside the share: seconds, or images where those are unknown."""
        return float(self.images) if self.seconds is None else self.seconds

    @property
    def cost_text(self) -> str:
        return counted(self.images, "image") if self.seconds is None else f"{self.seconds:.1f} s"

    def share_text(self, share: float) -> str:
        """A share to the digits that its grain supports."""
        return design.share_text(share, self.grain)


@dataclass(frozen=True, eq=False, kw_only=True)
class LightingComparison:
    """Lighting systems in the order of the share of defects that they find."""

    part: PartConfig
    options: design.OptimizeOptions
    provenance: Mapping[str, Any]
    systems: tuple[SystemResult, ...]
    unusable: Mapping[str, tuple[str, ...]]  # why systems cannot be used for the part, by name
    warnings: tuple[str, ...]
    paths: tuple[Path, ...]  # of the comparison's files

    @property
    def best(self) -> tuple[SystemResult, ...]:
        """The systems than which no other finds as much in less time, or more in the same (Pareto)."""
        return tuple(
            one
            for one in self.systems
            if not any(
                other.share >= one.share
                and other.cost <= one.cost
                and (other.share, -other.cost) != (one.share, -one.cost)
                for other in self.systems
            )
        )


def comparison_document(comparison: LightingComparison) -> dict[str, Any]:
    best = {one.name for one in comparison.best}
    systems = [
        {
            "system": one.name,
            "rig": {"file": one.rig.source.path.name, "sha256": one.rig.source.sha256},
            "folder": one.folder.name,
            "share": round(one.share, 6),
            "grain": round(one.grain, 6),
            "share_between_candidates": None if one.most is None else round(one.most, 6),
            "pareto": one.name in best,
            "defects": dict(one.defects),
            "not_found": {reason: round(share, 6) for reason, share in one.reasons.items()},
            "images": one.images,
            "seconds": None if one.seconds is None else round(one.seconds, 3),
            "mounting_tolerance": _tolerance_dict(one.mounting),
            "pose_tolerance": _tolerance_dict(one.pose),
            "size_mm": [round(side, 3) for side in one.size_mm],
            "footprint_mm": round(one.footprint_mm, 6),
            "chosen_size": one.chosen_size,
            "sizes": [{"size": s.size, "folder": s.folder.name, "share": round(s.share, 6)} for s in one.sizes],
        }
        for one in comparison.systems
    ]
    return {
        "format": FORMAT,
        "provenance": dict(comparison.provenance),
        "systems": systems,
        "unusable": [{"name": name, "messages": messages} for name, messages in comparison.unusable.items()],
    }


def _tolerance_dict(one: design.WidestTolerance | None) -> dict[str, Any] | None:
    return None if one is None else {"degrees": one.degrees, "or_more": one.open_ended}


def comparison_csv(comparison: LightingComparison) -> str:
    kinds = list(dict.fromkeys(kind for one in comparison.systems for kind in one.defects))
    size = [f"size_{axis}_mm" for axis in "xyz"]
    widest = ["mounting_tolerance_deg", "pose_tolerance_deg"]
    head = ["system", "share", "share_between_candidates", *kinds, "images", "seconds"]
    head += [*widest, *size, "footprint_mm", "pareto", "chosen_size"]
    rows: list[list[object]] = [[*head]]
    best = {one.name for one in comparison.best}
    for one in comparison.systems:
        shares = [f"{one.defects.get(kind, 0.0):.6f}" for kind in kinds]
        seconds = "" if one.seconds is None else f"{one.seconds:.3f}"
        sides = [f"{side:.3f}" for side in one.size_mm]
        widest = ["" if tolerance is None else f"{tolerance.degrees:g}" for tolerance in (one.mounting, one.pose)]
        rest = [*widest, *sides, one.footprint_mm, int(one.name in best), one.chosen_size]
        most = "" if one.most is None else f"{one.most:.6f}"
        rows.append([one.name, f"{one.share:.6f}", most, *shares, one.images, seconds, *rest])
    return csv_text(rows)


def comparison_report(comparison: LightingComparison, folder: Path) -> str:
    systems, first = comparison.systems, comparison.systems[0]
    answer = report.Answer(figure=first.share_text(first.share), text=f"by {first.name}: {_meaning(comparison)}.")
    rest = [f"{one.name} ({one.share_text(one.share)}, {one.cost_text})" for one in comparison.best if one is not first]
    less = f"Less time per part: {', '.join(rest)}. No other system finds as much in as little time."
    lead = [answer, *([report.Note(text=less)] if rest else []), report.Warnings(texts=comparison.warnings)]
    blocks: dict[str, list[report.Table | report.Picture | report.Gallery]] = {
        "Systems": [systems_table(comparison, folder), _chart(comparison)],
        "Kinds of defects": [
            _shares_table(
                systems, [one.defects for one in systems], "Share of each kind that is found, all places alike."
            )
        ],
        "Images": [_gallery(comparison)],
        "Why defects are missed": [
            _shares_table(
                systems,
                [one.reasons for one in systems],
                f"Shares of {design.BLIND_SHARES_OF}, of what the camera sees. Moved: lights whose best place is not "
                "that of their file.",
                moved=True,
            )
        ],
    }
    if any(one.sizes for one in systems):
        blocks["Sizes of lights"] = [_sizes_table(comparison, folder)]
    if comparison.unusable:
        rows = [[name, " ".join(messages)] for name, messages in comparison.unusable.items()]
        blocks["Systems that cannot be used"] = [report.Table(header=["system", "reason"], rows=rows, numbers_from=2)]
    sections = [report.Section(heading=heading, blocks=some) for heading, some in blocks.items()]
    name = comparison.part.name
    return report.page_html(report.Page(title=f"Lighting systems: {name}", subtitle=name, lead=lead, sections=sections))


def answer_text(comparison: LightingComparison) -> str:
    first = comparison.systems[0]
    size = "" if first.chosen_size in ("", AS_IN_FILE) else f" with {first.chosen_size}"
    return f"{first.name}{size} finds most: {first.share_text(first.share)} {_meaning(comparison)}"


def _meaning(comparison: LightingComparison) -> str:
    return design.finding_text(comparison.options.min_images, comparison.options.false_alarms)


def systems_table(comparison: LightingComparison, folder: Path | None = None) -> report.Table:
    """The systems, the best first; for a page in `folder` with links to their designs."""
    best = set(comparison.best)
    rows: list[list[str]] = []
    for one in comparison.systems:
        reasons = [f"{reason} {percent(share, 0)}" for reason, share in one.reasons.items() if share >= LEAST_REASON]
        rows.append(
            [
                one.name,
                one.share_text(one.share) + ("" if one.most is None else f" (≤ {one.share_text(one.most)})"),
                "yes" if one in best else "",
                str(one.images),
                "-" if one.seconds is None else f"{one.seconds:.1f}",
                _tolerance_text(one.mounting),
                _tolerance_text(one.pose),
                " × ".join(f"{side:.0f}" for side in one.size_mm),
                f"{one.footprint_mm:.3g}",
                ", ".join(reasons[:REASONS]) or "-",
            ]
        )
    header = ["system", "found", "Pareto", "images", "s/part", "lights ±°", "part ±°", "size [mm]", "pixel [mm]"]
    caption = (
        "Found: share of surface × defects (≤: with lights between the candidates at most). Pareto: no other system "
        "finds as much in less time per part. Lights ±°, part ±°: how far all angles of the lights, or tilt and "
        "rotation of the part, may be off at once while "
        f"{percent(design.DEFAULT_TOLERANCE_TARGET, 0)} of the share is kept. Size: of the box around the lights along "
        "X, Y, Z. Pixel: its side at the origin."
    )
    folders = [] if folder is None else [one.folder.relative_to(folder) for one in comparison.systems]
    links = [f"{own.as_posix()}/report.html" for own in folders]
    return report.Table(header=[*header, "not found, mostly"], rows=rows, numbers_from=1, caption=caption, links=links)


def _tolerance_text(one: design.WidestTolerance | None) -> str:
    if one is None:
        return "-"
    return f"≥ {one.degrees:g}" if one.open_ended else "< 0.05" if one.degrees == 0.0 else f"{one.degrees:.2g}"


def _shares_table(
    systems: Sequence[SystemResult], shares: Sequence[Mapping[str, float]], caption: str, *, moved: bool = False
) -> report.Table:
    names = list(dict.fromkeys(name for own in shares for name in own))
    rows = [
        [one.name, *(one.share_text(own.get(name, 0.0)) for name in names), *(["; ".join(one.moved)] if moved else [])]
        for one, own in zip(systems, shares, strict=True)
    ]
    return report.Table(header=["system", *names, *(["moved"] if moved else [])], rows=rows, caption=caption)


def _sizes_table(comparison: LightingComparison, folder: Path) -> report.Table:
    every = [(system, size) for system in comparison.systems for size in system.sizes]
    rows = [
        [system.name, own.size, system.share_text(own.share), "yes" if own.size == system.chosen_size else ""]
        for system, own in every
    ]
    links = [f"{own.folder.relative_to(folder).as_posix()}/report.html" for _, own in every]
    caption = "Each size with its lights where they show most. The best size of a system stands for it."
    return report.Table(
        header=["system", "size", "found", "best"], rows=rows, numbers_from=2, caption=caption, links=links
    )


def _gallery(comparison: LightingComparison) -> report.Gallery:
    most = max(len(one.pictures) for one in comparison.systems)
    rows: list[tuple[str, list[report.Picture | None]]] = [
        (one.name, [*one.pictures, *[None] * (most - len(one.pictures))]) for one in comparison.systems
    ]
    caption = "The first posture under the first lights of each system, at exposure 1; red: saturated pixels."
    return report.Gallery(header=[f"image {i + 1}" for i in range(most)], rows=rows, caption=caption)


@report.fixed_style()
def _chart(comparison: LightingComparison) -> report.Picture:
    known = all(one.seconds is not None for one in comparison.systems)
    label, shares = "seconds per part" if known else "images per part", ["defects found [%]"]
    figure, (panel,) = report.chart(title="What is found, and what it takes", x_label=label, labels=shares)
    for one in comparison.systems:
        x = one.cost if known else float(one.images)
        panel.plot([x], [100.0 * one.share], "o", color="#c2410c" if one in comparison.best else "#8a8f98")
        panel.annotate(one.name, (x, 100.0 * one.share), xytext=(6, 4), textcoords="offset points", fontsize=15)
    panel.set_ylim(bottom=0.0)
    panel.margins(x=0.15)
    png = report.png_bytes(report.figure_image(figure))
    return report.Picture(png=png, alt="Defects found against time", caption="Red: Pareto.")
