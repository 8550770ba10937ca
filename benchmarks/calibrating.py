"""Calibrate rigs with hidden errors on the virtual bench, from the plan to the inspection of a part.

``python -m benchmarks.calibrating -o out/calibrating --seeds 1`` captures the targets of `lightopt calibrate --plan`
under a true rig that differs from the rig file, calibrates, and prints how far off the result is. With ``--inspect`` it
captures the sample part with random defects and inspects it with the rig as filed, as calibrated, and as it truly is
(``--rigs``); with ``--good`` also as calibrated, with an inspection that has learned from so many good parts. With
``--clean`` it counts false alarms on so many good parts, each displaced.

For the tutorial, ``--hide`` only writes the rigs, ``--bend FILE`` only bends the mesh of a board, ``--compare`` only
prints errors, and ``--picture FILE`` only draws the targets.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from PIL import Image

from lightopt.config import copied_text, load_part, load_rig
from lightopt.core.arrays import Float64
from lightopt.core.transforms import rotation_from_vector, vector_of_rotation
from lightopt.estimate.rig_calibration import calibrate_rig, plan_calibration, write_calibration
from lightopt.scene import build_camera, build_lights, build_stage

CONFIGS = Path(__file__).parents[1] / "configs"
RIG, PART = CONFIGS / "rigs" / "four-panel.yaml", CONFIGS / "parts" / "cover-knob.yaml"

CAMERA_DEG, CAMERA_MM, FOCAL_SHARE, CENTRE_PX = 1.0, 2.0, 0.005, 8.0
AXIS_DEG, AXIS_MM = 0.1, 0.3
PANEL_MM, PANEL_DEG, GAIN = 3.0, 2.0, 0.08
BOW_MM = 0.1  # of the board's corners
RIG_FILES = {"filed": "rig.yaml", "calibrated": "calibration/rig.calibrated.yaml", "known": "known.yaml"}
RIGS = tuple(RIG_FILES)
CAPTURE = ("--exposure", "1,1/16", "--force", "--no-check-lights")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--inspect", type=int, metavar="DEFECTS", default=0)
    parser.add_argument("--rigs", nargs="+", choices=RIGS, default=RIGS, help="that parts are inspected by")
    parser.add_argument("--part", type=Path, default=PART, help="that is inspected")
    parser.add_argument("--good", type=int, metavar="PARTS", default=0)
    parser.add_argument("--clean", type=int, metavar="PARTS", default=0)
    parser.add_argument("--width", type=int, default=1600, help="of the camera's image [px]")
    parser.add_argument("--rays", type=int, default=2, help="along each side of a pixel")
    parser.add_argument("--hide", action="store_true", help="only write the rigs")
    parser.add_argument("--compare", action="store_true", help="only compare the calibrated rig in the folder")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="only draw the targets that were captured")
    parser.add_argument("--bend", type=Path, metavar="FILE", help="only bend this mesh of a board")
    given = parser.parse_args()
    if given.bend is not None:
        bend(given.bend, given.first)
        return
    if given.compare:
        compare(given.out)
        return
    if given.picture is not None:
        draw(given.out, given.picture)
        return
    for seed in range(given.first, given.first + given.seeds):
        folder = given.out if given.hide else given.out / f"{seed}"
        hide(folder, seed, width=given.width, rays=given.rays)
        if given.hide:
            continue
        calibrate(folder, seed)
        if given.inspect:
            inspect(folder, seed, given)
        if given.clean:
            count_alarms(folder, seed, given)


def bend(path: Path, seed: int) -> None:
    """Bow the mesh of a flat board as paper on a plate that is not quite flat."""
    data = path.read_bytes()
    triangles = np.frombuffer(data[84:], np.dtype([("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])).copy()
    along = triangles["v"][..., :2] / np.abs(triangles["v"][..., :2]).max(axis=(0, 1))
    terms = BOW_MM / np.sqrt(3.0) * np.random.default_rng([seed, 5]).normal(size=3)
    x, y = along[..., 0], along[..., 1]
    triangles["v"][..., 2] += terms[0] * x * x + terms[1] * x * y + terms[2] * y * y
    path.write_bytes(data[:84] + triangles.tobytes())


def hide(folder: Path, seed: int, *, width: int, rays: int) -> None:
    """Write rig.yaml, the sample rig with even panels that stay where they are; true.yaml, what the virtual bench has
    instead; and known.yaml, the rig file of one who knows the truth."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)

    def turned(degrees: float) -> Float64:
        return rotation_from_vector(np.radians(degrees) * unit())

    def unit() -> Float64:
        direction = rng.normal(size=3)
        return direction / np.linalg.norm(direction)

    filed = load_rig(RIG)
    camera = build_camera(filed)
    share = width / filed.camera.resolution_px[0]
    height = round(share * filed.camera.resolution_px[1])
    text = RIG.read_text(encoding="utf-8").replace("points: 4 ", "points: auto ")
    text = text.replace("[1600, 1200]", f"[{width}, {height}]").replace("um: 4.4", f"um: {4.4 / share:.9g}")
    text = re.sub(r",  ?elevation_range_deg: .*?]", "", text)
    document: dict[str, Any] = yaml.safe_load(text)
    own = document["camera"]
    rotation = turned(CAMERA_DEG) @ np.stack([camera.right, -camera.up, camera.forward], axis=1)
    # it still looks about at the table's middle
    position = -rotation[:, 2] * np.linalg.norm(camera.position) + rng.normal(0.0, CAMERA_MM, 3)
    for key in ("distance_mm", "elevation_deg", "azimuth_deg", "roll_deg", "image_distance_mm"):
        own.pop(key)
    focal = 12_500.0 * share * (1.0 + rng.normal(0.0, FOCAL_SHARE))
    own |= {
        "pose": {"position_mm": rounded(position), "rotation_vector_deg": vector(rotation)},
        "focal_px": rounded([focal, focal]),
        "principal_point_px": rounded(0.5 * np.array([width, height]) + share * rng.normal(0.0, CENTRE_PX, 2)),
        "distortion": {"k1": float(rng.normal(0.0, 0.05))},
        "vignetting": {"v2": -0.05},
    }
    own["sensor"] |= {"black_level": 2.0, "read_noise_levels": 0.9, "electrons_per_level": 55.0}
    gains = 1.0 + rng.uniform(-GAIN, GAIN, len(filed.lights))
    for light, panel, gain in zip(document["lights"], build_lights(filed), gains / gains.mean(), strict=True):
        for key in ("distance_mm", "elevation_deg", "azimuth_deg"):
            light.pop(key)
        axes = turned(PANEL_DEG) @ np.stack([panel.across, panel.along, panel.outward], axis=1)
        centre = panel.centre + PANEL_MM * unit()
        light |= {"pose": {"centre_mm": rounded(centre), "rotation_vector_deg": vector(axes)}, "gain": float(gain)}
    tilt = float(np.tan(np.radians(rng.normal(0.0, AXIS_DEG))))
    document["stage"]["tilt_axis"] = {
        "point_mm": rounded([0.0, *rng.normal(0.0, AXIS_MM, 2)]),
        "direction": [1.0, 0.0, tilt],
    }
    true, bench = yaml.safe_dump(document, sort_keys=False), f"seed: {seed + 1}, rays: {rays}}}\n"
    (folder / "true.yaml").write_text(true, encoding="utf-8")
    (folder / "known.yaml").write_text(f"{true}virtual_bench: {{{bench}", encoding="utf-8")
    (folder / "rig.yaml").write_text(f"{text}\nvirtual_bench: {{rig: true.yaml, {bench}", encoding="utf-8")


