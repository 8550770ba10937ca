"""A capture on devices in memory: what it does in which order, what it writes, and how it ends."""

from __future__ import annotations

import json
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from capture_doubles import broken, changing_at

from lightopt.config import load_part, load_rig
from lightopt.core.errors import HardwareError, InputError, Interrupted
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import read_observations
from lightopt.images import read_exr, read_image_set, read_metadata, read_png
from lightopt.rig.capture import CapturePlan
from lightopt.rig.capture._acquisition import AcquisitionEngine
from lightopt.rig.simulated import BenchTruth


def order(world):
    return [event for event in world.log if event[0] in ("move", "level", "grab") and event[-1] != 0]


def test_each_light_alone_in_each_posture(take, world, bench):
    done = take()
    assert (done.images, done.taken) == (4, 4)
    assert world.log[0] == ("open",)
    offs = [("level", "bench1", channel, 0) for channel in (1, 2, 3, 4)]
    assert world.log[1:5] == offs  # before anything else
    assert world.did("home") == [("home",)]
    assert world.did("move") == [("move", Posture(0.0, 0.0)), ("move", Posture(-10.0, 170.0))]
    assert world.log[-7:-3] == offs
    assert {event[0] for event in world.log[-3:]} == {"close"}
    lit = [event[1:] for event in world.log if event[0] == "level" and event[3]]
    assert lit == [("bench1", 1, 200), ("bench1", 2, 200)] * 2
    image_set = read_image_set(bench.out)
    assert [(e.light, e.posture.rotation_deg) for e in image_set.images] == [
        ("light1", 0.0),
        ("light3", 0.0),
        ("light1", 170.0),
        ("light3", 170.0),
    ]
    assert image_set.manifest.kind == "captured"


def test_no_two_lights_burn_at_once_and_none_while_the_stage_moves(take, world):
    def watch(event):
        if event[0] == "move":
            assert not world.lit
        if event[0] == "level" and event[3]:
            assert not world.lit
        if event[0] == "grab":
            assert len(world.lit) <= 1

    world.trouble = watch
    take(exposures=(1.0, 1 / 16), dark=True)
    assert len(world.did("grab")) == 2 * 2 * 2 + 2 * 2 + 2  # and one without light at the end of each posture


def test_what_is_known_of_each_image_is_in_the_manifest(take, bench):
    take(exposures=(1.0, 1 / 16))
    manifest = json.loads((bench.out / "manifest.json").read_text(encoding="utf-8"))
    facts = manifest["images"][1]["capture"]
    assert facts["exposure_us"] == {"requested": 625.0, "read": 625.0}
    assert facts["light"]["level"] == {"requested": 200, "read": 200}
    assert (facts["light"]["controller"], facts["light"]["channel"]) == ("bench1", 1)
    assert facts["stage"]["requested"] == facts["stage"]["read"] == {"elevation_deg": 0.0, "rotation_deg": 0.0}
    assert facts["retries"] == 0
    assert facts["frames"] == 1
    assert set(facts["devices"]) == {"lights", "stage", "camera"}
    assert facts["time"].endswith("Z")
    entry = manifest["images"][0]
    sensor = read_png(bench.out / entry["png"])
    assert entry["capture"]["saturated_share"] == pytest.approx((sensor >= 255).mean())
    assert entry["capture"]["lit"]["resemblance"] > 0.9
    assert read_metadata(bench.out / entry["png"])["capture"] == entry["capture"]


def test_the_linear_image_says_where_each_pixel_came_from(take, bench):
    take(exposures=(1 / 16, 1.0))
    entry = read_image_set(bench.out).images[0]
    channels = read_exr(bench.out / entry.exr)
    long, short = (
        read_png(bench.out / e.png).astype(float)
        for e in read_image_set(bench.out).images
        if (e.light, e.posture) == (entry.light, entry.posture)
    )
    expected = np.where(long < 255, long, short * 16)
    assert np.array_equal(channels["Y"], expected.astype(np.float32))
    assert np.array_equal(channels["exposure"], np.where(long < 255, 1.0, 1 / 16).astype(np.float32))
    assert np.array_equal(channels["valid"], ((long < 255) | (short < 255)).astype(np.float32))


