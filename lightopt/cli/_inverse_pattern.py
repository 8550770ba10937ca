"""The picture on a display whose reflection in a good part is regular."""

import math
import re
from pathlib import Path
from typing import Annotated

import typer

from lightopt.cli import _common as common
from lightopt.cli._terminal import echo, run_context, show_table
from lightopt.core.errors import InputError, counted

TILTS_DEG = 0.01, 0.03, 0.1
MOST_PIXELS = 20_000


def inverse_pattern(
    rig: common.RigFile,
    part: common.PartFile,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="The picture (PNG).")],
    light: str = common.selection_option(..., metavar="NAME", help="The display, by its name in RIG."),
    posture: str | None = common.selection_option(
        None, metavar="θ,φ", help="Tilt and rotation of the part [deg].", show_default="the first posture of PART"
    ),
    pixels: str = common.model_option("64x48", metavar="WxH", help="Columns and rows of the picture."),
    period: float = common.model_option(
        16.0, "--period-px", metavar="N", min=0.0, help="Period of the pattern in the image [px]; 0: flat."
    ),
    force: common.Force = False,
) -> None:
    """Compute the picture on a display whose reflection in a good part is a regular pattern of known levels.

    An image of a part, less that pattern, is flat but for defects. Writes the picture as a viewer at the part sees it,
    and prints how flat the rendered reflection is, what a tilt of the part adds, and what the defects listed in PART
    add. See docs/how-to/image-series.md.

    Example: lightopt inverse-pattern rig.yaml part.yaml --light lcd -o picture.png
    """
    from lightopt import series
    from lightopt.images import write_png
    from lightopt.scene import build_scene

    columns, rows = _parse_pixels(pixels)
    if out.suffix.lower() != ".png":
        raise InputError(f"option '--out': expected a name that ends in .png, found {out}")
    if 0.0 < period < 2.0:
        raise InputError(f"option '--period-px': expected 0, or at least 2 pixels, found {period:g}")
    loaded_rig, loaded_part = common.load_inputs(rig, part)
    chosen = common.parse_postures(None if posture is None else [posture])
    loaded_rig = loaded_rig.without_programme()
    scene = build_scene(loaded_rig, loaded_part, postures=chosen)
    display = series.display_of(loaded_rig, scene, light)
    with run_context() as run:
        run.warn(*scene.warnings)
        found = series.inverse_pattern(scene, display, pixels=(columns, rows), period_px=period or None)
        tilts = series.tilt_residuals(scene, found, [math.radians(tilt) for tilt in TILTS_DEG])
        shown = series.defects_shown(scene, found)
    facts = {"light": light, "posture": scene.postures[0].as_dict(), "period_px": period, "residual": found.residual}
    write_png(out, found.levels, metadata=facts, overwrite=force)
    mean = float(found.target.mean())
    echo(f"{counted(len(found.row), 'camera pixel')} of the part; mean level {mean:.4g} at exposure 1")
    echo(f"rendered reflection less the pattern: {100.0 * found.residual:.2g} % of the mean level (root mean square)")
    residuals = [[f"{tilt:g}°", f"{100.0 * rest:.2g} %"] for tilt, rest in zip(TILTS_DEG, tilts, strict=True)]
    show_table(["part tilted by", "residual"], residuals)
    if shown:
        show_table(
            ["defect", "greatest change", "over noise"],
            [[one.name, f"{100.0 * one.change:.2g} %", f"{one.over_noise:.3g}"] for one in shown],
        )
    echo(f"{out}")


def _parse_pixels(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    columns, rows = (0, 0) if found is None else (int(found[1]), int(found[2]))
    if min(columns, rows) < 2 or columns * rows > MOST_PIXELS:
        expected = f"columns and rows such as 64x48, at most {MOST_PIXELS:,} in all"
        raise InputError(f"option '--pixels': expected {expected}, found {text!r}")
    return columns, rows
