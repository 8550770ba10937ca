from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING

from lightopt.cli import _common as common
from lightopt.cli._common import model_option
from lightopt.cli._terminal import VERBOSE, echo, echo_paths, run_context, show_page_table
from lightopt.core.errors import CheckFailed, InputError

if TYPE_CHECKING:
    from lightopt.estimate.verification import Verification

MOST_ROWS = 4  # of each table without `--verbose`; verify.json has all of them


def verify(
    rig: common.RigFile,
    part: common.PartFile,
    images: common.Images,
    out: common.Out,
    baseline: Path | None = model_option(
        None, metavar="SET", help="Known good image set of the same part: report what has changed since."
    ),
    plan: Path | None = model_option(
        None, metavar="FILE", help="result.json of optimize with tolerances, which become the limits."
    ),
    limit: list[str] | None = model_option(
        None,
        "--limit",
        metavar="NAME=VALUE",
        help="Change a limit; repeatable. Names: gain, exposure (such as 3%), black (levels), part_mm, part_deg, "
        "camera_mm, camera_deg, panel_mm, panel_deg, blur_px.",
        show_default="see docs/how-to/verify.md",
    ),
    register: common.Register = True,
    history: Path | None = common.output_option(
        None, metavar="DIR", help="Add a row for this run to history.csv in DIR, and draw history.png."
    ),
    report: common.Report = True,
    force: common.Force = False,
    threads: common.Threads = None,
) -> None:
    """Compare captured IMAGES with the prediction and name what has changed on the rig.

    Reports for each light the overlap of the saturated areas, the offset of the highlights, and the residual over the
    noise. Names the causes with their sizes: gain of a light, exposure, black level, lights exchanged, panel, part or
    camera moved, focus, dust. Writes verify.json and report.html. Exit status 1 if the rig has left its tolerances.

    Example: lightopt verify rig.yaml part.yaml captured/ -o verified --history verified/history
    """
    from lightopt.estimate import verification
    from lightopt.images import read_image_set
    from lightopt.report import history_chart, verification_report

    loaded_rig, loaded_part = common.load_inputs(rig, part)
    planned = {} if plan is None else verification.plan_limits(plan, loaded_rig)
    limits = verification.VerifyLimits(**{**planned, **_limits(limit or [])})
    image_set = read_image_set(images)
    good = None if baseline is None else read_image_set(baseline)
    folder = verification.verify_folder(
        out, loaded_rig, loaded_part, image_set, baseline=good, limits=limits, register=register, force=force
    )
    with run_context(threads) as run:
        result = verification.verify_set(
            loaded_rig, loaded_part, image_set, baseline=good, limits=limits, register=register, run=run
        )
    run.warn(*result.warnings)
    _show(result)
    written: list[Path] = []
    if report:
        page = verification_report(result, part=loaded_part.name, rig=loaded_rig.name, provenance=folder.made_from)
        written.append(folder.write_text(verification.REPORT_NAME, page))
    written.insert(0, folder.finish(result.as_dict()))
    if history is not None:
        name = image_set.folder.resolve().name
        rows = verification.append_history(history, result, name=name, when=datetime.now(timezone.utc))
        written += [history / verification.HISTORY_NAME, history_chart(rows, history / "history.png")]
    echo_paths(*written)
    if not result.within_tolerances:
        raise CheckFailed(result.answer)


def _limits(given: list[str]) -> dict[str, float]:
    from lightopt.estimate.verification import VerifyLimits

    names = tuple(VerifyLimits().as_dict())
    values: dict[str, float] = {}
    for text in given:
        name, _, value = text.partition("=")
        if name not in names:
            raise InputError(f'--limit: expected NAME=VALUE with a name of {", ".join(names)}, found "{text}"')
        if name in ("gain", "exposure"):
            expected = "of the brightness, such as 3%"
            values[name] = common.parse_share(value, option=f"--limit {name}", expected=expected)
            continue
        try:
            values[name] = float(value)
        except ValueError:
            raise InputError(f'--limit {name}: expected a number, found "{value}"') from None
    return values


def _show(result: Verification) -> None:
    from lightopt.report import findings_table, lights_table

    echo(result.answer if result.within_tolerances else "the rig has left its tolerances")
    if result.findings:
        show_page_table(findings_table(result), most=MOST_ROWS)
    for finding in result.findings[: None if VERBOSE.get() else MOST_ROWS]:
        if finding.remedy:
            echo(f"to tell {finding.cause}: {finding.remedy}")
    show_page_table(lights_table(result), most=MOST_ROWS)
    if not VERBOSE.get() and max(len(result.findings), len(result.lights)) > MOST_ROWS:
        echo("--verbose shows all rows")
