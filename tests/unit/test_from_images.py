"""Lights chosen from images: the statistic, the search and its bound, weights, files, bad input."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest
from reference._from_images import reference_gains
from sample_sets import POSTURE, camera_levels, drawn_samples, write_samples, write_set
from scipy import ndimage

from lightopt.cli._main import run
from lightopt.config import load_rig
from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext
from lightopt.design import FromImagesOptions, from_images_answer, optimize_from_images
from lightopt.design.from_images._choice import choose_lights, score
from lightopt.design.from_images._evidence import Evidence
from lightopt.design.from_images._mixture import MixedImages, mix_lights
from lightopt.images import read_image_set, read_png, write_exr, write_png


def drawn_evidence(lights, defects, seed):
    random = np.random.default_rng(seed)
    common = random.normal(size=(lights, 3))
    covariance = np.eye(lights) + 0.3 * common @ common.T
    scale = np.sqrt(np.diag(covariance))
    starts = np.cumsum([0, *random.integers(0, 3, defects)])
    shape = (lights, int(starts[-1]))
    levels, sensor = random.uniform(20.0, 200.0, (lights, defects)), (0.7, 1.0 / 30.0)
    # lights with highlights at other places, and a common background
    places, own = random.uniform(0.0, 1.0, (lights, 1)), np.linspace(0.0, 1.0, 500)
    surface = 30.0 + 200.0 * np.exp(-(((own - places) / random.uniform(0.05, 0.3, (lights, 1))) ** 2))
    return Evidence(
        correlation=covariance / np.outer(scale, scale),
        factors=4.0 * random.normal(size=shape) * random.exponential(size=shape),
        starts=starts,
        thresholds=random.uniform(25.0, 60.0, defects),
        deviations=np.sqrt(sensor[0] + sensor[1] * levels + (0.03 * levels) ** 2),
        levels=levels,
        sensor=sensor,
        surface=(surface.T.astype(np.float32),),
        room=242.0,
        defects=tuple(("set", str(j)) for j in range(defects)),
        brightest=np.full(lights, 100.0),
        noise=np.ones(lights),
        z=5.0,
        shrinkage=0.05,
        good=5,
        surface_contrast=None,
    )


def exhaustive(evidence, count):
    choices = itertools.combinations(range(evidence.lights), count)
    return max(score(evidence.gains(list(choice))) for choice in choices)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("count", [1, 2, 4, 9])
def test_the_search_finds_what_exhaustive_search_finds(count, seed):
    evidence = drawn_evidence(9, 6, seed)
    found = choose_lights(evidence, count)
    best = exhaustive(evidence, count)
    assert found.proven
    assert found.score == pytest.approx(best, abs=1e-12)
    assert found.score == pytest.approx(score(evidence.gains(list(found.lights))), abs=1e-12)
    assert found == choose_lights(evidence, count, threads=1)
    stopped = choose_lights(evidence, count, limit=1)
    assert stopped.score <= best + 1e-12
    assert stopped.bound >= best - 1e-12


def test_a_stopped_search_says_so():
    evidence = drawn_evidence(24, 8, 3)
    stopped = choose_lights(evidence, 6, limit=10)
    whole = choose_lights(evidence, 6)
    assert not stopped.proven
    assert whole.proven
    assert stopped.score <= whole.score <= stopped.bound
    assert stopped.scored < whole.scored < whole.total


def test_weights_are_no_worse_than_single_lights_and_within_the_bound():
    evidence = drawn_evidence(12, 6, 1)
    mixed = MixedImages(evidence)
    mixture = mix_lights(mixed, choose_lights(evidence, 2).lights)
    assert mixture.single_score < mixture.score <= mixture.bound < 1.5 * mixture.score
    assert (mixture.weights >= 0.0).all()
    assert mixture.weights.max(axis=1) == pytest.approx(1.0)
    random = np.random.default_rng(5)
    for _ in range(300):
        weights = random.exponential(size=(2, 12)) * (random.random((2, 12)) < random.random())
        assert score(mixed.gains(weights)) <= mixture.bound + 1e-12


@pytest.mark.parametrize("seed", range(4))
def test_weights_of_few_lights_are_nearly_the_best_on_a_grid(seed):
    evidence = drawn_evidence(3, 4, seed)
    mixed = MixedImages(evidence)
    mixture = mix_lights(mixed, choose_lights(evidence, 1).lights)
    grid = [np.array([row]) for row in itertools.product(np.linspace(0.0, 1.0, 11), repeat=3) if max(row) == 1.0]
    best = max(score(mixed.gains(weights)) for weights in grid)
    assert 0.99 * best <= mixture.score
    assert best <= mixture.bound
    assert mixture.bound < 2.2 * best


def test_a_single_light_of_a_mixture_shows_what_it_shows_alone():
    evidence = replace(drawn_evidence(5, 6, 4), thresholds=np.full(6, 25.0))
    mixed = MixedImages(evidence)
    for i in range(5):
        level, _ = mixed.top(np.eye(5)[i])
        exposed = mixed.exposed(np.eye(5)[[i]])
        assert exposed[0, i] == pytest.approx(min(1.0, 242.0 / level))
        # what is left of R without the sensor's noise has no negative variance, so that it shows a little less
        assert (mixed.gains(np.eye(5)[[i]]) <= evidence.gains([i]) + 1e-12).all()
        assert mixed.gains(np.eye(5)[[i]]) == pytest.approx(evidence.gains([i]), rel=0.02)


@pytest.mark.parametrize("pixels", [0, 1, 3])
def test_a_bound_of_few_pixels(pixels):
    evidence = drawn_evidence(5, 6, 4)
    surface = tuple(own[:pixels] for own in evidence.surface if pixels)
    mixture = mix_lights(MixedImages(replace(evidence, surface=surface)), (0, 1))
    assert mixture.single_score <= mixture.score <= mixture.bound <= 1.0


def test_lights_alike_show_no_more_together_than_one_with_their_photons():
    # six lights as bright as saturation allows: an image of all has the photons of one
    evidence = drawn_evidence(6, 4, 1)
    contrast = np.full(evidence.factors.shape, 6.0)
    levels = np.full(evidence.levels.shape, 240.0)
    alike = replace(
        evidence,
        correlation=np.eye(6),
        factors=contrast,
        levels=levels,
        sensor=(0.0, 0.25),
        thresholds=np.full(4, 25.0),
        deviations=np.sqrt(0.25 * levels),
        surface=(np.full((1000, 6), 240.0, np.float32),),
    )
    mixed = MixedImages(alike)
    assert mixed.gains(np.ones((1, 6))) == pytest.approx(alike.gains([0]) * 242.0 / 240.0)
    mixture = mix_lights(mixed, (0,))
    assert mixture.bound == pytest.approx(mixture.single_score, rel=1e-3)


def test_the_gradients_of_the_weights_and_of_the_bound():
    evidence = drawn_evidence(6, 5, 2)
    mixed = MixedImages(evidence)
    weights = np.random.default_rng(3).uniform(0.1, 1.0, (2, 6)) * [[0.05], [1.0]]  # the second one saturates
    assert mixed.top(weights[0])[0] < evidence.room < mixed.top(weights[1])[0]
    for function, at, tolerance in (
        (mixed.loss, weights, 2e-4),
        (lambda u: mixed.tangent(u)[:2], weights.sum(axis=0), 1e-6),
    ):
        _, slope = function(at)
        for i in np.ndindex(at.shape):
            step = np.zeros(at.shape)
            step[i] = 1e-6
            ends = [function(at + sign * step)[0] for sign in (1, -1)]
            assert slope[i] == pytest.approx((ends[0] - ends[1]) / 2e-6, abs=tolerance)


def parts_under(lights, contrast, random, *, good=10, bad=6, brightness=0.01):
    """Light of samples (samples, lights, H, W) of which the last show five spots, and their masks."""
    masks = np.zeros((good + bad, *lights.shape[1:]), np.uint8)
    parts = lights * (1.0 + brightness * random.normal(size=(good + bad, len(lights), 1, 1)))
    for top, left in ((8, 10), (8, 50), (40, 30), (44, 60), (25, 22)):
        masks[good:, top : top + 6, left : left + 6] = 255
    return np.where(masks[:, None] > 0, (1.0 + contrast) * parts, parts), masks


def highlights(lights, level):
    y, x = np.mgrid[0.0:1.0:60j, 0.0:1.0:80j]
    return np.stack([level * (0.25 + 0.75 * np.exp(-((x - c) ** 2 + (y - 0.5) ** 2) / 0.02)) for c in lights])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lights", "contrast", "camera"),
    [
        (np.full((6, 60, 80), 180.0), 0.06, {"electrons": 4.0}),  # an image of all has the photons of one
        (highlights([0.2, 0.4, 0.6, 0.8], 235.0), 0.06, {"electrons": 20.0}),
        (highlights([0.2, 0.4, 0.6, 0.8], 60.0), 0.2, {"read": 3.0}),
    ],
)
def test_images_that_are_taken_show_what_their_weights_promise(tmp_path, lights, contrast, camera):
    random = np.random.default_rng(4)
    parts, masks = parts_under(lights, contrast, random)
    sets = write_samples(tmp_path / "single", camera_levels(parts, random, **camera), masks)
    result = optimize_from_images(sets, options=FromImagesOptions(images=1, mix=True))
    read, electrons = camera.get("read", 0.8), camera.get("electrons", 60.0)
    levels = np.array([lights.min(), lights.max()])
    # where all levels are alike, the constant part is not known
    constant, per_level = result.evidence.sensor
    if lights.std() > 0.0:
        assert constant + per_level * levels == pytest.approx(read**2 + 1 / 12 + levels / electrons, rel=0.15)
    mixed = MixedImages(result.evidence)
    (image,) = result.images
    chosen = [image.weights.get(f"led-{i + 1}", 0.0) * image.exposure for i in range(len(lights))]
    for weights in ([chosen], [[1.0] * len(lights)], [[1.0, 1.0] + [0.0] * (len(lights) - 2)]):
        exposed = mixed.exposed(np.array(weights))
        taken = camera_levels(np.einsum("nk,skyx->snyx", exposed, parts), random, **camera)
        own = write_samples(tmp_path / f"taken-{len(list(tmp_path.iterdir()))}", taken, masks)
        shown = optimize_from_images(own, options=FromImagesOptions(images=1)).gains
        # windows of weak defects are estimated with noise, and the lights were chosen by them
        assert np.median(mixed.gains(exposed)) == pytest.approx(np.median(shown), rel=0.35)


def test_many_lights_and_their_choice_counts_few(tmp_path):
    levels, masks = drawn_samples(lights=128, good=3, bad=1, size=(30, 48))
    sets = write_samples(tmp_path, levels, masks)
    result = optimize_from_images(sets, options=FromImagesOptions(images=2))
    assert result.choice.proven
    assert len(result.evidence.correlation) == 128
    assert 127 in result.choice.lights  # the only one under which the second spot shows


def test_the_choice_of_four_of_64_lights_scores_few_of_all():
    random = np.random.default_rng(64)
    evidence = drawn_evidence(64, 30, 64)
    # each defect shows under some neighbouring lights
    at = random.uniform(0.0, 64.0, evidence.factors.shape[1])
    lobes = 12.0 * np.exp(-((np.arange(64)[:, None] - at) ** 2) / 18.0)
    choice = choose_lights(replace(evidence, factors=lobes), 4)
    assert choice.proven
    assert choice.total == 635_376
    assert choice.scored < 0.6 * choice.total


def test_a_bound_that_is_nearly_reached_is_not_rounded_to_nothing(tmp_path):
    result = optimize_from_images(write_samples(tmp_path, *drawn_samples()), options=FromImagesOptions(images=2))
    near = replace(result, choice=replace(result.choice, bound=result.choice.score * 1.00001))
    assert from_images_answer(near)[1].endswith("no other choice exceeds its score by more than 0.1 %")


@pytest.mark.slow
@pytest.mark.parametrize("subset", [[0], [1, 3], [0, 1, 2, 3]])
def test_the_evidence_is_that_of_the_plain_reference(tmp_path, subset):
    levels, masks = drawn_samples(size=(30, 36), contrast=14.0)
    result = optimize_from_images(write_samples(tmp_path, levels, masks), options=FromImagesOptions(images=2))
    numbers, begin = np.zeros(masks.shape, int), 0
    for i, mask in enumerate(masks):
        own, count = ndimage.label(mask > 0, np.ones((3, 3)))
        numbers[i] = np.where(own > 0, own + begin, 0)
        begin += count
    expected = reference_gains(levels, numbers, np.ones(masks.shape[1:], bool), subset)
    gains = result.evidence.gains(subset)
    # the thresholds of these small images know nothing of larger windows than one
    assert gains * result.evidence.thresholds / result.evidence.z**2 == pytest.approx(expected, rel=1e-3, abs=1e-4)


def test_the_lights_that_show_the_spots_are_chosen(tmp_path):
    result = optimize_from_images(write_samples(tmp_path, *drawn_samples()), options=FromImagesOptions(images=2))
    assert [image.name for image in result.images] == ["led-1", "led-4"]
    assert (result.gains >= 1.0).all()
    assert result.choice.proven
    assert len(result.gains) == 4
    top = result.evidence.brightest[[0, 3]]
    for image, brightest in zip(result.images, top, strict=True):
        assert image.exposure == pytest.approx(0.95 * 255.0 / brightest, rel=0.01)


def test_good_samples_alone_raise_no_alarm(tmp_path):
    # masks where nothing is: noise is no evidence
    levels, masks = drawn_samples(contrast=0.0, seed=2)
    result = optimize_from_images(write_samples(tmp_path, levels, masks), options=FromImagesOptions(images=2))
    assert (result.evidence.all_lights() < 0.5).all()


def test_the_files_that_are_written(tmp_path, cli):
    sets = write_samples(tmp_path, *drawn_samples())
    out = tmp_path / "out"
    arguments = ["optimize", "--from-images", *map(str, sets), "-k", "2", "-o", str(out)]
    ran = cli(*arguments)
    assert ran.status == 0, ran.err
    assert ran.out.startswith("4 of 4 defects found in 2 images; no other choice scores more (proven)")
    assert "default of -k" not in ran.out
    document = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert document["format"] == "lightopt-from-images/1"
    assert [image["name"] for image in document["images"]] == ["led-1", "led-4"]
    assert document["found"] == 4
    assert "led-4" in (out / "report.html").read_text(encoding="utf-8")
    assert '{"name": "led-1", "lights": {"led-1": 1.0}' in (out / "programme.yaml").read_text(encoding="utf-8")
    synthesised = read_image_set(out / "images" / "s5")
    entry = synthesised.images[0]
    expected = np.floor(read_png(sets[5] / "led-1-0.png") * np.float32(entry.exposure) + 0.5)
    assert np.array_equal(synthesised.load(entry).sensor, np.minimum(expected, 255))
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    assert cli(*arguments, "--threads", "1").status == 0
    assert before == {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    other = cli(*arguments, "--mix")
    assert other.status == 2
    assert "mix: previously false, now true" in other.err
    assert cli(*arguments[:2], *map(str, sets[1:]), *arguments[-4:], "--force").status == 0
    assert sorted(path.name for path in (out / "images").iterdir()) == [f"s{i}" for i in range(1, 7)]
    assert cli(*arguments, "--force").status == 0
    # the synthesised images are samples themselves
    again = optimize_from_images([out / "images" / f"s{i}" for i in range(7)], options=FromImagesOptions(images=1))
    assert len(again.evidence.defects) == 4


def test_the_number_of_images_that_nobody_gave_is_said(tmp_path, cli):
    sets = write_samples(tmp_path, *drawn_samples())
    ran = cli("optimize", "--from-images", *map(str, sets), "-o", str(tmp_path / "out"), "--no-report")
    assert ran.out.splitlines()[0].endswith("; 4 is the default of -k"), ran.err


RIG = """\
format: lightopt-rig/1
name: array
camera: {distance_mm: 550, elevation_deg: 90, resolution_px: [48, 36], pixel_size_um: 44, image_distance_mm: 55,
  sensor: {bit_depth: 8}}
