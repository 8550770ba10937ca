"""Make the pictures and tables of docs/ anew, through the same commands and functions that a user calls.

Tables go between ``<!-- begin NAME -->`` and ``<!-- end NAME -->`` in the pages.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from bounce_picture import bounce_picture
from displaced_picture import displaced_picture
from finishes_picture import brushed_picture, diffuse_forms_picture, finishes_picture, measured_finishes_picture
from frames_drawing import frames_drawing
from lens_picture import lens_picture
from lighting_picture import lighting_picture
from machine_pictures import housings_picture, motion_picture
from PIL import Image
from regions_picture import regions_picture
from statistic_picture import statistic_picture

from lightopt import build_scene, render
from lightopt.images import read_exr, read_image_set
from lightopt.optics import expose, saturated_region
from lightopt.report import contact_sheet, rig_drawing

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PICTURES = DOCS / "pictures"
RIGS = ROOT / "configs" / "rigs"
PARTS = ROOT / "configs" / "parts"

# the paper's Table 1; R_s of m = 1 as printed and as it is read (docs/reference/reflection-model.md)
TABLE_1 = [
    (1, 1_180_000.0, 0.0525),
    (1, 11_800.0, 0.0525),
    (4, 12_500.0, 0.0475),
    (9, 16_200.0, 0.045),
    (16, 23_000.0, 0.0425),
]


def lightopt(*arguments: str | Path) -> str:
    """Run the command and return what it printed."""
    command = [sys.executable, "-m", "lightopt", *map(str, arguments)]
    return subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT).stdout


def replace_block(page: Path, name: str, text: str) -> None:
    """Put text between a page's markers."""
    content = page.read_text(encoding="utf-8")
    begin, end = f"<!-- begin {name} -->", f"<!-- end {name} -->"
    if begin not in content or end not in content:
        sys.exit(f"{page}: no markers for {name}")
    pattern = re.compile(re.escape(begin) + ".*?" + re.escape(end), re.DOTALL)
    page.write_text(pattern.sub(lambda _: f"{begin}\n{text}\n{end}", content), encoding="utf-8")


def saturated_table() -> str:
    """Each row of the paper's Table 1 on the cover knob: area and perimeter of the saturated region, and converged."""
    lines = [
        "| m | R_s | σ [rad] | saturated area [px], lights 1–4 | sum | perimeter [px], sum | sum with `points: auto` |",
        "|---|---|---|---|---|---|---|",
    ]
    posture = None
    for m, coefficient, sigma in TABLE_1:
        figures = {}
        for points in (m, "auto"):
            scene = build_scene(RIGS / "paper.yaml", PARTS / "cover-knob.yaml", points=points)
            posture = posture or scene.postures[0]
            scene = _with_reflectance(scene, coefficient, sigma, posture)
            images = next(iter(render(scene)))
            figures[points] = [
                saturated_region(
                    expose(image.level, sensor=scene.sensor, exposure=1.0, full_scale=scene.reflectance.full_scale),
                    scene.sensor.saturation_level,
                ).area
                for image in images.lights
            ]
            if points == m:
                perimeter = sum(saturated_region(image.level, 254.5).perimeter for image in images.lights)
        own = figures[m]
        lines.append(
            f"| {m} | {coefficient:,.0f} | {sigma} | {', '.join(f'{area:,}' for area in own)} | {sum(own):,} "
            f"| {perimeter:,.0f} | {sum(figures['auto']):,} |"
        )
    return "\n".join(lines)


def _with_reflectance(scene, coefficient, sigma, posture):
    from dataclasses import replace

    reflectance = replace(scene.reflectance, R_d=45.0, R_s=coefficient, sigma=sigma)
    return replace(scene, reflectance=reflectance, postures=(posture,))


def side_by_side(target: Path, images: list[np.ndarray], gain: float = 1.0) -> None:
    """Crops of linear images next to each other, as the camera would show them."""
    tiles = [np.clip(np.floor(image * gain + 0.5), 0, 255).astype(np.uint8) for image in images]
    gap = np.full((tiles[0].shape[0], 12), 255, np.uint8)
    row = [part for tile in tiles for part in (tile, gap)][:-1]
    Image.fromarray(np.concatenate(row, axis=1)).save(target, optimize=True)


