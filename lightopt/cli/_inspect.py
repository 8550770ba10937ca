from __future__ import annotations

from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, cast

import typer

from lightopt.cli._inputs import load_inputs
from lightopt.cli._options import Force, Out, PartFile, Quiet, RigFile, Threads, make_folder
from lightopt.cli._terminal import say, say_warning, show_share, show_table
from lightopt.errors import CheckFailed, InputError

if TYPE_CHECKING:
    from lightopt.config import PartConfig, RigConfig
    from lightopt.images import ImageSet
    from lightopt.inspection import (
        Detector,
        Fusion,
        InspectedPosture,
        Inspection,
        InspectOptions,
        Predictions,
        TrueSet,
        Verdict,
    )

__all__ = ["inspect"]

Images = Annotated[
    list[Path],
    typer.Argument(metavar="IMAGES…", help="Image sets of one part each: folder or manifest.json."),
]


def inspect(
    rig: RigFile,
    part: PartFile,
    images: Images,
    out: Out,
    detector: Annotated[
        str,
        typer.Option(metavar="NAME", help="residual: measured against predicted; or template. [residual]"),
    ] = "residual",
    fusion: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Of the synthetic image: paper, median, minimum, second-largest; or none. [paper]",
        ),
    ] = "paper",
    false_alarms: Annotated[
        float, typer.Option(metavar="N", help="Per posture, where only noise differs. [0.05]")
    ] = 0.05,
    seen_by: Annotated[
        int, typer.Option(metavar="K", help="A defect shows in so many images of a posture. [2]")
    ] = 2,
    no_shift: Annotated[
        bool, typer.Option("--no-shift", help="The part lies exactly where its file has it.")
    ] = False,
    truth: Annotated[
        bool,
        typer.Option(
            "--truth",
            help="Hold the result against the sets' labels, or against the defects that PART names: recall, false "
            "alarms, ROC, detection curve.",
        ),
    ] = False,
    fail_on_defect: Annotated[
        bool, typer.Option("--fail-on-defect", help="Exit status 1 where a part is NG.")
    ] = False,
    threads: Threads = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Find defects in IMAGES of PART, and say where they are.

    Writes defects.json, .csv and .ply, the synthetic image without highlights with its uncertainty, scores and an
    overlay for each posture. Several sets, as of several parts, get a folder each. OK or NG is by the limits under
    inspection: in PART.

    Example: lightopt inspect rig.yaml part.yaml captured/ -o inspected
    """
    from lightopt.images import read_image_set
    from lightopt.inspection import InspectOptions, Predictions

    options = InspectOptions(
        detector=cast("Detector", detector),
        fusion=None if fusion == "none" else cast("Fusion", fusion),
        false_alarms=false_alarms,
        seen_by=seen_by,
        shift=not no_shift,
        threads=threads,
    )
    problems = options.problems()
    if threads is not None and threads < 1:
        problems.append(f"--threads: expected at least 1, found {threads}")
    if problems:
        raise InputError(*problems)
    loaded_rig, loaded_part = load_inputs(rig, part)
    assert loaded_part is not None
    sets = [read_image_set(path) for path in images]
    folders = _folders(sets, out)
    predictions = Predictions()
    bad: list[str] = []
    known: list[TrueSet] = []
    begun = monotonic()
    for image_set, folder in zip(sets, folders, strict=True):
        verdict, true_set = _one(
            loaded_rig,
            loaded_part,
            image_set,
            folder,
            options,
            predictions,
            truth=truth,
            force=force,
            quiet=quiet,
        )
        known += [] if true_set is None else [true_set]
        if not verdict.good:
            bad.append(f"{image_set.folder}: NG, {'; '.join(verdict.reasons)}")
    if len(sets) > 1 and not quiet:
        minutes = (monotonic() - begun) / 60.0
        say(
            f"{len(sets)} parts, {len(sets) - len(bad)} OK; {len(sets) / max(minutes, 1e-9):.3g} parts per minute"
        )
    if truth:
        _tell_truth(known, out, force=force, quiet=quiet)
    if bad and fail_on_defect:
        raise CheckFailed(*bad)


def _folders(sets: list[ImageSet], out: Path) -> list[Path]:
    if len(sets) == 1:
        return [out]
    names = [image_set.folder.resolve().name for image_set in sets]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(
            f"image sets of the same folder name ({', '.join(twice)}): results go to folders of these names in {out}; "
            "rename one, or inspect them one by one"
        )
    return [out / name for name in names]


def _one(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    out: Path,
    options: InspectOptions,
    predictions: Predictions,
    *,
    truth: bool,
    force: bool,
    quiet: bool,
) -> tuple[Verdict, TrueSet | None]:
    from lightopt.inspection import (
        InspectionFolder,
        compare_with_truth,
        inspect_set,
        judge,
        provenance,
    )
    from lightopt.scene import place_defects

    folder = InspectionFolder(out, provenance(rig, part, image_set, options), force=force)
    make_folder(out)
    with show_share(quiet=quiet) as progress:
        result = inspect_set(
            rig, part, image_set, options=options, predictions=predictions, progress=progress
        )
    known = None
    if truth:
        placed = place_defects(result.nominal, rig, part)
        known = compare_with_truth(image_set, result, known=placed)
    for posture in result.postures:
        folder.write_posture(posture)
        _overlay(folder, result, posture)
    verdict = judge(result, part.inspection)
    written = folder.write(result, verdict.as_dict())
    for text in result.words:
        say_warning(text)
    if not quiet:
        _show(result, verdict)
        for path in written:
            say(f"{path}")
    return verdict, known


def _overlay(folder: object, result: Inspection, posture: InspectedPosture) -> None:
    from lightopt.images import posture_folder
    from lightopt.inspection import InspectionFolder
    from lightopt.report import defect_overlay

    assert isinstance(folder, InspectionFolder)
    numbers = {
        posture.sightings.index(sighting): defect.number
        for defect in result.defects
        for sighting in defect.sightings
        if sighting in posture.sightings
    }
    path = folder.place(f"{posture_folder(posture.view.posture)}/defects.png")
    defect_overlay(path, posture, numbers)


def _tell_truth(known: list[TrueSet], out: Path, *, force: bool, quiet: bool) -> None:
    import json

    from lightopt.images import write_text_atomic
    from lightopt.inspection import summarise

    summary = summarise(known)
    text = json.dumps(summary, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    write_text_atomic(out / "truth.json", text, overwrite=force)
    if quiet:
        return
    say(
        f"{summary['found']} of {summary['defects']} defects found, {len(summary['hidden'])} out of view; "
        f"{summary['false_alarms_per_posture']:g} false alarms per posture; area under the pixels' ROC "
        f"{'-' if summary['roc_auc'] is None else summary['roc_auc']}"
    )
    rows = [
        [
            kind,
            f"{curve['found']} of {curve['defects']}",
            "-" if curve["a90"] is None else f"{curve['a90']:.3g}",
            "-" if curve["a90_95"] is None else f"{curve['a90_95']:.3g}",
        ]
        for kind, curve in summary["detection"].items()
    ]
    show_table(["kind", "found", "a90 [mm]", "a90/95 [mm]"], rows)
    say(f"{out / 'truth.json'}")


def _show(result: Inspection, verdict: Verdict) -> None:
    rows = [
        [
            str(defect.number),
            defect.best.kind,
            ", ".join(f"{x:.2f}" for x in defect.best.position),
            f"{defect.size[0]:.2f} × {defect.size[1]:.2f}",
            f"{defect.area:.3g}",
            f"{100.0 * defect.greatest_contrast:.0f} %",
            f"{defect.best.score:.1f}",
            str(len(defect.sightings)),
        ]
        for defect in result.defects
    ]
    if rows:
        head = ["", "kind", "place [mm]", "size [mm]", "area [mm²]", "contrast", "score", "postures"]
        show_table(head, rows, numbers_from=2)
    if result.placement is not None:
        p = result.placement.as_dict()
        say(
            f"the part lies {p['x_mm']:+.3f} mm in x, {p['y_mm']:+.3f} mm in y and {p['turn_deg']:+.3f}° from where "
            "its file has it"
        )
    for posture in result.postures:
        c = posture.coverage
        whole = max(c.seen, 1e-9) / 100.0
        say(
            f"posture {posture.view.posture}: {c.inspected / whole:.1f} % of {c.seen:.0f} mm² inspected; not: "
            f"{c.edge / whole:.1f} % edges, {c.saturated / whole:.1f} % saturated, {c.shadow / whole:.1f} % dark"
        )
    if len(result.postures) > 1:
        s = result.surface
        whole = max(s.seen, 1e-9) / 100.0
        say(
            f"all postures: {s.inspected / whole:.1f} % of {s.seen:.0f} mm² inspected in one or more; not: "
            f"{s.edge / whole:.1f} % edges, {s.saturated / whole:.1f} % saturated, {s.shadow / whole:.1f} % dark; "
            f"{100.0 * (1.0 - s.seen / max(s.area, 1e-9)):.1f} % of the part's {s.area:.0f} mm² is never seen"
        )
    say(f"{verdict.word}: {'; '.join(verdict.reasons) or 'nothing found that counts'}")
