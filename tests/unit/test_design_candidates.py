"""Which positions the lights may take, and which are left out."""

from __future__ import annotations

import re
import tracemalloc

import numpy as np
import pytest
import trimesh

from lightopt import build_scene
from lightopt.config import load_rig
from lightopt.core.errors import InputError
from lightopt.design import find_candidates
from lightopt.design._candidates import place_grid

RIG = """\
format: lightopt-rig/1
name: test
camera: {{distance_mm: 550, elevation_deg: 90, resolution_px: [160, 120], pixel_size_um: 44, image_distance_mm: 55, sensor: {{bit_depth: 8}}}}
light_source: {{size_mm: [60, 60], points: 4}}
lights:
{lights}
"""  # noqa: E501


def rig_of(folder, *lights):
    path = folder / "rig.yaml"
    path.write_text(RIG.format(lights="\n".join(f"  - {{{light}}}" for light in lights)), encoding="utf-8")
    return load_rig(path)


def light(name, elevation, azimuth, rest="", distance=330):
    return f"name: {name}, distance_mm: {distance}, elevation_deg: {elevation}, azimuth_deg: {azimuth}{rest}"


def test_ranges_at_a_step_include_both_ends(tmp_path):
    rig = rig_of(
        tmp_path,
        light("a", 40, 0, ", elevation_range_deg: [30, 42]"),
        light("b", 50, 90, ", azimuth_range_deg: [80, 100]"),
        light("c", 50, 180, ", elevation_range_deg: [40, 50], azimuth_range_deg: [170, 190]"),
        light("d", 50, 270),
    )
    found = find_candidates(rig, step_deg=5.0)
    assert found.places[0] == ((30.0, 0.0), (35.0, 0.0), (40.0, 0.0), (42.0, 0.0))
    assert found.places[1] == tuple((50.0, a) for a in (80.0, 85.0, 90.0, 95.0, 100.0))
    assert found.places[2] == tuple((e, a) for e in (40.0, 45.0, 50.0) for a in (170.0, 175.0, 180.0, 185.0, 190.0))
    assert found.places[3] == ((50.0, 270.0),)
    assert found.space.sizes == (4, 5, 15, 1)
    assert found.left_out == ()
    panel = found.panels[2][7]
    assert np.rad2deg([panel.elevation, panel.azimuth]) == pytest.approx(found.places[2][7])
    # steps that rounding keeps just off the end do not give the end twice
    assert [e for e, _ in place_grid(rig, 0, step_deg=0.1).places][-2:] == [41.9, 42.0]


def test_distances_in_their_range_are_candidates_with_every_angle(tmp_path):
    rig = rig_of(
        tmp_path,
        light("a", 40, 0, ", elevation_range_deg: [30, 40], distance_range_mm: [300, 340]"),
        light("b", 50, 90, ", distance_range_mm: [330, 400], distance_step_mm: 30"),
        light("c", 50, 180, ", distance_range_mm: [330, 330]"),
        light("d", 50, 270),
        "name: e, kind: dome, radius_mm: 200, segments: 2, distance_range_mm: [0, 20], distance_step_mm: 20, "
        "camera_hole_mm: 150",
    )
    found = find_candidates(rig, step_deg=10.0)
    assert found.places[0] == tuple((e, 0.0, d) for e in (30.0, 40.0) for d in (300.0, 310.0, 320.0, 330.0, 340.0))
    assert found.places[1] == tuple((50.0, 90.0, d) for d in (330.0, 360.0, 390.0, 400.0))
    assert found.places[2] == ((50.0, 180.0, 330.0),)
    assert found.places[3] == ((50.0, 270.0),)
    for places, panels in zip(found.places[:2], found.panels[:2], strict=True):
        assert [panel.distance for panel in panels] == [place[2] for place in places]
        assert [np.linalg.norm(panel.centre) for panel in panels] == pytest.approx([place[2] for place in places])
    # channels of the dome stand at one distance
    assert found.places[4] == found.places[5] == ((90.0, 270.0, 0.0), (90.0, 270.0, 20.0))
    assert [[row.tolist() for row in group[4:]] for group in found.space.groups] == [[[0], [0]], [[1], [1]]]


def test_distances_that_a_light_cannot_have_are_left_out_one_by_one(tmp_path):
    rig = rig_of(
        tmp_path,
        light("low", 5, 180, ", distance_range_mm: [330, 400], distance_step_mm: 70"),
        light("a", 45, 0, ", distance_range_mm: [330, 400], distance_step_mm: 70"),
        light("b", 45, 5),
    )
    found = find_candidates(rig, step_deg=10.0)
    assert [(out.light, out.place, out.kind) for out in found.left_out] == [
        ("low", (5.0, 180.0, 330.0), "table"),
        ("a", (45.0, 0.0, 330.0), "collision"),
    ]
    assert found.places == (((5.0, 180.0, 400.0),), ((45.0, 0.0, 400.0),), ((45.0, 5.0),))
    with pytest.raises(InputError, match="more than 100,000 positions; raise option 'step_deg' 1 or distance_step_mm"):
        place_grid(rig_of(tmp_path, light("a", 45, 0, ", distance_range_mm: [1, 400], distance_step_mm: 0.001")), 0,
                     step_deg=1.0)  # fmt: skip


