"""The same pictures from Open3D, Mitsuba 3 and trimesh: compared pixel by pixel first, then timed."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks._case import Size, case_scene
from benchmarks._numpy_shading import render_numpy
from benchmarks._peer_casters import Open3DCaster, TrimeshCaster
from benchmarks._peer_mitsuba import MitsubaPeer
from benchmarks._report import Report, Table, ratio_text, ratios, rounds
from benchmarks.bare import THREADS
from lightopt.rendering import cast_rays_at, render_posture
from lightopt.scene import Scene

__all__ = ["AGREEMENT", "Peer", "agreement", "peers_of", "run", "table"]

AGREEMENT = 0.99
"""Least share of lit pixels that a peer must have within 1e-3 of ours before its time counts."""

TRIALS = {
    "Open3D + NumPy": "import open3d",
    "Mitsuba 3 llvm_ad_mono": "import mitsuba as mi; mi.set_variant('llvm_ad_mono'); assert (mi.Float(1) + 1)[0] == 2",
}
"""Programs that fail where an optional peer cannot run; in a process of their own, since a missing LLVM may end it."""

Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class Peer:
    """How to make pictures in two steps: `build` whatever the mesh needs, then `images` of all lights from it."""

    name: str
    build: Callable[[], object]
    images: Callable[[object], list[Float32]]


def peers_of(scene: Scene) -> tuple[list[Peer], list[str]]:
    """lightopt and the peers that run here, and why the others do not."""

    def ours(caster: object) -> list[Float32]:
        images = render_posture(scene, scene.postures[0], caster=caster, threads=THREADS)  # type: ignore[arg-type]
        return [light.level for light in images.lights]

    def shaded_in_numpy(caster: object) -> list[Float32]:
        return render_numpy(scene, caster, threads=THREADS)  # type: ignore[arg-type]

    everyone = [
        Peer("lightopt", lambda: cast_rays_at(scene), ours),
        Peer("Open3D + NumPy", lambda: Open3DCaster(scene, threads=THREADS), shaded_in_numpy),
        Peer(
            "Mitsuba 3 llvm_ad_mono",
            lambda: MitsubaPeer(scene, threads=THREADS),
            lambda peer: peer.render(),  # type: ignore[attr-defined]
        ),
        Peer("trimesh.ray + NumPy", lambda: TrimeshCaster(scene), shaded_in_numpy),
    ]
    problems = {name: problem for name, program in TRIALS.items() if (problem := _problem(program))}
    missing = [f"{name} does not run here and is left out: {problem}" for name, problem in problems.items()]
    return [peer for peer in everyone if peer.name not in problems], missing


def _problem(program: str) -> str:
    # last line of what a program complained about; empty where it ran
    done = subprocess.run([sys.executable, "-c", program], stderr=subprocess.PIPE, text=True)
    if done.returncode == 0:
        return ""
    lines = done.stderr.strip().splitlines()
    return lines[-1] if lines else f"exit status {done.returncode}"


def agreement(images: list[Float32], ours: list[Float32]) -> float:
    """Share of the pixels that either sees lit whose levels are within 1e-3 of each other, relative."""
    a, b = np.stack(images), np.stack(ours)
    larger = np.maximum(a, b)
    lit = larger > 0.0
    return float((np.abs(a - b)[lit] <= 1e-3 * larger[lit]).mean())


def run(size: Size) -> Report:
    """Check that the pictures agree, then measure building and rendering."""
    scene = case_scene(size)
    peers, missing = peers_of(scene)
    reference: list[Float32] = []
    first: dict[str, tuple[float, float]] = {}
    agreed: dict[str, float] = {}
    for peer in peers:
        start = time.perf_counter()
        built = peer.build()
        middle = time.perf_counter()
        images = peer.images(built)
        first[peer.name] = (middle - start, time.perf_counter() - middle)
        reference = reference or images
        agreed[peer.name] = agreement(images, reference)
    seconds = rounds(_tasks(peers), size.repeats)
    return _report(scene, size, peers, missing, first, agreed, seconds)


def _tasks(peers: list[Peer]) -> dict[str, Callable[[], object]]:
    built: dict[str, object] = {}

    def build(peer: Peer) -> None:
        built[peer.name] = peer.build()

    def images(peer: Peer) -> list[Float32]:
        return peer.images(built.pop(peer.name))

    tasks: dict[str, Callable[[], object]] = {}
    for peer in peers:
        tasks[f"{peer.name}: build"] = lambda peer=peer: build(peer)
        tasks[f"{peer.name}: images"] = lambda peer=peer: images(peer)
    return tasks


def _report(
    scene: Scene,
    size: Size,
    peers: list[Peer],
    missing: list[str],
    first: Mapping[str, tuple[float, float]],
    agreed: Mapping[str, float],
    seconds: Mapping[str, list[float]],
) -> Report:
    whole = {peer.name: _whole(peer.name, seconds) for peer in peers}
    return Report(
        "peers",
        [table([peer.name for peer in peers], first, agreed, seconds)],
        {
            "agreement": dict(agreed),
            "first_seconds": {name: {"build": a, "images": b} for name, (a, b) in first.items()},
            "seconds": dict(seconds),
            "whole_ratio": {name: ratios(times, whole["lightopt"]) for name, times in whole.items()},
        },
        [
            f"{scene.camera.width} × {scene.camera.height} px, {len(scene.mesh.faces):,} triangles",
            f"{len(scene.lights)} lights of {scene.lights[0].points} points, shadows",
            f"{THREADS} threads, {size.repeats} rounds",
            *missing,
        ],
    )


def table(
    names: Sequence[str],
    first: Mapping[str, tuple[float, float]],
    agreed: Mapping[str, float],
    seconds: Mapping[str, list[float]],
) -> Table:
    """One row per peer; no ratio for one whose pictures are not ours."""
    rows: list[tuple[str, ...]] = []
    ours = _whole("lightopt", seconds)
    for name in names:
        whole = _whole(name, seconds)
        ok = agreed[name] >= AGREEMENT
        rows.append(
            (
                name,
                f"{100 * agreed[name]:.3f} %" + ("" if ok else ": disagrees"),
                f"{sum(first[name]):.2f}",
                f"{min(seconds[f'{name}: build']):.2f}",
                f"{min(seconds[f'{name}: images']):.2f}",
                f"{np.median(whole):.2f}",
                *(ratio_text(whole, ours) if ok else ("–", "–")),
            )
        )
    columns = ("within 1e-3", "first s", "build s", "images s", "whole s", "whole / ours", "median ratio")
    return Table(
        "the same four images: share of lit pixels within 1e-3 of ours; the first time, compiling included;\n"
        "then the least times to build and to make the images, and the median of the whole",
        ("", *columns),
        rows,
    )


def _whole(name: str, seconds: Mapping[str, list[float]]) -> list[float]:
    return [a + b for a, b in zip(seconds[f"{name}: build"], seconds[f"{name}: images"], strict=True)]
