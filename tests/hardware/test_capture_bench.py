"""A capture on the virtual bench, through real drivers on real wires: faults, cables, signals, replay."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from fault_cases import Case, line_cases, make_rig, other_cases, pulled_cases
from fault_runs import OPTIONS, differences, suffer, undisturbed
from faulty_bench import set_fault, unplug

from lightopt.config import load_part, load_rig
from lightopt.core.errors import HardwareError, InputError
from lightopt.core.transforms import Posture
from lightopt.images import read_image_set, read_png
from lightopt.rig.capture import CaptureOptions, CapturePlan, capture, connect_devices, make_plan, wiring_of
from lightopt.rig.capture._wiring import start_bench
from lightopt.rig.simulated import BenchProcess, BenchTruth

posix = pytest.mark.skipif(sys.platform == "win32", reason="signals and pseudo-terminals are those of POSIX")


@pytest.fixture(scope="module")
def bed(tmp_path_factory):
    """The small rig with each stage, what an undisturbed run leaves, and how many messages and steps it has."""
    folder = tmp_path_factory.mktemp("bed")
    rigs = {stage: make_rig(folder / stage, stage) for stage in ("shot", "grbl")}
    counts = Counts(lambda stage: undisturbed(*rigs[stage], folder / f"truth-{stage}"))
    assert counts["shot"]  # the one that all tests need
    return folder, rigs, counts


class Counts(dict):
    """What an undisturbed run counts by the stage's driver, run when it is first asked for."""

    def __init__(self, run):
        self._run = run

    def __missing__(self, stage):
        self[stage] = self._run(stage)
        return self[stage]


@pytest.fixture
def patient(monkeypatch):
    """However slow the disk, lights wait for it, so that messages have the same number in every run."""
    monkeypatch.setattr(CapturePlan, "relighting_s", 60.0)