def test_a_full_turn_has_no_position_twice(tmp_path):
    rig = rig_of(tmp_path, light("a", 40, 0, ", azimuth_range_deg: [0, 360]"), light("b", 40, 0, distance=500))
    assert len(place_grid(rig, 0, step_deg=90.0).places) == 4


def test_common_elevation_ties_those_that_move(tmp_path):
    rig = rig_of(
        tmp_path,
        light("a", 40, 0, ", elevation_range_deg: [30, 60], azimuth_range_deg: [0, 10]"),
        light("b", 50, 90, ", elevation_range_deg: [45, 70]"),
        light("c", 55, 180),
    )
    found = find_candidates(rig, step_deg=5.0, common_elevation=True)
    shared = [45.0, 50.0, 55.0, 60.0]
    assert sorted({e for e, _ in found.places[0]}) == shared
    assert found.places[1] == tuple((e, 90.0) for e in shared)
    assert len(found.space.groups) == 4
    for elevation, rows in zip(shared, found.space.groups, strict=True):
        assert {found.places[0][k][0] for k in rows[0]} == {elevation}
        assert {found.places[1][k][0] for k in rows[1]} == {elevation}
        assert rows[2].tolist() == [0]


def test_positions_that_the_machine_cannot_take_are_listed(tmp_path):
    rig = rig_of(
        tmp_path,
        light("high", 80, 0, ", elevation_range_deg: [70, 90]"),
        light("low", 10, 180, ", elevation_range_deg: [2, 12]"),
    )
    found = find_candidates(rig, step_deg=5.0)
    said = {(out.light, out.place[0]): out.reason for out in found.left_out}
    assert "stands in the camera's view, over" in said["high", 90.0]
    assert "mm below the table top" in said["low", 2.0]
    kept = {e for e, _ in found.places[0]} | {e for e, _ in found.places[1]}
    assert kept & {e for _, e in said} == set()
    assert 70.0 in kept
    assert 12.0 in kept


def test_what_a_lens_bends_into_view_is_left_out(tmp_path):
    """The same panel is outside a straight view and inside that of a barrel lens, which shows more."""
    lights = (light("a", 82.2, 0, ", elevation_range_deg: [66.2, 82.2]"), light("b", 45, 180))
    assert find_candidates(rig_of(tmp_path, *lights), step_deg=16.0).left_out == ()
    straight = (tmp_path / "rig.yaml").read_text(encoding="utf-8")
    bent = straight.replace("image_distance_mm: 55,", "image_distance_mm: 55, distortion: {k1: -20},")
    (tmp_path / "rig.yaml").write_text(bent, encoding="utf-8")
    (out,) = find_candidates(load_rig(tmp_path / "rig.yaml"), step_deg=16.0).left_out
    assert (out.light, out.place[0]) == ("a", 82.2)
    assert "stands in the camera's view, over" in out.reason


def test_panels_that_meet_are_kept_apart(tmp_path):
    # 60 mm panels at 330 mm meet when less than about 10 degrees apart
    rig = rig_of(
        tmp_path, light("a", 45, 0, ", azimuth_range_deg: [0, 40]"), light("b", 45, 60, ", azimuth_range_deg: [20, 60]")
    )
    found = find_candidates(rig, step_deg=20.0)
    assert found.places == (tuple((45.0, a) for a in (0.0, 20.0, 40.0)), tuple((45.0, a) for a in (20.0, 40.0, 60.0)))
    np.testing.assert_array_equal(
        found.space.clashes[0, 1], [[False, False, False], [True, False, False], [False, True, False]]
    )
    blocked = find_candidates(
        rig_of(tmp_path, light("a", 45, 0, ", azimuth_range_deg: [0, 40]"), light("b", 45, 20)), step_deg=20.0
    )
    assert [(out.light, out.place[1]) for out in blocked.left_out] == [("a", 20.0)]
    assert blocked.left_out[0].reason == "collides with b in all of its positions"
    assert blocked.space.clashes == {}


