"""What ``lightopt inspect`` does with image sets: one by itself, or several, of which bad ones do not stop the rest."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING

from lightopt.cli._inspect_tables import show_inspection, show_truth
from lightopt.cli._options import make_folder
from lightopt.cli._terminal import say, say_error, say_warning, show_share
from lightopt.core.errors import InputError

if TYPE_CHECKING:
    from lightopt.config import PartConfig, RigConfig
    from lightopt.images import ImageSet
    from lightopt.inspection import (
        BatchFolder,
        Calibration,
        Inspection,
        InspectionFolder,
        InspectOptions,
        Predictions,
        TrueSet,
        TruthSource,
    )
    from lightopt.report import BatchRow


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """What is the same for all sets."""

    rig: RigConfig
    part: PartConfig
    options: InspectOptions
    calibration: Calibration | None
    truth: bool
    report: bool
    force: bool
    quiet: bool


def inspect_one(wanted: Wanted, image_set: ImageSet, out: Path) -> BatchRow:
    """Inspect a set and write its result; a set that is refused leaves no folder behind."""
    from lightopt.inspection import Predictions

    (source,) = _sources(wanted, [image_set])
    folder = _folder(wanted, image_set, out)
    with _made(out):
        result, known = _inspect(wanted, image_set, Predictions(), source)
    for text in (*source.words, *result.words):
        say_warning(text)
    return _write(wanted, folder, image_set.folder.resolve().name, result, known)


def inspect_batch(wanted: Wanted, sets: list[ImageSet], out: Path) -> list[BatchRow]:
    """Inspect several sets, write a folder each and ``batch.json`` above them; a refused one does not stop the rest."""
    from lightopt.inspection import Predictions
    from lightopt.report import BatchRow

    named = _named(sets, out)
    sources = _sources(wanted, sets)
    batch = _batch_folder(wanted, sets, out)
    folders = [
        _folder(wanted, image_set, out / name, before=sets[:number])
        for number, (image_set, name) in enumerate(named)
    ]
    predictions = Predictions()
    rows: list[BatchRow] = []
    known: list[TrueSet] = []
    begun = monotonic()
    for (image_set, name), folder, source in zip(named, folders, sources, strict=True):
        if not wanted.quiet:
            say(f"{name}:")
        try:
            with _made(out / name):
                result, true_set = _inspect(wanted, image_set, predictions, source)
        except InputError as error:
            folder.clear()
            own = f"{image_set.folder}"
            bare = (message.removeprefix(own).lstrip(",: ") for message in error.messages)
            say_error(*(f"{name}: not inspected: {message}" for message in bare))
            # results name folders, and not where on this machine they are
            told = (message.replace(str(image_set.folder), name) for message in error.messages)
            rows.append(BatchRow(name=name, refused=tuple(told)))
            continue
        for text in (*source.words, *result.words):
            say_warning(f"{name}: {text}")
        rows.append(_write(wanted, folder, name, result, None))
        known += [] if true_set is None else [true_set]
    if not wanted.quiet:
        minutes = (monotonic() - begun) / 60.0
        refused = sum(row.verdict is None for row in rows)
        good = sum(row.verdict.good for row in rows if row.verdict is not None)
        told = f", {refused} not inspected" if refused else ""
        say(f"{len(sets)} parts, {good} OK{told}; {len(sets) / max(minutes, 1e-9):.3g} parts per minute")
    _write_batch(wanted, batch, rows, known)
    return rows


def _sources(wanted: Wanted, sets: list[ImageSet]) -> list[TruthSource]:
    # what says which defects there are; whatever cannot be known is refused before any work, all of it together
    from lightopt.inspection import TruthSource, truth_source

    if not wanted.truth:
        return [TruthSource()] * len(sets)
    problems: list[str] = []

    def told(image_set: ImageSet) -> TruthSource:
        try:
            return truth_source(image_set, wanted.part)
        except InputError as error:
            problems.extend(error.messages)
            return TruthSource()

    sources = [told(image_set) for image_set in sets]
    if problems:
        raise InputError(*problems)
    return sources


def _named(sets: list[ImageSet], out: Path) -> list[tuple[ImageSet, str]]:
    names = [image_set.folder.resolve().name for image_set in sets]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(
            f"image sets of the same folder name ({', '.join(twice)}): results go to folders of these names in {out}; "
            "rename one, or inspect them one by one"
        )
    return list(zip(sets, names, strict=True))


def _folder(
    wanted: Wanted, image_set: ImageSet, out: Path, *, before: Sequence[ImageSet] = ()
) -> InspectionFolder:
    from lightopt.inspection import InspectionFolder, inspection_provenance

    made_from = inspection_provenance(
        wanted.rig, wanted.part, [image_set], wanted.options, calibration=wanted.calibration, before=before
    )
    return InspectionFolder(out, made_from, force=wanted.force)


def _batch_folder(wanted: Wanted, sets: list[ImageSet], out: Path) -> BatchFolder:
    from lightopt.inspection import BatchFolder, inspection_provenance

    made_from = inspection_provenance(
        wanted.rig, wanted.part, sets, wanted.options, calibration=wanted.calibration
    )
    made_from["options"]["truth"] = wanted.truth
    return BatchFolder(out, made_from, force=wanted.force)


@contextmanager
def _made(folder: Path) -> Generator[None]:
    # a folder that turns out to be wanted is made before the work; one that does not, goes
    there = folder.exists()
    make_folder(folder)
    try:
        yield
    except BaseException:
        if not there:
            with suppress(OSError):
                folder.rmdir()
        raise


def _inspect(
    wanted: Wanted, image_set: ImageSet, predictions: Predictions, source: TruthSource
) -> tuple[Inspection, TrueSet | None]:
    from lightopt.inspection import compare_with_truth, inspect_set
    from lightopt.scene import place_defects

    with show_share(quiet=wanted.quiet) as progress:
        result = inspect_set(
            wanted.rig,
            wanted.part,
            image_set,
            options=wanted.options,
            predictions=predictions,
            calibration=wanted.calibration,
            progress=progress,
        )
    if not wanted.truth:
        return result, None
    placed = () if source.part is None else place_defects(result.nominal, wanted.rig, source.part)
    return result, compare_with_truth(image_set, result, known=placed)


def _write(
    wanted: Wanted, folder: InspectionFolder, name: str, result: Inspection, known: TrueSet | None
) -> BatchRow:
    # known: of a set by itself; those of a batch are told together
    from lightopt.images import posture_folder
    from lightopt.inspection import REPORT_NAME, TRUTH_NAME, judge, summarise, truth_text
    from lightopt.report import BatchRow, defect_overlay, inspection_report

    summary = None if known is None else summarise([known])
    verdict = judge(result, wanted.part.inspection)
    if not wanted.quiet:  # before the pictures, which take longer than it did
        show_inspection(result, verdict)
    with show_share(quiet=wanted.quiet) as progress:
        for number, posture in enumerate(result.postures):
            if progress is not None:
                progress(f"pictures of posture {posture.view.posture}", number / len(result.postures))
            folder.write_posture(posture)
            path = folder.place(f"{posture_folder(posture.view.posture)}/defects.png")
            defect_overlay(path, posture, result.defects)
    more: list[Path] = []
    if summary is not None:
        more.append(folder.write_text(TRUTH_NAME, truth_text(summary)))
    if wanted.report:
        page = inspection_report(
            result,
            verdict,
            part=wanted.part.name,
            rig=wanted.rig.name,
            provenance=folder.made_from,
            truth=summary,
        )
        more.append(folder.write_text(REPORT_NAME, page))
    written = [*folder.write(result, verdict), *more]
    if not wanted.quiet:
        if summary is not None:
            show_truth(summary)
        for path in written:
            say(f"{path}")
    report = f"{name}/{REPORT_NAME}" if wanted.report else ""
    return BatchRow(name=name, report=report, defects=len(result.defects), verdict=verdict)


def _write_batch(wanted: Wanted, folder: BatchFolder, rows: list[BatchRow], known: list[TrueSet]) -> None:
    from lightopt import __version__
    from lightopt.inspection import REPORT_NAME, TRUTH_NAME, summarise, truth_text
    from lightopt.report import batch_report

    summary = summarise(known) if wanted.truth else None
    written: list[Path] = []
    if summary is not None:
        written.append(folder.write_text(TRUTH_NAME, truth_text(summary)))
    if wanted.report:
        page = batch_report(
            rows, part=wanted.part.name, rig=wanted.rig.name, version=__version__, truth=summary
        )
        written.append(folder.write_text(REPORT_NAME, page))
    written.insert(0, folder.finish({"sets": [row.as_dict() for row in rows]}))
    if not wanted.quiet:
        if summary is not None:
            show_truth(summary)
        for path in written:
            say(f"{path}")
