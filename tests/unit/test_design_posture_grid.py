"""Postures to choose from: a grid over the stage's range, less those that are of no use."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from lightopt.config import load_part, load_rig
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.design._problem import posture_grid, usable_postures
from lightopt.scene import build_scene, frame_part, view_from_part

STAGE = "stage: {elevation_range_deg: [-45, 45], rotation_range_deg: [0, 360]}"
HARDWARE = """\
hardware:
  controllers:
    main: {driver: ccs, port: virtual, channels: 4}
  lights:
    light1: {controller: main, channel: 1, level: 200}
    light3: {controller: main, channel: 3, level: 150}
  stage:
    driver: shot
    port: virtual
    rotation: {axis: "2", steps_per_deg: 200}
  camera: {driver: virtual}
"""


def grid(bench, step=22.5):
    return posture_grid(load_rig(bench.rig), load_part(bench.part), step_deg=step)


def test_multiples_of_the_step_and_both_ends_of_the_tilt(bench):
    found = grid(bench, 20.0)
    assert found[:2] == (Posture(0.0, 0.0), Posture(-10.0, 170.0))  # the part's own first
    own = {Posture(-10.0, 170.0)}
    assert sorted({p.elevation_deg for p in set(found) - own}) == [-45, -40, -20, 0, 20, 40, 45]
    assert sorted({p.rotation_deg for p in set(found) - own}) == [20.0 * k for k in range(18)]
    assert len(found) == len(set(found)) == 7 * 18 + 1


def test_default_step_gives_eighty_of_the_sample_rig(bench):
    assert len(set(grid(bench)) - {Posture(-10.0, 170.0)}) == 80


@pytest.mark.parametrize(
    ("stage", "tilts", "turns"),
    [
        ("stage: {elevation_range_deg: [0, 0], rotation_range_deg: [-360, 360]}", [0], [0, 90, 180, 270]),
        ("stage: {elevation_range_deg: [0, 0], rotation_range_deg: [-180, 180]}", [0], [-180, -90, 0, 90]),
        ("stage: {elevation_range_deg: [-30, 100], rotation_range_deg: [10, 100]}", [-30, 0, 90, 100], [10, 90, 100]),
    ],
)
def test_a_full_turn_is_taken_once(bench, stage, tilts, turns):
    bench.edit("rig.yaml", STAGE, stage)
    own = {Posture(0.0, 0.0), Posture(-10.0, 170.0)}
    found = [p for p in grid(bench, 90.0) if p not in own or p == Posture(0.0, 0.0)]
    assert sorted({p.elevation_deg for p in found}) == tilts
    assert sorted({p.rotation_deg for p in found} - {170.0}) == sorted(
        {*turns, *([0] if Posture(0.0, 0.0) in found else [])}
    )


def test_an_axis_that_the_stage_lacks_stays_at_zero(bench):
    with bench.rig.open("a", encoding="utf-8") as file:
        file.write(HARDWARE)
    found = grid(bench, 90.0)
    assert {p.elevation_deg for p in found} == {0.0}  # nor is the part's tilted posture among them
    assert [p.rotation_deg for p in found] == [0.0, 90.0, 180.0, 270.0]


@pytest.mark.parametrize(("step", "expected"), [(0.0, "found 0"), (-5.0, "found -5"), (0.5, "take a larger step")])
def test_bad_steps_are_refused(bench, step, expected):
    with pytest.raises(InputError, match=expected):
        grid(bench, step)


def usable(bench, postures, **options):
    scene = replace(build_scene(load_rig(bench.rig), load_part(bench.part)), postures=postures)
    return usable_postures(scene, scene.lights, **options)


def test_postures_that_leave_the_view_are_left_out_with_the_reason(bench):
    bench.edit("rig.yaml", "stage: {", "stage: {pivot_mm: [0, 0, -100], ")
    bench.edit("part.yaml", ", {elevation_deg: -10, rotation_deg: 170}", "")
    postures = (Posture(0.0, 0.0), Posture(-45.0, 0.0), Posture(0.0, 90.0), Posture(45.0, 0.0))
    kept, left_out = usable(bench, postures)
    assert kept == (Posture(0.0, 0.0), Posture(0.0, 90.0))
    assert [(out.posture.elevation_deg, out.kind) for out in left_out] == [(-45.0, "view"), (45.0, "view")]
    assert "px at the top" in left_out[0].reason
    assert "px at the bottom" in left_out[1].reason


def test_a_posture_may_leave_the_view_by_as_much_as_is_allowed(bench):
    bench.edit("rig.yaml", "stage: {", "stage: {pivot_mm: [0, 0, -100], ")
    bench.edit("part.yaml", ", {elevation_deg: -10, rotation_deg: 170}", "")
    postures = (Posture(0.0, 0.0), Posture(-45.0, 0.0), Posture(-20.0, 0.0))
    scene = build_scene(load_rig(bench.rig), load_part(bench.part))
    framings = {p: frame_part(view_from_part(scene, p).camera, scene.mesh) for p in postures}
    excess = {p: -min(framing.margins.values()) for p, framing in framings.items()}
    assert excess[postures[0]] <= 0.0 < excess[postures[2]] < excess[postures[1]]
    needed = excess[postures[2]]
    kept, left_out = usable(bench, postures, allow_outside_px=needed)
    assert kept == (postures[0], postures[2])
    kept, left_out = usable(bench, postures, allow_outside_px=needed - 0.01)
    assert kept == postures[:1]
    # what is more than what is allowed does not read as the same
    (reason,) = [out.reason for out in left_out if out.posture == postures[2]]
    leaves, allowed = (float(x) for x in re.findall(r"([\d.]+) px", reason))
    assert leaves >= needed >= leaves - 0.1
    assert allowed <= leaves
    assert "at the top" in reason
    assert usable(bench, postures, allow_outside_px=0.0)[0] == postures[:1]
    # wholly outside is of no use, whatever is allowed
    assert Posture(-90.0, 0.0) not in usable(bench, (*postures, Posture(-90.0, 0.0)), allow_outside_px=1e6)[0]


def test_postures_that_put_a_light_into_the_part_are_left_out(bench):
    bench.edit("rig.yaml", "{name: light1, distance_mm: 330", "{name: light1, distance_mm: 5")
    with pytest.raises(InputError, match=r"no posture of 1 is left.*a position of light1 is inside the part"):
        usable(bench, (Posture(0.0, 0.0),))