# near the highlight of light1 on the cover knob, by pixel of the first posture
SHOWN_DEFECTS = """
defects:
  - {name: scratch-1, kind: scratch, size_mm: [6, 0.25], slope_deg: 6, direction_deg: 25, AT: [925, 520]}
  - {name: scratch-2, kind: scratch, size_mm: [4, 0.2], slope_deg: 8, direction_deg: 110, AT: [850, 455]}
  - {name: dent-1, kind: dent, size_mm: 2, slope_deg: 3, AT: [985, 540]}
  - {name: dent-2, kind: dent, size_mm: 2, slope_deg: 5, AT: [880, 405]}
  - {name: bump, kind: bump, size_mm: 1, slope_deg: 3, AT: [905, 465]}
  - {name: blister, kind: blister, size_mm: 1.5, slope_deg: 6, AT: [975, 450]}
  - {name: pit, kind: pit, size_mm: 0.3, slope_deg: 20, AT: [945, 490]}
  - {name: stain, kind: stain, size_mm: [2.4, 1.6], R_d_factor: 0.3, direction_deg: 40, AT: [845, 570]}
  - {name: haze, kind: haze, size_mm: 2.5, sigma_factor: 1.5, AT: [905, 580]}
"""
# R_s of chrome reflects as much as that of satin: R_s·σ² is the same
FINISHES = {"chrome": (4.0, 3.13e6, 0.003), "satin": (45.0, 12500.0, 0.0475)}
DEFECTS_CROP = slice(370, 630), slice(800, 1060)


def defects_picture(target: Path, folder: Path) -> None:
    """The good part, the part with defects, and where they are; a row for each finish. Fourth root of the level."""
    posture = "at_pixel: {posture: {elevation_deg: 0, rotation_deg: 0}, pixel:"
    rows = []
    for finish, (diffuse, specular, sigma) in FINISHES.items():
        text = (PARTS / "cover-knob.yaml").read_text(encoding="utf-8")
        text = text.replace("file: cover-knob.step", f"file: '{(PARTS / 'cover-knob.step').as_posix()}'")
        for key, value in (("R_d", diffuse), ("R_s", specular), ("sigma_rad", sigma)):
            text = re.sub(rf"^  {key}: \S+", f"  {key}: {value}", text, flags=re.MULTILINE)
        part = folder / f"{finish}.yaml"
        shown = re.sub(r"AT: (\[\d+, \d+\])", rf"{posture} \1}}", SHOWN_DEFECTS)
        part.write_text(text + shown, encoding="utf-8")
        images = []
        for options in (("--no-defects",), ()):
            out = folder / f"{finish}-{len(options)}"
            lightopt(
                "render", RIGS / "four-panel.yaml", part, "-o", out, "-q", "--light", "light1", "--posture", "0,0",
                "--points", "auto", "--supersample", "2", "--patches", "500", *options,
            )  # fmt: skip
            level = read_exr(out / "posture_0_0" / "light1.exr")["Y"][DEFECTS_CROP]
            images.append((level / max(level.max(), 1.0)) ** 0.25 * 255.0)
        label = read_exr(out / "posture_0_0" / "geometry.exr")["defect"][DEFECTS_CROP]
        images.append(np.where(label >= 0, 255.0 - 18.0 * label, 0.35 * images[0]))
        gap = np.full((images[0].shape[0], 6), 255.0)
        rows += [np.concatenate([images[0], gap, images[1], gap, images[2]], axis=1)]
    gap = np.full((6, rows[0].shape[1]), 255.0)
    pixels = np.concatenate([rows[0], gap, rows[1]]).astype(np.uint8)
    Image.fromarray(np.kron(pixels, np.ones((2, 2), np.uint8))).save(target, optimize=True)


def report_picture(target: Path, folder: Path) -> None:
    """The top of the report of an optimisation, as a browser shows it."""
    from browsers import opened

    lightopt(
        "optimize", RIGS / "four-panel.yaml", PARTS / "spout.yaml", "-o", folder / "best", "-q",
    )  # fmt: skip
    with opened(folder / "best" / "report.html", width=1100, height=1430) as seen:
        seen.page.wait_for_selector("figure[data-state=live]")
        seen.page.screenshot(path=target)
    Image.open(target).convert("RGB").quantize(256, dither=Image.Dither.NONE).save(target, optimize=True)