def test_levels_count_at_the_exposure_that_the_camera_held(take, bench):
    """A camera holds 667 µs for 666.7: 0.05 % of every level, in the EXR and in what the fits read."""
    take(exposures=(1.0, 1 / 15))
    image_set = read_image_set(bench.out)
    rig, part = load_rig(bench.rig), load_part(bench.part)
    requested = [entry.exposure for entry in image_set.images[:2]]
    facts = [entry.extra["capture"]["exposure_us"] for entry in image_set.images[:2]]
    assert facts[1]["requested"] != facts[1]["read"]
    held = [one["read"] / 10_000.0 for one in facts]
    assert requested == [1.0, 1 / 15]
    assert [entry.held_exposure for entry in image_set.images[:2]] == pytest.approx(held, rel=1e-12)
    seen = read_observations(image_set, rig, part)
    assert [one.exposure for one in seen[:2]] == pytest.approx(held, rel=1e-12)
    channels = read_exr(bench.out / image_set.images[0].exr)
    assert set(np.unique(channels["exposure"])) <= {np.float32(e) for e in held}
    short = channels["exposure"] == np.float32(held[1])
    assert short.any()
    loaded = image_set.load(image_set.images[1]).levels
    assert loaded[short] == pytest.approx(channels["Y"][short], rel=1e-6)


def test_dark_frames_are_subtracted_in_the_exr_only(take, bench):
    truth = BenchTruth(dark_level=7.0, ambient_level=12.0)
    take(dark=True, truth=truth)
    image_set = read_image_set(bench.out)
    assert sorted(image_set.manifest.files) == ["posture_-10_170/dark.png", "posture_0_0/dark.png"]
    dark = read_png(bench.out / "posture_0_0/dark.png").astype(np.float32)
    assert dark.mean() == pytest.approx(19, abs=0.3)
    entry = image_set.images[0]
    raw = read_png(bench.out / entry.png).astype(np.float32)
    assert np.array_equal(read_exr(bench.out / entry.exr)["Y"], raw - dark)
    facts = read_metadata(bench.out / "posture_0_0/dark.png")["capture"]
    assert facts["light"] is None


def test_the_mean_of_frames_is_less_noisy(take, bench, world):
    take(average=16, exposures=(1 / 4,), lights=("light1",), postures=(Posture(0.0, 0.0),))
    assert len(world.did("grab")) == 16 + 16 + 16  # the frames without light, too, are means of 16
    entry = read_image_set(bench.out).images[0]
    level = read_exr(bench.out / entry.exr)["Y"] / 4
    png = read_png(bench.out / entry.png)
    assert np.abs(level - png).max() <= 0.5 + 1e-3
    corner = level[:20, :20]  # beside the part, where only read noise is
    assert 0 < corner.std() < 0.2


def test_an_exposure_waits_for_the_image_before_it(take, bench, world):
    listed = []

    def watch(event):
        if event[0] == "grab":
            path = bench.out / "manifest.json"
            listed.append(len(json.loads(path.read_text(encoding="utf-8"))["images"]))
            read_image_set(bench.out)  # valid at every moment

    world.trouble = watch
    take(exposures=(1.0, 1 / 16))
    assert listed == [0, 0, 0, 1, 2, 3, 4, 4, 5, 6, 7, 8]  # the first two and each fifth are without light


def burning_after(monkeypatch, world, module, name, *, seconds=0.15):
    """What burns once a function has taken long, each time that it is called."""
    seen = []
    plain = getattr(module, name)

    def slow(*arguments, **options):
        time.sleep(seconds)
        seen.append(set(world.lit))
        return plain(*arguments, **options)

    monkeypatch.setattr(module, name, slow)
    return seen


def test_no_light_burns_for_a_slow_disk(take, world, bench, monkeypatch):
    from lightopt.images import _set_writer

    monkeypatch.setattr(CapturePlan, "relighting_s", 0.02)
    burning = burning_after(monkeypatch, world, _set_writer, "write_png")
    assert take(exposures=(1.0, 1 / 16)).taken == 8
    assert burning == [set()] * 8
    assert [len(e.sha256) for e in read_image_set(bench.out).images] == [2] * 8  # PNG and EXR


def test_a_light_waits_for_a_quick_disk(take, world):
    take(exposures=(1.0, 1 / 16))
    assert len([event for event in world.did("level") if event[3]]) == 4  # two postures, two lights


def test_the_light_is_out_before_anything_is_made_of_its_frames(take, world, monkeypatch):
    from lightopt.rig.capture._acquisition import FrameMean

    monkeypatch.setattr(CapturePlan, "relighting_s", 0.02)
    burning = burning_after(monkeypatch, world, FrameMean, "image", seconds=0.1)
    take(postures=(Posture(0.0, 0.0),), average=3)
    assert burning == [set()] * 4