def every(cases, count):
    """About so many cases, evenly over all."""
    cases = list(cases)
    return cases[:: max(1, len(cases) // count)]


def check(bed, tmp_path, cases):
    folder, rigs, _ = bed
    wrong = []
    for number, case in enumerate(cases):
        assert bed[2][case.stage]  # the undisturbed run is there
        outcome = suffer(case, *rigs[case.stage], tmp_path / str(number), folder / f"truth-{case.stage}")
        if outcome.wrong:
            wrong.append((case, outcome))
    assert not wrong


def test_an_undisturbed_run_has_no_retries(bed):
    _, _, counts = bed
    devices, steps = counts["shot"]
    assert set(devices) == {"lights", "stage"}
    assert steps > 30


@pytest.mark.slow
@pytest.mark.parametrize("cases", [2, pytest.param(80, marks=pytest.mark.nightly)])
def test_spoilt_replies_are_requested_again_or_end_safely(bed, tmp_path, cases):
    check(bed, tmp_path, every(line_cases(bed[2]["shot"][0]), cases))


@pytest.mark.slow
@pytest.mark.parametrize("cases", [2, pytest.param(60, marks=pytest.mark.nightly)])
def test_a_pulled_cable_ends_safely_all_along_the_plan(bed, tmp_path, cases):
    check(bed, tmp_path, every(pulled_cases(*bed[2]["shot"]), cases))


@pytest.mark.slow
@pytest.mark.parametrize("cases", [2, pytest.param(40, marks=pytest.mark.nightly)])
def test_what_does_not_obey_ends_safely(bed, tmp_path, cases):
    check(bed, tmp_path, every(other_cases(), cases))


def test_one_lost_reply_is_one_retry_and_the_manifest_says_at_which_image(bed, tmp_path, patient):
    folder, rigs, _ = bed
    case = Case("reply dropped", "lights", "drop", {"after": 9})
    outcome = suffer(case, *rigs["shot"], tmp_path / "out", folder / "truth-shot")
    assert (outcome.finished, outcome.retries, outcome.wrong) == (True, 1, ())
    counts = [entry.extra["capture"]["retries"] for entry in read_image_set(tmp_path / "out").images]
    assert counts == [0, 0, 1, 0, 0, 0, 0, 0]  # it was lit for the third


def test_the_campaign_would_notice_a_light_left_on(bed, tmp_path, monkeypatch, patient):
    """The judge of the campaign judged: where nothing is switched off after an error, it must complain."""
    from lightopt.rig.capture import Devices

    folder, rigs, _ = bed
    monkeypatch.setattr(Devices, "all_off", lambda self: [])
    # from the message on that takes the intensity of the second light back
    case = Case("NG 03, value", "lights", "ng", {"code": 3, "after": 9, "count": None})
    outcome = suffer(case, *rigs["shot"], tmp_path / "out", folder / "truth-shot")
    assert outcome.wrong == ("a light is on and not reported",)


# --- the truth behind the devices


def take(bed, folder, truth=None, **options):
    rig, part = (load(path) for load, path in zip((load_rig, load_part), bed[1]["shot"], strict=True))
    return capture(
        rig,
        part,
        folder,
        options=CaptureOptions(**options),
        connect=lambda plan: connect_devices(rig, plan.wiring, part=part, plan=plan, truth=truth),
    )


def test_a_part_that_lies_elsewhere_is_seen_there(bed, tmp_path):
    take(bed, tmp_path / "shifted", truth=BenchTruth(part_offset_mm=(3.0, 0.0, 0.0)))
    shifted, straight = (read_image_set(path) for path in (tmp_path / "shifted", bed[0] / "truth-shot"))
    a, b = (read_png(s.path(s.images[0].png)).astype(float) for s in (shifted, straight))
    columns = np.arange(160)
    moved = (a.sum(0) @ columns) / a.sum() - (b.sum(0) @ columns) / b.sum()
    assert moved == pytest.approx(3.0 / 0.44, abs=1.5)  # 0.44 mm a pixel


def test_gains_of_the_bench_show_in_the_brightness_that_is_noted(bed, tmp_path):
    take(bed, tmp_path / "out", truth=BenchTruth(gains={"light3": 0.5}))
    lit = {e.light: e.extra["capture"]["lit"]["brightness"] for e in read_image_set(tmp_path / "out").images}
    assert lit["light1"] == pytest.approx(1.0, abs=0.05)
    assert lit["light3"] < 0.75  # the highlight is saturated either way


def test_a_folder_is_replayed_as_it_was_captured(bed, tmp_path):
    folder, rigs, _ = bed
    text = rigs["shot"][0].read_text(encoding="utf-8")
    replay = rigs["shot"][0].with_name("replay.yaml")
    camera = f"camera: {{driver: folder, folder: {(folder / 'truth-shot').as_posix()}}}"
    replay.write_text(text.replace("camera: {driver: virtual}", camera), encoding="utf-8", newline="\n")
    rig, part = load_rig(replay), load_part(rigs["shot"][1])
    capture(rig, part, tmp_path / "again", options=OPTIONS)
    assert differences(tmp_path / "again", folder / "truth-shot") == []
    plan = make_plan(rig, part, CaptureOptions(exposures=(0.5,)))
    with pytest.raises(InputError, match=r"no PNG of light1 .* at exposure 0.5 to replay"):
        connect_devices(rig, plan.wiring, plan=plan)


# --- a process of its own, whose lights are looked at from outside

ENDING = ("SIGINT", "SIGTERM", "SIGHUP")


@pytest.fixture
def light_ms():
    """Long enough for a second command to start, on however busy a machine, while the first has its first light on."""
    return 60_000


@pytest.fixture
def outside(bed, light_ms):
    """A bench that outlives the command, and a rig whose ports are its wires."""
    folder, rigs, _ = bed
    rig, part = rigs["shot"]
    loaded = load_rig(rig)
    with start_bench(loaded, wiring_of(loaded)) as bench:
        text = rig.read_text(encoding="utf-8")
        text = text.replace("driver: ccs, port: virtual", f"driver: ccs, port: {bench.ports['lights']}")
        text = text.replace("port: virtual", f"port: {bench.ports['stage']}")
        camera = f"camera: {{driver: folder, folder: {(folder / 'truth-shot').as_posix()}}}"
        text = text.replace("camera: {driver: virtual}", camera).replace("light_ms: 5", f"light_ms: {light_ms}")
        real = rig.with_name("real.yaml")
        real.write_text(text, encoding="utf-8", newline="\n")
        yield bench, real, part


def start(rig, part, out, *options):
    command = [sys.executable, "-m", "lightopt", "capture", rig, part, "-o", out, "--home", *options]
    # a signal that the tests ignore (SIGHUP under nohup) would be ignored by the command, too
    numbers = [getattr(signal, name) for name in ENDING if hasattr(signal, name)]
    before = [signal.signal(number, signal.default_int_handler) for number in numbers]
    try:
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def until_lit(bench: BenchProcess, process):
    end = time.monotonic() + 600
    while not any(bench.levels("lights").values()):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.slow
@posix
@pytest.mark.parametrize("name", ENDING)
def test_lights_go_off_when_the_command_is_ended(outside, tmp_path, name):
    bench, rig, part = outside
    process = start(rig, part, tmp_path / "out")
    until_lit(bench, process)
    process.send_signal(getattr(signal, name))
    _, errors = process.communicate(timeout=600)
    assert process.returncode == 130
    # a busy machine may make a reply late, which is told
    first, last = (line for line in errors.splitlines() if not line.startswith("warning: "))
    assert re.fullmatch(r"all lights are off; \d of 4 images are on disk; continue with --resume.*", first)
    assert last == "interrupted; files that were finished are complete"
    assert not any(bench.levels("lights").values())
    read_image_set(tmp_path / "out")


@pytest.mark.slow
@posix
@pytest.mark.parametrize("light_ms", [3000])
def test_lights_left_on_by_a_killed_command_are_off_before_the_next_moves(outside, tmp_path):
    bench, rig, part = outside
    process = start(rig, part, tmp_path / "out")
    until_lit(bench, process)
    process.kill()
    process.communicate()
    assert any(bench.levels("lights").values())  # nothing helps against kill -9 but the next command
    process = start(rig, part, tmp_path / "out", "--resume")
    _, errors = process.communicate(timeout=600)
    assert process.returncode == 0, errors
    assert not any(bench.levels("lights").values())


@pytest.mark.slow
@posix
@pytest.mark.parametrize("light_ms", [1000])
def test_a_cable_pulled_is_exit_3_and_says_in_which_step(outside, tmp_path):
    bench, rig, part = outside
    process = start(rig, part, tmp_path / "out")
    until_lit(bench, process)
    unplug(bench, "lights")
    _, errors = process.communicate(timeout=600)
    assert process.returncode == 3
    warnings = [line for line in errors.splitlines() if line.startswith("warning: ")]
    assert "device lost" in warnings[-1]  # told as it happens
    assert errors.splitlines()[len(warnings)].startswith("error: while ")
    assert "may still be lit" in errors
    assert "Traceback" not in errors


@pytest.mark.slow
@posix
def test_a_port_in_use_is_exit_3_and_nothing_moves(outside, tmp_path):
    bench, rig, part = outside
    process = start(rig, part, tmp_path / "out")
    until_lit(bench, process)
    second = start(rig, part, tmp_path / "second")
    _, errors = second.communicate(timeout=600)
    assert second.returncode == 3, errors
    assert "in use by another program" in errors
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=600)
    assert not any(bench.levels("lights").values())


@pytest.mark.slow
@posix
def test_the_serial_log_has_every_byte_up_to_a_kill(outside, tmp_path):
    bench, rig, part = outside
    log = tmp_path / "bytes.log"
    process = start(rig, part, tmp_path / "out", "--serial-log", log)
    until_lit(bench, process)
    process.kill()
    process.communicate()
    lines = log.read_text(encoding="utf-8").splitlines()
    assert any("@00F200" in line and " out " in line for line in lines)
    assert all(line[:4] == str(time.gmtime().tm_year) for line in lines)


@pytest.mark.slow
def test_no_bench_outlives_the_command(bed, tmp_path):
    rig, part = bed[1]["shot"]
    process = start(rig, part, tmp_path / "out")
    deadline = time.monotonic() + 600
    while not (tmp_path / "out" / "manifest.json").exists():
        assert time.monotonic() < deadline
        time.sleep(0.01)
    time.sleep(0.3)
    process.kill()
    process.communicate()
    if sys.platform == "linux":
        end = time.monotonic() + 120
        while _children_of_the_dead(str(rig)):
            assert time.monotonic() < end, "the bench's process still runs"
            time.sleep(0.1)


def _children_of_the_dead(mark):
    found = []
    for entry in Path("/proc").iterdir():
        try:
            text = (entry / "cmdline").read_bytes() if entry.name.isdigit() else b""
        except OSError:
            continue
        if b"lightopt.rig.simulated" in text and mark.encode() in text:
            found.append(entry.name)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("stage", ["shot", "grbl", "gsc", "zaber"])
def test_a_stage_switched_off_and_on_away_from_its_origin_is_noticed_before_its_images_count(tmp_path, stage):
    rig_file, part_file = make_rig(tmp_path, stage)
    rig, part = load_rig(rig_file), load_part(part_file)
    options = CaptureOptions(exposures=(1.0,), postures=(Posture(-10.0, 170.0),), lights=("light1",))

    def connect(plan):
        bench = start_bench(rig, plan.wiring, part=part)
        devices = connect_devices(rig, plan.wiring, part=part, plan=plan, bench=bench)
        light_off = devices.light_off

        def light_off_and_power_cycle(name):
            light_off(name)
            set_fault(bench, "stage", "power_cycle")

        devices.light_off = light_off_and_power_cycle
        devices._closing = (bench.close,)
        return devices

    with pytest.raises(HardwareError) as raised:
        capture(rig, part, tmp_path / "set", options=options, connect=connect)
    said = str(raised.value)
    assert "while checking that the stage has not moved" in said
    assert "those captured in this run were not kept" in said
    assert "all lights are off" in said
    assert not read_image_set(tmp_path / "set").images
    assert capture(rig, part, tmp_path / "set", options=options, resume=True).taken == 1


def test_a_bench_that_follows_a_true_rig_of_its_own(bed, tmp_path):
    path, part = (Path(file) for file in bed[1]["shot"])
    text = path.read_text(encoding="utf-8")
    assert text.count("azimuth_deg: 45") == 1
    true = tmp_path / "true.yaml"
    true.write_text(text.replace("azimuth_deg: 45", "azimuth_deg: 75"), encoding="utf-8")
    filed = tmp_path / "filed.yaml"
    filed.write_text(text + "\nvirtual_bench: {rig: true.yaml, part_offset_mm: [3, 0, 0], seed: 5}\n", encoding="utf-8")
    loaded, options = load_part(part), CaptureOptions(check=False)
    capture(load_rig(filed), loaded, tmp_path / "seen", options=options)
    truth = BenchTruth(part_offset_mm=(3.0, 0.0, 0.0), seed=5)
    rig = load_rig(true)

    def connect(plan):
        return connect_devices(rig, plan.wiring, part=loaded, plan=plan, truth=truth)

    capture(rig, loaded, tmp_path / "expected", options=options, connect=connect)
    seen, expected = (read_image_set(tmp_path / name).images for name in ("seen", "expected"))
    assert seen[0].light_azimuth_deg == 45.0  # as the file has it
    for one, other in zip(seen, expected, strict=True):
        assert (read_png(tmp_path / "seen" / one.png) == read_png(tmp_path / "expected" / other.png)).all()


def test_a_true_rig_with_other_lights_is_refused(bed, tmp_path):
    path, part = (Path(file) for file in bed[1]["shot"])
    text = path.read_text(encoding="utf-8")
    (tmp_path / "true.yaml").write_text(text.replace("light1", "lamp1"), encoding="utf-8")
    filed = tmp_path / "filed.yaml"
    filed.write_text(text + "\nvirtual_bench: {rig: true.yaml}\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"filed.yaml:\d+: virtual_bench.rig: .* has other lights"):
        capture(load_rig(filed), load_part(part), tmp_path / "seen", options=CaptureOptions(check=False))