def test_bad_input_says_where_and_what_to_do(tmp_path):
    movable = ", elevation_range_deg: [30, 60]"
    rig = rig_of(tmp_path, light("a", 40, 0, movable), light("b", 90, 90))
    with pytest.raises(InputError, match=r"rig.yaml:7: .*no position of light b is left: it stands in the camera"):
        find_candidates(rig, step_deg=5.0)
    rig = rig_of(tmp_path, light("a", 40, 0, movable), light("b", 70, 90, ", elevation_range_deg: [65, 70]"))
    with pytest.raises(InputError, match="b stays at 65° or above, a at 60° or below"):
        find_candidates(rig, step_deg=5.0, common_elevation=True)
    for step in (0.0, -1.0, float("nan")):
        with pytest.raises(InputError, match="option 'step_deg': expected degrees above 0"):
            find_candidates(rig, step_deg=step)
    for step in (1e-7, 1e-310, 5e-324):
        with pytest.raises(InputError, match="more than 100,000 positions"):
            find_candidates(rig, step_deg=step)


def test_reasons_are_grouped_by_kind_with_their_numbers(tmp_path):
    rig = rig_of(
        tmp_path,
        light("a", 85, 0, ", elevation_range_deg: [83, 90]"),
        light("b", 2, 180, ", elevation_range_deg: [1, 4]"),
        light("c", 45, 90, ", elevation_range_deg: [30, 60]"),
    )
    with pytest.raises(InputError) as refused:
        find_candidates(rig, step_deg=1.0)
    first, second = refused.value.messages
    pattern = r"light a is left: it stands in the camera's view, over [\d,]+ pixels \(first of 8 positions\)\. Change"
    assert re.search(pattern, first)
    # 330 mm out, half of 60 mm below: 30·cos θ − 330·sin θ
    assert "light b is left: it reaches 24.2 mm below the table top (first of 4 positions). Change" in second


@pytest.mark.slow
def test_thousands_of_positions_a_light_need_no_memory_for_their_pairs(tmp_path):
    rig = rig_of(
        tmp_path,
        light("a", 45, 0, ", elevation_range_deg: [30, 60], azimuth_range_deg: [0, 90]"),
        light("b", 45, 200, ", elevation_range_deg: [30, 60], azimuth_range_deg: [180, 270]"),
    )
    tracemalloc.start()
    found = find_candidates(rig, step_deg=1.0)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found.space.sizes == (2821, 2821)
    # a flag for each of the 8 million pairs, not three numbers
    assert peak < 60e6


def test_a_panel_inside_the_part_is_left_out_and_the_posture_named(tmp_path):
    small = ", size_mm: [10, 10]"
    rig = rig_of(tmp_path, light("a", 30, 45, ", azimuth_range_deg: [0, 90]" + small, distance=80), light("b", 50, 270))
    trimesh.creation.box((200, 20, 60)).export(tmp_path / "bar.stl")
    (tmp_path / "part.yaml").write_text(
        "format: lightopt-part/1\nname: bar\nmesh: {file: bar.stl, units: mm}\n"
        "placement: {anchor: rest_on_table}\n"
        "postures: [{elevation_deg: 0, rotation_deg: 0}, {elevation_deg: 0, rotation_deg: 90}]\n"
        "reflectance: {R_d: 45, R_s: 100, sigma_rad: 0.05}\n",
        encoding="utf-8",
    )
    scene = build_scene(rig, tmp_path / "part.yaml")
    found = find_candidates(rig, step_deg=45.0, scene=scene)
    assert found.places[0] == ((30.0, 45.0),)
    assert [(out.place[1], out.reason) for out in found.left_out] == [
        (0.0, "is inside the part in posture (0°, 0°)"),
        (90.0, "is inside the part in posture (0°, 90°)"),
    ]
    assert len(find_candidates(rig, step_deg=45.0).places[0]) == 3


SEGMENTS = """\
format: lightopt-rig/1
name: test
camera: {distance_mm: 550, elevation_deg: 90, resolution_px: [160, 120], pixel_size_um: 44, image_distance_mm: 55, sensor: {bit_depth: 8}}
lights:
  - {name: lcd, kind: display, size_mm: [120, 80], distance_mm: 250, elevation_deg: 40, azimuth_deg: 0,
     azimuth_range_deg: [0, 40], pattern: {period_mm: 30, phases: 3, directions: [u]}}
  - {name: bar, kind: bar, size_mm: [40, 20], distance_mm: 250, elevation_deg: 40, azimuth_deg: 180,
     elevation_range_deg: [40, 60]}
"""  # noqa: E501


def test_channels_of_a_light_move_together(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(SEGMENTS, encoding="utf-8")
    found = find_candidates(load_rig(path), step_deg=20.0)
    assert found.names == ("lcd-1", "lcd-2", "lcd-3", "bar")
    assert found.channels == ((0, 1, 2), (3,))
    assert found.space.sizes == (3, 3, 3, 2)
    groups = [tuple(tuple(map(int, row)) for row in rows) for rows in found.space.groups]
    assert groups == [((k,), (k,), (k,), (0, 1)) for k in range(3)]
    assert found.message == "3 × 3 × 3 × 2 positions of lcd-1, lcd-2, lcd-3, bar: 6 combinations at most"
    # channels have the same place, and do not collide with each other
    assert found.space.clashes == {}