def rounded(values: Any) -> list[float]:
    """Plain numbers for YAML."""
    return [round(float(value), 9) for value in values]


def vector(rotation: Float64) -> list[float]:
    """A rotation's vector [deg]."""
    return rounded(np.degrees(vector_of_rotation(rotation)))


def run(*arguments: object) -> None:
    """Run the command line."""
    subprocess.run([sys.executable, "-m", "lightopt", *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)


def calibrate(folder: Path, seed: int) -> None:
    """Capture and calibrate, and print the errors."""
    rig, made = load_rig(folder / "rig.yaml"), folder / "calibration"
    begun = time.monotonic()
    if not (made / "sensor-b").is_dir():
        commands = plan_calibration(rig, made, force=True).commands
        bend(made / "board.stl", seed)
        for command in commands[:-1]:
            run(*command.split()[1:], "--force")
    captured = time.monotonic()
    found = calibrate_rig(rig, made)
    write_calibration(found, force=True)
    spent = time.monotonic() - captured
    print(f"{folder.name}: captured in {captured - begun:.0f} s, calibrated in {spent:.0f} s")
    compare(folder)


def compare(folder: Path) -> None:
    """Print how far the calibrated rig is off."""
    made, true = (load_rig(folder / name) for name in ("calibration/rig.calibrated.yaml", "true.yaml"))
    camera, real_camera = build_camera(made), build_camera(true)
    focal = camera.image_distance / real_camera.image_distance - 1.0
    (point, axis), (there, direction) = build_stage(made).tilt_axis, build_stage(true).tilt_axis
    print(f"  focal length {100 * focal:+.3f} %, tilt axis {angle(axis, direction):.4f}°,", end=" ")
    print(f"{np.linalg.norm((point - there)[1:]):.4f} mm")
    for panel, real in zip(build_lights(made), build_lights(true), strict=True):
        off, away = panel.centre - real.centre, real.centre / np.linalg.norm(real.centre)
        far = float(off @ away)
        print(
            f"  {panel.name}: {np.linalg.norm(off - far * away):.2f} mm aside, {far:+.2f} mm in range, "
            f"{angle(panel.outward, real.outward):.2f}°, gain {100 * (panel.gain / real.gain - 1):+.2f} %"
        )
    electrons, real_electrons = (rig.camera.sensor.electrons_per_level for rig in (made, true))
    assert electrons is not None
    assert real_electrons is not None
    print(f"  electrons per level {100 * (electrons / real_electrons - 1.0):+.2f} %")


def draw(folder: Path, path: Path) -> None:
    """Draw an image of each target side by side."""
    sheet = Image.new("L", (1216, 300), 255)
    for number, (name, posture) in enumerate((("board", "-40_226"), ("ball", "-20_10"), ("plate", "-25_10"))):
        image = Image.open(folder / "calibration" / name / f"posture_{posture}" / "light1.png")
        sheet.paste(image.convert("L").resize((400, 300)), (408 * number, 0))
    sheet.save(path, optimize=True)


def angle(a: Float64, b: Float64) -> float:
    """Between unit vectors [deg]."""
    return float(np.degrees(np.arccos(np.clip(a @ b, -1.0, 1.0))))


def inspect(folder: Path, seed: int, given: argparse.Namespace) -> None:
    """Inspect the sample part with random defects by the filed, the calibrated and the true rig."""
    name, good = given.part.stem, given.good
    part = folder / f"{name}.yaml"
    run(
        "defects", folder / "true.yaml", given.part, "-o", part, "--seed", seed + 1, "--count", given.inspect, "--force"
    )
    for kind in given.rigs:
        rig, images = folder / RIG_FILES[kind], folder / f"images-{name}-{kind}"
        run("capture", rig, part, "-o", images, *CAPTURE)
        judge(kind, rig, part, images)
        if kind == "calibrated" and good:
            sets = [folder / f"good-{name}-{k}" for k in range(good)]
            for k, one in enumerate(sets):
                run("capture", rig, given.part, "-o", one, *CAPTURE, "--seed", 1000 + k)
            # the least rate that so many parts allow
            rate = np.ceil(1e3 * (1.0 - 0.05 ** (1.0 / good))) / 1e3
            learned = folder / f"learned-{name}"
            run("inspect", rig, part, *sets, "-o", learned, "--calibrate", "--false-alarms", rate, "--force")
            judge(f"calibrated, {good} good parts", rig, part, images, "--calibration", learned)


def count_alarms(folder: Path, seed: int, given: argparse.Namespace) -> None:
    """Inspect good parts, each moved and turned on the stage, and print the false alarms."""
    rng = np.random.default_rng(seed)
    name, config = given.part.stem, load_part(given.part)
    parts = [folder / f"clean-{name}-{k}.yaml" for k in range(given.clean)]
    for part in parts:
        x, y, turn = rng.uniform((-1.0, -1.0, -2.0), (1.0, 1.0, 2.0)).round(3)
        place = {"translate_mm": f"[{x}, {y}, 0]", "rotate_deg": f"[0, 0, {turn}]"}
        text = copied_text(config, folder, {("placement", key): value for key, value in place.items()})
        part.write_text(text, encoding="utf-8")
    for kind in given.rigs:
        rig, sets = folder / RIG_FILES[kind], [folder / f"{part.stem}-{kind}" for part in parts]
        for k, (part, images) in enumerate(zip(parts, sets, strict=True)):
            run("capture", rig, part, "-o", images, *CAPTURE, "--seed", 2000 + k)
        out = folder / f"clean-{name}-inspected-{kind}"
        run("inspect", rig, given.part, *sets, "-o", out, "--fusion", "none", "--no-report", "--force")
        found = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(out.glob("**/defects.json"))]
        assert len(found) == len(parts)
        alarms = sum(len(one["defects"]) for one in found)
        print(f"  {kind}: {alarms} false alarms in {len(config.postures) * len(parts)} postures of good parts")


def judge(name: str, rig: Path, part: Path, images: Path, *options: object) -> None:
    """Inspect a set and print what was found."""
    out = images.parent / f"{images.name.replace('images', 'inspected')}{'-learned' if options else ''}"
    command = [
        sys.executable,
        "-m",
        "lightopt",
        "inspect",
        rig,
        part,
        images,
        "-o",
        out,
        "--evaluate",
        "--force",
        "--fusion",
        "none",
        "--no-report",
        *options,
    ]
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, check=False)
    if not (out / "truth.json").is_file():
        print(f"  {name}: {done.stderr.strip().splitlines()[0]}")
        return
    truth = json.loads((out / "truth.json").read_text(encoding="utf-8"))
    alarms = truth["false_alarms_per_posture"]
    print(f"  {name}: found {truth['found']} of {truth['defects']}, {alarms:g} false alarms a posture")


if __name__ == "__main__":
    main()
