from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from lightopt.cli import _common as common, _terminal as terminal
from lightopt.cli._common import model_option, output_option
from lightopt.cli._terminal import VERBOSE, echo, show_page_table, show_progress
from lightopt.core.errors import CheckFailed, InputError, counted, percent, refuse
from lightopt.core.run_context import RunContext, StageShare

if TYPE_CHECKING:
    from lightopt import inspection
    from lightopt.config import PartConfig, RigConfig
    from lightopt.images import ImageSet, ResultFolder


# on the terminal without `--verbose`: rows of the table of defects (defects.csv has all), and names of missed defects
MOST_DEFECTS, MOST_MISSED = 4, 6
calibration_option = partial(typer.Option, rich_help_panel="Calibration with good parts")


def inspect(
    rig: common.RigFile,
    part: common.PartFile,
    images: Annotated[
        list[Path], typer.Argument(metavar="IMAGES", help="Image sets of one part each: folder or manifest.json.")
    ],
    out: common.Out,
    detector: str = model_option(
        "catalogue",
        metavar="residual|catalogue|template",
        help="residual: measured minus predicted level; catalogue: also whole defects of the part's catalogue; "
        "template: dots and lines in the synthetic image.",
    ),
    reference: str = model_option(
        "model",
        metavar="model|good-parts|self",
        help="What images are compared with. model: mesh and reflectance; good-parts: what a calibration "
        "learned; self: the surroundings of each place.",
    ),
    fusion: str = model_option(
        "paper",
        metavar="paper|median|minimum|second-largest|none",
        help="Rule that fuses images into the synthetic image without highlights.",
    ),
    false_alarms: float | None = model_option(
        None,
        metavar="N",
        help="Expected false alarms per posture from noise alone, from 1e-9 to 1; with a calibration, share of "
        "good parts with a false alarm in a posture.",
        show_default="0.05",
    ),
    min_images: common.MinImages = 2,
    register: common.Register = True,
    calibrate: bool = calibration_option(
        False, "--calibrate", help="Write calibration.json from IMAGES of good parts; do not inspect them."
    ),
    calibration: Path | None = calibration_option(
        None, metavar="FILE", help="Use this calibration.json; its false-alarm rate becomes the default."
    ),
    evaluate: bool = output_option(
        False,
        "--evaluate",
        help="Compare with ground truth (labels of the sets, or defects of their part files) and write truth.json.",
    ),
    fail_on_defect: bool = output_option(False, "--fail-on-defect", help="Exit status 1 if a part is NG."),
    report: common.Report = True,
    derived: common.Derived = False,
    force: common.Force = False,
    threads: common.Threads = None,
) -> None:
    """Find defects in IMAGES of PART and locate them on the part.

    Writes report.html, defects.json, defects.csv and defects.ply. Also writes for each posture the synthetic image
    without highlights, its uncertainty, the scores, and an overlay of the defects. Each of several sets gets a folder;
    batch.json lists them. The inspection section of PART has the limits for OK and NG. With --calibrate, only
    calibration.json and its maps are written.

    Example: lightopt inspect rig.yaml part.yaml captured/ -o inspected
    """
    from lightopt import inspection
    from lightopt.images import read_image_set

    learned = None if calibration is None else inspection.read_calibration(calibration)
    if false_alarms is None:
        false_alarms = inspection.InspectOptions.false_alarms if learned is None else learned.rate
    options = inspection.InspectOptions(
        detector=detector,
        fusion=None if fusion == "none" else cast("Any", fusion),
        reference=cast("Any", reference),
        false_alarms=false_alarms,
        min_images=min_images,
        register=register,
    )
    problems = options.problems()
    if calibrate:
        given = {"--calibration": learned is not None, "--evaluate": evaluate, "--fail-on-defect": fail_on_defect}
        given_names = (name for name, is_given in given.items() if is_given)
        problems += [f"{name}: cannot be combined with --calibrate, which does not inspect" for name in given_names]
    refuse(problems)
    loaded_rig, loaded_part = common.load_inputs(rig, part)
    output = _Output(rig=loaded_rig, part=loaded_part, report=report, threads=threads)
    sets = [read_image_set(path) for path in images]
    if calibrate:
        _calibrate(output, sets, out, options, force=force)
        return
    if learned is not None:
        learned.require_match(loaded_rig, loaded_part, options)
    rows = _inspect(output, sets, out, options, learned, evaluate=evaluate, force=force)
    for row, image_set in zip(rows, sets, strict=True):
        if derived and row.verdict is not None:
            folder = out / row.name if len(sets) > 1 else out
            common.add_derived(loaded_rig, loaded_part, image_set, folder, force=force)
    bad = inspection.rejections(sets, rows) if fail_on_defect else []
    if refused := [row.name for row in rows if row.verdict is None]:
        raise InputError(*bad, f"{len(refused)} of {counted(len(sets), 'set')} not inspected: {', '.join(refused)}")
    if bad:
        raise CheckFailed(*bad)


@dataclass(frozen=True, kw_only=True)
class _Output:
    # what is the same for all sets
    rig: RigConfig
    part: PartConfig
    report: bool
    threads: int | None


