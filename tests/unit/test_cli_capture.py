"""``lightopt capture`` and ``lightopt bench``: what they refuse before anything is opened, and what they say."""

from __future__ import annotations

import sys

import pytest

from lightopt.images import read_png

HARDWARE = """\
hardware:
  controllers:
    main: {driver: ccs, port: virtual, channels: 4}
  lights:
    light1: {controller: main, channel: 1, level: 200, max_level: 220, max_on_s: 5}
    light3: {controller: main, channel: 3, level: 150}
  stage:
    driver: shot
    port: virtual
    elevation: {axis: "1", steps_per_deg: 100, speed_deg_per_s: 500}
    rotation: {axis: "2", steps_per_deg: 100, speed_deg_per_s: 500}
  camera: {driver: virtual}
  timing: {light_ms: 5, stage_ms: 5}
"""


@pytest.fixture
def wired(bench):
    """The small rig with devices."""
    text = bench.rig.read_text(encoding="utf-8")
    bench.rig.write_text(text + HARDWARE, encoding="utf-8", newline="\n")
    bench.edit("rig.yaml", "  pixel_size_um: 44\n", "  pixel_size_um: 44\n  exposure_us: 8000\n")
    return bench


@pytest.fixture
def sealed(monkeypatch):
    """No port, no process and no bench may be opened."""
    import serial

    from lightopt.rig.simulated import BenchProcess

    def refuse(*arguments, **options):
        raise AssertionError("something was opened")

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    monkeypatch.setattr(BenchProcess, "__init__", refuse)


BAD = [
    ("driver: ccs", "driver: cs", [], 'makers, found "cs"'),
    ("port: virtual, channels", "port: /dev/nowhere, channels", [], "no port /dev/nowhere on this computer; there"),
    ("    light3: {controller: main, channel: 3, level: 150}\n", "", [], "light3"),
    ("channel: 3", "channel: 1", [], "channel"),
    ("level: 200, max_level: 220", "level: 230, max_level: 220", [], "220"),
    ("", "", ["--posture", "0,400"], "rotation 400° is outside the stage's range 0° to 360°"),
    ("", "", ["--posture", "50,0"], "elevation 50° is outside the stage's range -45° to 45°"),
    ("", "", ["--light", "lamp"], 'no light "lamp"'),
    ("", "", ["--exposure", "1,zero"], '--exposure: expected a number .* found "zero"'),
    ("", "", ["--exposure", "1/100000"], r"exposure 1e-05 is 0.08 µs .* outside the camera's 10 to 1e\+07 µs"),
    ("", "", ["--exposure", "1,1"], "--exposure: the same one was given twice"),
    ("", "", ["--exposure", "700"], "light1: would be on for .* longer than max_on_s 5"),
    ("", "", ["--average", "0"], "--average: expected"),
    ("", "", ["--average", "1001"], "--average: expected 1 to 1000 frames, found 1001"),
    ("camera: {driver: virtual}", "camera: {driver: folder, folder: nowhere}", [], "nowhere"),
]


@pytest.mark.parametrize(("old", "new", "options", "says"), BAD)
def test_bad_input_is_exit_2_before_anything_is_opened(cli, wired, sealed, old, new, options, says):
    import re

    if old:
        wired.edit("rig.yaml", old, new)
    ran = cli("capture", wired.rig, wired.part, "-o", wired.out, *options)
    assert ran.status == 2
    assert ran.out == ""
    assert all(line.startswith(("error: ", "see: ")) for line in ran.err.splitlines())
    assert re.search(says, ran.err)


def test_a_dry_run_prints_every_step_and_opens_nothing(cli, wired, sealed):
    ran = cli("capture", wired.rig, wired.part, "--dry-run", "--exposure", "1,1/4", "--dark")
    assert (ran.status, ran.err) == (0, "")
    lines = ran.out.splitlines()
    assert lines[0].split() == ["at", "[s]", "takes", "[s]", "step"]
    assert sum("expose light" in line for line in lines) == 8
    assert sum("expose dark" in line for line in lines) == 6
    assert lines[-1].startswith("8 images in ")
    assert lines[-1].endswith("no device was opened or moved")
    assert not wired.out.exists()


def test_a_folder_is_needed(cli, wired, sealed):
    ran = cli("capture", wired.rig, wired.part)
    assert (ran.status, ran.out) == (2, "")
    assert ran.err.startswith("error: --out: expected a folder")


