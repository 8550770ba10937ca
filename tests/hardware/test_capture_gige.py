"""Captures with the GigE camera behind its real driver: through the commands, with faults, and for long."""

from __future__ import annotations

import hashlib
import json
import shutil

import pytest
import rig_faults
from camera_worlds import needs
from fault_runs import OPTIONS, alike, differences
from rig_faults import RigCase, gige_rig, rig_cases, undergo
from soak import soak

from lightopt.cli._main import run
from lightopt.config import load_part, load_rig
from lightopt.images import read_image_set
from lightopt.rig.capture import capture


@pytest.fixture(scope="module")
def bed(tmp_path_factory: pytest.TempPathFactory):
    """Rig, part, and what an undisturbed run leaves."""
    needs("aravis")
    folder = tmp_path_factory.mktemp("gige")
    rig, part = gige_rig(folder)
    capture(load_rig(rig), load_part(part), folder / "truth", options=OPTIONS)
    return rig, part, folder / "truth"


def seen(bed, tmp_path, *case, **more):
    rig, part, truth = bed
    return undergo(RigCase("", *case, **more), rig, part, tmp_path / "set", truth)


def test_the_manifest_says_what_took_the_frames(bed):
    images = read_image_set(bed[2]).images
    facts = [entry.extra["capture"] for entry in images]
    camera = facts[0]["devices"]["camera"]
    assert (camera["driver"], camera["serial"], camera["pixel_format"]) == ("aravis", "LIGHTOPT1", "Mono8")
    assert camera["trigger"] == "software"
    numbers = [fact["frame_numbers"][0] for fact in facts]
    assert len(set(numbers)) == 8
    stamps = [fact["camera_time_ns"] for fact in facts]
    assert len(set(stamps)) == 8
    assert all(fact["camera"]["frames_lost"] == 0 for fact in facts)


@pytest.mark.slow
@pytest.mark.parametrize(
    "fault", [pytest.param("lost", marks=pytest.mark.slow), pytest.param("incomplete", marks=pytest.mark.slow), "stale"]
)
def test_an_unsound_frame_is_taken_again_and_the_manifest_says_at_which_image(bed, tmp_path, fault):
    found = seen(bed, tmp_path, "camera", fault, {"after": 4})
    assert (found.how, found.retries, found.wrong) == ("taken again, same images", 1, ())
    facts = [entry.extra["capture"] for entry in read_image_set(tmp_path / "set").images]
    reported = [event for fact in facts for event in fact.get("events", ())]
    assert len(reported) == 1
    assert reported[0]["port"] == "camera LIGHTOPT1"
    assert "taken again (1 of 2) after: " in reported[0]["what"]


@pytest.mark.slow
def test_a_camera_that_is_unplugged_stops_the_run_in_the_dark(bed, tmp_path):
    found = seen(bed, tmp_path, "camera", "vanish", {"after": 5})
    assert (found.how, found.wrong) == ("stopped, by reply", ())
    assert "while exposing" in found.message
    assert "the camera does not answer any more" in found.message
    assert "all lights are off" in found.message


@pytest.mark.slow
def test_a_camera_that_hangs_stops_the_run_in_the_dark(bed, tmp_path):
    found = seen(bed, tmp_path, "camera", "hang", {"after": 5})
    assert (found.how, found.wrong) == ("stopped, by reply", ())
    assert "while exposing" in found.message
    assert "all lights are off" in found.message


@pytest.mark.slow
def test_an_old_image_under_a_new_stamp_is_found_in_the_image(bed, tmp_path):
    # the sixth frame is the first of a light: the frame before was dark
    found = seen(bed, tmp_path, "camera", "old_image", {"after": 4})
    assert (found.how, found.wrong) == ("stopped, by image", ())


@pytest.mark.slow
def test_a_full_disk_stops_the_run_and_what_was_there_stays(bed, tmp_path):
    found = seen(bed, tmp_path, here=lambda: rig_faults._full_disk(6))
    assert (found.how, found.wrong) == ("stopped, by reply", ())
    assert "No space left" in found.message


@pytest.mark.slow
def test_a_clock_that_is_set_back_harms_nothing(bed, tmp_path):
    found = seen(bed, tmp_path, here=lambda: rig_faults._clock_back(5))
    assert (found.how, found.wrong) == ("harmless, same images", ())


