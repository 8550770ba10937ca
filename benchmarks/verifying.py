"""Rates of ``lightopt verify``: faults named and false alarms; writes the tables of docs/how-to/verify.md.

``python -m benchmarks.verifying`` simulates the sample rig and part with faults of random direction, light and sign,
with the sensor's noise, and verifies the images. A fault is named rightly if what exceeds its limit is the body or
light that has the fault, alone or as one of two that cannot be told apart, and nothing else exceeds its limit.
``--unmodelled`` takes images that the model did not make.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks._report import Table
from lightopt import build_scene, load_part, load_rig
from lightopt.core.transforms import Posture
from lightopt.defects import Waviness
from lightopt.estimate.registration import Observation
from lightopt.estimate.verification import Verification, VerifyLimits
from lightopt.estimate.verification._parameters import Parameters
from lightopt.estimate.verification._verify import verify_observations
from lightopt.optics import expose, image_rng
from lightopt.rendering import cast_rays_at, render_posture
from lightopt.scene import Scene, project, view_from_part

ROOT = Path(__file__).resolve().parents[1]
RIG = ROOT / "configs" / "rigs" / "four-panel.yaml"
PART = ROOT / "configs" / "parts" / "cover-knob.yaml"

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Levels = dict[tuple[Posture, str], Float32]

GAIN, EXPOSURE, BLACK, PART_MM, CAMERA_MM, PANEL_MM, PANEL_DEG, BLUR_PX = 0.05, 0.03, 2.0, 0.1, 0.3, 3.0, 2.0, 2.0
DUST = {"lens": (4.0, 0.3), "part": (3.0, 0.5)}
"""Radius [px] and depth of a spot."""


@dataclass
class Fault:
    """What is wrong in a simulated set: parameters of the rig, blur [px], spots as factors of images, exchanged lights.

    expected: Bodies and lights that have a fault.
    """

    theta: Float64
    blur: float = 0.0
    spot: Callable[[Scene, Posture], Float32] | None = None
    exchanged: tuple[str, str] | None = None
    expected: frozenset[str] = frozenset()

    def joined(self, other: Fault) -> Fault:
        """Both at once."""
        return Fault(
            self.theta + other.theta,
            max(self.blur, other.blur),
            self.spot or other.spot,
            self.exchanged or other.exchanged,
            self.expected | other.expected,
        )


def draw(kind: str, scene: Scene, p: Parameters, rng: np.random.Generator) -> Fault:
    """A fault of random direction, light and sign."""
    theta = np.zeros(p.size)
    light = str(rng.choice([one.name for one in scene.lights]))
    sign = float(rng.choice([-1.0, 1.0]))
    angle = rng.uniform(0.0, 2.0 * math.pi)
    aside = np.array([math.cos(angle), math.sin(angle), 0.0])
    fault = Fault(theta, expected=frozenset({kind.partition(" ")[0]}))
    if kind == "gain":
        theta[p.group("gain", light).where] = math.log1p(sign * GAIN)
        fault.expected = frozenset({f"gain {light}"})
    elif kind == "exposure":
        theta[p.group("exposure").where] = math.log1p(sign * EXPOSURE)
    elif kind == "black":
        theta[p.group("black").where] = BLACK
    elif kind == "part":
        theta[p.group("part_shift").where] = PART_MM * aside
    elif kind == "camera":
        theta[p.group("camera_shift").where] = CAMERA_MM * aside
    elif kind in ("panel 3 mm", "panel 2°"):
        fault.expected = frozenset({f"panel {light}"})
        mm, turn = PANEL_MM, 0.0
        if kind == "panel 2°":  # about the origin
            turn = math.radians(PANEL_DEG)
            mm = next(float(np.linalg.norm(one.centre)) for one in scene.lights if one.name == light) * turn
        theta[p.group("panel_shift", light).where] = mm * aside
        theta[p.group("panel_turn", light).where] = turn * np.array([-aside[1], aside[0]])
    elif kind == "focus":
        fault.blur = BLUR_PX
    elif kind == "swap":
        names = rng.choice([one.name for one in scene.lights], 2, replace=False)
        fault.exchanged = str(names[0]), str(names[1])
    elif kind.startswith("dust"):
        where = kind.partition(" ")[2]
        fault.expected = frozenset({f"dust_{where}"})
        point = _visible_point(scene, rng)
        fixed = project(view_from_part(scene, scene.postures[0]).camera, point[None])
        radius, depth = DUST[where]

        def spot(scene: Scene, posture: Posture) -> Float32:
            x, y, _ = fixed if where == "lens" else project(view_from_part(scene, posture).camera, point[None])
            rows, columns = np.mgrid[0 : scene.camera.height, 0 : scene.camera.width] + 0.5
            off = (np.square(columns - x) + np.square(rows - y)) / radius**2
            return (1.0 - depth * np.exp(-0.5 * off)).astype(np.float32)

        fault.spot = spot
    return fault


def _visible_point(scene: Scene, rng: np.random.Generator) -> Float64:
    # on the upper side of the part, not near its rim
    vertices = scene.mesh.vertices
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    radius = np.hypot(*(vertices - middle)[:, :2].T)
    inner = np.flatnonzero((radius < 0.6 * radius.max()) & (vertices[:, 2] > middle[2]))
    return vertices[rng.choice(inner)]


def simulate(scene: Scene, p: Parameters, fault: Fault) -> Levels:
    """Linear images of the rig with a fault [grey level]."""
    caster = cast_rays_at(scene)
    found: Levels = {}
    for posture in scene.postures:
        view = p.view(scene, posture, fault.theta)
        world = replace(
            scene,
            camera=view.camera.moved(view.rotation, view.translation),
            lights=tuple(light.moved(view.rotation, view.translation) for light in view.lights),
        )
        spot = None if fault.spot is None else fault.spot(scene, posture)
        for image in render_posture(world, posture, caster=caster).lights:
            log = fault.theta[p.group("exposure").first] + fault.theta[p.group("gain", image.light).first]
            level = image.level * np.float32(math.exp(log))
            if fault.blur:
                level = ndimage.gaussian_filter(level, fault.blur)
            found[posture, image.light] = level if spot is None else level * spot
    if fault.exchanged:
        a, b = fault.exchanged
        for posture in scene.postures:
            found[posture, a], found[posture, b] = found[posture, b], found[posture, a]
    return found


def observe(scene: Scene, levels: Levels, black: float, seed: int) -> list[Observation]:
    """Expose linear images, with noise; the black level is off by `black`."""
    sensor = replace(scene.sensor, black_level=scene.sensor.black_level + black)
    found: list[Observation] = []
    for j, posture in enumerate(scene.postures):
        for i, light in enumerate(scene.lights):
            rng = image_rng(seed, light=i, posture=j, exposure=0)
            full_scale = scene.reflectance.full_scale
            png = expose(levels[posture, light.name], sensor=sensor, exposure=1.0, full_scale=full_scale, rng=rng)
            found.append(
                Observation(
                    light=light.name, posture=posture, exposure=1.0, levels=png.astype(np.float32),
                    saturated=png >= sensor.saturated_from, half_width=0.5, source=Path("simulated", f"{i}-{j}.png"),
                )
            )  # fmt: skip
    return found


def bodies(kind: str, light: str) -> str:
    """The body or light that a finding names."""
    body = kind.removesuffix("_shift").removesuffix("_turn")
    return f"{body} {light}" if body in ("gain", "panel") else body


def named(result: Verification) -> list[frozenset[str]]:
    """What each finding beyond its limit may be, and dust on the part, which has none."""
    found: list[frozenset[str]] = []
    for finding in result.findings:
        if finding.exceeds or finding.kind == "dust_part":
            causes = [(finding.kind, finding.light), *finding.alternatives]
            found.append(frozenset(bodies(kind, light) for kind, light in causes))
    return found


def rightly(result: Verification, expected: frozenset[str]) -> bool:
    """Whether all faults are named and nothing else; a note of dust on a part that has none does not count."""
    causes = [some for some in named(result) if expected & {"dust_part"} or some != {"dust_part"}]
    return all(some & expected for some in causes) and expected <= frozenset().union(*causes)


@dataclass
class Count:
    """Sets of one kind."""

    right: int = 0
    total: int = 0
    seconds: float = 0.0

    def add(self, right: bool, seconds: float) -> None:
        """One more set."""
        self.right, self.total, self.seconds = self.right + right, self.total + 1, self.seconds + seconds


SINGLE = (
    *("swap", "gain", "black", "part", "camera", "panel 2°", "panel 3 mm", "focus", "dust lens", "dust part"),
    "exposure",
)
PAIRED = ("gain", "black", "part", "camera", "panel 3 mm", "focus", "exposure", "swap", "dust lens")


def run(
    scene: Scene,
    truth: Scene,
    kinds: Sequence[tuple[str, ...]],
    seeds: int,
    *,
    first: int = 0,
    imperfect: Mapping[str, Sequence[float]] | None = None,
    baseline: bool = False,
) -> Table:
    """Verify sets with faults of these kinds; truth: the scene that the images are made from."""
    limits = VerifyLimits()
    p = Parameters.of(scene, limits)
    base = np.zeros(p.size)
    for name, values in (imperfect or {}).items():
        kind, _, light = name.partition(" ")
        base[p.group(kind, light).where] = values
    counts: dict[tuple[str, ...], Count] = {}
    kept: dict[tuple[str, ...], Levels] = {}
    good = None
    if baseline:
        good = observe(truth, simulate(truth, p, Fault(base)), 0.0, 10_000 + first)
    for seed in range(first, first + seeds):
        for kind in kinds:
            rng = np.random.default_rng([seed, SINGLE.index(kind[0]) if kind else 99])
            fault = Fault(base)
            for one in kind:
                fault = fault.joined(draw(one, truth, p, rng))
            if kind or () not in kept:
                kept[()] = simulate(truth, p, fault)
            black = float(fault.theta[p.group("black").first])
            images = observe(truth, kept[()], black, seed)
            begun = time.process_time(), time.perf_counter()
            result = verify_observations(scene, images, baseline=good, limits=limits)
            seconds = time.perf_counter() - begun[1]
            right = rightly(result, fault.expected)
            counts.setdefault(kind, Count()).add(right, time.process_time() - begun[0])
            if not right:
                print(f"  seed {seed}: expected {sorted(fault.expected)}, found:", flush=True)
                for f in result.findings:
                    print(f"    {f.cause}: {f.amount}{' BEYOND' if f.exceeds else ''}", flush=True)
            print(f"{' + '.join(kind) or 'unchanged'} seed {seed}: {right}, {seconds:.1f} s", flush=True)
    return Table(
        title="named rightly",
        header=["fault", "rightly", "of", "processor time [s]"],
        rows=[
            [" + ".join(kind) or "unchanged", str(c.right), str(c.total), f"{c.seconds / c.total:.1f}"]
            for kind, c in counts.items()
        ],
    )


def unmodelled(seeds: int, first: int) -> list[Table]:
    """Unchanged sets and sets with one fault, of parts and rigs that the model does not describe."""
    rig, part = load_rig(RIG), load_part(PART)
    scene = build_scene(rig, part)
    own = scene.reflectance
    finer = part.model_copy(update={"mesh": part.mesh.model_copy(update={"chord_tolerance_mm": 0.002})})
    imperfect = {
        "camera_shift": (0.4, -0.3, 1.0),
        "camera_turn": (0.0, 0.0, 0.002),
        "panel_shift light1": (2.0, -1.5, 3.0),
        "panel_shift light3": (-2.0, 1.0, -2.0),
        "gain light2": (0.04,),
    }
    cases: list[tuple[str, Scene, bool]] = [
        ("finer tessellation", build_scene(rig, finer), False),
        ("lobe 5 % wider", replace(scene, reflectance=replace(own, sigma=1.05 * own.sigma)), False),
        (
            "waviness 0.1° over 1 mm",
            replace(scene, waviness=Waviness(slope=math.radians(0.1), length=1.0, seed=3)),
            False,
        ),
        ("rig with poses off, baseline", scene, True),
    ]
    tables: list[Table] = []
    for name, truth, baseline in cases:
        kinds: list[tuple[str, ...]] = [(), ("gain",), ("part",)]
        table = run(
            scene, truth, kinds, seeds, first=first, baseline=baseline, imperfect=imperfect if baseline else None
        )
        tables.append(replace(table, title=name))
    return tables


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2, help="sets of each fault")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--unchanged", type=int, default=5, help="sets without a fault")
    parser.add_argument("--pairs", type=int, default=4, help="sets with two faults")
    parser.add_argument("--unmodelled", action="store_true", help="images that the model did not make")
    parser.add_argument("--only", nargs="*", help="faults to simulate")
    given = parser.parse_args()
    scene = build_scene(load_rig(RIG), load_part(PART))
    if given.unmodelled:
        tables = unmodelled(given.seeds, given.first)
    else:
        kinds = [(kind,) for kind in SINGLE if not given.only or kind in given.only]
        drawn = np.random.default_rng(given.first)
        pairs = [tuple(map(str, drawn.choice(PAIRED, 2, replace=False))) for _ in range(given.pairs)]
        tables = [
            run(scene, scene, [()], given.unchanged, first=given.first),
            run(scene, scene, kinds, given.seeds, first=given.first),
            *(run(scene, scene, [pair], 1, first=given.first + i) for i, pair in enumerate(pairs)),
        ]
    for table in tables:
        print(table.text())


if __name__ == "__main__":
    main()
