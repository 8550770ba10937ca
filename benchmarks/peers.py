"""The same pictures from Open3D, Mitsuba 3 and trimesh: compared pixel by pixel first, then timed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks._case import SCENES, Size
from benchmarks._numpy_shading import render_numpy
from benchmarks._peer_casters import Open3DCaster, TrimeshCaster
from benchmarks._peer_mitsuba import MitsubaPeer
from benchmarks._peer_process import MITSUBA, PeerError, PeerProcess
from benchmarks._report import Report, Table, ratio_text, ratios
from benchmarks.bare import THREADS
from lightopt.rendering import cast_rays_at, rays_of_images, render_posture
from lightopt.scene import Scene

AGREEMENT = 0.99
"""Least share of lit pixels that a peer must have within 1e-3 of ours before its time counts."""

Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class Peer:
    """How to make pictures in two steps: `build` whatever the mesh needs, then `images` of all lights from it."""

    build: Callable[[], object]
    images: Callable[[object], list[Float32]]


def _ours(scene: Scene) -> Peer:
    def images(caster: object) -> list[Float32]:
        rendered = render_posture(scene, scene.postures[0], caster=caster, threads=THREADS)  # type: ignore[arg-type]
        return [light.level for light in rendered.lights]

    return Peer(lambda: cast_rays_at(scene, rays=rays_of_images(scene)), images)


def _open3d(scene: Scene) -> Peer:
    import open3d  # noqa: F401  (fails at once where it lacks a library)

    return Peer(lambda: Open3DCaster(scene, threads=THREADS), _shaded_in_numpy(scene))


def _mitsuba(scene: Scene) -> Peer:
    import mitsuba

    mitsuba.set_variant("llvm_ad_mono")
    assert (mitsuba.Float(1) + 1)[0] == 2  # fails at once where there is no LLVM
    return Peer(lambda: MitsubaPeer(scene, threads=THREADS), lambda peer: peer.render())  # type: ignore[attr-defined]


def _trimesh(scene: Scene) -> Peer:
    return Peer(lambda: TrimeshCaster(scene), _shaded_in_numpy(scene))


def _shaded_in_numpy(scene: Scene) -> Callable[[object], list[Float32]]:
    return lambda caster: render_numpy(scene, caster, threads=THREADS)  # type: ignore[arg-type]


PEERS: dict[str, Callable[[Scene], Peer]] = {
    "lightopt": _ours,
    "Open3D + NumPy": _open3d,
    MITSUBA: _mitsuba,
    "trimesh.ray + NumPy": _trimesh,
}
"""How each is made, in the process of its own."""


def start_peers(size: Size, part: str) -> tuple[list[PeerProcess], list[str]]:
    """Processes of lightopt and of the peers that run here, and why the others do not."""
    there: list[PeerProcess] = []
    missing: list[str] = []
    for name in PEERS:
        try:
            there.append(PeerProcess(name, size, part))
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
    """Check that the pictures agree, then measure building and rendering, for each sample part."""
    tables, notes = [], [f"{THREADS} threads, {size.repeats} rounds"]
    numbers: dict[str, object] = {}
    for part, scene_of in SCENES.items():
        scene = scene_of(size)
        shown, missing, numbers[part] = _measure(part, scene, size)
        tables.append(shown)
        notes += [note for note in missing if note not in notes]
        camera = scene.camera
        notes.append(f"{part}: {camera.width} × {camera.height} px, {len(scene.mesh.faces):,} triangles")
    return Report("peers", tables, numbers, notes)


def _measure(part: str, scene: Scene, size: Size) -> tuple[Table, list[str], dict[str, object]]:
    # the table, why peers are missing, the numbers
    peers, missing = start_peers(size, part)
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
    names = [peer.name for peer in peers]
    whole = {name: _whole(name, seconds) for name in names}
    title = f"{part}, the same {len(scene.lights)} images of lights of {scene.lights[0].points} points, with shadows"
    numbers: dict[str, object] = {
        "triangles": len(scene.mesh.faces),
        "agreement": agreed,
        "first_seconds": {name: {"build": a, "images": b} for name, (a, b) in first.items()},
        "seconds": seconds,
        "whole_ratio": {name: ratios(times, whole["lightopt"]) for name, times in whole.items()},
        "our_share": {name: ratios(whole["lightopt"], times) for name, times in whole.items()},
    }
    return table(title, names, first, agreed, seconds), missing, numbers


def table(
    title: str,
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
                f"{min(whole):.2f}",
                *(ratio_text(ours, whole) if ok else ("–", "–")),
            )
        )
    columns = ("within 1e-3", "first s", "build s", "images s", "whole s", "ours / its", "of medians")
    return Table(
        f"{title}:\nshare of lit pixels within 1e-3 of ours; the first time, compiling included;\n"
        "the least times; lightopt's time over its own, of least times and of medians",
        ("", *columns),
        rows,
    )


def _whole(name: str, seconds: Mapping[str, list[float]]) -> list[float]:
    return [a + b for a, b in zip(seconds[f"{name}: build"], seconds[f"{name}: images"], strict=True)]
