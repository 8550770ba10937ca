"""Commands on files: rig and part files (written, explained by a schema, validated, given defects), image sets."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer
from typer import Argument, Option

from lightopt.cli import _common as common
from lightopt.cli._common import output_option
from lightopt.cli._optimize import show_overlaps
from lightopt.cli._terminal import VERBOSE, echo, echo_paths, show_table
from lightopt.core.errors import CheckFailed, InputError, counted
from lightopt.core.run_context import RunContext

if TYPE_CHECKING:
    from lightopt.config import FileKind
    from lightopt.images.comparison import FileComparison


def init(
    folder: Path = Argument(..., metavar="DIR", help="Output folder; created if missing."), force: common.Force = False
) -> None:
    """Write a sample set-up to DIR: commented rig.yaml and part.yaml, the part's mesh, and JSON schemas for editors.

    Then: lightopt check DIR/rig.yaml DIR/part.yaml
    """
    from importlib.resources import files

    from lightopt.images import make_folder, write_bytes_atomic

    samples = files("lightopt.samples")

    def text(name: str) -> bytes:
        content = samples.joinpath(name).read_text(encoding="utf-8")
        return content.replace("$schema=../schema/", "$schema=").encode()

    # the schemas lie beside the files here
    outputs = {
        "rig.yaml": text("rigs/four-panel.yaml"),
        "part.yaml": text("parts/cover-knob.yaml"),
        "cover-knob.step": samples.joinpath("parts/cover-knob.step").read_bytes(),
        "rig.json": f"{_schema_text('rig')}\n".encode(),
        "part.json": f"{_schema_text('part')}\n".encode(),
    }
    taken = [name for name in outputs if (folder / name).exists()]
    if taken and not force:
        raise InputError(f"{folder} already has {', '.join(taken)}; use --force to overwrite them, or another folder")
    make_folder(folder)
    for name, content in outputs.items():
        write_bytes_atomic(folder / name, content)
        echo(f"{folder / name}")
    echo(f"next: lightopt check {folder / 'rig.yaml'} {folder / 'part.yaml'}")


def schema(
    kind: Literal["rig", "part", "ranges", "batch"] = Argument(
        ..., metavar="KIND", help="Kind of file: rig, part, ranges (of a dataset) or batch."
    ),
) -> None:
    """Print the JSON schema of a kind of file, for editors and other programs.

    Example: lightopt schema rig > rig.json

    An editor with the YAML language server uses this schema if the first line of a YAML file is

    # yaml-language-server: $schema=rig.json
    """
    echo(_schema_text(kind))


def _schema_text(kind: FileKind) -> str:
    from lightopt.config import json_schema

    return json.dumps(json_schema(kind), indent=2, ensure_ascii=False)


def check(
    rig: common.RigFile,
    part: Path | None = Argument(None, metavar="PART", help="Part file (YAML); without it only the rig is checked."),
    json_file: common.JsonFile = None,
    drawing: Path | None = output_option(None, metavar="FILE", help="Draw rig and PART with frames and angles (PNG)."),
    force: common.Force = False,
) -> None:
    """Validate RIG and PART and summarise the set-up, before anything is rendered.

    Checks the pixel footprint, field of view, part size, panel points and facets relative to the lobe width, lights in
    the camera's view, and surface that no camera ray reaches. If several findings on one topic are ok, only the first
    is printed; --verbose prints all. Exit status 1 if a finding is an error, 2 if a file cannot be used.

    Example: lightopt check rig.yaml part.yaml --drawing rig.png
    """
    from lightopt.preflight import check_rig, check_scene

    if drawing is not None and part is None:
        raise InputError("--drawing: expected a part file as well")
    loaded_rig, loaded_part = common.load_rig_and_maybe_part(rig, part)
    report = check_rig(loaded_rig) if loaded_part is None else check_scene(loaded_rig, loaded_part)
    levels = Counter(finding.level for finding in report.findings)
    named = [counted(levels[level], level) for level in ("error", "warning", "note") if levels[level]]
    echo(f"{', '.join(named) or 'nothing to correct'}; {levels['ok']} of {len(report.findings)} findings are ok")
    shown: set[str] = set()
    for finding in report.findings:
        if finding.level == "ok" and finding.topic in shown and not VERBOSE.get():
            continue  # such as each posture's view
        shown.add(finding.topic)
        where = f" ({finding.where})" if finding.where else ""
        text = f"{finding.level + ':':9}{finding.topic}: {finding.text}{where}"
        echo(text, even_if_quiet=finding.level in ("warning", "error"))
    if drawing is not None and loaded_part is not None:
        from lightopt.report import rig_drawing
        from lightopt.scene import build_scene

        echo(f"{rig_drawing(build_scene(loaded_rig, loaded_part), drawing, overwrite=force)}")
    if json_file is not None:
        from lightopt.config import input_hashes
        from lightopt.core.provenance import provenance
        from lightopt.images import write_text_atomic

        found = {**report.as_dict(), "provenance": provenance(input_hashes(loaded_rig, loaded_part), {})}
        write_text_atomic(json_file, json.dumps(found, indent=2, ensure_ascii=False) + "\n", overwrite=force)
    if errors := levels["error"]:
        raise CheckFailed(f"{errors} of {counted(len(report.findings), 'finding')} must be corrected before rendering")


def defects(
    rig: common.RigFile,
    part: common.PartFile,
    out: Path = Option(..., "--out", "-o", metavar="FILE", help="Part file to write; its folder is made if missing."),
    seed: int = Option(..., metavar="N", help="Random seed; the same seed gives the same defects."),
    count: int = Option(..., metavar="K", help="Number of defects, 1 to 500."),
    force: common.Force = False,
    threads: common.Threads = None,
) -> None:
    """Place random defects on PART for testing, where the camera of RIG sees the part in at least one posture.

    Takes the entries of the part's defect_catalogue, or of the built-in catalogue (docs/how-to/defects.md), in turn.
    Positions are uniform by area. They keep clear of silhouettes, creases and other defects. Writes a copy of PART,
    including its comments, with the list of defects at the end. render shows these defects.

    Example: lightopt defects rig.yaml part.yaml --seed 1 --count 14 -o part.defects.yaml
    """
    from lightopt import inspection
    from lightopt.images import make_folder, write_text_atomic

    loaded_rig, loaded_part = common.load_inputs(rig, part)
    comment = f"{counted(count, 'defect')}, placed at random by: lightopt defects --seed {seed} --count {count}"
    run = RunContext(threads=threads)
    placed = inspection.place_random_defects(loaded_rig, loaded_part, count=count, seed=seed, run=run)
    made_from = inspection.random_defect_provenance(loaded_rig, loaded_part, count=count, seed=seed)
    text = inspection.random_defects_text(loaded_part, placed, folder=out.parent, comment=comment, made_from=made_from)
    make_folder(out.parent)
    write_text_atomic(out, text, overwrite=force)
    kinds = Counter(defect.entry.name for defect in placed)
    echo(f"{counted(len(placed), 'defect')}: {', '.join(f'{n} × {name}' for name, n in kinds.items())}")
    echo_paths(out)


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
