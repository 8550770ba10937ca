"""The programme of a rig file: images of several lights with weights, in the file, in renders and on devices."""

from __future__ import annotations

import re

import numpy as np
import pytest

from lightopt import build_scene, render
from lightopt.config import RigConfig, load_part, load_rig
from lightopt.core.errors import HardwareError, InputError
from lightopt.images import read_exr, read_image_set
from lightopt.rig.capture import CaptureOptions, make_plan
from lightopt.scene import build_lights

LIGHTS = """\
  - {name: dome, kind: dome, radius_mm: 150, camera_hole_mm: 40, segments: 4, lower_elevation_deg: 10, leak: 0.2}
  - {name: bar, kind: bar, size_mm: [200, 20], distance_mm: 250, elevation_deg: 30, azimuth_deg: 180, gain: 2}
  - {name: lcd, kind: display, size_mm: [300, 200], distance_mm: 300, elevation_deg: 60, pattern: {period_mm: 60}}
"""
PROGRAMME = """\
programme:
  - {name: all-on, lights: {dome-1: 1, dome-2: 1, dome-3: 1, dome-4: 1}}
  - {name: east, lights: {dome-4: 0.5, dome-1: 0.25, bar: 1}, exposures: [1, 1/16]}
  - {name: panel, lights: {light1: 0.5}}
  - {name: checks, lights: {lcd-1: 0.5, lcd-6: 0.75}}
"""


@pytest.fixture
def mixed(bench):
    """A bench with a dome and a bar, and the programme above, whose camera has a quarter of the pixels."""
    bench.edit("rig.yaml", "resolution_px: [160, 120]", "resolution_px: [80, 60]")
    bench.edit("rig.yaml", "pixel_size_um: 44", "pixel_size_um: 88")
    bench.edit("rig.yaml", "stage:", f"{LIGHTS}{PROGRAMME}stage:")
    return bench


def test_images_take_the_place_of_lights(mixed):
    rig = load_rig(mixed.rig)
    assert [light.name for light in rig.lights] == ["all-on", "east", "panel", "checks"]
    assert [light.name for light in rig.channels][:4] == ["light1", "light3", "dome-1", "dome-2"]
    assert [rig.exposures(light.name, (2.0,)) for light in rig.lights] == [(2.0,), (1.0, 0.0625), (2.0,), (2.0,)]
    assert rig.source.at("lights", 1).split(": ")[-1] == "lights[2]"  # the dome's entry
    alone = rig.without_programme()
    assert [light.name for light in alone.lights] == [light.name for light in rig.channels]
    assert alone.source.at("lights", 6).split(": ")[-1] == "lights[3]"
    again = RigConfig.model_validate(rig.model_dump())
    assert [light.mixture for light in again.lights] == [light.mixture for light in rig.lights]
    # what is kept for a set of lights is not taken for others
    dumps = [light.model_dump(mode="json") for light in rig.lights]
    assert dumps[1]["mixture"][1]["weight"] == 0.25


