"""The same pictures from Open3D, Mitsuba 3 and trimesh: compared pixel by pixel first, then timed."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable, Mapping
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

__all__ = ["AGREEMENT", "Peer", "agreement", "peers_of", "run"]

AGREEMENT = 0.99
"""Least share of lit pixels that a peer must have within 1e-3 of ours before its time counts."""

Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class Peer:
    """How to make pictures in two steps: `build` whatever the mesh needs, then `images` of all lights from it."""

    name: str
    build: Callable[[], object]
    images: Callable[[object], list[Float32]]


def peers_of(scene: Scene) -> tuple[list[Peer], list[str]]:
    """lightopt and its peers, and the names of those that are not installed."""

    def ours(caster: object) -> list[Float32]:
        images = render_posture(scene, scene.postures[0], caster=caster, threads=THREADS)  # type: ignore[arg-type]
        return [light.level for light in images.lights]

    def shaded_in_numpy(caster: object) -> list[Float32]:
        return render_numpy(scene, caster, threads=THREADS)  # type: ignore[arg-type]

    everyone = {
        "lightopt": Peer("lightopt", lambda: cast_rays_at(scene), ours),
        "open3d": Peer("Open3D + NumPy", lambda: Open3DCaster(scene, threads=THREADS), shaded_in_numpy),
        "mitsuba": Peer(
            "Mitsuba 3 llvm_ad_mono",
            lambda: MitsubaPeer(scene, threads=THREADS),
            lambda peer: peer.render(),  # type: ignore[attr-defined]
        ),
        "trimesh": Peer("trimesh.ray + NumPy", lambda: TrimeshCaster(scene), shaded_in_numpy),
    }
    there = {name: peer for name, peer in everyone.items() if importlib.util.find_spec(name) is not None}
    return list(there.values()), sorted(set(everyone) - set(there))


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
    whole = {
        peer.name: [
            a + b
            for a, b in zip(seconds[f"{peer.name}: build"], seconds[f"{peer.name}: images"], strict=True)
        ]
        for peer in peers
    }
    rows: list[tuple[str, ...]] = []
    for peer in peers:
        ok = agreed[peer.name] >= AGREEMENT
        rows.append(
            (
                peer.name,
                f"{100 * agreed[peer.name]:.3f} %" if ok else f"{100 * agreed[peer.name]:.3f} %: disagrees",
                f"{sum(first[peer.name]):.2f}",
                f"{min(seconds[f'{peer.name}: build']):.2f}",
                f"{min(seconds[f'{peer.name}: images']):.2f}",
                f"{np.median(whole[peer.name]):.2f}",
                *(ratio_text(whole[peer.name], whole["lightopt"]) if ok else ("", "")),
            )
        )
    notes = [
        f"{scene.camera.width} × {scene.camera.height} px, {len(scene.mesh.faces):,} triangles, "
        f"{len(scene.lights)} lights of {scene.lights[0].points} points, shadows, {THREADS} threads, {size.repeats} rounds"
    ]
    if missing:
        notes.append(f"not installed, so left out: {', '.join(missing)}; pip install '.[bench]' brings them")
    return Report(
        "peers",
        [
            Table(
                "the same four images (first: with just-in-time compilation; whole: build and images)",
                (
                    "",
                    "within 1e-3",
                    "first s",
                    "build s",
                    "images s",
                    "whole, median s",
                    "whole / ours, least",
                    "median",
                ),
                rows,
            )
        ],
        {
            "agreement": dict(agreed),
            "first_seconds": {name: {"build": a, "images": b} for name, (a, b) in first.items()},
            "seconds": dict(seconds),
            "whole_ratio": {name: ratios(times, whole["lightopt"]) for name, times in whole.items()},
        },
        notes,
    )
