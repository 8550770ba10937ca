"""A camera whose process hangs: it neither ends nor answers, and the run has to end in the dark all the same."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

import pytest
from camera_worlds import needs
from fault_cases import make_rig
from rig_faults import gige_rig

from lightopt.config import load_part, load_rig
from lightopt.core.errors import HardwareError
from lightopt.images import read_image_set
from lightopt.rig.capture import wiring_of
from lightopt.rig.capture._software_cameras import VirtualCamera
from lightopt.rig.capture._wiring import start_bench

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="SIGSTOP is of POSIX")

ENDS_S = 300.0  # of a run whose camera hangs, on a busy computer


def test_the_time_that_a_frame_may_take_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig_file, part_file = make_rig(tmp_path)
    rig = load_rig(rig_file)
    with start_bench(rig, wiring_of(rig), part=load_part(part_file)) as bench:
        camera = VirtualCamera(bench)
        camera.set_exposure(2e6)
        bench.prepare(10_000.0)
        with pytest.raises(HardwareError, match=r"did not answer the request frame within 0\.3 s"):
            camera.grab(timeout_s=0.3)
        with pytest.raises(HardwareError, match="cannot take the request"):  # the frame that comes late is nobody's
            camera.grab(timeout_s=10)


@pytest.mark.slow
def test_a_bench_that_hangs_while_it_renders_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lightopt.rig.simulated._bench_process._ANSWER_S", 0.3)
    rig_file, part_file = make_rig(tmp_path)
    rig = load_rig(rig_file)
    with start_bench(rig, wiring_of(rig), part=load_part(part_file)) as bench:
        camera = VirtualCamera(bench)
        os.kill(bench.pid, signal.SIGSTOP)
        begun = time.monotonic()
        with pytest.raises(HardwareError, match=r"did not answer the request prepare within .*: its process hangs"):
            camera.grab(timeout_s=600)
        assert time.monotonic() - begun < 60


@contextmanager
def rig_with(camera: str, folder: Path) -> Generator[tuple[Path, Path, Callable[[int], int]]]:
    """A rig whose lights and stage are in a process of their own; rig, part, and who the camera's process is."""
    rig_file, part_file = (gige_rig if camera == "gige" else make_rig)(folder)
    rig, part = load_rig(rig_file), load_part(part_file)
    text = rig_file.read_text(encoding="utf-8")
    seeing = start_bench(rig, wiring_of(rig), part=part) if camera == "gige" else None
    lights = start_bench(rig, wiring_of(rig))
    try:
        text = text.replace("driver: ccs, port: virtual", f"driver: ccs, port: {lights.ports['lights']}")
        text = text.replace("    port: virtual", f"    port: {lights.ports['stage']}")
        if seeing is not None:
            text = text.replace("port: virtual}", f"port: {seeing.ports['camera']}}}")
        assert "port: virtual" not in text
        rig_file.write_text(text, encoding="utf-8", newline="\n")

        def process(run: int) -> int:
            if seeing is not None:
                return seeing.pid
            (child,) = Path(f"/proc/{run}/task/{run}/children").read_text(encoding="ascii").split()
            return int(child)

        yield rig_file, part_file, process
        assert not any(lights.levels("lights").values())
    finally:
        lights.close()
        if seeing is not None:
            seeing.close()


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="the process is found as Linux lists it")
@pytest.mark.parametrize("camera", ["virtual", pytest.param("gige", marks=pytest.mark.nightly)])
def test_a_capture_ends_in_the_dark_when_the_camera_hangs_and_resumes(camera: str, tmp_path: Path) -> None:
    if camera == "gige":
        needs("aravis")
    with rig_with(camera, tmp_path) as (rig, part, process):
        out = tmp_path / "set"
        # the camera sees none of the lights, which are in another process: images are not judged
        command = [sys.executable, "-m", "lightopt", "capture", str(rig), str(part), "-o", str(out)]
        command += ["--exposure", "1,1/16", "--home", "--no-check-lights"]
        run = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        until = time.monotonic() + ENDS_S
        while listed(out) < 3:
            assert run.poll() is None
            assert time.monotonic() < until
            time.sleep(0.005)
        hung = process(run.pid)
        os.kill(hung, signal.SIGSTOP)
        begun = time.monotonic()
        _, said = run.communicate(timeout=ENDS_S)
        assert (run.returncode, time.monotonic() - begun < ENDS_S) == (3, True), said
        assert "all lights are off" in said
        assert listed(out) < 8
        if camera == "gige":
            os.kill(hung, signal.SIGCONT)
            time.sleep(4)  # a camera gives a client up that has been silent for three seconds
        again = subprocess.run([*command, "--resume"], capture_output=True, text=True, timeout=2 * ENDS_S)
        assert again.returncode == 0, again.stderr
        assert len(read_image_set(out).images) == 8


def listed(folder: Path) -> int:
    """Images that are in the manifest of a set that is being written."""
    try:
        return len(json.loads((folder / "manifest.json").read_text(encoding="utf-8"))["images"])
    except FileNotFoundError:
        return 0