def test_an_image_is_the_weighted_sum_of_its_lights(mixed):
    rig, part = load_rig(mixed.rig), load_part(mixed.part)
    postures = build_scene(rig, part).postures[:1]
    both = [build_scene(one, part, postures=postures) for one in (rig, rig.without_programme())]
    images, alone = ({i.light: i.level.astype(float) for i in next(iter(render(scene))).lights} for scene in both)
    for image in rig.programme:
        wanted = sum(weight * alone[light] for light, weight in image.lights.items())
        np.testing.assert_allclose(images[image.name], wanted, rtol=1e-5, atol=5e-3)
        assert wanted.max() > 50


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "dome-4: 0.5",
            "dome-5: 0.5",
            r"rig.yaml:19: programme\[1\].lights.dome-5: no light .*dome-5.*; the rig has li",
        ),
        ("dome-4: 0.5", "dome-4: 1.5", r"rig.yaml:19: programme\[1\].lights.dome-4: expected a weight above 0 up to 1"),
        ("dome-4: 0.5", "dome-4: 0", "expected a weight above 0 up to 1 .*found 0"),
        ("name: east", "name: Dome-1", r"programme\[1\].name: .*dome-1.* is a light of the rig"),
        ("name: east", "name: all-on", r"programme\[1\].name: the name .*all-on.* is already that of programme\[0\]"),
        ("light1: 0.5", "light1: 0.5, bar: 1", r"programme\[2\].lights.light1: .*light1.* is a panel"),
        ("bar: 1}", "bar: 1, lcd-3: 1}", r"programme\[1\].lights.lcd-3: .*lcd-3.* is of a display with stripes"),
        ("1/16", "1", r"programme\[1\].exposures: the same exposure was given twice"),
        ("1/16", "0/16", r"expected a number above 0, such as 1 or 1/16"),
    ],
)
def test_mistakes_are_named_with_their_line(mixed, old, new, message):
    mixed.edit("rig.yaml", old, new)
    with pytest.raises(InputError) as error:
        load_rig(mixed.rig)
    assert re.search(message, str(error.value)), error.value
    assert len(error.value.messages) == 1


def test_lights_with_ranges_are_refused(mixed):
    mixed.edit(
        "rig.yaml",
        "elevation_deg: 60, azimuth_deg: 45",
        "elevation_deg: 60, azimuth_deg: 45, elevation_range_deg: [30, 60]",
    )
    with pytest.raises(InputError, match=r"light1.* has a range, and lights of a programme are fixed"):
        load_rig(mixed.rig)


def test_render_gives_each_image_its_exposures(cli, mixed):
    ran = cli("render", mixed.rig, mixed.part, "-o", mixed.out, "--posture", "0,0", "--patches", "500", "--sheet")
    assert ran.status == 0, ran.err
    keys = [(e.light, e.exposure) for e in read_image_set(mixed.out).images]
    assert keys == [("all-on", 1.0), ("east", 1.0), ("east", 0.0625), ("panel", 1.0), ("checks", 1.0)]


def test_a_capture_lights_all_lights_of_an_image_at_their_levels(mixed, take, world):
    done = take()
    assert done.images == 10
    lit = [event[1:] for event in world.log if event[0] == "level" and event[3]]
    one = [("bench1", 3, 200), ("bench1", 4, 200), ("bench2", 1, 200), ("bench2", 2, 200)]
    two = [("bench2", 2, 100), ("bench1", 3, 50), ("bench2", 3, 200)]
    four = [("bench2", 4, 100), ("bench4", 1, 150)]
    assert lit == [*one, *two, ("bench1", 1, 100), *four] * 2
    image = next(e for e in read_image_set(mixed.out).images if e.light == "east")
    assert [one["level"]["requested"] for one in image.extra["capture"]["light"]["lights"]] == [100, 50, 200]
    assert "valid" in read_exr(mixed.out / image.exr)


def test_all_lights_of_an_image_go_out_when_one_fails(mixed, take, world):
    def fails(event):
        if event[0] == "level" and event[1:3] == ("bench2", 2) and event[3]:
            raise HardwareError("no reply")

    world.trouble = fails
    with pytest.raises(HardwareError, match="no reply"):
        take()
    assert not world.lit


def test_weights_that_no_whole_level_gives_are_refused(mixed):
    mixed.edit("rig.yaml", "dome-1: 0.25", "dome-1: 0.003")
    with pytest.raises(InputError, match=r"programme\[1\].lights.dome-1: weight 0.003 of level 200 is 0.6, and the"):
        make_plan(load_rig(mixed.rig), load_part(mixed.part), CaptureOptions())


def test_mixed_lights_have_the_gain_of_their_lights(mixed):
    rig = load_rig(mixed.rig)
    assert isinstance(rig, RigConfig)
    east = build_lights(rig)[1]
    assert east.gain == pytest.approx(0.5 + 0.25 + 2.0)
