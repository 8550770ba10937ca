from pathlib import Path
from typing import Annotated

import typer

from lightopt.cli._optimize_tables import show_overlaps
from lightopt.cli._options import Force, Quiet, Verbose
from lightopt.cli._terminal import echo


def overlap(
    images: Annotated[Path, typer.Argument(metavar="IMAGES", help="Image set: its folder or manifest.json.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="DIR", help="Write the maps (PNG) and overlap.json here.")
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
    _verbose: Verbose = False,
) -> None:
    """Report where the saturated regions of a posture's images overlap, rendered or captured.

    Per posture and exposure: saturated pixels of each light, pixels saturated under both lights of each pair, and
    pixels saturated in two images or more. The maps show no highlight in grey, one in blue, several in red.

    Example: lightopt overlap captured/ -o overlaps
    """
    from lightopt.images import find_overlaps, read_image_set, write_overlaps

    image_set = read_image_set(images)
    found = find_overlaps(image_set)
    if not quiet:
        show_overlaps(found)
    if out is None:
        return
    for path in write_overlaps(found, image_set, out, force=force):
        if not quiet:
            echo(f"{path}")