@pytest.mark.slow
def test_capture_says_where_the_set_is_and_takes_nothing_twice(cli, wired):
    first = cli("capture", wired.rig, wired.part, "-o", wired.out, "--serial-log", wired.folder / "bytes.log")
    assert (first.status, first.err) == (0, "")
    assert first.out.splitlines()[-1] == str(wired.out / "manifest.json")
    assert "@00F200" in (wired.folder / "bytes.log").read_text(encoding="utf-8")
    again = cli("capture", wired.rig, wired.part, "-o", wired.out)
    assert again.status == 2
    assert "use --resume" in again.err
    resumed = cli("capture", wired.rig, wired.part, "-o", wired.out, "--resume")
    assert "4 images (4 of them existed already)" in resumed.out
    render = cli("render", wired.rig, wired.part, "-o", wired.out, "--force", "--patches", "500")
    assert render.status == 2
    assert "captured images, which simulated ones never replace" in render.err


def test_a_capture_without_devices_says_that_it_was_the_virtual_bench(cli, bench):
    ran = cli("capture", bench.rig, bench.part, "-o", bench.out, "--posture", "0,0", "--light", "light1")
    assert (ran.status, ran.err) == (0, "")
    assert "VIRTUAL BENCH" in ran.out.splitlines()[-1]


def test_a_dry_run_says_that_the_folder_holds_another_capture(cli, wired, sealed, snapshot):
    from lightopt.images import read_manifest

    whole = ("capture", wired.rig, wired.part, "--dry-run", "-o", wired.out)
    assert cli(*whole).status == 0
    (wired.folder / "plain.txt").write_text("mine")
    file = cli(*whole[:-1], wired.folder / "plain.txt")
    assert file.status == 2
    assert "expected a folder for the results, found a file" in file.err
    assert "found a file" in cli("capture", wired.rig, wired.part, "-o", wired.folder / "plain.txt").err
    cli("render", wired.rig, wired.part, "-o", wired.out, "--patches", "500", "--posture", "0,0")
    before = snapshot(wired.out)
    assert read_manifest(wired.out / "manifest.json").images
    ran = cli(*whole)
    assert ran.status == 2
    assert "holds an image set; use --resume" in ran.err
    assert "holds the image set of another run (kind: previously" in cli(*whole, "--resume").err
    assert cli(*whole, "--force").status == 0
    assert snapshot(wired.out) == before


def test_what_is_taken_of_a_light_is_counted_in_words_that_agree(cli, wired, sealed):
    ran = cli("capture", wired.rig, wired.part, "--dry-run", "--exposure", "700")
    assert "(settling and 1 exposure of 1 frame)" in ran.err


@pytest.mark.slow
def test_the_contact_sheets_of_a_capture(cli, wired):
    ran = cli("capture", wired.rig, wired.part, "-o", wired.out, "--exposure", "1,1/16", "--sheet", "--posture", "0,0")
    assert (ran.status, ran.err) == (0, "")
    sheets = [line.partition(": ") for line in ran.out.splitlines()[-2:]]
    assert [words for words, _, _ in sheets] == ["contact sheet, exposure 1", "contact sheet, exposure 0.0625"]
    whole, dim = (read_png(path, colour=True) for _, _, path in sheets)
    assert whole.shape == dim.shape
    assert whole.mean() > dim.mean() + 1.0  # a sixteenth of the light


@pytest.mark.slow
@pytest.mark.parametrize("quiet", [(), ("--quiet",)])
def test_what_is_out_of_the_ordinary_on_the_wires_is_said(cli, wired, quiet):
    options = ("--posture", "0,10.005", "--light", "light1", *quiet)
    ran = cli("capture", wired.rig, wired.part, "-o", wired.out, *options)
    assert ran.status == 0
    (said,) = ran.err.splitlines()
    assert said.startswith("warning: ")
    assert "rotation: 10.005° lies between two steps, goes to 10" in said
    moved = cli("bench", "move", wired.rig, "--rotation", "10.005")
    assert "warning: " in moved.err
    assert "stage (shot): rotation: 10.005° lies between two steps" in moved.err


def test_an_interrupted_capture_says_how_to_go_on(cli, wired, monkeypatch):
    import lightopt.rig.capture
    from lightopt.core.errors import Interrupted

    def stop(*arguments, **options):
        raise Interrupted("all lights are off; 1 of 4 images are on disk; continue with --resume")

    monkeypatch.setattr(lightopt.rig.capture, "capture", stop)
    ran = cli("capture", wired.rig, wired.part, "-o", wired.out)
    assert (ran.status, ran.out) == (130, "")
    said = [line for line in ran.err.splitlines() if line]
    assert said[0] == "all lights are off; 1 of 4 images are on disk; continue with --resume"
    assert said[1].startswith("interrupted")


# --- bench


def test_status_asks_every_device(cli, wired):
    ran = cli("bench", "status", wired.rig)
    assert (ran.status, ran.err) == (0, "")
    names = [" ".join(line.split()[:2]) for line in ran.out.splitlines()[1:]]
    assert names[:3] == ["controller main", "light light1", "light light3"]
    assert names[3].startswith("stage")