lights:   # four of them
  - {name: led, kind: led_array, size_mm: [240, 160], rows: 2, columns: 2, led_mm: 8, distance_mm: 250}
"""


def test_the_programme_goes_into_the_rig(tmp_path, cli):
    sets = write_samples(tmp_path, *drawn_samples())
    rig = tmp_path / "rig.yaml"
    rig.write_text(RIG, encoding="utf-8")
    out = tmp_path / "out"
    common = ["optimize", "--from-images", *map(str, sets), "--rig", str(rig), "--mix", "--no-report"]
    ran = cli(*common, "-k", "1", "-o", str(out))
    assert ran.status == 0, ran.err
    programmed = load_rig(out / "rig.optimized.yaml")
    document = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert [light.name for light in programmed.lights] == [image["name"] for image in document["images"]]
    assert programmed.lights[0].exposures == (document["images"][0]["exposure"],)
    assert {channel.name: weight for channel, weight in programmed.lights[0].mixture} == document["images"][0]["lights"]
    refused = cli(*common, "-k", "1", "-o", str(tmp_path / "again"), "--rig", str(out / "rig.optimized.yaml"))
    assert refused.status == 2
    assert "has a programme" in refused.err


def test_lights_of_the_written_rig_do_not_move(tmp_path, cli):
    sets = write_samples(tmp_path, *drawn_samples())
    light = "{name: led-%d, distance_mm: 300, elevation_deg: 60, azimuth_deg: %d, elevation_range_deg: [30, 80]}"
    lights = "".join(f"  - {light % (i, 90 * i)}\n" for i in range(1, 5))
    rig = tmp_path / "rig.yaml"
    rig.write_text(RIG[: RIG.index("lights:")] + "light_source: {size_mm: [60, 60], points: 4}\nlights:\n" + lights)
    mixed = cli(
        "optimize", "--from-images", *map(str, sets), "--rig", str(rig), "-k", "2", "-o", str(tmp_path), "--mix"
    )
    assert mixed.status == 2
    assert "rig.yaml: --mix shows several lights in an image, and " in mixed.err
    ran = cli("optimize", "--from-images", *map(str, sets), "--rig", str(rig), "-k", "2", "-o", str(tmp_path / "out"))
    assert ran.status == 0, ran.err
    assert "range" not in (tmp_path / "out" / "rig.optimized.yaml").read_text(encoding="utf-8")


def test_a_rig_and_a_part_are_not_asked_for(tmp_path, cli):
    ran = cli("optimize", "--from-images", "rig.yaml", "part.yaml", str(tmp_path), "-o", str(tmp_path / "out"))
    assert ran.status == 2
    assert "rig.yaml, part.yaml: lights are chosen from image sets; --rig names" in ran.err


def test_no_defective_sample_is_said(tmp_path):
    levels, masks = drawn_samples(bad=0)
    levels[:, 2] *= 0.2
    warned: list[str] = []
    result = optimize_from_images(
        write_samples(tmp_path, levels, masks), options=FromImagesOptions(images=2), run=RunContext(warn=warned.append)
    )
    assert "no defective sample: signal over noise of the good surface is all that can be optimised" in warned[0]
    assert "led-3" not in [image.name for image in result.images]
    assert result.evidence.surface_contrast is not None


@pytest.mark.parametrize(("good", "text"), [(1, "one good sample"), (3, "3 good samples")])
def test_few_good_samples_are_said(tmp_path, good, text):
    warned: list[str] = []
    result = optimize_from_images(
        write_samples(tmp_path, *drawn_samples(good=good, bad=0)),
        options=FromImagesOptions(images=1),
        run=RunContext(warn=warned.append),
    )
    assert any(text in line for line in warned)
    # of a single sample too, noise is about the 1.5 levels that it was drawn with
    assert result.evidence.noise == pytest.approx(1.5, rel=0.25)


@pytest.mark.parametrize("number", [1, 6])
def test_a_sample_of_another_part_is_named(tmp_path, number):
    # a good one, and a defective one beside its masks
    levels, masks = drawn_samples(good=5, bad=2)
    sets = write_samples(tmp_path / "alike", levels, masks)
    warned: list[str] = []
    optimize_from_images(sets, options=FromImagesOptions(images=1), run=RunContext(warn=warned.append))
    assert not any("unlike" in line for line in warned)
    levels[number] = levels[number][..., ::-1, ::-1]
    sets = write_samples(tmp_path / "unlike", levels, masks)
    optimize_from_images(sets, options=FromImagesOptions(images=1), run=RunContext(warn=warned.append))
    (line,) = (line for line in warned if "unlike" in line)
    assert line.startswith(f"unlike the other samples: s{number} (")
    assert "another part" in line


@pytest.mark.parametrize(("bad", "text"), [(1, "at most one good sample at each place"), (4, "at most 4 good samples")])
def test_defects_that_no_good_sample_shows_are_said(tmp_path, bad, text):
    levels, masks = drawn_samples(good=0, bad=bad)
    masks[:] = masks[0]
    warned: list[str] = []
    sets = write_samples(tmp_path, levels, masks)
    optimize_from_images(sets, options=FromImagesOptions(images=1), run=RunContext(warn=warned.append))
    assert warned[0].startswith("no defect can be used: signal over noise of the good surface is all")
    assert warned[1].startswith(text)
    assert warned[2].startswith(f"{2 * bad} defects not used, since no good sample shows the place: s0 1, s0 2")


def test_one_good_sample_and_one_with_spots(tmp_path):
    levels, masks = drawn_samples(good=1, bad=1)
    result = optimize_from_images(write_samples(tmp_path, levels, masks), options=FromImagesOptions(images=2))
    assert [image.name for image in result.images] == ["led-1", "led-4"]


def test_postures_add_up(tmp_path):
    # the second posture shows what the first one hides; masks have a file for each
    levels, masks = drawn_samples(bad=1)
    plain, _ = drawn_samples(good=6, bad=0, seed=8)
    sets = []
    for i, (own, mask, other) in enumerate(zip(levels, masks, plain, strict=True)):
        sets.append(write_set(tmp_path / f"s{i}", other, tilted=own))
        if mask.any():
            (sets[-1] / "masks").mkdir()
            write_png(sets[-1] / "masks" / "posture_10_0.png", mask, metadata={})
    result = optimize_from_images(sets, options=FromImagesOptions(images=2))
    assert [name for _, name in result.evidence.defects] == ["(10°, 0°) 1", "(10°, 0°) 2"]
    assert [image.name for image in result.images] == ["led-1", "led-4"]
    assert (result.gains >= 1.0).all()


def test_a_region_leaves_the_rest_out(tmp_path):
    levels, masks = drawn_samples(bad=0)
    levels[:, 0, :, 24:] = 0.0
    sets = write_samples(tmp_path, levels, masks)
    region = np.zeros(masks.shape[1:], np.uint8)
    region[:, 24:] = 1
    write_png(tmp_path / "region.png", region, metadata={})
    options = FromImagesOptions(images=3)
    result = optimize_from_images(sets, options=options, region=tmp_path / "region.png")
    assert [image.name for image in result.images] == ["led-2", "led-3", "led-4"]
    spotted = write_samples(tmp_path / "spotted", *drawn_samples())  # each spot lies left of the region
    write_png(tmp_path / "right.png", np.where(np.arange(48) >= 30, region, 0).astype(np.uint8), metadata={})
    warned: list[str] = []
    result = optimize_from_images(
        spotted, options=options, region=tmp_path / "right.png", run=RunContext(warn=warned.append)
    )
    assert result.evidence.surface_contrast is not None
    assert any(line.startswith("no defect can be used: signal over noise") for line in warned)
    outside = "4 defects not used, since the part or its region does not have the place: s5 1, s5 2, s6 1, s6 2"
    assert outside in warned
    region[:] = 0
    region[7, 7] = 1
    write_png(tmp_path / "region.png", region, metadata={})
    with pytest.raises(InputError, match="no window of 3 × 3 px lies within the part"):
        optimize_from_images(sets, options=options, region=tmp_path / "region.png")


def test_saturated_lights_are_named(tmp_path):
    levels, masks = drawn_samples()
    levels[:, 1] = 255.0
    warned: list[str] = []
    optimize_from_images(
        write_samples(tmp_path, levels, masks), options=FromImagesOptions(images=1), run=RunContext(warn=warned.append)
    )
    assert any(line.startswith("saturated pixels, which show no defect: led-2 100.0 %") for line in warned)


@pytest.mark.parametrize("share", [1, 2])
def test_a_saturated_light_is_not_chosen_without_defects(tmp_path, share):
    levels, masks = drawn_samples(bad=0)
    levels[:, 1, :, : levels.shape[3] // share] = 255.0
    result = optimize_from_images(write_samples(tmp_path, levels, masks), options=FromImagesOptions(images=1))
    assert result.choice.lights != (1,)
    alone = [score(result.evidence.gains([i])) for i in range(4)]
    assert (alone[1] > 0.0) == (share == 2)
    assert alone[1] < 0.6 * min(alone[0], *alone[2:])


def test_a_defect_on_saturated_pixels_is_not_shown(tmp_path):
    levels, masks = drawn_samples(bad=1)
    levels[:5, 0] = 255.0  # the first light shows the first spot, as darker than what is saturated
    levels[5, 0] = np.where(masks[5] > 0, 200.0, 255.0)
    result = optimize_from_images(write_samples(tmp_path, levels, masks), options=FromImagesOptions(images=1))
    assert result.evidence.gains([0]) == pytest.approx(0.0)


@pytest.mark.parametrize("bad", [0, 2])
def test_lights_that_are_all_saturated_are_refused(tmp_path, bad):
    levels, masks = drawn_samples(bad=bad)
    sets = write_samples(tmp_path, np.full_like(levels, 255.0), masks)
    assert "each pixel of the part is saturated under each light" in refusal(sets)
    levels[:, :, 2:] = 255.0
    assert bad or "most of the part is black or saturated" in refusal(write_samples(tmp_path / "most", levels, masks))


def test_an_image_of_a_light_that_is_off_has_no_exposure(tmp_path):
    levels, masks = drawn_samples()
    levels[:, 1] = 0.0
    sets = write_samples(tmp_path, levels, masks)
    assert "99.9 % of the part's pixels are black under led-2" in refusal(sets, options=FromImagesOptions(images=4))
    assert len(optimize_from_images(sets, options=FromImagesOptions(images=3)).images) == 3


@pytest.fixture
def three(tmp_path):
    levels, masks = drawn_samples(good=2, bad=1)
    return write_samples(tmp_path, levels, masks), levels, masks


def refusal(sets, **given):
    with pytest.raises(InputError) as caught:
        optimize_from_images(sets, **{"options": FromImagesOptions(images=1), **given})
    return str(caught.value)


def test_a_mask_of_another_size_is_refused(tmp_path, three):
    sets, levels, masks = three
    small = write_set(tmp_path / "small", levels[2], masks[2, :20])
    assert "mask.png: a mask of 48 × 20 px for images of 48 × 36 px" in refusal([*sets, small])


def test_images_of_another_size_are_refused(tmp_path, three):
    sets, levels, _ = three
    cropped = write_set(tmp_path / "cropped", levels[0, :, :30])
    message = refusal([*sets, cropped])
    assert "led-1-0.png: expected 48 × 36 px, the size of images of" in message
    assert message.endswith("found 48 × 30 px")


def test_a_mask_of_no_posture_is_refused(tmp_path, three):
    sets, _, _ = three
    (sets[0] / "masks").mkdir()
    (sets[2] / "mask.png").rename(sets[0] / "masks" / "posture_0_5.png")
    message = refusal(sets)
    assert "posture_0_5.png: the set has no such posture; expected a name such as masks/posture_0_0.png" in message


@pytest.mark.parametrize("name", ["Mask.png", "masks.png", "mask-1.TIF", "masks/Posture_0_0.PNG", "masks/spot.png"])
def test_a_mask_of_another_name_is_refused(three, name):
    sets, _, _ = three
    (sets[2] / name).parent.mkdir(exist_ok=True)
    (sets[2] / "mask.png").rename(sets[2] / name)
    message = refusal(sets)
    assert f"{sets[2] / name}: " in message


def test_an_empty_mask_is_refused(three):
    sets, _, masks = three
    write_png(sets[2] / "mask.png", 0 * masks[2], metadata={})
    assert f"{sets[2] / 'mask.png'}: 0 everywhere; expected a mask that is not 0 on defects" in refusal(sets)


def test_a_picture_that_is_not_used_is_said(three):
    sets, _, masks = three
    write_png(sets[0] / "spots.png", masks[2], metadata={})
    warned: list[str] = []
    optimize_from_images(sets, options=FromImagesOptions(images=1), run=RunContext(warn=warned.append))
    assert warned[0].startswith(f"{sets[0] / 'spots.png'}: not used: the manifest does not list it")


def with_geometry(folder, channels, defects=None):
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    if channels:
        write_exr(folder / "g.exr", {name: np.asarray(own, np.float32) for name, own in channels.items()}, metadata={})
        manifest["geometry"] = [{"posture": POSTURE, "exr": "g.exr"}]
    manifest |= {} if defects is None else {"defects": defects}
    (folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")


@pytest.mark.parametrize(
    ("channels", "defects", "message"),
    [
        ({"P.X": 0}, None, "g.exr: expected a channel Z, found P.X; render the set anew"),
        ({"Z": 1, "small": True}, None, "g.exr: geometry of 20 × 20 px for images of 48 × 36 px; render the set anew"),
        ({"Z": 1, "defect": 7}, [{"name": "a"}], "g.exr: channel defect: expected -1 to 0, as the manifest lists 1"),
        ({"Z": 1, "defect": np.nan}, [{"name": "a"}], "g.exr: channel defect: expected -1 to 0"),
        ({"Z": 1}, [{"name": "a"}], "g.exr: expected a channel defect, found Z; render the set anew, or add masks"),
        ({}, ["a"], "the manifest lists defects, but no geometry of posture (0°, 0°) shows where they are"),
    ],
)
def test_foreign_geometry_is_refused(three, channels, defects, message):
    sets, _, _ = three
    size = (20, 20) if channels.pop("small", False) else (36, 48)
    with_geometry(sets[0], {name: np.full(size, value) for name, value in channels.items()}, defects)
    assert message in refusal(sets)


def test_rendered_defects_need_no_name(three):
    sets, _, masks = three
    (sets[2] / "mask.png").unlink()
    with_geometry(
        sets[2], {"Z": np.ones(masks[2].shape), "defect": np.where(masks[2] > 0, 1, -1)}, ["a", {"kind": "b"}]
    )
    result = optimize_from_images(sets, options=FromImagesOptions(images=1))
    assert result.evidence.defects == (("s2", "2"),)


def test_sets_of_other_lights_exposures_or_sensors_are_refused(tmp_path, three):
    sets, levels, _ = three
    other = write_set(tmp_path / "other", levels[0], lights=["led-1", "led-2", "led-3", "top"])
    longer = write_set(tmp_path / "longer", levels[0], exposure=2.0)
    deeper = write_set(tmp_path / "deeper", levels[0], black_level=4)
    message = refusal([*sets, other, longer, deeper])
    assert "other: no image of light 'led-4' at exposure 1 in posture (0°, 0°)" in message
    assert "s0: no image of light 'top' at exposure 1" in message
    assert "longer: no image of light 'led-1' at exposure 1 in posture (0°, 0°) and 3 images more" in message
    assert "deeper: black_level: 4, but" in message


def test_other_bad_input_is_refused(tmp_path, three):
    sets, levels, _ = three
    assert "given twice" in refusal([*sets, sets[0]])
    assert "option 'images': expected a number from 1 to 4" in refusal(sets, options=FromImagesOptions(images=5))
    assert "false_alarms" in refusal(sets, options=FromImagesOptions(images=1, false_alarms=2.0))
    dark = write_set(tmp_path / "dark", 0.0 * levels[0])
    assert "no pixel is brighter than 2% of full scale" in refusal([dark])
    assert "none of the chosen images: expected led-" in refusal(
        sets, captured=write_set(tmp_path / "captured", levels[0, :1], lights=["ring"])
    )
    white = write_set(tmp_path / "white", np.full_like(levels[0], 255.0))
    assert f"{white}: each pixel of the part is saturated" in refusal(sets, captured=white)
    write_png(tmp_path / "nothing.png", np.zeros(levels.shape[2:], np.uint8), metadata={})
    assert "nothing.png: 0 everywhere" in refusal(sets, region=tmp_path / "nothing.png")


def test_the_command_without_sets_says_what_is_missing(cli):
    ran = cli("optimize", "--from-images", "-o", "out")
    assert ran.status == 2
    assert "SETS" in ran.err
    assert run(["optimize", "--from-images", "--help"]) == 0