ENDS = {
    "camera: no frame comes, permanently": "stopped, by reply",
    "camera: a frame has the number of the one before": "taken again, same images",
    "camera: a frame has a lower number than the one before": "taken again, same images",
    "camera: exposure halves by itself": "stopped, by reply",
    "camera: another pixel format, as after a power cycle": "stopped, by reply",
    "lamp stays dark": "stopped, by image",
    "lamp stays on": "stopped, by image",
    "lamp gives 80 % of its light": "not noticed",
    "plugs of two lamps swapped": "stopped, by image",
    "stage tilted by 1° more than it says, from its second move on": "not noticed",
    "stage tilted by 1° more than it says, from its second move on, with --check-repeatability": "with a warning",
    "stage turned by 1° more than it says, from its second move on, with --check-repeatability": "with a warning",
}
"""Faults that the tests above do not have, and how docs/validation/reliability.md says that they end."""


@pytest.mark.slow
@pytest.mark.parametrize("kind", ENDS)
def test_every_kind_of_fault_ends_as_it_must(bed, tmp_path, kind):
    rig, part, truth = bed
    case = next(case for case in rig_cases(1) if case.kind == kind)
    found = undergo(case, rig, part, tmp_path / "set", truth)
    assert (found.how, found.wrong) == (ENDS[kind], ()), found


@pytest.mark.slow
def test_what_the_commands_capture_and_fit_holds_the_truth(bed, tmp_path, capsys):
    rig, part, _ = bed
    out = tmp_path / "set"
    assert run(["capture", str(rig), str(part), "-o", str(out), "--exposure", "1,1/16", "--dark"]) == 0
    text = part.read_text(encoding="utf-8")
    truth = load_part(part).reflectance
    guess = part.with_name("guess.yaml")
    old, new = "R_d: 45.0, R_s: 12500, sigma_rad: 0.0475", "R_d: 30, R_s: 4000, sigma_rad: 0.06"
    assert old in text
    guess.write_text(text.replace(old, new), encoding="utf-8", newline="\n")
    fitted = tmp_path / "fit"
    options = ["-o", str(fitted), "--joint", "--no-validate", "--pixels", "5000"]
    assert run(["fit-specular", str(rig), str(guess), str(out), *options]) == 0
    found = json.loads((fitted / "fit.json").read_text(encoding="utf-8"))
    assert set(found["fitted"]) == {"R_d", "R_s", "sigma_rad"}
    for name in found["fitted"]:
        low, high = found["values"][name]["interval_95"]
        assert low <= getattr(truth, name) <= high, name


def test_an_image_that_is_another_is_not_there(bed, tmp_path):
    truth = bed[2]
    copy = tmp_path / "copy"
    shutil.copytree(truth, copy)
    assert alike(copy, truth) == 8
    images = read_image_set(copy)
    first, second = (images.path(images.images[i].png or "") for i in (0, 1))
    manifest = copy / "manifest.json"
    sums = [hashlib.sha256(path.read_bytes()).hexdigest() for path in (second, first)]
    manifest.write_text(manifest.read_text("utf-8").replace(*sums), encoding="utf-8", newline="\n")
    shutil.copyfile(first, second)  # of the right shape, and listed so
    assert alike(copy, truth) == 7


@pytest.mark.slow
def test_a_long_run_with_random_faults_loses_nothing(tmp_path):
    needs("aravis")
    found = soak(tmp_path, postures=6, rate=0.03, seed=1)
    assert found.there == found.requested == 24
    assert found.struck > 0
    assert found.retries > 0
    assert found.ended_bytes - found.begun_bytes < 200 << 20


@pytest.mark.slow
def test_a_freely_running_camera_takes_the_same_light(bed, tmp_path):
    """Frames that began before a change are thrown away, so that every image is lit by its light."""
    rig, part, truth = bed
    free = rig.with_name("free.yaml")
    text = rig.read_text(encoding="utf-8")
    free.write_text(
        text.replace("port: virtual}\n  timing", "port: virtual, trigger: none}\n  timing"),
        encoding="utf-8",
        newline="\n",
    )
    assert load_rig(free).hardware.camera.trigger == "none"
    done = capture(load_rig(free), load_part(part), tmp_path / "set", options=OPTIONS)
    assert done.images == 8
    found = read_image_set(tmp_path / "set")
    assert all(entry.extra["capture"]["lit"]["resemblance"] > 0.9 for entry in found.images)
    assert differences(tmp_path / "set", truth)  # the noise is another: frames were thrown away
