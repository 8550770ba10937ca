"""The last look at the first posture: a stage that lost steps is told by how much, and nothing else is taken for it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lightopt.config import load_part, load_rig
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import Placement, place_part
from lightopt.optics import expose
from lightopt.rendering import cast_rays_at, render_posture
from lightopt.rig.capture._image_checks import Repeatability, measure_repeatability
from lightopt.scene import Scene, build_scene

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
POSTURE = Posture(0.0, 0.0)
FIXTURE = Placement(x=0.5, y=-0.3, turn=np.radians(0.5))


def scene_of(part: str, shrunk: int = 4) -> Scene:
    """The sample, seen by one light with 1/4 of the pixels each way, or fewer."""
    rig = load_rig(CONFIGS / "rigs" / "four-panel.yaml")
    scene = build_scene(rig, load_part(CONFIGS / "parts" / part), postures=[POSTURE])
    camera = scene.camera
    camera = replace(
        camera, width=camera.width // shrunk, height=camera.height // shrunk, pixel_size=shrunk * camera.pixel_size
    )
    return replace(scene, camera=camera, lights=scene.lights[:1])


def taken(scene: Scene, posture: Posture, seed: int, gain: float = 1.0) -> np.ndarray:
    """A frame of the part as it lies in its fixture, half a millimetre and half a degree off."""
    placed = place_part(scene, FIXTURE)
    (image,) = render_posture(placed, posture, caster=cast_rays_at(placed)).lights
    rng = np.random.default_rng(seed)
    return expose(np.float32(gain) * image.level, sensor=scene.sensor, exposure=1.0, full_scale=255.0, rng=rng)


def second_look(
    scene: Scene, world: Scene, tilt_deg: float, turn_deg: float, gain: float = 0.95
) -> Repeatability | None:
    first = taken(world, POSTURE, 1)
    last = taken(world, Posture(tilt_deg, turn_deg), 2, gain)
    return measure_repeatability(first, last, light="light1", posture=POSTURE, scene=scene)


PREDICTED: dict[str, float] = {}
GLOSS = {"R_d": 70.0, "R_s": 4000.0, "sigma": 0.08}
METAL = {"R_d": 12.0, "R_s": 30_000.0, "sigma": 0.03}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "reflectance"),
    [
        pytest.param("cover-knob.yaml", PREDICTED, marks=pytest.mark.nightly),
        pytest.param("spout.yaml", PREDICTED, marks=pytest.mark.nightly),
        pytest.param("cover-knob.yaml", GLOSS, marks=pytest.mark.nightly),
        ("spout.yaml", GLOSS),
        pytest.param("cover-knob.yaml", METAL, marks=pytest.mark.nightly),
        pytest.param("spout.yaml", METAL, marks=pytest.mark.nightly),
    ],
)
def test_a_degree_is_reported_and_nothing_is_reported_of_what_returned(
    part: str, reflectance: dict[str, float]
) -> None:
    """Whatever the part is really like, wherever it lies, and with a lamp that has lost 5 %."""
    scene = scene_of(part)
    world = replace(scene, reflectance=replace(scene.reflectance, **reflectance))
    same = second_look(scene, world, 0.0, 0.0)
    assert same is not None
    assert (same.deviation, same.converged) == (None, True)
    assert max(abs(same.tilt_deg), abs(same.turn_deg)) < 0.1
    for tilt, turn in ((1.0, 0.0), (0.0, -1.0)):
        found = second_look(scene, world, tilt, turn)
        assert found is not None
        assert found.deviation is not None
        assert found.converged
        assert (found.tilt_deg, found.turn_deg) == pytest.approx((tilt, turn), abs=0.7)
        assert ("elevation" if tilt else "rotation") in found.deviation


@pytest.mark.slow
def test_a_third_of_a_degree_is_reported_in_a_small_image_or_said_to_be_unseen() -> None:
    """100 × 75 pixels: the errors are those of the scatter, not of how much a cell may pull."""
    scene = scene_of("cover-knob.yaml", shrunk=16)
    same, found = second_look(scene, scene, 0.0, 0.0), second_look(scene, scene, 0.3, 0.0)
    assert same is not None
    assert found is not None
    assert (same.deviation, same.unobservable) == (None, "")
    assert found.deviation is not None
    assert found.deviation.startswith("its elevation by roughly +")
    assert "rotation" not in found.deviation
    world = replace(scene, reflectance=replace(scene.reflectance, **METAL))
    dim = second_look(scene, world, 0.3, 0.0)
    assert dim is not None
    assert (dim.deviation, dim.unobservable) == (None, "elevation and rotation")


@pytest.mark.slow
def test_what_cannot_be_seen_is_said_to_be_so() -> None:
    unsure = Repeatability(tilt_deg=0.9, turn_deg=2.0, tilt_error_deg=0.01, turn_error_deg=0.7)
    assert unsure.deviation == "its elevation by roughly +0.9°"
    assert unsure.unobservable == "rotation"
    lost = replace(unsure, converged=False)
    assert lost.deviation is None
    assert lost.as_dict()["converged"] is False
    scene = scene_of("cover-knob.yaml")
    dark = np.zeros((300, 400), np.uint8)
    assert measure_repeatability(dark, dark, light="light1", posture=POSTURE, scene=scene) is None


def test_a_run_that_comes_back_takes_no_more_images_and_ends_in_the_dark(take, world, bench) -> None:
    done = take(check_repeatability=True)
    assert (done.images, done.taken, done.warnings) == (4, 4, ())
    moves = [Posture(0.0, 0.0), Posture(-10.0, 170.0), Posture(0.0, 0.0)]
    assert world.did("move") == [("move", posture) for posture in moves]
    assert not world.lit
    facts = json.loads((bench.out / "manifest.json").read_text(encoding="utf-8"))["repeatability"]
    assert (facts["light"], facts["posture"]) == ("light1", {"elevation_deg": 0.0, "rotation_deg": 0.0})
    assert abs(facts["tilt_deg"]) < 0.1
    take(resume=True)  # whether it came back is no part of what the set is
    take(resume=True, check_repeatability=True)


def test_a_stage_that_lost_steps_on_its_way_is_reported(take, world, bench) -> None:
    def slip(event):
        if event == ("move", Posture(-10.0, 170.0)):
            world.slipped = Posture(1.0, 0.0)

    world.trouble = slip
    done = take(check_repeatability=True)
    (reported,) = done.warnings
    assert reported.startswith(
        "repeated image at (0°, 0°): the part has rotated since the first image, its elevation by roughly +"
    )
    assert "it lost steps, or the part slipped; home the stage and capture again" in reported
    manifest = json.loads((bench.out / "manifest.json").read_text(encoding="utf-8"))
    assert manifest["warnings"] == [reported]
    assert manifest["repeatability"]["tilt_deg"] == pytest.approx(1.0, abs=0.7)


def test_there_has_to_be_something_to_come_back_from(take) -> None:
    with pytest.raises(InputError, match="check of repeatability: expected a stage and two postures or more"):
        take(check_repeatability=True, postures=(Posture(0.0, 0.0),))
