"""Ctrl-C and kill -9 at any moment: nothing half-written, and the same command afterwards completes the set."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lightopt.core.interrupts import interrupt
from lightopt.images import read_image_set

# about a second of rendering, 8 images of 3 × 3 rays a pixel
OPTIONS = (*("--exposure", "1,1/16", "--layers", "--noise", "1"), *("--patches", "1000", "--supersample", "3"))
IMAGES = 8
INTERRUPTED = "interrupted; files that were finished are complete"

MOMENTS = (
    "posture_-10_170/geometry.exr",
    *(
        pytest.param(name, marks=pytest.mark.nightly)
        for name in (
            "patches.npz",
            "posture_0_0/light1.png",
            "manifest.json",
            "posture_0_0/geometry.exr",
            "posture_0_0/light3.exr",
            "posture_-10_170/light1_x0.0625.png",
        )
    ),
)
"""Files whose appearance is a moment to interrupt at: while tracing for patches, rendering, and writing. In every run
one; the writer itself is interrupted at all of its writes in tests/unit/test_images_sets.py."""

ALL_MOMENTS = 20
"""Between the start of a process and its end."""

one_console = pytest.mark.skipif(
    sys.platform == "win32", reason="Windows sends Ctrl-C to all processes of a console, pytest included"
)


def start(bench, out: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "lightopt", "render", bench.rig, bench.part, "-o", out, *OPTIONS]
    # a shell that runs the tests in the background lets its children ignore Ctrl-C; a handler is not inherited
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    finally:
        signal.signal(signal.SIGINT, before)


def wait_for(process: subprocess.Popen[str], path: Path) -> None:
    end = time.monotonic() + 120
    while not path.exists():
        assert process.poll() is None, f"the command ended before {path.name} was there: {process.communicate()}"
        assert time.monotonic() < end, f"no {path.name} after two minutes"
        time.sleep(0.001)


def complete(bench, out: Path) -> str:
    process = start(bench, out)
    said, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    return said


def check_interrupted(out: Path) -> None:
    """The set is valid, nothing is half-written, and at most the files written last are not listed yet."""
    assert not [path for path in out.rglob("*") if path.name.startswith(".")]
    image_set = read_image_set(out)
    # the patches are written beside the images, and may be what is missing
    assert len(image_set.images) < IMAGES or not image_set.manifest.files
    listed = {name for entry in image_set.images for name in (entry.png, entry.exr)}
    listed |= {entry.exr for entry in image_set.geometry} | {*image_set.manifest.files, "manifest.json"}
    there = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    assert len(there - listed) <= 2, there - listed


@pytest.fixture(scope="module")
def undisturbed(shared_bench, tmp_path_factory, snapshot):
    """What the command leaves when nobody disturbs it."""
    out = tmp_path_factory.mktemp("undisturbed") / "out"
    complete(shared_bench, out)
    assert len(read_image_set(out).images) == IMAGES
    return snapshot(out)


@pytest.mark.slow
@one_console
@pytest.mark.parametrize("moment", MOMENTS)
def test_ctrl_c_leaves_a_valid_set_that_the_same_command_completes(
    shared_bench, tmp_path, undisturbed, snapshot, moment
):
    out = tmp_path / "out"
    process = start(shared_bench, out)
    wait_for(process, out / moment)
    process.send_signal(signal.SIGINT)
    said, errors = process.communicate(timeout=120)
    assert process.returncode == 130, errors
    assert (said, errors) == ("", INTERRUPTED + "\n")
    check_interrupted(out)
    complete(shared_bench, out)
    assert snapshot(out) == undisturbed


@pytest.mark.slow
@pytest.mark.parametrize("moment", MOMENTS)
def test_a_killed_run_is_completed_by_the_same_command(shared_bench, tmp_path, undisturbed, snapshot, moment):
    out = tmp_path / "out"
    process = start(shared_bench, out)
    wait_for(process, out / moment)
    process.kill()
    process.communicate(timeout=120)
    before = len(read_image_set(out).images)
    said = complete(shared_bench, out)
    if before:
        assert f"({before} of them existed already)" in said
    assert snapshot(out) == undisturbed


@pytest.mark.nightly
@one_console
@pytest.mark.parametrize("kill", [False, True], ids=["Ctrl-C", "kill"])
def test_any_moment(cli, shared_bench, tmp_path, undisturbed, snapshot, kill):
    """Moments from the start of the process to its end; the set is valid after each, or not begun."""
    began = time.monotonic()
    complete(shared_bench, tmp_path / "whole")
    whole = time.monotonic() - began
    for step in range(ALL_MOMENTS):
        out = tmp_path / str(step)
        process = start(shared_bench, out)
        time.sleep(whole * (step + 0.5) / ALL_MOMENTS)
        process.send_signal(signal.SIGKILL if kill else signal.SIGINT)
        _, errors = process.communicate(timeout=120)
        if (out / "manifest.json").exists():
            done = len(read_image_set(out).images)
            # once all is done, the signal meets an interpreter that is about to leave
            assert kill or process.returncode == 130 or done == IMAGES, errors
            assert kill or not list(out.rglob(".*"))
        # in process, which saves the start of an interpreter
        completed = cli("render", shared_bench.rig, shared_bench.part, "-o", out, *OPTIONS)
        assert completed.status == 0, completed.err
        assert snapshot(out) == undisturbed, f"interrupted after {step + 0.5} of {ALL_MOMENTS}"


# --- the same in process, at every single write: before the file is flushed, and before it is put in its place

QUICK = ("--exposure", "1,1/16", "--patches", "500")


@pytest.fixture(scope="module")
def quick(shared_bench, tmp_path_factory, snapshot):
    from lightopt.cli._main import run

    out = tmp_path_factory.mktemp("quick") / "out"
    assert run(["render", str(shared_bench.rig), str(shared_bench.part), "-o", str(out), "-q", *QUICK]) == 0
    return snapshot(out)


@pytest.mark.nightly
@pytest.mark.parametrize("call", ["replace", "fsync"])
def test_ctrl_c_at_every_write(cli, shared_bench, tmp_path, quick, snapshot, monkeypatch, call):
    original = getattr(os, call)
    calls = 0

    def interrupted_at(number):
        def count(*arguments):
            nonlocal calls
            calls += 1
            if calls == number:
                raise KeyboardInterrupt
            return original(*arguments)

        return count

    number = 0
    while True:
        number += 1
        out, calls = tmp_path / str(number), 0
        with monkeypatch.context() as patch:
            patch.setattr(os, call, interrupted_at(number))
            ran = cli("render", shared_bench.rig, shared_bench.part, "-o", out, "-q", *QUICK)
        if calls < number:  # all of the run's writes were interrupted once
            assert ran.status == 0
            break
        assert (ran.status, ran.out, ran.err) == (130, "", INTERRUPTED + "\n"), number
        if (out / "manifest.json").exists():
            check_interrupted(out)
        else:
            assert number == 1
            assert list(out.iterdir()) == []
        again = cli("render", shared_bench.rig, shared_bench.part, "-o", out, "-q", *QUICK)
        assert again.status == 0
        assert snapshot(out) == quick, f"interrupted at write {number}"
    # manifest, patches, 2 geometries, 4 EXR and 8 PNG, and the manifest after each entry
    assert number - 1 == 1 + 2 + 2 * 2 + 4 + 8 * 2


def test_ctrl_c_while_rays_are_cast(cli, shared_bench, tmp_path, quick, snapshot, monkeypatch):
    from lightopt.geometry import RayCaster

    first_hit, calls = RayCaster.first_hit, 0

    def count(self, *arguments, **options):
        nonlocal calls
        calls += 1
        if calls == 4:  # in a worker thread, while the second posture is rendered
            raise KeyboardInterrupt
        return first_hit(self, *arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(RayCaster, "first_hit", count)
        ran = cli("render", shared_bench.rig, shared_bench.part, "-o", tmp_path / "out", *QUICK)
    assert calls >= 4
    assert (ran.status, ran.err) == (130, INTERRUPTED + "\n")
    check_interrupted(tmp_path / "out")
    assert cli("render", shared_bench.rig, shared_bench.part, "-o", tmp_path / "out", "-q", *QUICK).status == 0
    assert snapshot(tmp_path / "out") == quick


@one_console
@pytest.mark.parametrize("inspected", [True, False], ids=["defects", "levels"])
def test_ctrl_c_is_answered_soon_while_panels_of_very_many_points_are_cast(shared_bench, inspected):
    """A block of patches under such a panel takes many seconds of a processor; it ends within one piece of it.

    However busy the machine: pieces that begin with the request wait until the thread that gets it has stopped them.
    """
    from lightopt import build_scene
    from lightopt.core import threads
    from lightopt.defects import BUILT_IN_CATALOGUE
    from lightopt.design import DetectionModel, luminance_matrix, planned_catalogue
    from lightopt.geometry import RayCaster
    from lightopt.rendering import build_patches

    scene = build_scene(shared_bench.rig, shared_bench.part)
    shadow_rays: list[int] = []  # of the pieces that begin from the request on
    armed = threading.Event()

    class Interrupting(RayCaster):
        def visible(self, *geometry: Any, candidates: Any, **how: Any) -> Any:
            if armed.is_set():
                shadow_rays.append(int(np.count_nonzero(candidates)))
                if len(shadow_rays) == 1:
                    signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
                if (stopped := threads._stopped.get()) is not None:
                    stopped.wait(60.0)
            return super().visible(*geometry, candidates=candidates, **how)

    caster = Interrupting(scene.mesh.vertices, scene.mesh.faces)
    table = build_patches(scene, caster=caster, budget=8000)
    inspection = DetectionModel(catalogue=planned_catalogue(BUILT_IN_CATALOGUE), sensor=scene.sensor, full_scale=255.0)

    def cast(points: int) -> None:
        panels = [[replace(light, points=points)] for light in scene.lights]
        luminance_matrix(
            scene,
            table,
            scene.postures[0],
            panels,
            caster=caster,
            detection=inspection if inspected else None,
            threads=2,
        )

    cast(4)  # compiles what is not compiled yet
    # as the commands do: an interrupt that meets a finaliser of LLVM's binding would be lost and leave its lock taken
    signal.signal(signal.SIGINT, interrupt)
    armed.set()
    with pytest.raises(KeyboardInterrupt):
        cast(10_000)
    # each of both threads ends its piece, and may have begun another one; all pieces have a hundred times as many
    assert len(shadow_rays) <= 4
    assert sum(shadow_rays) < 0.05 * len(scene.lights) * 10_000 * len(table.inspectable(scene.postures[0]))
