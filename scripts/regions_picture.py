"""Draw docs/pictures/regions.png: the sample knob with a satin half and a printed ring.

``python scripts/regions_picture.py [PNG]``. All four lights; the square root of the levels.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from lightopt import build_scene, load_part, load_rig, render
from lightopt.images import write_png

ROOT = Path(__file__).resolve().parents[1]
PARTS = ROOT / "configs" / "parts"
SIDE, PIXEL = 240, 0.1  # of the mask [px], [mm]
REGIONS = f"""
regions:
  - name: print
    mask: {{file: print.png, onto: +z, corner_mm: [{-0.5 * SIDE * PIXEL}, {-0.5 * SIDE * PIXEL}], pixel_mm: {PIXEL}}}
    reflectance: {{R_d: 90, R_s: 0, sigma_rad: 0.1}}
  - name: satin half
    box_mm: {{low: [-100, -100, -100], high: [0, 100, 100]}}
    reflectance: {{model: ggx, R_d: 60, R_s: 900, alpha: 0.2}}
"""
SATURATED = 255.0


def regions_picture(target: Path) -> None:
    """Render the knob and write the picture."""
    place = (np.arange(SIDE) - 0.5 * (SIDE - 1)) * PIXEL
    radius = np.hypot(*np.meshgrid(place, place))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        ring = ((radius > 8.5) & (radius < 11.0)).astype(np.uint8) * 255
        write_png(folder / "print.png", ring, metadata={})
        text = (PARTS / "cover-knob.yaml").read_text(encoding="utf-8")
        text = text.replace("cover-knob.step", (PARTS / "cover-knob.step").as_posix())
        (folder / "part.yaml").write_text(text + REGIONS, encoding="utf-8")
        rig, part = load_rig(ROOT / "configs" / "rigs" / "four-panel.yaml"), load_part(folder / "part.yaml")
        scene = build_scene(rig, part, points="auto")
        images = next(iter(render(scene)))
    rows, columns = (
        slice(np.flatnonzero(a)[0] - 12, np.flatnonzero(a)[-1] + 13)
        for a in (images.geometry.hit.any(axis=1), images.geometry.hit.any(axis=0))
    )
    shown = [image.level[rows, columns][::3, ::3] for image in images.lights]
    levels = np.concatenate(shown, axis=1) / SATURATED
    write_png(target, np.round(255.0 * np.sqrt(np.clip(levels, 0.0, 1.0))).astype(np.uint8), metadata={})


if __name__ == "__main__":
    regions_picture(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "pictures" / "regions.png")