def _inspect(
    output: _Output,
    sets: list[ImageSet],
    out: Path,
    options: inspection.InspectOptions,
    calibration: inspection.Calibration | None,
    *,
    evaluate: bool,
    force: bool,
) -> list[inspection.BatchRow]:
    # one set goes to `out`; several go to folders below it, and what is said of all of them to `out`
    from lightopt import inspection

    rig, part, several = output.rig, output.part, len(sets) > 1
    names = inspection.set_names(sets, out)
    sources = inspection.truth_sources(sets, part) if evaluate else None
    describe = partial(inspection.inspection_provenance, rig, part, options=options, calibration=calibration)
    batch = None
    if several:
        made_from = describe(sets)
        made_from["options"]["evaluate"] = evaluate
        batch = inspection.BatchFolder(out, made_from, force=force)
    folders = [
        inspection.InspectionFolder(out / name if several else out, describe([sets[i]], before=sets[:i]), force=force)
        for i, name in enumerate(names)
    ]
    shown: list[StageShare | None] = [None]

    def progress(stage: str, share: float) -> None:
        if shown[0] is not None:
            shown[0](stage, share)

    run = RunContext(threads=output.threads, progress=progress, warn=terminal.echo_warning)
    arguments: dict[str, Any] = {"options": options, "calibration": calibration, "truth": sources, "folders": folders}
    results = inspection.inspect_batch(rig, part, sets, **arguments, run=run)
    rows: list[inspection.BatchRow] = []
    evaluations: list[inspection.SetEvaluation] = []
    begun = monotonic()
    for name, image_set, folder in zip(names, sets, folders, strict=True):
        with show_progress() as shown[0]:  # ends before the result is printed
            inspected = next(results)
        if inspected.error is not None:
            if not several:
                raise inspected.error
            folder.clear()
            own = f"{image_set.folder}"
            bare = (message.removeprefix(own).lstrip(",: ") for message in inspected.error.messages)
            terminal.echo_error(*(f"{name}: not inspected: {message}" for message in bare))
            # results name folders, and not where on this machine they are
            reasons = (message.replace(own, name) for message in inspected.error.messages)
            rows.append(inspection.BatchRow(name=name, refused=tuple(reasons)))
            continue
        rows.append(_write_set(output, folder, inspected, summarised=not several))
        if inspected.evaluation is not None:
            evaluations.append(inspected.evaluation)
    if batch is not None:
        minutes = (monotonic() - begun) / 60.0
        words = Counter(row.word for row in rows)
        others = f", {words['not inspected']} not inspected" if words["not inspected"] else ""
        pace = f"{len(rows) / max(minutes, 1e-9):.3g} parts per minute"
        echo(f"{len(rows)} parts, {words['OK']} OK{others}; {pace}")
        if shares := sorted(row.verdict.inspected for row in rows if row.verdict is not None):
            ends = dict.fromkeys(map(percent, (shares[0], shares[-1])))
            echo(f"inspected: {' to '.join(ends)} of the visible surface of each part")
        _write_batch(output, batch, rows, evaluations if evaluate else None)
    return rows


def _calibrate(
    output: _Output, sets: list[ImageSet], out: Path, options: inspection.InspectOptions, *, force: bool
) -> None:
    from lightopt import inspection
    from lightopt.images import make_folder

    rig, part = output.rig, output.part
    inspection.require_good_sets(len(sets), options)
    folder = inspection.CalibrationFolder(out, inspection.inspection_provenance(rig, part, sets, options), force=force)
    make_folder(out)
    with terminal.run_context(output.threads) as run:
        calibration = inspection.calibrate(rig, part, sets, options=options, run=run)
    path = folder.write(calibration)
    _show_calibration(calibration, options.false_alarms)
    terminal.echo_paths(path)


def _write_set(
    output: _Output, folder: inspection.InspectionFolder, inspected: inspection.InspectedSet, *, summarised: bool
) -> inspection.BatchRow:
    """Print a result, write its files, and the evaluation where it is `summarised` for this set alone."""
    from lightopt import inspection
    from lightopt.images import posture_folder
    from lightopt.report.inspection import defect_overlay, inspection_report

    result, verdict = inspected.result, inspected.verdict
    assert result is not None
    assert verdict is not None
    summary = inspection.summarise([inspected.evaluation]) if summarised and inspected.evaluation is not None else None
    if summarised:  # before the pictures, which take longer than the inspection did
        _show_inspection(result, verdict, folder.made_from)
    else:
        echo(f"{inspected.name}: {verdict.word}: {verdict.explanation}")
    with show_progress() as progress:
        for number, posture in enumerate(result.postures):
            if progress is not None:
                progress(f"pictures of posture {posture.view.posture}", number / len(result.postures))
            folder.write_posture(posture)
            path = folder.place(f"{posture_folder(posture.view.posture)}/defects.png")
            defect_overlay(path, posture, result.defects)
    names = {"part": output.part.name, "rig": output.rig.name}
    page = partial(inspection_report, result, verdict, **names, provenance=folder.made_from, truth=summary)
    _write_rest(output, folder, summary, page, lambda: folder.write(result, verdict), shown=summarised)
    report = f"{inspected.name}/{inspection.REPORT_NAME}" if output.report else ""
    return inspection.BatchRow(name=inspected.name, report=report, defects=len(result.defects), verdict=verdict)


