"""The three references on parts that the model does not describe; writes a table of docs/validation/inspection.md.

``python -m benchmarks.references`` renders parts from meshes and textures of their own, and inspects them with a flat
plate or disc as CAD: a matte plate without features, a brushed plate, a sheet with wavy normals, and a coin. Each part
is displaced, and has noise, texture or waves of its own. Calibrations learn from other good parts than those that are
counted.
"""

from __future__ import annotations

import argparse
import json
import math
import pickle
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks._case import RIG
from benchmarks.inspection import FIRST, replace_block
from benchmarks.loop import run_command
from lightopt import load_part, load_rig
from lightopt.config import PartConfig, RigConfig
from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import rotation_z
from lightopt.estimate.registration import Placement, place_part, refuse_mismatch
from lightopt.images import ImageSet, read_image_set, write_png
from lightopt.inspection import REFERENCES, InspectOptions, PostureView, PredictionCache
from lightopt.inspection._inspect import Inspector
from lightopt.inspection.calibration._calibrate import calibrate_registered
from lightopt.inspection.calibration._calibration import sets_needed
from lightopt.inspection.evaluation._evaluation import region_hits
from lightopt.inspection.prediction._posture_view import some_pixels
from lightopt.inspection.prediction._predict import ReferenceName
from lightopt.inspection.prediction._registered_set import RegisteredSet, register_set
from lightopt.optics import expose, image_rng
from lightopt.rendering import cast_rays_at, render_posture
from lightopt.scene import build_scene

Float = NDArray[np.float64]
Surface = Callable[[Float, Float, np.random.Generator], Float]
"""Height of a surface over x and y [mm]; waves of its own are drawn from the generator."""

WIDTH = 400
PIXEL_MM = 0.044 * 1600 / WIDTH
THICKNESS_MM = 3.0
STEP_MM = 0.2
"""Between the vertices of the top."""
SHIFT_MM, TURN_RAD = 0.25, math.radians(0.15)
"""A part lies up to so far off its place."""

EFFECTS = (1.0, 0.3)
DEFECTS = 6


def catalogue(effect: float) -> str:
    """Defects to place: slopes, and the light that a stain takes away, times an effect."""
    lines = ["defect_catalogue:"]
    shapes = {
        "scratch": ("[6, 0.5]", 6),
        "dent": ("2", 5),
        "bump": ("1.5", 5),
        "pit": ("0.8", 15),
        "blister": ("1.5", 6),
    }
    for kind, (size, slope) in shapes.items():
        lines.append(f"  - {{name: {kind}, kind: {kind}, size_mm: {size}, slope_deg: {effect * slope:g}}}")
    lines.append(f"  - {{name: stain, kind: stain, size_mm: [2, 1.5], R_d_factor: {1.0 - 0.15 * effect:g}}}")
    return "\n".join(lines) + "\n"


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of part that its model does not describe.

    half_mm: Half of its sides.
    round: Whether it is a disc.
    surface: Of the true part; None is flat, as the model has it.
    own_surface: Whether each part has another one.
    grain_mm: Width of the texture's grain along x and y.
    grain: Its standard deviation, as a share of the light.
    common: Of the grain's variance, the share that is the same under all lights.
    """

    half_mm: tuple[float, float] = (21.0, 15.0)
    round: bool = False
    surface: Surface | None = None
    own_surface: bool = False
    grain_mm: tuple[float, float] = (0.1, 0.1)
    grain: float = 0.0
    common: float = 0.5


def waves(x: Float, y: Float, rng: np.random.Generator) -> Float:
    """A sheet's waves: slopes of about half a degree, 8 to 25 mm long."""
    height = np.zeros_like(x)
    for _ in range(8):
        length, direction, phase = rng.uniform(8.0, 25.0), rng.uniform(0.0, math.pi), rng.uniform(0.0, 2.0 * math.pi)
        k = 2.0 * math.pi / length
        slope = math.radians(0.5) / math.sqrt(4.0)
        height += slope / k * np.sin(k * (math.cos(direction) * x + math.sin(direction) * y) + phase)
    return height


