"""Commands on image sets alone."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from lightopt.cli import _common as common
from lightopt.cli._common import output_option
from lightopt.cli._optimize import show_overlaps
from lightopt.cli._terminal import VERBOSE, echo, echo_paths, show_table
from lightopt.core.errors import CheckFailed, InputError, counted

if TYPE_CHECKING:
    from lightopt.images.comparison import FileComparison


threshold_option = partial(typer.Option, rich_help_panel="Thresholds")
MOST_ROWS, MOST_NOTES = 8, 3  # shown without `--verbose`


def overlap(
    images: common.Images,
    out: Path | None = typer.Option(
        None, "--out", "-o", metavar="DIR", help="Output folder for maps (PNG) and overlap.json; created if missing."
    ),
    force: common.Force = False,
) -> None:
    """Report where the saturated regions of a posture's images overlap.

    Prints per posture and exposure the number of pixels that are saturated under each light, under both lights of each
    pair, and in two images or more. With --out, maps show pixels saturated in one image in blue, in several in red.

    Example: lightopt overlap captured/ -o overlaps
    """
    from lightopt.images import find_overlaps, read_image_set, write_overlaps

    image_set = read_image_set(images)
    found = find_overlaps(image_set)
    show_overlaps(found)
    if out is not None:
        echo_paths(*write_overlaps(found, image_set, out, force=force))


def compare(
    golden: Path = typer.Argument(..., metavar="A", help="Golden EXR, PNG or image set (folder or manifest.json)."),
    new: Path = typer.Argument(..., metavar="B", help="New EXR, PNG or image set."),
    absolute: float = threshold_option(
        0.05, metavar="LEVEL", help="A pixel differs if B deviates from A by more than this plus --relative times A."
    ),
    relative: float = threshold_option(0.001, metavar="SHARE", help="Relative part of the threshold; see --absolute."),
    max_share: float = threshold_option(
        0.001, metavar="SHARE", help="Share of the part's pixels, in A or B, that may differ."
    ),
    geometry_absolute: float = threshold_option(
        0.001, metavar="MM", help="Threshold of geometry images and patch tables."
    ),
    min_iou: float | None = threshold_option(
        None, metavar="IOU", help="Minimum IoU of the saturated areas.", show_default="not checked"
    ),
    saturation: float | None = threshold_option(
        None, metavar="LEVEL", help="Level from which a pixel is saturated.", show_default="as the files say"
    ),
    diff: Path | None = output_option(
        None,
        metavar="PATH",
        help="Write a difference picture (PNG), or a folder of them. Red: B is higher; blue: lower; green: "
        "saturated in A only; magenta: in B only.",
    ),
    json_file: common.JsonFile = None,
    force: common.Force = False,
) -> None:
    """Compare a new image or image set B with a golden one A; exit status 1 if they differ too much.

    Prints per channel the maximum and rms difference, the 99th percentile, the share of differing pixels, and the
    intersection over union (IoU) of the saturated areas. Pixels that are background in both images do not count, except
    in a PNG with noise. A file that is missing in B is a failure; a file that is missing in A is a note. Exit status 2
    if A or B is neither an image nor an image set.

    Example: lightopt compare golden/ out/ --diff differences/
    """
    from lightopt.images import comparison, make_folder, write_text_atomic

    sets = golden.is_dir() or new.is_dir() or golden.name == "manifest.json"
    if sets and diff is not None:
        make_folder(diff)
    thresholds = comparison.ComparisonThresholds(
        absolute=absolute,
        relative=relative,
        max_share=max_share,
        geometry_absolute=geometry_absolute,
        min_iou=min_iou,
        saturation=saturation,
    )
    compare_them = comparison.compare_sets if sets else comparison.compare_files
    result = compare_them(golden, new, thresholds)
    if json_file is not None:
        figures = {**result.as_dict(), "provenance": comparison.comparison_provenance(result, thresholds)}
        write_text_atomic(json_file, json.dumps(figures, indent=2) + "\n", overwrite=force)
    files = result.files if isinstance(result, comparison.SetComparison) else (result,)
    _show(files, parts=2 if sets else 1)
    if isinstance(result, comparison.SetComparison):
        notes = result.notes
        shown = notes if VERBOSE.get() else notes[:MOST_NOTES]
        for note in shown:
            echo(f"note: {note}")
        if len(shown) < len(notes):
            echo(f"and {counted(len(notes) - len(shown), 'note')} more; --verbose shows all")
    if diff is not None:
        draw = partial(comparison.difference_picture, saturation=saturation, overwrite=force)
        echo(_draw(files, diff, draw, sets=sets))
    if not result.passed:
        raise CheckFailed(*(f"differs: {reason}" for reason in result.reasons))


def _show(files: Sequence[FileComparison], *, parts: int) -> None:
    # the verdict, and the channels that differ, or the greatest difference where none does
    channels = [(file, channel) for file in files for channel in file.channels]
    differing = [pair for pair in channels if not pair[1].passed]
    if all(file.passed for file in files):
        echo(f"no difference beyond the thresholds in {counted(len(files), 'file')}")
    greatest = sorted(channels, key=lambda pair: (pair[1].share, pair[1].max or 0.0))[-1:]
    shown = channels if VERBOSE.get() else (differing or greatest)[:MOST_ROWS]
    rows: list[list[str]] = []
    for file, channel in shown:
        p99 = None if channel.percentiles is None else channel.percentiles.get("p99")
        numbers = ["-" if value is None else f"{value:.4g}" for value in (channel.max, channel.rms, p99)]
        iou = "-" if channel.iou is None else f"{channel.iou:.4f}"
        verdict = "ok" if channel.passed else "DIFFERS"
        name = "/".join(Path(file.b).parts[-parts:])
        rows.append([name, channel.name, *numbers, f"{100.0 * channel.share:.3f} %", iou, verdict])
    if rows:
        show_table(["file", "channel", "max", "rms", "p99", "differing", "IoU", ""], rows, numbers_from=2)
    if len(shown) < len(differing):
        echo(f"and {counted(len(differing) - len(shown), 'channel')} more that differ; --verbose shows all")


def _draw(files: Sequence[FileComparison], path: Path, draw: Callable[..., float], *, sets: bool) -> str:
    if not sets:
        (one,) = files
        if not one.channels:
            raise InputError(f"{path}: no difference picture, since the files cannot be compared", *one.reasons)
        return f"{path}: blue lower, red higher, full colour at {draw(one.a, one.b, path):.4g}"
    drawn = [file for file in files if file.channels and Path(file.a).suffix in (".exr", ".png")]
    for file in drawn:
        draw(file.a, file.b, path / f"{'_'.join(Path(file.b).parts[-2:])}.diff.png")
    return f"{counted(len(drawn), 'difference picture')} in {path}"
