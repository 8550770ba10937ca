"""A capture that stopped half way: which images count, which are taken anew, and what waits for the disk."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from capture_doubles import broken, changing_at

from lightopt.core.errors import HardwareError, InputError, Interrupted
from lightopt.core.provenance import file_sha256
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.images import ImageSetWriter, png_name, read_image_set, read_png
from lightopt.rig.capture import CapturePlan
from lightopt.rig.capture._acquisition import AcquisitionEngine
from lightopt.rig.capture._capture import LOCK_NAME
from lightopt.rig.capture._captured_set import MOST_LINEARS, BackgroundWriter, CapturedSet

HERE = (Posture(0.0, 0.0),)


def undisturbed(world):
    world.trouble = lambda event: None
    world.plugs, world.levels = {}, {}
    world.log.clear()


def glowing(level):
    """Light1 burns on, whatever its controller says."""

    def change(world):
        world.plugs = {("bench1", 1): ("bench1", 9)}
        world.levels["bench1", 9] = level

    return change


def manifest(bench):
    return json.loads((bench.out / "manifest.json").read_text(encoding="utf-8"))


# --- images of which nobody knows whether a second light burned


def test_images_before_a_frame_that_was_not_dark_are_not_kept_and_taken_anew(take, world, bench):
    take(folder=bench.folder / "whole", postures=HERE)
    undisturbed(world)
    world.trouble = changing_at(world, 3, glowing(16))  # light3, whose image alone does not show it
    with pytest.raises(HardwareError, match="the frame without light looks like light1") as raised:
        take(postures=HERE)
    assert "were not kept; option 'resume' captures them again" in str(raised.value)
    assert manifest(bench)["images"] == []
    assert not list(bench.out.rglob("*.png"))
    undisturbed(world)
    assert take(postures=HERE, resume=True).taken == 2
    whole, resumed = read_image_set(bench.folder / "whole"), read_image_set(bench.out)
    for a, b in zip(whole.images, resumed.images, strict=True):
        assert np.array_equal(read_png(whole.path(a.png)), read_png(resumed.path(b.png)))


def test_images_that_no_dark_frame_followed_are_taken_anew(take, world, bench):
    def trouble(event):
        if event[0] == "grab" and len(world.did("grab")) == 7:  # the last of the second posture, without light
            raise KeyboardInterrupt

    world.trouble = trouble
    with pytest.raises(
        Interrupted, match="4 of 4 images are on disk; continue with option 'resume', which captures 2 of them"
    ):
        take()
    assert len(manifest(bench)["ended_dark"]) == 1
    undisturbed(world)
    done = take(resume=True)
    assert (done.taken, len(world.did("move"))) == (2, 1)
    assert len(manifest(bench)["ended_dark"]) == 2
    undisturbed(world)
    assert take(resume=True).taken == 0
    assert world.log == []


def test_a_lost_image_is_taken_anew_with_the_other_exposures_of_its_light_only(take, world, bench):
    take(exposures=(1.0, 1 / 16))
    (bench.out / read_image_set(bench.out).images[1].png).unlink()
    undisturbed(world)
    assert take(exposures=(1.0, 1 / 16), resume=True).taken == 2
    assert len(manifest(bench)["ended_dark"]) == 2
    assert len(read_image_set(bench.out).images) == 8


@pytest.mark.parametrize("check", [True, False])
def test_exposures_of_two_runs_are_not_merged(take, world, bench, check):
    world.trouble = broken("grab", number=2 + check * 2)  # light1 at 1/16
    with pytest.raises(HardwareError):
        take(exposures=(1.0, 1 / 16), postures=HERE, check=check)
    assert [entry.exposure for entry in read_image_set(bench.out).images] == [1.0]
    undisturbed(world)

    def half(event):
        if event[0] == "grab":
            world.levels.update({key: 100 for key, level in world.levels.items() if level == 200})

    world.trouble = half
    assert take(exposures=(1.0, 1 / 16), postures=HERE, check=check, resume=True).taken == 4
    images = read_image_set(bench.out)
    long, short = (read_png(images.path(entry.png)).astype(float) for entry in images.images[:2])
    both = (long < 255) & (short >= 4)
    assert np.median(short[both] * 16 / long[both]) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("average", [1, 2])
def test_dark_frames_of_the_run_before_show_a_weak_light(take, world, average):
    world.trouble = broken("grab", number=2 * average + 1)  # without light, light1, light3
    with pytest.raises(HardwareError):
        take(dark=True, postures=HERE, average=average)
    undisturbed(world)
    world.trouble = changing_at(world, 3 if average == 1 else 7, glowing(16))  # after light1 and light3
    with pytest.raises(HardwareError, match="the frame without light looks like light1"):
        take(dark=True, postures=HERE, average=average, resume=True)


# --- valid at every moment


def test_the_set_is_valid_whenever_resuming_means_is_killed(take, world, bench, monkeypatch):
    options = {"exposures": (1.0, 1 / 16), "average": 2, "dark": True}
    world.trouble = broken("grab", number=2 * 2 + 2 * 2 + 1)
    with pytest.raises(HardwareError):
        take(**options)
    assert len(read_image_set(bench.out).images) == 2
    undisturbed(world)
    plain, moments = ImageSetWriter._save, []

    def save(self, **changes):
        there = manifest(bench)
        hashes = {entry["png"]: entry["sha256"]["png"] for entry in there["images"]}
        hashes |= {entry["exr"]: entry["sha256"]["exr"] for entry in there["images"] if "exr" in entry}
        hashes |= there["files"]
        moments.append([name for name, digest in hashes.items() if file_sha256(bench.out / name) != digest])
        return plain(self, **changes)

    monkeypatch.setattr(ImageSetWriter, "_save", save)
    assert take(**options, resume=True).taken == 8
    assert len(moments) > 12
    assert not any(moments)


# --- the disk


def test_a_full_disk_is_reported_with_step_and_state(take, world, bench, monkeypatch):
    from lightopt.images import _atomic

    plain, count = os.replace, []

    def full(*arguments):
        count.append(arguments)
        if len(count) > 4:
            raise OSError(28, "No space left on device")
        return plain(*arguments)

    monkeypatch.setattr(_atomic.os, "replace", full)
    with pytest.raises(HardwareError) as raised:
        take()
    assert raised.value.exit_status == 3
    assert raised.value.messages[0].startswith("while checking and writing the ")
    assert "No space left on device" in raised.value.messages[0]
    assert raised.value.messages[-1] == "all lights are off"
    assert not world.lit


def test_an_early_error_of_a_linear_image_is_not_lost(take, monkeypatch):
    plain, count = CapturedSet.add_linear, []

    def first_fails(self, *arguments):
        count.append(arguments)
        if len(count) == 1:
            raise InputError("no room for the first")
        return plain(self, *arguments)

    monkeypatch.setattr(CapturedSet, "add_linear", first_fails)
    with pytest.raises(HardwareError, match=r"^while checking and writing the .*: no room for the first"):
        take()


def test_nothing_is_written_after_an_image_that_was_not():
    def fail():
        raise InputError("no room")

    done, disk = [], BackgroundWriter()
    disk.submit_image(fail)
    disk.submit_image(done.append, 1)
    disk.submit_linear(done.append, 2)
    with pytest.raises(HardwareError, match="no room"):
        disk.wait_for_image()
    disk.close()
    assert done == []


def test_few_linear_images_wait(take, monkeypatch):
    plain, waiting, most = CapturedSet.add_linear, [], []
    queue = BackgroundWriter.submit_linear

    def slow(self, *arguments):
        time.sleep(0.1)
        plain(self, *arguments)
        waiting.pop()

    def count(self, *arguments):
        waiting.append(1)
        most.append(len(waiting))
        queue(self, *arguments)

    monkeypatch.setattr(CapturedSet, "add_linear", slow)
    monkeypatch.setattr(BackgroundWriter, "submit_linear", count)
    take(check=False, postures=tuple(Posture(0.0, angle) for angle in (0.0, 40.0, 80.0, 120.0)))
    assert len(most) == 8
    assert max(most) <= MOST_LINEARS + 1  # the one that is about to be queued has its exposures, too


@pytest.mark.skipif(os.name == "nt", reason="os.kill ends a Windows process at once")
def test_a_disk_that_hangs_is_waited_for_and_the_folder_stays_locked(take, world, bench, monkeypatch):
    from lightopt.images import _set_writer
    from lightopt.rig.capture import _capture

    monkeypatch.setattr(_capture, "DISK_WARNING_S", 0.05)
    inside, gate, said, plain = threading.Event(), threading.Event(), [], _set_writer.write_png

    def hang(*arguments, **options):
        inside.set()
        gate.wait(20)
        return plain(*arguments, **options)

    def person():
        inside.wait(20)
        time.sleep(0.1)
        os.kill(os.getpid(), signal.SIGINT)
        while not said:
            time.sleep(0.01)
        seen.append(set(world.lit))
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.2)
        seen.append((bench.out / LOCK_NAME).exists())
        gate.set()

    seen = []
    monkeypatch.setattr(_set_writer, "write_png", hang)
    at_the_keys = threading.Thread(target=person)
    at_the_keys.start()
    with pytest.raises(
        Interrupted, match="all lights are off; 1 of 4 images are on disk; continue with option 'resume'"
    ):
        take(run=RunContext(warn=said.append))
    at_the_keys.join()
    assert said == ["all lights are off; waiting until the disk has written the exposed images; Ctrl-C also waits"]
    assert seen == [set(), True]
    assert not (bench.out / LOCK_NAME).exists()
    assert not [t.name for t in threading.enumerate() if t.name.startswith(("disk", "linear"))]
    monkeypatch.setattr(_set_writer, "write_png", plain)
    assert take(resume=True).images == len(read_image_set(bench.out).images) == 4


def test_linear_images_that_nobody_has_begun_with_are_left_to_resuming(take, world, bench, monkeypatch):
    plain, made = CapturedSet.add_linear, []

    def slow(self, *arguments):
        made.append(arguments[0])
        time.sleep(0.5)
        plain(self, *arguments)

    monkeypatch.setattr(CapturedSet, "add_linear", slow)
    world.trouble = broken("move", number=2, error=KeyboardInterrupt())
    with pytest.raises(Interrupted):
        take()
    assert made == ["light1"]


@pytest.mark.skipif(os.name == "nt", reason="os.kill ends a Windows process at once")
def test_ctrl_c_at_the_very_end_says_that_the_set_is_complete(take, world, bench):
    def trouble(event):
        if event[0] == "level" and len(world.did("grab")) == 7 and event[2] == 4:  # switching all off at the end
            os.kill(os.getpid(), signal.SIGINT)

    world.trouble = trouble
    with pytest.raises(Interrupted, match="all lights are off; 4 of 4 images are on disk; the set is complete"):
        take()


# --- lights


def test_a_light_that_is_lit_anew_settles_anew(take, world, monkeypatch):
    from lightopt.images import _set_writer

    plain, lit, waited, grabs = _set_writer.write_png, [], [], AcquisitionEngine.light_on

    def slow(*arguments, **options):
        time.sleep(0.1)
        return plain(*arguments, **options)

    def light_on(self, name):
        grabs(self, name)
        self._light_settled += 0.15
        lit.append(self._light_settled)

    def watch(event):
        if event[0] == "grab" and world.lit:
            waited.append(time.monotonic() >= lit[-1])

    monkeypatch.setattr(CapturePlan, "relighting_s", 0.01)
    monkeypatch.setattr(_set_writer, "write_png", slow)
    monkeypatch.setattr(AcquisitionEngine, "light_on", light_on)
    world.trouble = watch
    take(exposures=(1.0, 1 / 16), postures=HERE)
    assert len(lit) > 2  # each light anew for its second exposure
    assert waited == [True] * 4


def test_an_exposure_for_which_the_light_may_not_burn_is_not_begun():
    plan = SimpleNamespace(
        exposures=(),
        exposure_us={}.get,
        wiring=SimpleNamespace(hardware=SimpleNamespace(timing=SimpleNamespace(frame_timeout_s=1.0))),
    )
    camera = SimpleNamespace(exposure_range_us=(1.0, 1e7))
    devices = SimpleNamespace(camera=camera, identities=dict, remaining_on_s=lambda name: 0.01)
    engine = AcquisitionEngine(devices, plan, sensor=None)
    engine._lit, engine._held_us = ("light1", {}), 20_000.0
    with pytest.raises(HardwareError, match=r"light1 may be on for 0\.01 s more \(max_on_s\)"):
        engine._grab()
    engine.close()


def test_what_was_noticed_stays_in_the_manifest_of_a_run_that_failed(take, world, bench):
    from lightopt.rig.simulated import BenchTruth

    world.trouble = broken("move", number=2)
    with pytest.raises(HardwareError):
        take(truth=BenchTruth(ambient_level=4.0))
    assert any(text.startswith("without any light") for text in manifest(bench)["warnings"])


# --- the folder


def test_a_start_that_failed_is_in_nobodys_way(take, world, bench):
    world.trouble = broken("level")
    with pytest.raises(HardwareError):
        take()
    undisturbed(world)
    assert take(exposures=(1.0, 1 / 4)).taken == 8


@pytest.mark.parametrize("options", [{}, {"resume": True}])
def test_a_file_that_a_killed_run_had_not_listed_yet_is_taken_anew(take, world, bench, options):
    world.trouble = broken("grab", number=2)  # without light, light1
    with pytest.raises(HardwareError):
        take(postures=HERE)
    undisturbed(world)
    assert manifest(bench)["images"] == []
    (bench.out / "posture_0_0").mkdir(exist_ok=True)
    (bench.out / png_name("light1", HERE[0], 1.0)).write_bytes(b"killed before it was listed")
    assert take(postures=HERE, **options).taken == 2


def test_what_differs_is_said_before_which_files_do(take, bench):
    from lightopt.config import load_part

    take(postures=HERE)
    bench.edit("part.yaml", "R_d: 45.0", "R_d: 46.0")
    with pytest.raises(InputError) as raised:
        take(postures=HERE, part=load_part(bench.part), average=2, resume=True)
    assert "(options.average: previously 1, now 2; part.sha256: another content); use option 'force'" in str(
        raised.value
    )
