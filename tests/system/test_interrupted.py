"""Ctrl-C and kill -9 at any moment: nothing half-written, and the same command afterwards completes the set."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from lightopt.images import read_image_set

# about a second of rendering, 8 images of 4 × 4 rays a pixel: long enough to be met in the middle on any machine
OPTIONS = (
    "--exposure",
    "1",
    "--exposure",
    "1/16",
    "--layers",
    "--noise",
    "1",
    "--patches",
    "2000",
    "--supersample",
    "4",
)
MOMENTS = (
    "manifest.json",
    "patches.npz",
    "posture_0_0/geometry.exr",
    "posture_0_0/light1.png",
    "posture_0_0/light3.exr",
    "posture_-10_170/geometry.exr",
    "posture_-10_170/light1_x0.0625.png",
)
"""Files whose appearance is a moment to interrupt at: while tracing for patches, rendering, and writing."""


def start(bench, out: Path) -> subprocess.Popen[str]:
    command = [
        sys.executable,
        "-m",
        "lightopt",
        "render",
        str(bench.rig),
        str(bench.part),
        "-o",
        str(out),
        *OPTIONS,
    ]
    # a group of its own, so that a signal to it on Windows does not meet the tests
    flags = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP} if sys.platform == "win32" else {}
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **flags)


def interrupt(process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.CTRL_BREAK_EVENT if sys.platform == "win32" else signal.SIGINT)


def wait_for(process: subprocess.Popen[str], path: Path) -> None:
    end = time.monotonic() + 120
    while not path.exists():
        assert process.poll() is None, (
            f"the command ended before there was {path.name}: {process.communicate()}"
        )
        assert time.monotonic() < end, f"no {path.name} after two minutes"
        time.sleep(0.001)


def complete(bench, out: Path) -> str:
    process = start(bench, out)
    said, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    return said


@pytest.fixture(scope="module")
def undisturbed(shared_bench, tmp_path_factory, snapshot):
    """What the command leaves when nobody disturbs it."""
    out = tmp_path_factory.mktemp("undisturbed") / "out"
    complete(shared_bench, out)
    return snapshot(out)


def files(out: Path) -> list[Path]:
    return [path for path in out.rglob("*") if path.is_file()]


@pytest.mark.parametrize("moment", MOMENTS)
def test_ctrl_c_leaves_a_valid_set_that_the_same_command_completes(
    shared_bench, tmp_path, undisturbed, snapshot, moment
):
    out = tmp_path / "out"
    process = start(shared_bench, out)
    wait_for(process, out / moment)
    interrupt(process)
    said, errors = process.communicate(timeout=120)
    if process.returncode == 0 and moment == MOMENTS[-1]:
        return  # over before the signal was met: there was little left to do
    assert process.returncode == 130, errors
    assert errors.splitlines()[-1] == "interrupted; what was finished is complete on disk"
    assert "Traceback" not in errors
    assert said == ""
    image_set = read_image_set(out)
    assert len(image_set.images) < 8
    assert not list(out.rglob("*.partial"))
    # at most the file written last is not listed yet
    listed = {name for e in image_set.images for name in (e.png, e.exr)} | {g.exr for g in image_set.geometry}
    strays = (
        {p.relative_to(out).as_posix() for p in files(out)}
        - listed
        - {*image_set.manifest.files, "manifest.json"}
    )
    assert len(strays) <= 2, strays
    complete(shared_bench, out)
    assert snapshot(out) == undisturbed


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
        assert f"({before} of them were there already)" in said
    assert snapshot(out) == undisturbed


@pytest.mark.slow
@pytest.mark.parametrize("kill", [False, True], ids=["Ctrl-C", "kill"])
def test_any_moment(shared_bench, tmp_path, undisturbed, snapshot, kill):
    """Twenty moments from the start of the process to its end; the set is valid after each, or not begun."""
    began = time.monotonic()
    complete(shared_bench, tmp_path / "whole")
    whole = time.monotonic() - began
    for step in range(20):
        out = tmp_path / str(step)
        process = start(shared_bench, out)
        time.sleep(whole * (step + 0.5) / 20)
        if kill:
            process.kill()
        else:
            interrupt(process)
        _, errors = process.communicate(timeout=120)
        if (out / "manifest.json").exists():
            read_image_set(out)
            assert kill or process.returncode in (0, 130), errors
            assert kill or not list(out.rglob("*.partial"))
        complete(shared_bench, out)
        assert snapshot(out) == undisturbed, f"interrupted after {step + 0.5} twentieths"
