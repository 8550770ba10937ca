from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lightopt.cli._optimize_tables import show_overlaps
from lightopt.cli._options import Force, Quiet, make_folder
from lightopt.cli._terminal import say

__all__ = ["overlap"]


def overlap(
    images: Annotated[Path, typer.Argument(metavar="IMAGES", help="Image set: its folder or manifest.json.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="DIR", help="Write the maps (PNG) and overlap.json here."),
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Say where the saturated regions of a posture's images overlap, rendered or captured.

    Per posture and exposure: saturated pixels of each light, pixels saturated under both lights of each pair, and
    pixels saturated in two images or more. The maps show no highlight in grey, one in blue, several in red.

    Example: lightopt overlap captured/ -o overlaps
    """
    import json

    from lightopt.images import read_image_set, write_text_atomic
    from lightopt.overlap import find_overlaps, overlap_map_name, write_overlap_map

    found = find_overlaps(read_image_set(images))
    if not quiet:
        show_overlaps(found)
    if out is None:
        return
    for one in found:
        path = out / overlap_map_name(one.posture, one.exposure)
        make_folder(path.parent)
        write_overlap_map(one, path, overwrite=force)
        if not quiet:
            say(f"{path}")
    text = json.dumps({"overlaps": [one.as_dict() for one in found]}, indent=1, ensure_ascii=False) + "\n"
    write_text_atomic(out / "overlap.json", text, overwrite=force)
    if not quiet:
        say(f"{out / 'overlap.json'}")
