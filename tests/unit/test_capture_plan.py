"""The plan of a capture: its steps, its times, its order, and what it refuses before anything is opened."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from lightopt.config import load_part, load_rig
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.rig.capture import CaptureOptions, make_plan, wiring_of
from lightopt.scene import pace_text, travel_order, travel_s

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
    rotation: {axis: "2", steps_per_deg: 200, speed_deg_per_s: 50}
  camera: {driver: virtual}
  timing: {light_ms: 50, stage_ms: 300}
"""


@pytest.fixture
def wired(bench):
    """The small rig with a hardware section whose stage only turns."""
    text = bench.rig.read_text(encoding="utf-8")
    bench.rig.write_text(text + HARDWARE, encoding="utf-8", newline="\n")
    bench.edit("rig.yaml", "  pixel_size_um: 44\n", "  pixel_size_um: 44\n  exposure_us: 8000\n")
    bench.edit("part.yaml", "{elevation_deg: -10, rotation_deg: 170}", "{elevation_deg: 0, rotation_deg: 170}")
    return bench


def plan_of(bench, **options):
    return make_plan(load_rig(bench.rig), load_part(bench.part), CaptureOptions(**options))


def kinds(plan):
    return [(step.kind, step.light, step.exposure) for step in plan.steps()]


def test_every_light_is_darkened_first_then_the_stage_homes(wired):
    assert kinds(plan_of(wired))[:3] == [
        ("light off", "light1", None),
        ("light off", "light3", None),
        ("home", None, None),
    ]


def test_exposures_of_one_light_follow_one_another_the_longest_first(wired):
    plan = plan_of(wired, exposures=(1 / 16, 1.0))
    first = next(i for i, step in enumerate(plan.steps()) if step.kind == "light on")
    assert kinds(plan)[first : first + 6] == [
        ("light on", "light1", None),
        ("settle", "light1", None),
        ("expose", "light1", 1.0),
        ("expose", "light1", 1 / 16),
        ("light off", "light1", None),
        ("light on", "light3", None),
    ]
    assert plan.exposure_us(1 / 16) == 500.0


def test_frames_without_light_come_before_the_lights_of_a_posture(wired):
    plan = plan_of(wired, exposures=(1.0, 0.5), dark=True)
    exposed = [(light, exposure) for kind, light, exposure in kinds(plan) if kind == "expose"]
    assert exposed[:4] == [(None, 1.0), (None, 0.5), ("light1", 1.0), ("light1", 0.5)]
    assert len(exposed) == 2 * (2 + 2 * 2 + 1)  # at the end of each posture, one that shows that no light burns on
    assert not plan.needs_dark_reference


def test_times_are_those_of_the_rig_file(wired):
    plan = plan_of(wired)
    moves = [step.seconds for step in plan.steps() if step.kind == "move"]
    assert moves == [0.0, pytest.approx(170 / 50)]
    settling = [step.seconds for step in plan.steps() if step.kind == "settle"]
    assert sorted(set(settling)) == [0.05, 0.3]
    assert plan.on_s(plan.lights[0]) == pytest.approx(0.05 + 0.008 + 160 * 120 * 80e-9)


def test_without_a_hardware_section_it_is_the_virtual_bench(bench):
    plan = plan_of(bench)
    assert not plan.wiring.given
    assert plan.wiring.hardware.camera.driver == "virtual"
    assert plan.home
    assert {name: (c.controller, c.channel) for name, c in plan.wiring.hardware.lights.items()} == {
        "light1": ("bench1", 1),
        "light3": ("bench1", 2),
    }


def test_a_real_stage_is_homed_when_requested_only(wired):
    wired.edit("rig.yaml", "driver: shot\n    port: virtual", "driver: shot\n    port: /dev/ttyUSB7")
    assert not plan_of(wired).home
    assert plan_of(wired, home=True).home


# --- what is refused


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (
            {"postures": (Posture(0.0, 400.0),)},
            r"option 'postures': rotation 400° is outside .* 0° to 360° \(.*rig.yaml:\d+",
        ),
        ({"postures": (Posture(5.0, 0.0),)}, "elevation 5°, but the stage has no elevation axis"),
        ({"lights": ("light2",)}, 'no light "light2" in .*; it has light1, light3'),
        ({"exposures": (1e-4,)}, r"exposure 0.0001 is 0.8 µs .* outside the camera's 10 to 1e\+07 µs"),
        ({"exposures": (0.0,)}, "expected numbers above 0, found 0"),
        ({"exposures": (1.0, 1.0)}, "option 'exposures': the same one was given twice"),
        ({"exposures": (700.0,)}, "light1: would be on for 5.65 s without a break .* longer than max_on_s 5"),
        ({"average": 0}, "option 'average': expected 1 to 1000 frames, found 0"),
        ({"average": 600}, "light1: would be on for 5.77 s without a break .* longer than max_on_s 5"),
    ],
)
def test_what_cannot_be_is_refused(wired, options, says):
    with pytest.raises(InputError, match=says):
        plan_of(wired, **options)