def plan_pictures(blind: Path, page: Path, folder: Path) -> None:
    """Why defects are not found, in the first posture of a plan; and the top of the plan's report."""
    from browsers import opened

    out = folder / "planned"
    lightopt(
        "optimize", RIGS / "four-panel.yaml", PARTS / "cover-knob.yaml", "-o", out, "-q", "--choose-postures", "2",
        "--posture-step", "90", "--exposure", "1,1/4,1/16", "--patches", "20000", "--no-images",
    )  # fmt: skip
    pictured = sorted(out.glob("posture_*/blind.png"))[0]
    image = Image.open(pictured).convert("RGB")
    image.resize((image.width // 2, image.height // 2), Image.Resampling.LANCZOS).save(blind, optimize=True)
    with opened(out / "report.html", width=1100, height=1100) as seen:
        seen.page.wait_for_selector("figure[data-state=live]")
        seen.page.screenshot(path=page)
    Image.open(page).convert("RGB").quantize(128, dither=Image.Dither.NONE).save(page, optimize=True)


def inspection_picture(target: Path, folder: Path) -> None:
    """The cover knob with defects under light1, the synthetic image, and what was found."""
    rig, part = folder / "inspected-rig.yaml", folder / "inspected.yaml"
    text = (RIGS / "four-panel.yaml").read_text(encoding="utf-8")
    text = text.replace("[1600, 1200]", "[800, 600]").replace("pixel_size_um: 4.4", "pixel_size_um: 8.8")
    rig.write_text(text, encoding="utf-8")
    lightopt("defects", rig, PARTS / "cover-knob.yaml", "-o", part, "-q", "--seed", "4", "--count", "14")
    images, out = folder / "inspected-images", folder / "inspected"
    lightopt("render", rig, part, "-o", images, "-q", "--noise", "1", "--posture", "0,0", "--patches", "500")
    lightopt("inspect", rig, part, images, "-o", out, "-q", "--no-register")
    paths = [
        images / "posture_0_0" / "light1.png",
        out / "posture_0_0" / "synthetic.png",
        out / "posture_0_0" / "defects.png",
    ]
    pixels = [np.asarray(Image.open(path).convert("RGB"))[40:565, 105:705] for path in paths]
    gap = np.full((pixels[0].shape[0], 8, 3), 255, np.uint8)
    picture = np.concatenate([pixels[0], gap, pixels[1], gap, pixels[2]], axis=1)
    Image.fromarray(picture).save(target, optimize=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="pictures only, no tables")
    quick = parser.parse_args().quick
    PICTURES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        frames_drawing(PICTURES / "frames.png")
        scene = build_scene(RIGS / "four-panel.yaml", PARTS / "cover-knob.yaml")
        rig_drawing(scene, PICTURES / "four-panel.png")
        print(lightopt("render", RIGS / "four-panel.yaml", PARTS / "cover-knob.yaml", "-o", out / "knob", "-q"))
        contact_sheet(read_image_set(out / "knob"), PICTURES / "cover-knob-sheet.png")
        crops = []
        for points in ("4", "auto"):
            target = out / f"spout-{points}"
            lightopt(
                "render", RIGS / "four-panel.yaml", PARTS / "spout.yaml", "-o", target, "-q",
                "--light", "light2", "--posture", "0,0", "--points", points,
            )  # fmt: skip
            crops.append(read_exr(target / "posture_0_0" / "light2.exr")["Y"][100:1100, 200:1400][::2, ::2])
        side_by_side(PICTURES / "spout-4-auto.png", crops, gain=3.0)
        defects_picture(PICTURES / "defects.png", out)
        report_picture(PICTURES / "report.png", out)
        plan_pictures(PICTURES / "blind-spots.png", PICTURES / "plan.png", out)
        inspection_picture(PICTURES / "inspection.png", out)
        statistic_picture(PICTURES / "statistic.png")
        displaced_picture(PICTURES / "displaced.png")
        finishes_picture(PICTURES / "finishes.png")
        brushed_picture(PICTURES / "brushed.png")
        regions_picture(PICTURES / "regions.png")
        diffuse_forms_picture(PICTURES / "diffuse-forms.png")
        measured_finishes_picture(PICTURES / "measured-finishes.png")
        bounce_picture(PICTURES / "interreflection.png")
        lighting_picture(PICTURES / "lighting-systems.png")
        lens_picture(PICTURES / "lens.png")
        motion_picture(PICTURES / "motion.png")
        housings_picture(PICTURES / "housings.png")
    findings = lightopt("check", "configs/rigs/four-panel.yaml", "configs/parts/cover-knob.yaml")
    replace_block(DOCS / "tutorial" / "getting-started.md", "check", f"```text\n{findings.rstrip()}\n```")
    if not quick:
        replace_block(DOCS / "reference" / "reflection-model.md", "table-1", saturated_table())


if __name__ == "__main__":
    main()
