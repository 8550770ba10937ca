from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from lightopt.cli import _common as common
from lightopt.cli._common import output_option
from lightopt.cli._terminal import echo, echo_paths, run_context, show_page_table
from lightopt.core.errors import InputError

sample_option = partial(typer.Option, rich_help_panel="Samples")
choice_option = partial(typer.Option, rich_help_panel="Choice of images")
Sets = Annotated[
    list[Path],
    typer.Argument(metavar="SETS", help="Image sets of good and defective samples: folders or manifest.json."),
]
MOST_DEFECTS = 8  # shown without `--verbose`


def optimize_from_images(
    sets: Sets,
    out: common.Out,
    region: Path | None = sample_option(
        None, "--region", metavar="PNG", help="Where to inspect: not 0.", show_default="where the part is seen"
    ),
    images: int = choice_option(4, "--images", "-k", metavar="N", min=1, help="Number of images to take of a part."),
    mix: bool = choice_option(False, "--mix", help="Show several lights in an image, each with a weight."),
    false_alarms: float = choice_option(
        0.05, metavar="N", help="Expected false alarms per posture, from 1e-9 to 1: when a defect counts as found."
    ),
    max_combinations: int = choice_option(
        50_000_000, metavar="N", min=1, help="Stop after about N choices of lights and report a bound."
    ),
    rig: Path | None = output_option(
        None, "--rig", metavar="RIG", help="Rig file of the lights; written with the programme as rig.optimized.yaml."
    ),
    compare: Path | None = output_option(
        None, "--compare", metavar="SET", help="Set captured with the programme, to compare with what is synthesised."
    ),
    report: common.Report = True,
    force: common.Force = False,
    threads: common.Threads = None,
) -> None:
    """Choose lights from images of samples, without a CAD model.

    SETS are rendered or captured with one light (or segment, or LED) at a time, of samples at the same place of the
    image: good ones, and defective ones with masks. A set's mask is masks/posture_θ_φ.png beside its manifest, or
    mask.png for a single posture: 0 where the sample is good, anything else on defects; pixels that touch are one
    defect. Sets that were rendered with defects need none. A set without a mask is a good sample.

    Finds the N lights whose images show the defects best, by exact search with a bound, and how long to expose them;
    with --mix the weights of lights that are on together. Writes result.json, programme.yaml (the programme of a rig
    file, for capture), the images as they would look (images/), and report.html. See docs/how-to/from-images.md.

    Example: lightopt optimize --from-images good-1 good-2 good-3 scratched dented -k 4 -o chosen
    """
    from lightopt.design import (
        FromImagesOptions,
        agreement_text,
        finish_from_images,
        from_images_answer,
        optimize_from_images as choose,
        write_from_images,
    )
    from lightopt.report.design import chosen_table, defects_table, from_images_report, scores_table

    if files := [path.name for path in sets if path.suffix.lower() in (".yaml", ".yml")]:
        raise InputError(
            f"{', '.join(files)}: lights are chosen from image sets; give no rig and part file (--rig names the rig "
            "that is to take the programme)"
        )
    options = FromImagesOptions(images=images, mix=mix, false_alarms=false_alarms, limit=max_combinations)
    with run_context(threads) as run:
        result = choose(sets, options=options, region=region, rig=rig, captured=compare, run=run)
        output = write_from_images(result, out, force=force, run=run)
        page = from_images_report(result) if report else None
        paths = finish_from_images(output, result, page)
    echo(" ".join(from_images_answer(result)))
    for table in (chosen_table(result), scores_table(result)):
        show_page_table(table)
    show_page_table(defects_table(result), most=MOST_DEFECTS)
    if result.agreement is not None:
        echo(agreement_text(*result.agreement))
    echo_paths(*paths)