def test_a_light_burns_for_the_time_given(cli, wired):
    ran = cli("bench", "light", wired.rig, "light1", "100", "--seconds", "0.05")
    assert (ran.status, ran.err) == (0, "")
    assert ran.out.splitlines() == [
        "light1 is on at level 100 for 0.05 s",
        "light1 is off; the controller held level 100",
    ]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("light", "RIG", "light1", "221", "--seconds", "1"), "expected a level from 1 to 220"),
        (("light", "RIG", "lamp", "--seconds", "1"), 'no light "lamp"'),
        (("light", "RIG", "light1"), "standard input is not a terminal"),
        (("move", "RIG"), "expected --elevation, --rotation or both"),
        (("move", "RIG", "--rotation", "400"), "rotation 400° is outside the stage's range"),
        (("snap", "RIG", "frame.png"), "--part: required with the virtual camera"),
        (("light", "RIG", "light1", "--seconds", "6"), "light1 would be on for 6 s, longer than its max_on_s of 5 s ("),
        (
            ("snap", "RIG", "frame.png", "--part", "PART", "--light", "light1", "--exposure", "700"),
            "longer than its max_on_s of 5 s (",
        ),
    ],
)
def test_bench_refuses_before_anything_is_opened(cli, wired, sealed, arguments, says):
    files = {"RIG": wired.rig, "PART": wired.part}
    ran = cli("bench", *(files.get(argument, argument) for argument in arguments))
    assert (ran.status, ran.out) == (2, "")
    assert says in ran.err


def test_home_move_and_off(cli, wired):
    assert cli("bench", "home", wired.rig).out == "the stage is at (0°, 0°)\n"
    assert cli("bench", "move", wired.rig, "--rotation", "82").out == "the stage is at (0°, 82°)\n"
    assert cli("bench", "off", wired.rig).out == "all lights of small are off (main)\n"


def test_snap_takes_a_frame(cli, wired):
    path = wired.folder / "frame.png"
    ran = cli("bench", "snap", wired.rig, path, "--light", "light3", "--part", wired.part)
    assert (ran.status, ran.err) == (0, "")
    frame = read_png(path)
    assert frame.shape == (120, 160)
    assert ran.out.startswith(f"levels {frame.min()} to {frame.max()}, mean ")


def test_devices_lists_ports_without_opening_one(cli, wired, sealed):
    ran = cli("bench", "devices", wired.rig)
    assert (ran.status, ran.err) == (0, "")
    assert "controller main  ccs" in ran.out
    assert "NO" not in ran.out


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("port: virtual, channels", "port: /dev/nowhere, channels", "no port /dev/nowhere on this computer"),
        ("port: virtual, channels", "port: PLAIN, channels", "is not a serial port, but a file"),
        ("camera: {driver: virtual}", "camera: {driver: folder, folder: nowhere}", "nowhere"),
        ('"1", steps_per_deg: 100,', '"1", steps_per_deg: 10000,', "the controller takes 1 to 500000"),
    ],
)
def test_a_dry_run_sees_devices_that_cannot_be(cli, wired, sealed, old, new, says):
    wired.edit("rig.yaml", old, new.replace("PLAIN", str(wired.part)))
    ran = cli("capture", wired.rig, wired.part, "--dry-run")
    assert ran.status == 2
    assert "no device was opened or moved" in ran.out  # the plan is shown all the same
    assert says in ran.err
    whole = cli("capture", wired.rig, wired.part, "-o", wired.out)
    assert (whole.status, whole.out) == (2, "")
    assert says in whole.err


def test_devices_marks_ports_that_are_not_there(cli, wired, sealed):
    wired.edit("rig.yaml", "port: virtual, channels", "port: /dev/nowhere, channels")
    ran = cli("bench", "devices", wired.rig)
    assert ran.status == 0
    assert "NO: no port /dev/nowhere on this computer" in ran.out


def test_an_exposure_that_no_camera_has_is_reported_before_how_long_a_light_would_burn(cli, wired, sealed):
    ran = cli(
        "bench",
        "snap",
        wired.rig,
        wired.folder / "f.png",
        "--light",
        "light1",
        "--exposure",
        "2000",
        "--part",
        wired.part,
    )
    assert ran.status == 2
    assert "exposure 2000 is 1.6e+07 µs" in ran.err
    assert "max_on_s" not in ran.err


@pytest.mark.skipif(sys.platform == "win32", reason="the port is one of POSIX")
def test_a_port_that_is_there_was_not_opened(cli, wired, sealed):
    wired.edit("rig.yaml", "{driver: ccs, port: virtual,", "{driver: ccs, port: /dev/tty,")
    assert "present, not opened" in cli("bench", "devices", wired.rig).out
