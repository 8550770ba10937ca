"""Draw docs/pictures/image-series.png, and print the figures of docs/how-to/image-series.md.

``python scripts/series_pictures.py [PNG]``. Images derived from series of a chrome cover knob; slopes of a dent of 0.1°
in a plate by deflectometry, through 12-bit images with noise; and the inverse pattern for a sphere with such a dent.
"""

from __future__ import annotations

import math
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from lightopt.cli._main import run
from lightopt.geometry import box_mesh, sphere_mesh, stl_bytes
from lightopt.images import read_exr, read_png

ROOT = Path(__file__).resolve().parent.parent
CAMERA = """\
format: lightopt-rig/1
name: series
camera:
  distance_mm: 550
  elevation_deg: 90
  resolution_px: [{width}, {height}]
  pixel_size_um: {pixel}
  image_distance_mm: 55
  sensor: {{bit_depth: 12, read_noise_levels: 4}}
lights:
  - name: lcd
    kind: display
    size_mm: [400, 300]
    distance_mm: 300
    elevation_deg: 60
    azimuth_deg: 270
    pattern: {{period_mm: 25, second_period_mm: 450, phases: 4}}
"""
OTHERS = """\
  - {name: dome, kind: dome, radius_mm: 150, camera_hole_mm: 40, segments: 4, lower_elevation_deg: 10}
  - {name: leds, kind: led_array, size_mm: [200, 100], rows: 1, columns: 5, led_mm: 20, distance_mm: 200, gain: 0.3}
"""
PART = """\
format: lightopt-part/1
name: mirror
mesh: {{file: mirror.stl, units: mm, crease_angle_deg: 40}}
placement: {{anchor: rest_on_table, translate_mm: [0, 0, {low}]}}
postures: [{{elevation_deg: {tilt}, rotation_deg: 0}}]
reflectance: {{R_d: 2, R_s: {R_s}, sigma_rad: {sigma}}}
"""
SHOWN = (
    ("lcd.lcd-1", "an image of the display"),
    ("lcd.u.phase", "phase, u"),
    ("lcd.u.modulation", "modulation, u"),
    ("lcd.u.curvature.x", "curvature, u along x"),
    ("lcd.u.place_mm", "place, u"),
    ("dome.east_minus_west", "dome, east minus west"),
    ("dome.north_minus_south", "dome, north minus south"),
    ("leds.brightest", "LEDs, the brightest"),
)


def command(*arguments: object) -> None:
    """Run a command line; the script ends where it fails."""
    if status := run([str(one) for one in arguments]):
        raise SystemExit(status)


def write_world(folder: Path, *, rig: str = "", resolution: tuple[int, int] = (160, 120), **part: object) -> None:
    """Write rig and part files; `defects` of the part as YAML."""
    size = {"width": resolution[0], "height": resolution[1], "pixel": 7040 / resolution[0]}
    (folder / "rig.yaml").write_text(CAMERA.format(**size) + rig, encoding="utf-8")
    sigma = float(str(part["sigma"]))
    text = PART.format(R_s=5.0 / sigma**2, **{key: part[key] for key in ("tilt", "low", "sigma")})
    (folder / "part.yaml").write_text(text + str(part.get("defects", "")), encoding="utf-8")


def draw_knob(folder: Path, target: Path) -> None:
    """The derived images of the cover knob."""
    shutil.copyfile(ROOT / "configs" / "parts" / "cover-knob.stl", folder / "mirror.stl")
    write_world(folder, rig=OTHERS, resolution=(320, 240), sigma=0.005, tilt=0, low=0)
    out = folder / "knob"
    command("render", folder / "rig.yaml", folder / "part.yaml", "-o", out, "--noise", 1, "--derived", "-q")
    width, height, line = 320, 240, 18
    sheet = Image.new("L", (4 * width, 2 * (height + line)), 255)
    for number, (name, label) in enumerate(SHOWN):
        x, y = number % 4 * width, number // 4 * (height + line)
        path = out / "derived" / "posture_0_0" / f"{name}.png"
        if number:
            pixels = read_png(path).astype(np.uint8)
        else:
            pixels = np.clip(read_png(out / "posture_0_0" / "lcd-1.png") / 8.0, 0, 255).astype(np.uint8)
        sheet.paste(Image.fromarray(pixels), (x, y + line))
        ImageDraw.Draw(sheet).text((x + 4, y + 3), label, fill=0)
    sheet.save(target)


def measure_dent(folder: Path, sigma: float) -> None:
    """Slopes of a dent of 0.1°, 16 mm wide, against its own."""
    (folder / "mirror.stl").write_bytes(stl_bytes(box_mesh(np.array([[-25.0, -25.0, -5.0], [25.0, 25.0, 0.0]]))))
    dent = "defects:\n  - {name: dent, kind: dent, at_mm: [0, 0, 0], size_mm: 16, slope_deg: 0.1}\n"
    write_world(folder, sigma=sigma, tilt=15, low=-5, defects=dent)
    out = folder / f"dent{sigma}"
    command("render", folder / "rig.yaml", folder / "part.yaml", "-o", out, "--noise", 1, "--derived", "-q")
    slopes = read_exr(out / "derived" / "posture_15_0" / "lcd.exr")
    geometry = read_exr(out / "posture_15_0" / "geometry.exr")
    # the plate's own coordinates: turned back by 15° about X
    turn = math.radians(15.0)
    x = geometry["P.X"]
    y = math.cos(turn) * geometry["P.Y"] + math.sin(turn) * geometry["P.Z"]
    rho = np.hypot(x, y) / 8.0
    on = geometry["Z"] > 0
    slope = np.where(rho < 1.0, 0.1 * np.sin(math.pi * rho), 0.0) / np.maximum(8.0 * rho, 1e-9)
    inside, outside = on & (rho < 1.0), on & (rho > 1.2) & (np.hypot(x, y) < 22.0)
    error = [(slopes[f"slope.{axis}_deg"] + slope * own)[inside] for axis, own in (("x", x), ("y", y))]
    noise = float(np.nanstd(slopes["slope.x_deg"][outside]))
    rest = math.sqrt(float(np.mean(np.square(error))))
    modulation = float(np.nanmedian(slopes["u.modulation"][outside]))
    print(f"sigma {sigma:g}: modulation {modulation:.2f}, rms error {rest:.4f} deg, noise beside it {noise:.4f} deg")


def invert(folder: Path) -> None:
    """The inverse pattern for a sphere of radius 80 mm."""
    (folder / "mirror.stl").write_bytes(stl_bytes(sphere_mesh(80.0)))
    dent = "defects:\n  - {name: dent, kind: dent, at_mm: [0, -18, 77.95], size_mm: 3, slope_deg: 0.1}\n"
    for sigma, period in ((0.003, 16), (0.005, 16), (0.01, 16), (0.005, 8), (0.005, 0)):
        write_world(folder, sigma=sigma, tilt=0, low=-160, defects=dent)
        print(f"sigma {sigma:g}, period {period} px", flush=True)
        files = folder / "rig.yaml", folder / "part.yaml"
        command("inverse-pattern", *files, "--light", "lcd", "--period-px", period, "-o", folder / "p.png", "--force")


def series_pictures(target: Path) -> None:
    """Draw the picture, print the figures."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        draw_knob(folder, target)
        for sigma in (0.003, 0.005, 0.01):
            measure_dent(folder, sigma)
        invert(folder)


if __name__ == "__main__":
    series_pictures(Path(sys.argv[1]) if sys.argv[1:] else ROOT / "docs" / "pictures" / "image-series.png")
