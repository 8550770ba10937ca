from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lightopt.cli._options import Force, make_folder
from lightopt.cli._terminal import say, show_table
from lightopt.core.errors import CheckFailed, InputError, counted

if TYPE_CHECKING:
    from lightopt.images.comparison import FileComparison


def compare(
    golden: Annotated[Path, typer.Argument(metavar="A", help="Golden EXR, PNG or image set (folder).")],
    new: Annotated[Path, typer.Argument(metavar="B", help="New EXR, PNG or image set.")],
    absolute: Annotated[
        float, typer.Option(metavar="LEVEL", help="A pixel differs by more than this level …")
    ] = 0.05,
    relative: Annotated[
        float, typer.Option(metavar="SHARE", help="… plus this share of the golden level.")
    ] = 0.001,
    max_share: Annotated[
        float,
        typer.Option(
            metavar="SHARE",
            help="Share of pixels that may differ, of those that are part (not level 0 or the black level) in A or B.",
        ),
    ] = 0.001,
    geometry_absolute: Annotated[
        float, typer.Option(metavar="MM", help="Threshold in geometry images and patch tables.")
    ] = 0.001,
    min_iou: Annotated[
        float | None,
        typer.Option(metavar="IOU", help="Least overlap of the saturated areas, intersection over union."),
    ] = None,
    saturation: Annotated[
        float | None, typer.Option(metavar="LEVEL", help="Saturated from this level on. [what the files say]")
    ] = None,
    diff: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            help="Difference picture (PNG); a folder of them for image sets. Red: B is higher, blue: lower; green: "
            "saturated in A alone, magenta: in B alone.",
        ),
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write all figures as JSON.")
    ] = None,
    force: Force = False,
) -> None:
    """Compare two images or image sets, golden A against new B; exit status 1 where they differ too much.

    Per channel: greatest and rms difference, 99th percentile, share of differing pixels, and overlap (IoU) of the
    saturated areas. Pixels that are background in both images (level 0 or the black level, rays that miss the part)
    do not count, so a small part cannot hide in a large frame; all pixels of a PNG with noise do count. A file that
    only one set has: missing in B it is a failure, missing in A a note. Exit status 2 where A or B is no
    image and no image set.

    Example: lightopt compare golden/ out/ --diff differences/
    """
    import json

    from lightopt.images import write_text_atomic
    from lightopt.images.comparison import (
        ComparisonThresholds,
        SetComparison,
        compare_files,
        compare_sets,
        comparison_provenance,
    )

    sets = golden.is_dir() or new.is_dir() or golden.name == "manifest.json"
    if sets and diff is not None:
        make_folder(diff)
    thresholds = ComparisonThresholds(
        absolute=absolute,
        relative=relative,
        max_share=max_share,
        geometry_absolute=geometry_absolute,
        min_iou=min_iou,
        saturation=saturation,
    )
    result = compare_sets(golden, new, thresholds) if sets else compare_files(golden, new, thresholds)
    if json_file is not None:
        figures = {**result.as_dict(), "provenance": comparison_provenance(result, thresholds)}
        write_text_atomic(json_file, json.dumps(figures, indent=2) + "\n", overwrite=force)
    if isinstance(result, SetComparison):
        _show(result.files, parts=2)
        for note in (*result.notes, *(f"only in the new set: {name}" for name in result.extra)):
            say(f"note: {note}")
        if diff is not None:
            _draw_set(result.files, diff, saturation, force)
    else:
        _show((result,), parts=1)
        if diff is not None:
            _draw_file(result, diff, saturation, force)
    if not result.passed:
        raise CheckFailed(*(f"differs: {reason}" for reason in result.reasons))
    say("no difference beyond the thresholds")


def _show(files: Sequence[FileComparison], *, parts: int) -> None:
    rows: list[list[str]] = []
    for file in files:
        name = "/".join(Path(file.b).parts[-parts:])
        for channel in file.channels:
            p99 = None if channel.percentiles is None else channel.percentiles.get("p99")
            numbers = (channel.max, channel.rms, p99)
            rows.append(
                [
                    name,
                    channel.name,
                    *("-" if value is None else f"{value:.4g}" for value in numbers),
                    f"{100.0 * channel.share:.3f} %",
                    "-" if channel.iou is None else f"{channel.iou:.4f}",
                    "ok" if channel.passed else "DIFFERS",
                ]
            )
    if rows:
        show_table(["file", "channel", "max", "rms", "p99", "differing", "IoU", ""], rows, numbers_from=2)


def _draw_set(files: Sequence[FileComparison], folder: Path, saturation: float | None, force: bool) -> None:
    from lightopt.images.comparison import difference_picture

    drawn = [file for file in files if file.channels and Path(file.a).suffix in (".exr", ".png")]
    for file in drawn:
        path = folder / f"{'_'.join(Path(file.b).parts[-2:])}.diff.png"
        difference_picture(file.a, file.b, path, saturation=saturation, overwrite=force)
    say(f"{counted(len(drawn), 'difference picture')} in {folder}")


def _draw_file(file: FileComparison, path: Path, saturation: float | None, force: bool) -> None:
    from lightopt.images.comparison import difference_picture

    if not file.channels:
        raise InputError(f"{path}: no difference picture, since the files cannot be compared", *file.reasons)
    scale = difference_picture(file.a, file.b, path, saturation=saturation, overwrite=force)
    say(f"{path}: blue lower, red higher, full colour at {scale:.4g}")