def test_what_may_not_burn_long_waits_less():
    plan = SimpleNamespace(
        exposures=(), exposure_us={}.get, relighting_s=0.16, frames_s={1.0: 0.02, 0.5: 0.01}.__getitem__
    )
    for left, expected in ((None, 0.16), (5.0, 0.16), (0.1, 0.07), (0.02, 0.0)):
        camera = SimpleNamespace(exposure_range_us=(1.0, 1e7))
        devices = SimpleNamespace(camera=camera, identities=dict, remaining_on_s=lambda name, left=left: left)
        engine = AcquisitionEngine(devices, plan, sensor=None)
        engine._lit = ("light1", {})
        assert engine.max_wait_s((1.0, 0.5)) == pytest.approx(expected)


def test_a_camera_without_trigger_has_frames_discarded(take, bench, world):
    take(truth=BenchTruth(triggered=False), folder=bench.folder / "free")
    take(folder=bench.folder / "triggered")
    free, triggered = (read_image_set(bench.folder / name) for name in ("free", "triggered"))
    for a, b in zip(free.images, triggered.images, strict=True):
        first, second = (read_png(s.path(e.png)).astype(float) for s, e in ((free, a), (triggered, b)))
        assert np.abs(first - second).mean() < 2.0


# --- resuming


def test_only_what_is_missing_is_taken(take, bench, world, snapshot):
    take(folder=bench.folder / "whole", exposures=(1.0, 1 / 16), dark=True)
    world.trouble = broken("grab", number=6)
    with pytest.raises(HardwareError):
        take(exposures=(1.0, 1 / 16), dark=True)
    before = len(read_image_set(bench.out).images)
    assert before == 3
    world.trouble = lambda event: None
    world.log.clear()
    done = take(exposures=(1.0, 1 / 16), dark=True, resume=True)
    assert done.taken == 8  # no frame without light followed the first three
    assert len(world.did("grab")) == 8 + 2 + 2  # dark frames, and one at the end of each posture
    whole, resumed = read_image_set(bench.folder / "whole"), read_image_set(bench.out)
    assert [e.key for e in whole.images] == [e.key for e in resumed.images]
    for a, b in zip(whole.images, resumed.images, strict=True):
        assert np.array_equal(read_png(whole.path(a.png)), read_png(resumed.path(b.png)))
        one, other = read_exr(whole.path(a.exr)), read_exr(resumed.path(b.exr))
        assert all(np.array_equal(one[name], other[name]) for name in ("Y", "valid", "exposure"))


def test_a_complete_set_opens_nothing(take, world, bench, snapshot):
    take()
    before = snapshot(bench.out)
    world.log.clear()
    assert take(resume=True).taken == 0
    assert world.log == []
    assert snapshot(bench.out) == before


def test_means_are_not_mixed_with_those_of_another_run(take, bench, world):
    world.trouble = broken("grab", number=2 * 2 + 2 + 1)  # dark at both, light1 at 1, light1 at 1/16
    with pytest.raises(HardwareError):
        take(exposures=(1.0, 1 / 16), average=2)
    assert len(read_image_set(bench.out).images) == 1
    world.trouble = lambda event: None
    assert take(exposures=(1.0, 1 / 16), average=2, resume=True).taken == 8


def test_a_set_is_not_captured_into_again_without_saying_so(take, world):
    take()
    world.log.clear()
    with pytest.raises(InputError, match="use option 'resume'"):
        take()
    assert world.log == []


@pytest.mark.parametrize(
    ("file", "old", "new", "says"),
    [
        ("rig.yaml", "azimuth_deg: 45", "azimuth_deg: 46", "rig.sha256"),
        ("part.yaml", "R_d: 45.0", "R_d: 46.0", "part.sha256"),
    ],
)
def test_resuming_refuses_another_rig_or_part(take, bench, world, file, old, new, says):
    take()
    bench.edit(file, old, new)
    world.log.clear()
    with pytest.raises(InputError, match=says):
        take(resume=True, rig=load_rig(bench.rig), part=load_part(bench.part))
    assert world.log == []


def test_resuming_refuses_another_plan_and_says_what_differs(take, world):
    take()
    world.log.clear()
    with pytest.raises(InputError, match=r"options.average: previously 1, now 4"):
        take(resume=True, average=4)
    with pytest.raises(InputError, match=r"options.exposures"):
        take(resume=True, exposures=(1.0, 0.5))
    assert world.log == []


# --- ways out


