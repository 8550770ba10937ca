"""Commands on rig and part files: written, explained by a schema, validated, given random defects."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from typer import Argument, Option

from lightopt.cli import _common as common
from lightopt.cli._common import output_option
from lightopt.cli._terminal import VERBOSE, echo, echo_paths
from lightopt.core.errors import CheckFailed, InputError, counted
from lightopt.core.run_context import RunContext

if TYPE_CHECKING:
    from lightopt.config import FileKind


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
