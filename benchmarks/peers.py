"""The same pictures from Open3D, Mitsuba 3 and trimesh: compared pixel by pixel first, then timed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks._case import Size, case_scene
from benchmarks._numpy_shading import render_numpy
from benchmarks._peer_casters import Open3DCaster, TrimeshCaster
from benchmarks._peer_mitsuba import MitsubaPeer
from benchmarks._peer_process import MITSUBA, PeerError, PeerProcess
from benchmarks._report import Report, Table, ratio_text, ratios
from benchmarks.bare import THREADS
from lightopt.rendering import cast_rays_at, render_posture
from lightopt.scene import Scene

AGREEMENT = 0.99
"""Least share of lit pixels that a peer must have within 1e-3 of ours before its time counts."""

Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class Peer:
    """How to make pictures in two steps: `build` whatever the mesh needs, then `images` of all lights from it."""

    build: Callable[[], object]
    images: Callable[[object], list[Float32]]


def _ours(size: Size) -> Peer:
    scene = case_scene(size)

    def images(caster: object) -> list[Float32]:
        rendered = render_posture(scene, scene.postures[0], caster=caster, threads=THREADS)  # type: ignore[arg-type]
        return [light.level for light in rendered.lights]

    return Peer(lambda: cast_rays_at(scene), images)


def _open3d(size: Size) -> Peer:
    import open3d  # noqa: F401  (fails at once where it lacks a library)

    scene = case_scene(size)
    return Peer(lambda: Open3DCaster(scene, threads=THREADS), _shaded_in_numpy(scene))


def _mitsuba(size: Size) -> Peer:
    import mitsuba

    mitsuba.set_variant("llvm_ad_mono")
    assert (mitsuba.Float(1) + 1)[0] == 2  # fails at once where there is no LLVM
    scene = case_scene(size)
    return Peer(lambda: MitsubaPeer(scene, threads=THREADS), lambda peer: peer.render())  # type: ignore[attr-defined]


def _trimesh(size: Size) -> Peer:
    scene = case_scene(size)
    return Peer(lambda: TrimeshCaster(scene), _shaded_in_numpy(scene))


def _shaded_in_numpy(scene: Scene) -> Callable[[object], list[Float32]]:
    return lambda caster: render_numpy(scene, caster, threads=THREADS)  # type: ignore[arg-type]


PEERS: dict[str, Callable[[Size], Peer]] = {
    "lightopt": _ours,
    "Open3D + NumPy": _open3d,
    MITSUBA: _mitsuba,
    "trimesh.ray + NumPy": _trimesh,
}
"""How each is made, in the process of its own."""


def start_peers(size: Size) -> tuple[list[PeerProcess], list[str]]:
    """Processes of lightopt and of the peers that run here, and why the others do not."""
    there: list[PeerProcess] = []
    missing: list[str] = []
    for name in PEERS:
        try:
            there.append(PeerProcess(name, size))
        except PeerError as error:  # noqa: PERF203  (each may fail)
            missing.append(str(error))
    return there, missing


def agreement(images: list[Float32], ours: list[Float32]) -> float:
    """Share of the pixels that either sees lit whose levels are within 1e-3 of each other, relative."""
    a, b = np.stack(images), np.stack(ours)
    larger = np.maximum(a, b)
    lit = larger > 0.0
    return float((np.abs(a - b)[lit] <= 1e-3 * larger[lit]).mean())


def run(size: Size) -> Report:
    """Check that the pictures agree, then measure building and rendering."""
    peers, missing = start_peers(size)
    reference: list[Float32] = []
    first: dict[str, tuple[float, float]] = {}
    agreed: dict[str, float] = {}
    seconds: dict[str, list[float]] = {}
    for peer in tuple(peers):
        try:
            first[peer.name] = (peer.build(), peer.images())
            images = peer.levels()
        except PeerError as error:
            peers.remove(peer)
            missing.append(str(error))
            continue
        reference = reference or images
        agreed[peer.name] = agreement(images, reference)
    for _ in range(size.repeats):
        for peer in peers:
            seconds.setdefault(f"{peer.name}: build", []).append(peer.build())
            seconds.setdefault(f"{peer.name}: images", []).append(peer.images())
    for peer in peers:
        peer.close()
    return _report(case_scene(size), size, [peer.name for peer in peers], missing, first, agreed, seconds)


def _report(
    scene: Scene,
    size: Size,
    names: Sequence[str],
    missing: list[str],
    first: Mapping[str, tuple[float, float]],
    agreed: Mapping[str, float],
    seconds: Mapping[str, list[float]],
) -> Report:
    whole = {name: _whole(name, seconds) for name in names}
    return Report(
        "peers",
        [table(names, first, agreed, seconds)],
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