@pytest.mark.parametrize("kind", ["home", "move", "grab"])
def test_lights_are_off_after_an_error_at(take, world, kind):
    world.trouble = broken(kind, number=1 if kind == "home" else 2)
    with pytest.raises(HardwareError, match="all lights are off") as raised:
        take()
    assert raised.value.messages[0].startswith("while ")
    assert not world.lit
    assert {event[0] for event in world.log[-3:]} == {"close"}


@pytest.mark.parametrize("kind", ["home", "move", "grab"])
def test_lights_are_off_after_ctrl_c_at(take, world, kind):
    world.trouble = broken(kind, number=1 if kind == "home" else 2, error=KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        take()
    assert not world.lit
    assert bool(world.did("stop")) == (kind != "grab")  # the stage was moving
    assert {event[0] for event in world.log[-3:]} == {"close"}


def test_every_channel_is_tried_even_if_one_fails(take, world):
    def trouble(event):
        if event[0] == "grab":
            raise HardwareError("no frame")
        if event[0] == "level" and event[2] in (1, 3) and world.did("grab"):
            raise HardwareError("does not answer")

    world.trouble = trouble
    with pytest.raises(HardwareError) as raised:
        take()
    said = str(raised.value)
    assert "no frame" in said
    assert "controller bench1, channels 1, 3: not switched off, may still be lit: does not answer" in said
    assert "all lights are off" not in said
    assert [event[2] for event in world.log if event[0] == "level"][-4:] == [1, 2, 3, 4]


def test_a_channel_that_cannot_be_switched_off_at_the_start_ends_the_run(take, world):
    world.trouble = broken("level")
    with pytest.raises(
        HardwareError, match=r"while switching all lights off: controller bench1, channel 1: .* may still be lit"
    ):
        take()
    assert not world.did("home")


def test_a_disk_that_refuses_ends_with_lights_off(take, world, monkeypatch):
    from lightopt.images import _set_writer

    def full(*arguments, **options):
        raise InputError("disk full")

    monkeypatch.setattr(_set_writer, "write_png", full)
    with pytest.raises(HardwareError, match="while checking and writing the previous image: disk full") as raised:
        take()
    assert "all lights are off" in str(raised.value)
    assert not world.lit


# --- images that are not what they say


def test_swapped_plugs_are_named(take, world, bench):
    world.plugs = {("bench1", 1): ("bench1", 2), ("bench1", 2): ("bench1", 1)}
    with pytest.raises(HardwareError, match="light1 was lit, but the image looks like light3") as raised:
        take()
    assert "all lights are off" in str(raised.value)
    assert read_image_set(bench.out).images == ()


def test_a_light_that_stays_dark_is_named(take, world):
    world.plugs = {("bench1", 2): ("bench1", 4)}
    with pytest.raises(HardwareError, match="light3 stays dark"):
        take()


def test_a_light_that_does_not_go_out_is_named(take, world):
    world.plugs = {("bench1", 3): ("bench1", 2)}

    class Stuck(dict):
        def __setitem__(self, key, value):
            super().__setitem__(key, value or self.get(key, 0))

    world.levels = Stuck()
    with pytest.raises(HardwareError, match="light1 is on together with light3"):
        take()


def test_without_the_check_anything_is_captured(take, world):
    world.plugs = {("bench1", 1): ("bench1", 2), ("bench1", 2): ("bench1", 1)}
    assert take(check=False).taken == 4
    assert len(world.did("grab")) == 4  # and no frame without light is needed


def test_a_lamp_that_dies_between_exposures_is_named(take, world, bench):
    # two frames without light, light1 at 1, light1 at 1/16
    world.trouble = changing_at(world, 4, lambda world: world.levels.update({("bench1", 1): 0}))
    with pytest.raises(HardwareError, match=r"light1 \(0°, 0°\) at exposure 0\.0625: light1 ") as raised:
        take(exposures=(1.0, 1 / 16))
    assert "all lights are off" in str(raised.value)
    assert [entry.exposure for entry in read_image_set(bench.out).images] == [1.0]


def test_a_lamp_that_weakens_between_exposures_is_named(take, world):
    world.trouble = changing_at(world, 6, lambda world: world.levels.update({("bench1", 1): 120}))
    with pytest.raises(HardwareError, match=r"light1 is \d+% as bright as at exposure 1: it failed, changed"):
        take(exposures=(1.0, 1 / 4, 1 / 16))


@pytest.mark.parametrize("level", [20, 60, 200])
def test_a_light_that_stays_on_after_the_last_image_is_named(take, world, level):
    def stuck(world):
        world.plugs = {("bench1", 1): ("bench1", 9)}
        world.levels["bench1", 9] = level

    world.trouble = changing_at(world, 4, stuck)  # without light, light1, light3, without light
    with pytest.raises(HardwareError, match="the frame without light looks like light1"):
        take(postures=(Posture(0.0, 0.0),))


def test_a_light_that_stays_on_is_judged_by_the_posture_that_it_shows(take, world, monkeypatch):
    from lightopt.rig.capture import _image_checks

    plain = _image_checks.find_light_left_on
    last = threading.Event()

    def late(*arguments, **options):  # the disk comes to it only once the stage travels to the next posture
        if len(world.did("grab")) == 4:
            last.wait(5.0)
        return plain(*arguments, **options)

    def stuck(event):
        at = len(world.did("grab"))
        if event[0] == "grab" and at == 4:  # without light, light1, light3, without light
            world.plugs = {("bench1", 1): ("bench1", 9)}
            world.levels["bench1", 9] = 60
        if event[0] == "move" and at == 4:
            time.sleep(0.1)
            last.set()

    monkeypatch.setattr(_image_checks, "find_light_left_on", late)
    world.trouble = stuck
    with pytest.raises(HardwareError, match="the frame without light looks like light1"):
        take(postures=(Posture(0.0, 0.0), Posture(-30.0, 90.0)))
    assert last.is_set()
    assert len(world.did("grab")) == 4


def test_another_part_is_refused_unless_unchecked(take, world, bench):
    bench.edit("part.yaml", "translate_mm: [0, 0, 0]", "translate_mm: [12, -9, 0]")
    other = load_part(bench.part)
    with pytest.raises(HardwareError, match="does not look as predicted under any light"):
        take(part=other)
    assert take(part=other, force=True, check=False).taken == 4


def test_ambient_light_that_nothing_subtracts_is_reported(take):
    assert take(truth=BenchTruth(ambient_level=4.0), dark=True).warnings == ()
    said = take(truth=BenchTruth(ambient_level=4.0), force=True).warnings
    assert [text.partition(":")[0] for text in said] == [
        "without any light the image is 4 levels above black at exposure 1"
    ]


# --- what is there


def test_force_removes_nothing_before_the_devices_are_open_and_dark(take, world, bench, snapshot):
    take()
    before = snapshot(bench.out)
    world.trouble = broken("level")
    with pytest.raises(HardwareError, match="while switching all lights off"):
        take(force=True)
    assert snapshot(bench.out) == before
    world.trouble = lambda event: None
    assert take(force=True).replaced > 0


def test_without_the_check_is_another_plan(take, world):
    take()
    with pytest.raises(InputError, match=r"options\.check: previously true, now false"):
        take(resume=True, check=False)


def test_an_interrupted_run_says_where_it_stands(take, world, bench):
    world.trouble = broken("grab", number=4, error=KeyboardInterrupt())
    with pytest.raises(
        Interrupted, match="all lights are off; 2 of 4 images are on disk; continue with option 'resume'"
    ):
        take()
    assert len(read_image_set(bench.out).images) == 2


def test_two_captures_into_one_folder_are_refused(take, world, bench):
    from lightopt.rig.capture._capture import LOCK_NAME, lock_folder

    with (
        lock_folder(bench.out),
        pytest.raises(InputError, match=r"another capture writes into this folder \(process \d+\)"),
    ):
        take()
    assert world.log == []
    (bench.out / LOCK_NAME).write_text("4711\n", encoding="ascii")  # left by one that was killed
    assert take().taken == 4
    assert not (bench.out / LOCK_NAME).exists()


def test_what_happened_on_the_links_is_at_the_image_where_it_happened(take, world, bench):
    from lightopt.rig.devices import Event

    def happen(event):
        at = len(world.did("grab"))
        if event[0] == "grab" and at in (1, 3, 4):  # without light, light3, without light at the end
            world.events.append(Event("2026-01-01T00:00:00.000Z", "double", f"frame {at}", at != 3))

    world.trouble = happen
    assert take(postures=(Posture(0.0, 0.0),)).retries == 2
    manifest = json.loads((bench.out / "manifest.json").read_text(encoding="utf-8"))
    first, second = (entry["capture"] for entry in manifest["images"])
    assert ([e["what"] for e in first["events"]], first["retries"]) == (["frame 1"], 1)
    assert ([e["what"] for e in second["events"]], second["retries"]) == (["frame 3"], 0)
    assert [event["what"] for event in manifest["events"]] == ["frame 4"]
    assert take(resume=True, postures=(Posture(0.0, 0.0),)).taken == 0
