"""A part that moves while the camera exposes: rig files, image sets, checks and captures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lightopt.config import load_part, load_rig
from lightopt.core.errors import InputError
from lightopt.images import read_exr, read_image_set, read_png
from lightopt.inspection import InspectOptions, inspect_set
from lightopt.optics import expose
from lightopt.preflight import check_scene
from lightopt.rendering import cast_rays_at, render_posture
from lightopt.scene import build_scene

STAGE = "stage: {elevation_range_deg: [-45, 45], rotation_range_deg: [0, 360]"
FEW = ("--patches", "500", "-q")


@pytest.fixture
def moving(bench):
    """The small rig, on which the part moves 3 mm, about 7 px, in the 10 ms of exposure 1."""
    bench.edit("rig.yaml", "  image_distance_mm: 55", "  image_distance_mm: 55\n  exposure_us: 10000")
    bench.edit("rig.yaml", STAGE, STAGE + ", motion: {velocity_mm_per_s: [300, 0, 0]}")
    bench.edit("part.yaml", ", {elevation_deg: -10, rotation_deg: 170}", "")
    return bench


def test_motion_is_relative_to_the_exposure_time_and_absent_at_rest(moving):
    scene = build_scene(moving.rig, moving.part)
    assert scene.motion.velocity.tolist() == [300.0, 0.0, 0.0]
    assert (scene.motion.turn_deg_per_s, scene.motion.exposure_s) == (0.0, pytest.approx(0.01))
    moving.edit("rig.yaml", "[300, 0, 0]", "[0, 0, 0]")
    assert build_scene(moving.rig, moving.part).motion is None
    moving.edit("rig.yaml", "velocity_mm_per_s: [0, 0, 0]", "rotation_deg_per_s: -90")
    assert build_scene(moving.rig, moving.part).motion.turn_deg_per_s == -90.0


@pytest.mark.parametrize(
    ("wrong", "line", "says"),
    [
        (("\n  exposure_us: 10000", ""), 14, "stage.motion: the rig's camera has no exposure_us"),
        (("[300, 0, 0]", "300"), 15, "stage.motion.velocity_mm_per_s: expected [x, y, z]"),
        (("velocity_mm_per_s", "velocity"), 15, "stage.motion"),
        (("[300, 0, 0]}", "[300, 0, 0], rotation_deg_per_s: fast}"), 15, "rotation_deg_per_s: expected a number"),
    ],
)
def test_wrong_motions_are_named_with_their_line(moving, wrong, line, says):
    moving.edit("rig.yaml", *wrong)
    with pytest.raises(InputError) as error:
        load_rig(moving.rig)
    assert f"rig.yaml:{line}: " in str(error.value)
    assert says in str(error.value)


def test_each_exposure_of_a_set_is_blurred_by_its_own_time(cli, moving, snapshot):
    options = ("--exposure", "1/4,1", *FEW)
    assert cli("render", moving.rig, moving.part, "-o", moving.out, *options).status == 0
    scene = build_scene(moving.rig, moving.part)
    caster = cast_rays_at(scene)
    blurred = {e: render_posture(scene, scene.postures[0], caster=caster, exposure=e) for e in (1.0, 0.25)}
    entries = read_image_set(moving.out).images
    assert len(entries) == 4
    for entry in entries:
        own = {e: next(i.level for i in blurred[e].lights if i.light == entry.light) for e in blurred}
        levels = expose(own[entry.exposure], sensor=scene.sensor, exposure=entry.exposure, full_scale=255.0)
        assert np.array_equal(read_png(moving.out / entry.png), levels)
        # the linear image is that of the longest
        assert np.array_equal(read_exr(moving.out / entry.exr)["Y"], own[1.0])
        assert np.abs(own[1.0] - own[0.25]).max() > 20.0
    before = snapshot(moving.out)
    for name in ("light1.exr", "light3_x0.25.png"):
        (moving.out / "posture_0_0" / name).unlink()
    assert cli("render", moving.rig, moving.part, "-o", moving.out, *options).status == 0
    assert snapshot(moving.out) == before


def test_a_set_of_a_part_that_moves_gets_no_longer_exposure_later(cli, moving):
    """The linear images have the blur of the longest exposure, however the set was made."""
    files = ("render", moving.rig, moving.part, "-o", moving.out, *FEW)
    assert cli(*files, "--exposure", "1/2").status == 0
    assert cli(*files, "--exposure", "1/4").status == 0
    ran = cli(*files, "--exposure", "1,1/4")
    assert ran.status == 2
    assert "the set has exposure 0.5, and its linear image would be blurred as by exposure 1" in ran.err
    assert cli(*files, "--exposure", "1,1/4", "--force").status == 0
    assert len(read_image_set(moving.out).images) == 4
    # what was lost of the longest one is written again
    lost = moving.out / "posture_0_0" / "light1.png"
    lost.unlink()
    assert cli(*files, "--exposure", "1,1/4").status == 0
    assert lost.exists()


def test_what_takes_the_part_to_be_at_rest_says_so(cli, moving):
    assert cli("render", moving.rig, moving.part, "-o", moving.out, "--noise", "1", *FEW).status == 0
    files = (moving.rig, moving.part)
    said = "px in the image during exposure 1: here it is at rest"
    ran = cli("verify", *files, moving.out, "-o", moving.folder / "verified")
    assert (ran.status, said in ran.err) == (2, True)
    assert "the blur would count as faults; take the set at rest" in ran.err
    for command in (
        ("fit-diffuse", *files, moving.out, "-o", moving.folder / "fit"),
        ("dataset", *files, "--images", "1", "-o", moving.folder / "set"),
        ("optimize", *files, "--step", "30", "--patches", "500", "--no-images", "-o", moving.folder / "best"),
    ):
        ran = cli(*command)
        assert said in ran.out + ran.err, command[0]
    assert said in (moving.folder / "set" / "datasheet.md").read_text(encoding="utf-8")


def test_exposures_of_a_programme_are_blurred_by_their_own_time(cli, moving):
    moving.edit("rig.yaml", "\nstage:", "\nprogramme:\n  - {name: a, lights: {light1: 1}, exposures: [1/4]}\n"
                "  - {name: b, lights: {light3: 1}}\nstage:")  # fmt: skip
    assert cli("render", moving.rig, moving.part, "-o", moving.out, *FEW).status == 0
    scene = build_scene(moving.rig, moving.part)
    for entry in read_image_set(moving.out).images:
        images = render_posture(scene, scene.postures[0], caster=cast_rays_at(scene), exposure=entry.exposure)
        level = next(i.level for i in images.lights if i.light == entry.light)
        assert np.array_equal(read_exr(moving.out / entry.exr)["Y"], level)
        assert entry.exposure == {"a": 0.25, "b": 1.0}[entry.light]


def test_a_motion_of_zero_changes_no_byte_of_a_picture(cli, moving):
    written = []
    for motion, instead in (("[300, 0, 0]", "[0, 0, 0]"), (", motion: {velocity_mm_per_s: [0, 0, 0]}", "")):
        moving.edit("rig.yaml", motion, instead)
        out = moving.out.with_name(f"set{len(written)}")
        assert cli("render", moving.rig, moving.part, "-o", out, *FEW).status == 0
        written.append((out / "posture_0_0" / "light1.png", out / "posture_0_0" / "light1.exr"))
    (png, exr), (other_png, other_exr) = written
    assert np.array_equal(read_png(png), read_png(other_png))
    assert read_exr(exr)["Y"].tobytes() == read_exr(other_exr)["Y"].tobytes()


def test_a_part_that_moves_too_far_exits_2(cli, moving):
    moving.edit("rig.yaml", "[300, 0, 0]", "[30000, 0, 0]")
    ran = cli("render", moving.rig, moving.part, "-o", moving.out, *FEW)
    assert ran.status == 2
    assert "px" in ran.err
    assert "expected at most 256; shorten camera.exposure_us" in ran.err


@pytest.mark.parametrize(("velocity", "level"), [(30, "ok"), (300, "warning")])
def test_check_states_the_motion_in_pixels(moving, velocity, level):
    moving.edit("rig.yaml", "[300, 0, 0]", f"[{velocity}, 0, 0]")
    rig, part = load_rig(moving.rig), load_part(moving.part)
    [found] = [one for one in check_scene(rig, part).findings if one.topic == "motion"]
    assert found.level == level
    table = velocity * 0.01 * 55 / (550 * 0.044)  # at the table's distance; the part is nearer
    assert found.values["least_px"] == pytest.approx(table, rel=0.05)
    assert table < found.values["largest_px"] < 1.1 * table
    assert "px in the 10 ms of exposure 1" in found.text
    assert ("1 px takes exposure" in found.text) == (level == "warning")
    assert "part.yaml:5: postures[0]" in found.where
    at_rest = rig.model_copy(update={"stage": rig.stage.model_copy(update={"motion": None})})
    assert not [one for one in check_scene(at_rest, part).findings if one.topic == "motion"]


def test_the_virtual_bench_captures_a_part_that_moves(cli, moving):
    moving.edit("rig.yaml", "read_noise_levels: 0.8, electrons_per_level: 60", "black_level: 3")
    ran = cli("capture", moving.rig, moving.part, "-o", moving.out, "--exposure", "1,1/4", "-q")
    assert ran.status == 0, ran.err
    scene = build_scene(moving.rig, moving.part)
    for entry in read_image_set(moving.out).images:
        images = render_posture(scene, scene.postures[0], caster=cast_rays_at(scene), exposure=entry.exposure)
        level = next(i.level for i in images.lights if i.light == entry.light)
        expected = expose(level, sensor=scene.sensor, exposure=entry.exposure, full_scale=255.0)
        found = read_png(moving.out / entry.png)
        assert np.abs(found.astype(int) - expected).max() <= 1
    still = render_posture(replace(scene, motion=None), scene.postures[0], caster=cast_rays_at(scene)).lights[0].level
    assert np.abs(read_png(moving.out / "posture_0_0/light1.png").astype(int) - np.clip(still, 0, 255)).max() > 50


def test_inspection_predicts_the_blur_of_each_exposure(cli, moving):
    """Good images of a part that moves: as predicted in motion, and nearly all of it a defect if predicted at rest."""
    options = ("--noise", "3", "--exposure", "1,1/8", "--light", "light1", *FEW)
    assert cli("render", moving.rig, moving.part, "-o", moving.out, *options).status == 0
    rig, part = load_rig(moving.rig), load_part(moving.part)
    at_rest = rig.model_copy(update={"stage": rig.stage.model_copy(update={"motion": None})})
    at_rest._source = rig.source
    options = InspectOptions(fusion=None, detector="residual", min_images=1)
    found, still = (inspect_set(one, part, read_image_set(moving.out), options=options) for one in (rig, at_rest))
    assert (len(found.defects), bool(still.defects)) == (0, True)
    assert np.hypot(found.placement.x, found.placement.y) < 0.02  # of 0.44 mm that a pixel sees
    view = found.postures[0].view
    chosen = view.clean & ~view.saturated
    off = (np.abs(view.level - view.predicted) / np.hypot(view.deviation, view.slack))[chosen]
    assert np.mean(off**2) < 1.5
    assert np.mean(view.saturated) < 0.5 * np.mean(view.predicted > 255.0)  # the short exposure counts there