def _write_batch(
    output: _Output,
    folder: inspection.BatchFolder,
    rows: Sequence[inspection.BatchRow],
    evaluations: Sequence[inspection.SetEvaluation] | None,
) -> None:
    """Write the files above the folders of several sets."""
    from lightopt import __version__, inspection
    from lightopt.report.inspection import batch_report

    summary = None if evaluations is None else inspection.summarise(evaluations)
    names = {"part": output.part.name, "rig": output.rig.name}
    page = partial(batch_report, rows, **names, version=__version__, truth=summary)
    _write_rest(output, folder, summary, page, lambda: [folder.finish({"sets": [row.as_dict() for row in rows]})])


def _write_rest(
    output: _Output,
    folder: ResultFolder,
    summary: Mapping[str, Any] | None,
    page: Callable[[], str],
    finish: Callable[[], list[Path]],
    *,
    shown: bool = True,
) -> None:
    """Write the evaluation and the page, finish the folder, and print the evaluation and the main paths."""
    from lightopt.inspection import REPORT_NAME, TRUTH_NAME, truth_text

    more: list[Path] = []
    if summary is not None:
        more.append(folder.write_text(TRUTH_NAME, truth_text(summary)))
        _show_evaluation(summary)
    if output.report:
        more.append(folder.write_text(REPORT_NAME, page()))
    paths = [*more[::-1], *finish()]
    if shown or VERBOSE.get():
        terminal.echo_main_paths(folder.folder, paths, main={REPORT_NAME, "defects.json", "batch.json"})


def _show_calibration(calibration: inspection.Calibration, rate: float) -> None:
    """The greatest score of each good set, the threshold, and the rates that these sets can hold."""
    from lightopt.inspection import least_rate

    postures = calibration.postures
    rows = [[name, *(f"{one.peaks[i]:.1f}" for one in postures)] for i, name in enumerate(calibration.sets)]
    rows.append(["threshold", *(f"{one.threshold(rate):.1f}" for one in postures)])
    terminal.show_table(["greatest score", *(str(one.posture) for one in postures)], rows)
    count = len(calibration.sets)
    echo(
        f"{count} good sets support a rate of {rate:g} (share of good parts with a false alarm in a posture); the "
        f"lowest rate that they support is {least_rate(count):.3g}"
    )


def _show_evaluation(summary: Mapping[str, Any]) -> None:
    # recall, false alarms and the size that is detected, from lightopt.inspection.summarise
    from lightopt.report.inspection import detection_table, missed_defects

    alarms, hidden, area = summary["false_alarms_per_posture"], summary["hidden"], summary["roc_auc"]
    why = f" (out of view, at an edge, or narrower than a pixel: {_few(hidden)})" if hidden else ""
    echo(
        f"{summary['found']} of {summary['defects']} known defects found, {len(hidden)} without an evaluable pixel"
        f"{why}; {alarms:g} false alarm{'' if alarms == 1.0 else 's'} per posture; area under the pixels' ROC "
        f"{'-' if area is None else area}"
    )
    if missed := missed_defects(summary):
        echo(f"missed: {_few(missed)}")
    if VERBOSE.get():
        show_page_table(detection_table(summary))


def _few(names: Sequence[str]) -> str:
    most = len(names) if VERBOSE.get() else MOST_MISSED
    more = f" and {len(names) - most} more; truth.json has all" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _show_inspection(
    result: inspection.InspectionResult, verdict: inspection.Verdict, made_from: Mapping[str, Any]
) -> None:
    # the verdict, defects, where the part lies, what was inspected
    from lightopt.inspection import REFERENCE_DEFECT, REFERENCES
    from lightopt.report.inspection import (
        dark_text,
        defect_table,
        placement_text,
        surface_notes,
        surface_table,
        threshold_text,
    )

    echo(f"{verdict.word}: {verdict.explanation}")
    basis = "" if result.reference == "model" else f"; compared with: {REFERENCES[result.reference].basis}"
    echo(f"threshold of the score: {threshold_text(result, made_from)}{basis}")
    if result.defects:
        show_page_table(defect_table(result, verdict), most=MOST_DEFECTS)
        if not VERBOSE.get() and len(result.defects) > MOST_DEFECTS:
            echo(f"and {len(result.defects) - MOST_DEFECTS} more; --verbose shows them")
    if result.placement is not None and (place := placement_text(result.placement)):
        echo(f"displacement of the part from nominal: {place}")
    echo(f"{REFERENCE_DEFECT} is found on {percent(verdict.finds)} of the visible surface{dark_text(verdict)}")
    if VERBOSE.get():
        show_page_table(surface_table(result))
        for sentence in surface_notes(result):
            echo(sentence)