def test_a_posture_of_the_part_outside_the_range_is_named_with_its_line(wired):
    wired.edit("part.yaml", "rotation_deg: 170", "rotation_deg: -5")
    with pytest.raises(InputError, match=r"part.yaml:\d+: postures\[1\]: rotation -5° is outside"):
        plan_of(wired)


def test_without_a_stage_one_run_takes_one_posture(wired):
    text = wired.rig.read_text(encoding="utf-8")
    start, end = text.index("  stage:\n    driver"), text.index("  camera: {driver")
    wired.rig.write_text(text[:start] + text[end:], encoding="utf-8", newline="\n")
    with pytest.raises(InputError, match=r"has no stage, so one run captures one posture; .* found 2"):
        plan_of(wired)
    plan = plan_of(wired, postures=(Posture(-20.0, 30.0),))
    assert "move" not in {step.kind for step in plan.steps()}


# --- the order of postures


def seconds(a, b):
    return max(abs(a.elevation_deg - b.elevation_deg) / 10, abs(a.rotation_deg - b.rotation_deg) / 90)


def total(order, start):
    return sum(seconds(a, b) for a, b in itertools.pairwise((start, *order)))


def test_how_fast_the_stage_goes_is_reported_with_who_says_so(bench):
    rig = load_rig(bench.rig)
    assert pace_text(rig) == "at 90°/s of the virtual bench, since the rig has no hardware section"
    there = Posture(45.0, 90.0)
    assert travel_s(None, Posture(0.0, 0.0), there) == 1.0
    hardware = wiring_of(rig).hardware
    assert hardware.stage is not None
    slow = hardware.stage.elevation.model_copy(update={"speed_deg_per_s": 5.0})
    stage = hardware.stage.model_copy(update={"elevation": slow})
    for one, says in (
        (hardware.stage, "at 90°/s, the speed_deg_per_s of the rig's hardware.stage"),
        (stage, "at 5°/s in tilt, 90°/s in rotation, the speed_deg_per_s of the rig's hardware.stage"),
        (None, "the rig's hardware has no stage"),
    ):
        given = rig.model_copy(update={"hardware": hardware.model_copy(update={"stage": one})})
        assert pace_text(given) == says
    assert travel_s(stage, Posture(0.0, 0.0), there) == 9.0


def test_few_postures_are_visited_in_the_quickest_order():
    postures = [Posture(0.0, r) for r in (180.0, 0.0, 278.0, 82.0)]
    order = travel_order(postures, start=Posture(0.0, 0.0), time=seconds)
    assert [p.rotation_deg for p in order] == [0.0, 82.0, 180.0, 278.0]


def test_many_postures_are_visited_in_a_good_order():
    postures = [Posture(e, r) for r in (300.0, 60.0, 180.0, 0.0, 240.0, 120.0) for e in (20.0, -20.0, 0.0)]
    start = Posture(0.0, 0.0)
    order = travel_order(postures, start=start, time=seconds)
    assert sorted(map(str, order)) == sorted(map(str, postures))
    assert total(order, start) < 0.45 * total(postures, start)
    assert order == travel_order(postures, start=start, time=seconds)


def test_a_seed_is_for_a_simulated_camera(tmp_path):
    root = Path(__file__).parents[2] / "configs"
    part = load_part(root / "parts" / "cover-knob.yaml")
    text = (root / "rigs" / "four-panel.yaml").read_text(encoding="utf-8")
    rig = tmp_path / "rig.yaml"
    rig.write_text(text, encoding="utf-8")
    assert make_plan(load_rig(rig), part, CaptureOptions(seed=2)).options.as_dict()["seed"] == 2
    serial = load_rig(root / "rigs" / "four-panel-serial.yaml")
    camera = serial.hardware.camera.model_copy(update={"driver": "aravis"})
    real = serial.model_copy(update={"hardware": serial.hardware.model_copy(update={"camera": camera})})
    with pytest.raises(InputError, match="option 'seed'"):
        make_plan(real, part, CaptureOptions(seed=2))
