from collections import Counter
from pathlib import Path
from typing import Annotated

import typer

from lightopt.cli._inputs import load_inputs
from lightopt.cli._options import Force, JsonFile, Quiet, RigFile, Verbose, output_option
from lightopt.cli._terminal import echo
from lightopt.core.errors import CheckFailed, InputError, counted


def check(
    rig: RigFile,
    part: Annotated[
        Path | None, typer.Argument(metavar="[PART]", help="Part file (YAML); without it only the rig is checked.")
    ] = None,
    json_file: JsonFile = None,
    drawing: Annotated[
        Path | None, output_option(metavar="FILE", help="Draw the rig with its frames and angles (PNG).")
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Validate RIG and PART and summarise the set-up, before anything is rendered.

    Checks the pixel footprint, field of view, size, panel points and facets against the lobe, lights in the camera's
    view, and surface that no camera ray reaches. Exit status 1 where a finding is an error, 2 where a file cannot be
    used. Of several findings on one topic that are ok, the first is shown; --verbose shows all.

    Example: lightopt check rig.yaml part.yaml --drawing rig.png
    """
    import json

    from lightopt.preflight import check_rig, check_scene

    if drawing is not None and part is None:
        raise InputError("--drawing: needs a part file, too")
    loaded_rig, loaded_part = load_inputs(rig, part)
    report = check_rig(loaded_rig) if loaded_part is None else check_scene(loaded_rig, loaded_part)
    levels = Counter(finding.level for finding in report.findings)
    if not quiet:
        named = [counted(levels[level], level) for level in ("error", "warning", "note") if levels[level]]
        echo(f"{', '.join(named) or 'nothing to correct'}; {levels['ok']} of {len(report.findings)} findings are ok")
    shown: set[str] = set()
    for finding in report.findings:
        if quiet and finding.level in ("ok", "note"):
            continue
        if finding.level == "ok" and finding.topic in shown and not verbose:
            continue  # such as each posture's view
        shown.add(finding.topic)
        where = f" ({finding.where})" if finding.where else ""
        echo(f"{finding.level + ':':9}{finding.topic}: {finding.text}{where}")
    if drawing is not None and loaded_part is not None:
        from lightopt.report import rig_drawing
        from lightopt.scene import build_scene

        echo(f"{rig_drawing(build_scene(loaded_rig, loaded_part), drawing, overwrite=force)}")
    if json_file is not None:
        from lightopt.config import input_hashes
        from lightopt.core.provenance import provenance
        from lightopt.images import write_text_atomic

        found = {**report.as_dict(), "provenance": provenance(input_hashes(loaded_rig, loaded_part), {})}
        text = json.dumps(found, indent=2, ensure_ascii=False) + "\n"
        write_text_atomic(json_file, text, overwrite=force)
    if errors := levels["error"]:
        raise CheckFailed(f"{errors} of {counted(len(report.findings), 'finding')} must be corrected before rendering")
