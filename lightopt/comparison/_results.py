"""What lighting systems show of a part and what they cost: as values, JSON, CSV and a page."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lightopt.config import PartConfig, RigConfig
from lightopt.core.errors import counted, percent
from lightopt.design import (
    BLIND_SHARES_OF,
    DEFAULT_TOLERANCE_TARGET,
    OptimizeOptions,
    WidestTolerance,
    finding_text,
    share_text,
)
from lightopt.images import csv_text
from lightopt.report import (
    Answer,
    Gallery,
    Note,
    Page,
    Picture,
    Section,
    Table,
    Warnings,
    chart,
    figure_image,
    fixed_style,
    page_html,
    png_bytes,
)

FORMAT = "lightopt-lighting-comparison/1"
REASONS = 2  # reasons of each system in the table
LEAST_REASON = 0.005  # share of the least of them


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
    pictures: tuple[Picture, ...]  # of the first posture
    # how far all lights, and the part, may be off while most of the share is kept; None where that was not computed
    mounting: WidestTolerance | None = None
    pose: WidestTolerance | None = None

    @property
    def cost(self) -> float:
        """What it is compared by beside the share: seconds, or images where those are unknown."""
        return float(self.images) if self.seconds is None else self.seconds


@dataclass(frozen=True, kw_only=True)
class UnusableSystem:
    """A lighting system that cannot be used for the part."""

    name: str
    messages: tuple[str, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class LightingComparison:
    """Lighting systems in the order of the share of defects that they find."""

    part: PartConfig
    options: OptimizeOptions
    provenance: Mapping[str, Any]
    systems: tuple[SystemResult, ...]
    unusable: tuple[UnusableSystem, ...]
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
    """What comparison.json says."""
    best = {one.name for one in comparison.best}
    systems = [
        {
            "system": one.name,
            "rig": {"file": one.rig.source.path.name, "sha256": one.rig.source.sha256},
            "folder": one.folder.name,
            "share": round(one.share, 6),
            "grain": round(one.grain, 6),
            "pareto": one.name in best,
            "defects": dict(one.defects),
            "not_found": {reason: round(share, 6) for reason, share in one.reasons.items()},
            "images": one.images,
            "seconds": None if one.seconds is None else round(one.seconds, 3),
            "mounting_tolerance": _tolerance_dict(one.mounting),
            "pose_tolerance": _tolerance_dict(one.pose),
            "size_mm": [round(side, 3) for side in one.size_mm],
            "footprint_mm": round(one.footprint_mm, 6),
        }
        for one in comparison.systems
    ]
    return {
        "format": FORMAT,
        "provenance": dict(comparison.provenance),
        "systems": systems,
        "unusable": [asdict(one) for one in comparison.unusable],
    }


def _tolerance_dict(one: WidestTolerance | None) -> dict[str, Any] | None:
    return None if one is None else {"degrees": one.degrees, "or_more": one.open_ended}


def comparison_csv(comparison: LightingComparison) -> str:
    """The systems as a table, the best first."""
    kinds = list(dict.fromkeys(kind for one in comparison.systems for kind in one.defects))
    size = [f"size_{axis}_mm" for axis in "xyz"]
    widest = ["mounting_tolerance_deg", "pose_tolerance_deg"]
    head = ["system", "share", *kinds, "images", "seconds", *widest, *size, "footprint_mm", "pareto"]
    rows: list[list[object]] = [[*head]]
    best = {one.name for one in comparison.best}
    for one in comparison.systems:
        shares = [f"{one.defects.get(kind, 0.0):.6f}" for kind in kinds]
        seconds = "" if one.seconds is None else f"{one.seconds:.3f}"
        sides = [f"{side:.3f}" for side in one.size_mm]
        widest = ["" if tolerance is None else f"{tolerance.degrees:g}" for tolerance in (one.mounting, one.pose)]
        rest = [*widest, *sides, one.footprint_mm, int(one.name in best)]
        rows.append([one.name, f"{one.share:.6f}", *shares, one.images, seconds, *rest])
    return csv_text(rows)


def comparison_report(comparison: LightingComparison, folder: Path) -> str:
    """The report as HTML; `folder` is where it goes."""
    sections = [
        Section(heading="Systems", blocks=[systems_table(comparison, folder), _chart(comparison)]),
        Section(heading="Kinds of defects", blocks=[_kinds_table(comparison)]),
        Section(heading="Images", blocks=[_gallery(comparison)]),
        Section(heading="Why defects are missed", blocks=[_reasons_table(comparison)]),
    ]
    if comparison.unusable:
        rows = [[one.name, " ".join(one.messages)] for one in comparison.unusable]
        table = Table(header=["system", "reason"], rows=rows, numbers_from=2)
        sections.append(Section(heading="Systems that cannot be used", blocks=[table]))
    first = comparison.systems[0]
    answer = Answer(figure=share_text(first.share, first.grain), text=f"by {first.name}: {_meaning(comparison)}.")
    lead = [answer, *(Note(text=text) for text in _others(comparison)), Warnings(texts=comparison.warnings)]
    name = comparison.part.name
    return page_html(Page(title=f"Lighting systems: {name}", subtitle=name, lead=lead, sections=sections))


def answer_text(comparison: LightingComparison) -> str:
    """The answer in a sentence."""
    first = comparison.systems[0]
    return f"{first.name} finds most: {share_text(first.share, first.grain)} {_meaning(comparison)}"


def _meaning(comparison: LightingComparison) -> str:
    return finding_text(comparison.options.min_images, comparison.options.false_alarms)


def _others(comparison: LightingComparison) -> Iterator[str]:
    rest = [one for one in comparison.best if one is not comparison.systems[0]]
    if rest:
        texts = ", ".join(f"{one.name} ({share_text(one.share, one.grain)}, {_cost(one)})" for one in rest)
        yield f"Less time per part: {texts}. No other system finds as much in as little time."


def _cost(one: SystemResult) -> str:
    return f"{counted(one.images, 'image')}" if one.seconds is None else f"{one.seconds:.1f} s"


def systems_table(comparison: LightingComparison, folder: Path | None = None) -> Table:
    """The systems, the best first; for a page in `folder` with the sides of pixels, and links to their designs."""
    best = set(comparison.best)
    rows = [
        [
            one.name,
            share_text(one.share, one.grain),
            "yes" if one in best else "",
            str(one.images),
            "-" if one.seconds is None else f"{one.seconds:.1f}",
            _tolerance_text(one.mounting),
            _tolerance_text(one.pose),
            " × ".join(f"{side:.0f}" for side in one.size_mm),
            *([] if folder is None else [f"{one.footprint_mm:.3g}"]),
            ", ".join(f"{reason} {percent(share, 0)}" for reason, share in _main_reasons(one)) or "-",
        ]
        for one in comparison.systems
    ]
    header = ["system", "found", "Pareto", "images", "s/part", "lights ±°", "part ±°", "size [mm]", "not found, mostly"]
    if folder is not None:
        header.insert(-1, "pixel [mm]")
    caption = (
        "Found: share of surface × defects. Pareto: no other system finds as much in less time per part. Lights ±°, "
        "part ±°: how far all angles of the lights, or tilt and rotation of the part, may be off at once while "
        f"{percent(DEFAULT_TOLERANCE_TARGET, 0)} of the share is kept. Size: of the box around the lights along X, Y, "
        "Z. Pixel: its side at the origin."
    )
    links = (
        []
        if folder is None
        else [f"{one.folder.relative_to(folder).as_posix()}/report.html" for one in comparison.systems]
    )
    return Table(header=header, rows=rows, numbers_from=1, caption=caption, links=links)


def _tolerance_text(one: WidestTolerance | None) -> str:
    if one is None:
        return "-"
    return f"≥ {one.degrees:g}" if one.open_ended else "< 0.05" if one.degrees == 0.0 else f"{one.degrees:.2g}"


def _main_reasons(one: SystemResult) -> list[tuple[str, float]]:
    return [(reason, share) for reason, share in one.reasons.items() if share >= LEAST_REASON][:REASONS]


def _kinds_table(comparison: LightingComparison) -> Table:
    kinds = list(dict.fromkeys(kind for one in comparison.systems for kind in one.defects))
    rows = [
        [one.name, *(share_text(one.defects.get(kind, 0.0), one.grain) for kind in kinds)] for one in comparison.systems
    ]
    return Table(header=["system", *kinds], rows=rows, caption="Share of each kind that is found, all places alike.")


def _reasons_table(comparison: LightingComparison) -> Table:
    reasons = list(dict.fromkeys(reason for one in comparison.systems for reason in one.reasons))
    rows = [
        [one.name, *(share_text(one.reasons.get(reason, 0.0), one.grain) for reason in reasons), "; ".join(one.moved)]
        for one in comparison.systems
    ]
    caption = (
        f"Shares of {BLIND_SHARES_OF}, of what the camera sees. Moved: lights whose best place is not that of their "
        "file."
    )
    return Table(header=["system", *reasons, "moved"], rows=rows, caption=caption)


def _gallery(comparison: LightingComparison) -> Gallery:
    most = max(len(one.pictures) for one in comparison.systems)
    rows: list[tuple[str, list[Picture | None]]] = [
        (one.name, [*one.pictures, *[None] * (most - len(one.pictures))]) for one in comparison.systems
    ]
    caption = "The first posture under the first lights of each system, at exposure 1; red: saturated pixels."
    return Gallery(header=[f"image {i + 1}" for i in range(most)], rows=rows, caption=caption)


@fixed_style()
def _chart(comparison: LightingComparison) -> Picture:
    known = all(one.seconds is not None for one in comparison.systems)
    label = "seconds per part" if known else "images per part"
    figure, (panel,) = chart(title="What is found, and what it takes", x_label=label, labels=["defects found [%]"])
    for one in comparison.systems:
        x = one.cost if known else float(one.images)
        panel.plot([x], [100.0 * one.share], "o", color="#c2410c" if one in comparison.best else "#8a8f98")
        panel.annotate(one.name, (x, 100.0 * one.share), xytext=(6, 4), textcoords="offset points", fontsize=9)
    panel.set_ylim(bottom=0.0)
    panel.margins(x=0.15)
    return Picture(png=png_bytes(figure_image(figure)), alt="Defects found against time", caption="Red: Pareto.")