def relief(x: Float, y: Float, _rng: np.random.Generator) -> Float:
    """A coin's relief, the same on each: smooth hills with slopes up to some 15°, and a flat rim."""
    rng = np.random.default_rng(5)
    height = np.zeros_like(x)
    for _ in range(60):
        r, a = 12.5 * math.sqrt(rng.random()), rng.uniform(0.0, 2.0 * math.pi)
        width = rng.uniform(0.7, 2.0)
        square = (x - r * math.cos(a)) ** 2 + (y - r * math.sin(a)) ** 2
        height += 0.2 * width * rng.choice([-1.0, 1.0]) * np.exp(-square / (2.0 * width**2))
    return height * np.clip((15.5 - np.hypot(x, y)) / 2.0, 0.0, 1.0)


KINDS = {
    "matte plate": Kind(),
    "brushed plate": Kind(grain_mm=(4.0, 0.12), grain=0.05),
    "sheet": Kind(surface=waves, own_surface=True, grain=0.01),
    "coin": Kind(half_mm=(18.0, 18.0), round=True, surface=relief, grain=0.01),
}


def write_solid(path: Path, kind: Kind, surface: Surface | None, rng: np.random.Generator) -> None:
    """Write a plate or disc as STL: a top with a surface, walls, and a flat bottom."""
    n, m = (math.ceil(2.0 * half / STEP_MM) + 1 for half in kind.half_mm)
    u, v = np.meshgrid(np.linspace(-1.0, 1.0, n), np.linspace(-1.0, 1.0, m), indexing="ij")
    if kind.round:
        u, v = u * np.sqrt(1.0 - 0.5 * v * v), v * np.sqrt(1.0 - 0.5 * u * u)
    x, y = kind.half_mm[0] * u, kind.half_mm[1] * v
    top = np.full_like(x, THICKNESS_MM) if surface is None else THICKNESS_MM + surface(x, y, rng)
    above, below = np.stack([x, y, top], axis=-1), np.stack([x, y, np.zeros_like(x)], axis=-1)

    def faces(a: Float) -> Float:
        corners = a[:-1, :-1], a[1:, :-1], a[1:, 1:], a[:-1, 1:]
        first, second, third, fourth = (corner.reshape(-1, 3) for corner in corners)
        return np.concatenate([np.stack([first, second, third], 1), np.stack([first, third, fourth], 1)])

    def border(a: Float) -> Float:
        return np.concatenate([a[:-1, 0], a[-1, :-1], a[:0:-1, -1], a[0, ::-1]])

    walls = faces(np.stack([border(below), border(above)], axis=1))[:, ::-1]
    triangles = np.concatenate([faces(above), faces(below)[:, ::-1], walls[:, ::-1]])
    data = np.zeros(len(triangles), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")]))
    data["corners"] = triangles
    path.write_bytes(bytes(80) + np.uint32(len(data)).tobytes() + data.tobytes())


def part_text(mesh: str, effect: float = 1.0) -> str:
    """A part file of a matte plate or disc, with defects to place."""
    return (
        f"format: lightopt-part/1\nname: {mesh}\nmesh: {{file: {mesh}.stl, units: mm}}\n"
        "placement: {anchor: rest_on_table}\npostures: [{elevation_deg: 0, rotation_deg: 0}]\n"
        f"reflectance: {{R_d: 170, R_s: 400, sigma_rad: 0.1}}\n{catalogue(effect)}"
    )


def files(folder: Path, kind: Kind) -> tuple[Path, Path]:
    """The sample rig with a smaller camera, and the part as its model has it."""
    text = RIG.read_text(encoding="utf-8").replace("[1600, 1200]", f"[{WIDTH}, {WIDTH * 3 // 4}]")
    (folder / "rig.yaml").write_text(text.replace("pixel_size_um: 4.4", f"pixel_size_um: {100 * PIXEL_MM:g}"))
    write_solid(folder / "cad.stl", kind, None, np.random.default_rng(0))
    (folder / "cad.yaml").write_text(part_text("cad"), encoding="utf-8")
    return folder / "rig.yaml", folder / "cad.yaml"


def grain(kind: Kind, points: Float, rng: np.random.Generator) -> Float:
    """Texture at points of the part, shape (n, 3): standard deviation 1."""
    step = 0.5 * PIXEL_MM
    sides = [math.ceil((2.0 * half + 2.0) / step) for half in kind.half_mm]
    noise = ndimage.gaussian_filter(rng.standard_normal(sides), [one / step for one in kind.grain_mm], mode="wrap")
    where = [(points[:, axis] + kind.half_mm[axis] + 1.0) / step for axis in (0, 1)]
    return ndimage.map_coordinates(noise / noise.std(), where, order=1, mode="nearest")


def take(folder: Path, kind: Kind, seed: int, effect: float | None) -> tuple[ImageSet, NDArray[np.int32] | None]:
    """Images of a part that lies off its place, with noise, texture and waves of a seed, and defects of an effect.

    effect: None for a good part.
    Returns: The images, and the number of the defect that each pixel shows, −1 for none; None for a good part.
    """
    good = effect is None
    rng = np.random.default_rng([11, seed, good])
    out = folder / f"{'good' if good else 'bad'}-{seed:03}"
    out.mkdir()
    mesh = f"own-{out.name}" if kind.own_surface else "own"
    if not (folder / f"{mesh}.stl").exists():
        write_solid(folder / f"{mesh}.stl", kind, kind.surface, rng)
    path = folder / f"{mesh}.yaml"
    path.write_text(part_text(mesh, effect or 1.0), encoding="utf-8")
    if effect is not None:
        path = folder / f"{out.name}.yaml"
        which = "--seed", seed, "--count", DEFECTS
        run_command("defects", folder / "rig.yaml", folder / f"{mesh}.yaml", *which, "-o", path, "-q")
    rig = load_rig(folder / "rig.yaml")
    scene = build_scene(rig, load_part(path), postures=(FIRST,), defects=effect is not None)
    x, y, turn = (float(a) for a in rng.uniform(-1.0, 1.0, 3) * (SHIFT_MM, SHIFT_MM, TURN_RAD))
    placed = place_part(scene, Placement(x=x, y=y, turn=turn))
    images = render_posture(placed, FIRST, caster=cast_rays_at(placed))
    hit = images.geometry.hit
    points = (images.geometry.points[hit].astype(np.float64) - [x, y, 0.0]) @ rotation_z(turn)
    common = grain(kind, points, rng)
    entries: list[dict[str, object]] = []
    for number, (light, image) in enumerate(zip(rig.lights, images.lights, strict=True)):
        own = math.sqrt(kind.common) * common + math.sqrt(1.0 - kind.common) * grain(kind, points, rng)
        level = image.level.astype(np.float64)
        level[hit] *= np.maximum(1.0 + kind.grain * own, 0.0)
        noise = image_rng(seed + 1000 * (not good), light=number, posture=0, exposure=0)
        levels = expose(level, sensor=scene.sensor, exposure=1.0, full_scale=255.0, rng=noise)
        write_png(out / f"{light.name}.png", levels, metadata={})
        angles = {"light_elevation_deg": light.elevation_deg, "light_azimuth_deg": light.azimuth_deg}
        shot = {"posture": FIRST.as_dict(), "exposure": 1.0, "png": f"{light.name}.png"}
        entries.append({"light": light.name, **angles, **shot})
    manifest = {"format": "lightopt-images/1", "kind": "captured", "bit_depth": 8, "full_scale": 255, "images": entries}
    (out / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    labels = images.geometry.defect
    return read_image_set(out), None if labels is None else labels.astype(np.int32)


@dataclass(frozen=True)
class Size:
    """How many parts of a kind there are: good ones to learn from and to count, and bad ones of each effect."""

    kinds: tuple[str, ...]
    learned: int
    good: int
    bad: int
    rate: float


FULL = Size(tuple(KINDS), sets_needed(0.1), 43, 6, 0.1)
TOY = Size(("brushed plate",), sets_needed(0.5), 2, 1, 0.5)

Registered = tuple[RegisteredSet, PostureView, NDArray[np.int32] | None]


def register_once(folder: Path, name: str, size: Size) -> list[Path]:
    """Take the images of all parts of a kind and register each: a file for each, which all references use."""
    kind = KINDS[name]
    rig_file, part_file = files(folder, kind)
    rig, part = load_rig(rig_file), load_part(part_file)
    good = size.learned + size.good
    tasks: list[tuple[int, float | None]] = [(seed, None) for seed in range(good)]
    tasks += [(seed, EFFECTS[seed // size.bad]) for seed in range(len(EFFECTS) * size.bad)]
    cache, paths = PredictionCache(), list[Path]()
    for seed, effect in tasks:
        images, labels = take(folder, kind, seed, effect)
        # the place does not depend on the reference; images that are not the model's are refused when they are compared
        registered = register_set(
            rig, part, images, register=True, reference="self", cache=cache, run=RunContext(threads=1)
        )
        ((view, _),) = registered.views
        path = folder / f"{images.folder.name}.pickle"
        path.write_bytes(pickle.dumps((replace(registered, views=iter(())), view, labels)))
        paths.append(path)
        print(f"{name}: {len(paths)} of {len(tasks)} sets", flush=True)
    return paths


def read_registered(path: Path) -> Registered:
    """A set that is registered, ready to be compared."""
    registered, view, labels = cast("Registered", pickle.loads(path.read_bytes()))  # its own file
    return replace(registered, views=iter([(view, dict.fromkeys(view.lights, ((1.0, 1),)))])), view, labels


def try_kind(task: tuple[str, Size]) -> list[str]:
    """Rows of the table: one kind of part, each reference."""
    name, size = task
    with tempfile.TemporaryDirectory(prefix="lightopt-references-") as place:
        folder = Path(place)
        paths = register_once(folder, name, size)
        rig, part = load_rig(folder / "rig.yaml"), load_part(folder / "cad.yaml")
        return [count(name, reference, rig, part, paths, size) for reference in REFERENCES]


def count(
    name: str, reference: ReferenceName, rig: RigConfig, part: PartConfig, paths: Sequence[Path], size: Size
) -> str:
    """A row of the table: false alarms of good parts and defects found, with a reference."""
    options = InspectOptions(detector="residual", fusion=None, reference=reference, false_alarms=size.rate)
    calibration = None
    if reference == "good-parts":
        sets = ((path.stem, read_registered(path)[0]) for path in paths[: size.learned])
        names = [path.stem for path in paths[: size.learned]]
        calibration = calibrate_registered(sets, names, options=options, fingerprint={}, threads=1)
    alarms: list[int] = []
    thresholds: list[float] = []
    found, placed, refused = dict.fromkeys(EFFECTS, 0), dict.fromkeys(EFFECTS, 0), 0
    for number, path in enumerate(paths[size.learned :]):
        registered, view, labels = read_registered(path)
        try:
            if reference == "model":
                levels = view.level, view.predicted, view.limit, view.deviation
                refuse_mismatch(*levels, some_pixels(view.clean), path.stem)
            inspector = Inspector(rig, part, options, PredictionCache(), calibration, RunContext(threads=1))
            result = inspector.inspect_registered(registered, path.stem)
        except InputError:
            refused += 1
            continue
        thresholds.append(result.postures[0].threshold)
        if labels is None:
            alarms.append(len(result.defects))
            continue
        effect = EFFECTS[(number - size.good) // size.bad]
        seen = {int(index) for index in np.unique(labels[view.clean]) if index >= 0}
        hits = region_hits(result.postures[0].labels, labels)
        placed[effect] += len(seen)
        found[effect] += len(seen & {int(index) for touched in hits for index in touched})
    print(f"{name}, {reference}: threshold {np.median(thresholds) if thresholds else math.nan:.1f}", flush=True)
    cells = [f"{sum(map(bool, alarms))} of {len(alarms)} ({sum(alarms)})"]
    cells += [f"{found[effect]} of {placed[effect]}" for effect in EFFECTS]
    return f"| {name} | {reference} | {' | '.join(cells)} | {refused} |"


def table(rows: Sequence[str]) -> str:
    """All kinds and references."""
    effects = [f"found, effect {effect:g}" for effect in EFFECTS]
    head = ["part", "reference", "good parts with false alarms (regions)", *effects, "refused sets"]
    return "\n".join([f"| {' | '.join(head)} |", "|---" * len(head) + "|", *rows])


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), help="of parts; all by default")
    parser.add_argument("--workers", type=int, default=2, help="kinds that are worked on at once")
    parser.add_argument("--no-page", action="store_true", help="print the table only")
    parser.add_argument("--toy", action="store_true", help="few parts of one kind; prints the table only")
    given = parser.parse_args(arguments)
    size = TOY if given.toy else FULL
    tasks = [(name, size) for name in given.kinds or size.kinds]
    # not forked: a copy of a process whose threads hold locks waits for ever
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        rows = [row for rows in pool.map(try_kind, tasks) for row in rows]
    print(table(rows))
    if not given.no_page and not given.toy and not given.kinds:
        replace_block("references", table(rows))


if __name__ == "__main__":
    main()
