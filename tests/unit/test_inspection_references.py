"""References other than the model: a part's own neighbourhood, good parts; texture counts as noise."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import ndimage, stats

from lightopt import build_scene, load_part, load_rig
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.defects import SCALES_PX
from lightopt.estimate.registration import Placement, place_part
from lightopt.images import read_image_set, read_png, write_png
from lightopt.inspection import InspectOptions, PostureView, PredictionCache, inspect_set
from lightopt.inspection.calibration._systematic import PackedDeviations, SystematicSums, subtract_mean
from lightopt.inspection.detection._deviation import Deviations
from lightopt.inspection.detection._residual_score import (
    deviation_of_score,
    rank_scores,
    score_deviations,
    smoothed_deviations,
    threshold,
)
from lightopt.inspection.detection._texture import EDGE_PX, texture_threshold, whiten_texture
from lightopt.inspection.prediction._neighbourhood import _POWERS, RIDGE, _local_fit, neighbourhood_view
from lightopt.inspection.prediction._posture_view import Photometry
from lightopt.inspection.prediction._predict import Prediction
from lightopt.optics import expose, image_rng
from lightopt.rendering import cast_rays_at, render_posture

FLAT = Posture(0.0, 0.0)

# --- the neighbourhood


def view_of(level, *, clean=None, predicted=None, noise=1.0):
    """A view of levels, shape (lights, H, W); the model predicts 100 unless given."""
    level = np.asarray(level, np.float32)
    clean = np.ones(level.shape[1:], bool) if clean is None else clean
    prediction = Prediction(
        images=SimpleNamespace(lights=(), geometry=SimpleNamespace(hit=clean)),
        clean=clean,
        grazing=np.zeros_like(clean),
        area=np.ones(clean.shape, np.float32),
    )
    return PostureView(
        posture=FLAT,
        lights=tuple(f"light{i}" for i in range(len(level))),
        level=level,
        predicted=np.full_like(level, 100.0) if predicted is None else np.asarray(predicted, np.float32),
        deviation=np.full_like(level, noise),
        slack=np.zeros_like(level),
        limit=np.full_like(level, 250.0),
        saturated=np.zeros(level.shape, bool),
        prediction=prediction,
        photometry=Photometry(gains={}, dark=0.0),
    )


def quadratic(rows=160, columns=200):
    y, x = np.mgrid[:rows, :columns] / 100.0
    return 100.0 + 20.0 * x - 15.0 * y - 8.0 * x * x + 5.0 * x * y + 6.0 * y * y


def test_the_fit_is_that_of_least_squares_place_by_place():
    rng = np.random.default_rng(1)
    image, weight = rng.normal(50.0, 5.0, (14, 18)), rng.random((14, 18)) * (rng.random((14, 18)) < 0.8)
    width = 2.5
    (ours,) = _local_fit(width, weight, [image])
    reach = math.ceil(3.0 * width)
    rows, columns = np.mgrid[:14, :18]
    for y, x in ((0, 0), (7, 9), (13, 4)):
        p, q = rows - y, columns - x
        near = (np.abs(p) <= reach) & (np.abs(q) <= reach)
        w = (weight * np.exp(-0.5 * (p**2 + q**2) / width**2))[near]
        design = np.stack([(p[near] / width) ** a * (q[near] / width) ** b for a, b in _POWERS], axis=1)
        ridge = RIDGE * w.sum() * np.diag([1e-6, 1, 1, 1, 1, 1])
        theirs = np.linalg.solve(design.T @ (w[:, None] * design) + ridge, design.T @ (w * image[near]))
        assert ours[y, x] == pytest.approx([c * width ** -(a + b) for c, (a, b) in zip(theirs, _POWERS, strict=True)])


def test_the_neighbourhood_of_a_smooth_surface_is_the_surface_whatever_a_defect_does():
    level = quadratic()
    stained = level.copy()
    stained[60:85, 90:115] *= 0.6
    noisy = stained + np.random.default_rng(2).normal(0.0, 1.0, level.shape)
    view, known = neighbourhood_view(view_of([noisy]), 24.0)
    assert known.all()
    assert np.abs(view.predicted[0] - level).max() < 1.5
    assert np.abs(view.predicted[0] - level)[60:85, 90:115].max() < 1.0


def test_no_neighbourhood_reaches_over_an_edge_into_a_shadow_or_is_too_small():
    level = quadratic()
    clean = np.ones(level.shape, bool)
    clean[:, 98:102] = False  # a crease
    level[:, :100] *= 0.5
    clean[:20, :20], clean[4:12, 4:12] = False, True  # an island of 64 pixels
    predicted = np.full((1, *level.shape), 100.0)
    predicted[0, 120:] = 0.0
    level[120:] = 0.0
    view, known = neighbourhood_view(view_of([level], clean=clean, predicted=predicted), 20.0)
    assert np.array_equal(known[0], clean & (np.arange(160) < 120)[:, None] & ~ndimage.binary_erosion(~known[0]))
    assert not known[0, 4:12, 4:12].any()
    assert not view.clean[4:12, 4:12].any()
    assert np.abs(view.predicted[0] - level)[known[0]].max() < 0.3
    assert (view.predicted[0, 130:] == 0.0).all()


def test_what_the_model_has_and_the_neighbourhood_lacks_counts_as_noise():
    y, x = np.mgrid[:160, :200]
    spot = 80.0 * np.exp(-((y - 80) ** 2 + (x - 100) ** 2) / 50.0)
    level = quadratic() + spot
    view, _ = neighbourhood_view(view_of([level], predicted=[level]), 30.0)
    assert view.deviation[0, 80, 100] > 50.0
    assert view.deviation[0, 20, 20] < 1.3


# --- texture


def noise(lights=4, rows=240, columns=320, *, seed=0, along=0.0, strength=0.0, common=0.0):
    """White noise, and brush marks along the rows with a part that all images share."""
    rng = np.random.default_rng(seed)

    def marks():
        own = ndimage.gaussian_filter(rng.standard_normal((rows, columns)), (0.7, along))
        return strength * own / own.std()

    z = rng.standard_normal((lights, rows, columns))
    if strength:
        shared = marks()
        z += [math.sqrt(common) * shared + math.sqrt(1.0 - common) * marks() for _ in range(lights)]
    usable = np.zeros(z.shape, bool)
    usable[:, 10:-10, 12:-12] = True
    z = np.where(usable, z, 0.0).astype(np.float32)
    return Deviations(z, np.ones_like(z), usable, usable.copy())


def spreads(found):
    return [float(s[c].std()) for s, c in (smoothed_deviations(found, scale) for scale in SCALES_PX)]


def test_sensor_noise_alone_stays_as_it_is():
    found = noise()
    white = whiten_texture(found)
    assert spreads(white) == pytest.approx([1.0] * 3, abs=0.06)
    assert white.correlation == 0.0
    inside = white.usable[0]
    assert np.corrcoef(found.z[0][inside], white.z[0][inside])[0, 1] > 0.98
    assert np.array_equal(inside, ndimage.binary_erosion(found.usable[0], iterations=EDGE_PX))


def test_brush_marks_become_noise_of_variance_one_at_every_scale_and_a_defect_stays():
    found = noise(along=25.0, strength=8.0, common=0.5)
    assert min(spreads(found)) > 5.0
    white = whiten_texture(found)
    assert spreads(white) == pytest.approx([1.0] * 3, abs=0.12)
    # not only on average: at the ends of the marks, too
    for part in (np.s_[:, :, :30], np.s_[:, :, -30:], np.s_[:, :30], np.s_[:, -30:]):
        assert white.z[part][white.usable[part]].std() < 1.25
    z = found.z.copy()
    z[:, 100:106, 150:156] -= 12.0  # 1.5 times the spread of the marks
    before, after = (score_deviations(one, min_images=2) for one in (white, whiten_texture(replace(found, z=z))))
    assert after[100:106, 150:156].max() > 3.0 * before.max()


def test_a_strong_defect_leaves_no_echo_along_the_marks():
    found = noise(along=25.0, strength=8.0)
    z = found.z.copy()
    z[:, 100:106, 150:156] = 500.0
    plain, marked = whiten_texture(found).z, whiten_texture(replace(found, z=z)).z
    beside = np.s_[:, 95:111, 165:240]
    assert np.abs(marked[beside] - plain[beside]).max() < 2.5  # of 500


def test_the_law_of_correlated_images_is_that_of_draws():
    rng = np.random.default_rng(5)
    rho, count, k = 0.6, 4, 2
    draws = math.sqrt(rho) * rng.normal(size=400_000) + math.sqrt(1 - rho) * rng.normal(size=(count, 400_000))
    kth = np.sort(np.abs(draws), axis=0)[-k]
    chance = 10.0 ** -rank_scores(kth, count, k, rho)
    assert stats.kstest(chance, "uniform").statistic < 0.004
    independent = 10.0 ** -rank_scores(kth, count, k)
    assert np.mean(independent < 1e-4) > 5e-4  # which would make five times as many false alarms and more


@pytest.mark.parametrize("rho", [0.0, 0.5])
def test_the_deviation_that_has_a_score_is_the_inverse_of_the_law(rho):
    for k in (1, 2):
        z = deviation_of_score(6.0, 4, k, rho)
        # for independent images it is the leading term of the law
        assert rank_scores(np.array([z]), 4, k, rho)[0] == pytest.approx(6.0, abs=0.02)


@pytest.mark.parametrize(
    "common", [0.0, pytest.param(0.5, marks=pytest.mark.nightly), pytest.param(0.9, marks=pytest.mark.slow)]
)
def test_scores_on_texture_hold_their_rate(common):
    """Of 12 postures with 1 expected in 20, three or more happen with a probability of 2 %."""
    alarms = 0
    for seed in range(12):
        white = whiten_texture(noise(seed=seed, along=25.0, strength=6.0, common=common))
        assert white.correlation == pytest.approx(0.0, abs=0.12) if common == 0.0 else white.correlation > 0.1
        score = score_deviations(white, min_images=2)
        law = threshold(0.05, int(white.usable[0].sum()), len(SCALES_PX))
        alarms += bool(score.max() > texture_threshold(score, white, law, 0.05))
    assert alarms <= 2


def test_a_threshold_rises_with_heavy_scores_and_not_with_a_defect():
    found = noise()
    score = score_deviations(found, min_images=2)
    law = threshold(0.05, int(found.usable[0].sum()), len(SCALES_PX))
    assert texture_threshold(score, found, law, 0.05) < 1.2 * law
    assert texture_threshold(3.0 * score, found, law, 0.05) > 2.0 * law
    marked = found.z.copy()
    marked[:, 100:140, 100:140] += 30.0
    score = score_deviations(replace(found, z=marked), min_images=2)
    assert texture_threshold(score, found, law, 0.05) < 1.2 * law


# --- good parts


def test_a_place_that_few_good_parts_show_is_not_usable():
    found = noise(2, 60, 80)
    nominal = np.arange(60 * 80, dtype=np.int32).reshape(60, 80)
    sums = SystematicSums()
    for seed in range(6):
        one = noise(2, 60, 80, seed=seed + 1)
        seen = one.usable.copy()
        if seed:
            seen[:, :, :40] = False
        shown = replace(one, z=np.where(seen, one.z + 5.0, 0.0).astype(np.float32), usable=seen, lit=seen)
        sums.add(PackedDeviations.of(shown, nominal))
    after = subtract_mean(found, sums.systematic().where_known(), nominal)
    assert not after.usable[:, :, :40].any()
    assert np.array_equal(after.usable[:, :, 40:], found.usable[:, :, 40:])
    assert after.z[after.usable].mean() == pytest.approx(-5.0, abs=0.2)


# --- the command

PLATE = """\
format: lightopt-part/1
name: plate
mesh: {file: plate.stl, units: mm}
postures: [{elevation_deg: 0, rotation_deg: 0}]
reflectance: {R_d: 170, R_s: 0, sigma_rad: 0.1}
defect_catalogue: [{name: stain, kind: stain, size_mm: 3, R_d_factor: 0.7}]
"""


def write_plate(path, half_x, half_y):
    corners = np.array([[x, y, z] for z in (0, 2) for y in (-half_y, half_y) for x in (-half_x, half_x)], np.float32)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    data = np.zeros(len(faces), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")]))
    data["corners"] = corners[np.array(faces)]
    path.write_bytes(bytes(80) + np.uint32(len(data)).tobytes() + data.tobytes())


@pytest.fixture
def plate(bench):
    """A matte plate of 56 mm × 40 mm."""
    write_plate(bench.folder / "plate.stl", 28.0, 20.0)
    (bench.folder / "plate.yaml").write_text(PLATE, encoding="utf-8")
    return bench


def take(bench, name, seed, *, place=None, marks=0.0, print_=0.0, stain=0.0):
    """Images of the plate with brush marks of its own, a print that its model lacks, and a stain at its middle."""
    rig = load_rig(bench.rig)
    scene = build_scene(rig, load_part(bench.folder / "plate.yaml"), postures=(FLAT,))
    placed = place_part(scene, place or Placement())
    images = render_posture(placed, FLAT, caster=cast_rays_at(placed))
    points = images.geometry.points.astype(np.float64) - [placed.placement.translation[0], 0.0, 0.0]
    x, y = points[..., 0], points[..., 1]
    rng = np.random.default_rng([17, seed])
    factor = np.ones(x.shape)
    if marks:
        brushed = ndimage.gaussian_filter(rng.standard_normal(x.shape), (0.7, 15.0))
        factor += marks * brushed / brushed.std()
    factor -= print_ * (np.abs(np.hypot(x + 10.0, y) - 7.0) < 2.0)
    factor -= stain * (np.hypot(x - 12.0, y - 4.0) < 1.6)
    folder = bench.folder / name
    folder.mkdir()
    entries = []
    for number, image in enumerate(images.lights):
        draws = image_rng(seed, light=number, posture=0, exposure=0)
        levels = expose(image.level * factor, sensor=scene.sensor, exposure=1.0, full_scale=255.0, rng=draws)
        write_png(folder / f"{image.light}.png", levels, metadata={})
        light = next(one for one in rig.lights if one.name == image.light)
        angles = {"light_elevation_deg": light.elevation_deg, "light_azimuth_deg": light.azimuth_deg}
        shot = {"posture": FLAT.as_dict(), "exposure": 1.0, "png": f"{image.light}.png"}
        entries.append({"light": image.light, **angles, **shot})
    manifest = {"format": "lightopt-images/1", "kind": "captured", "bit_depth": 8, "full_scale": 255, "images": entries}
    (folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    return folder


def inspect(cli, bench, sets, *options, out="out"):
    sets = sets if isinstance(sets, list) else [sets]
    where = bench.folder / out
    return cli(
        "inspect", bench.rig, bench.folder / "plate.yaml", *sets, "-o", where, "--fusion", "none", *options
    )  # fmt: skip


def result(bench, out="out"):
    return json.loads((bench.folder / out / "defects.json").read_text(encoding="utf-8"))


def at_stain(defect):
    return math.dist(defect["position_mm"][:2], (12.0, 4.0)) < 2.0


def test_a_brushed_plate_is_compared_with_its_own_neighbourhood(cli, plate):
    good, bad = take(plate, "good", 1, marks=0.04), take(plate, "bad", 2, marks=0.04, stain=0.3)
    assert inspect(cli, plate, good, "--no-register", out="model").status == 0
    assert result(plate, "model")["verdict"] == "NG"  # brush marks are not in the model
    ran = inspect(cli, plate, good, "--no-register", "--reference", "self", out="good-out")
    assert ran.status == 0
    assert result(plate, "good-out")["verdict"] == "OK"
    ran = inspect(cli, plate, bad, "--no-register", "--reference", "self")
    (defect,) = result(plate)["defects"]
    assert at_stain(defect)
    assert "compared with: smooth neighbourhood of each place in the part's own images" in ran.out
    assert "reference self: deviations wider than the neighbourhood" in ran.err
    assert "with reference self, detector residual is used" in ran.err
    reference = result(plate)["reference"]
    assert reference["name"] == "self"
    assert "defects at edges are not found" in reference["limits"]
    page = (plate.out / "report.html").read_text(encoding="utf-8")
    assert "smooth neighbourhood of each place" in page
    assert result(plate)["provenance"]["options"]["reference"] == "self"


def test_good_parts_are_the_reference_of_a_print_that_the_model_lacks(cli, plate):
    places = [Placement(), Placement(x=0.3), Placement(y=-0.3), Placement(x=-0.2, y=0.2), Placement(x=0.1, y=0.3)]
    sets = [take(plate, f"g{i}", i, print_=0.4, place=place) for i, place in enumerate(places)]
    good, bad = take(plate, "good", 8, print_=0.4), take(plate, "bad", 9, print_=0.4, stain=0.2)
    assert inspect(cli, plate, good, "--no-register", "--reference", "self", out="self").status == 0
    options = ("--no-register", "--reference", "good-parts")
    ran = inspect(cli, plate, sets, *options, "--calibrate", "--false-alarms", "0.5", out="cal")
    assert ran.status == 0, ran.err
    calibration = plate.folder / "cal" / "calibration.json"
    ran = inspect(cli, plate, [good, bad], *options, "--calibration", calibration)
    assert ran.status == 0, ran.err
    assert result(plate, "out/good")["verdict"] == "OK"
    (defect,) = result(plate, "out/bad")["defects"]
    assert at_stain(defect)
    # a contrast with the level of good parts
    assert all(contrast == pytest.approx(-0.2, abs=0.08) for contrast in defect["sightings"][0]["contrast"].values())
    # another reference than it was made for, and the other way round
    ran = inspect(cli, plate, good, "--no-register", "--calibration", calibration, out="other")
    assert ran.status == 2
    assert "--reference: calibration.json was made with good-parts, found model" in ran.err


def test_good_parts_set_the_threshold_of_the_own_neighbourhood(cli, plate):
    sets = [take(plate, f"g{i}", i, marks=0.04) for i in range(5)]
    options = ("--no-register", "--reference", "self")
    ran = inspect(cli, plate, sets, *options, "--calibrate", "--false-alarms", "0.5", out="cal")
    assert ran.status == 0, ran.err
    peaks = json.loads((plate.folder / "cal" / "calibration.json").read_text(encoding="utf-8"))["postures"][0]["peaks"]
    bad = take(plate, "bad", 9, marks=0.04, stain=0.3)
    assert inspect(cli, plate, bad, *options, "--calibration", plate.folder / "cal").status == 0
    found = result(plate)
    assert found["postures"][0]["threshold"] == pytest.approx(max(3.0, *peaks), abs=1e-3)
    assert any(map(at_stain, found["defects"]))


def test_images_that_are_not_like_the_good_parts_are_refused(cli, plate):
    sets = [take(plate, f"g{i}", i, print_=0.8) for i in range(5)]
    options = ("--no-register", "--reference", "good-parts")
    assert inspect(cli, plate, sets, *options, "--calibrate", "--false-alarms", "0.5", out="cal").status == 0
    other = take(plate, "other", 9, marks=0.8)
    ran = inspect(cli, plate, other, *options, "--calibration", plate.folder / "cal")
    assert ran.status == 2
    assert "the images do not look like this part" in ran.err


def test_good_parts_need_a_calibration_and_the_message_says_how_to_make_one(cli, plate):
    ran = inspect(cli, plate, take(plate, "good", 1), "--reference", "good-parts")
    assert ran.status == 2
    assert "--reference: good-parts needs a calibration" in ran.err
    assert "make one with --calibrate" in ran.err
    assert not plate.out.exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--reference", "cad"), "--reference: expected model or good-parts or self"),
        (("--reference", "self", "--detector", "template", "--fusion", "median"), "is not for detector template"),
    ],
)
def test_options_that_do_not_go_together_are_refused(cli, plate, options, said):
    ran = cli("inspect", plate.rig, plate.folder / "plate.yaml", plate.folder, "-o", plate.out, *options)
    assert ran.status == 2
    assert said in ran.err


def test_results_do_not_depend_on_threads(cli, plate, snapshot):
    images = take(plate, "bad", 2, marks=0.04, stain=0.3)
    for threads in ("1", "3"):
        options = ("--no-register", "--reference", "self", "--threads", threads)
        assert inspect(cli, plate, images, *options, out=threads).status == 0
    assert snapshot(plate.folder / "1") == snapshot(plate.folder / "3")


@pytest.mark.slow
@pytest.mark.parametrize("reference", ["model", pytest.param("self", marks=pytest.mark.nightly), "good-parts"])
@pytest.mark.parametrize("whole_view", [False, pytest.param(True, marks=pytest.mark.nightly)])
def test_a_matte_plate_without_features_is_registered_as_far_as_its_outline_shows(cli, plate, reference, whole_view):
    if whole_view:
        write_plate(plate.folder / "plate.stl", 60.0, 50.0)
    place = Placement() if whole_view else Placement(x=0.35, y=-0.25)
    sets = [take(plate, f"g{i}", i, place=place) for i in range(5)]
    options = ["--reference", reference]
    if reference == "good-parts":
        learned = inspect(cli, plate, sets, *options, "--calibrate", "--false-alarms", "0.5", out="cal")
        assert learned.status == 0, learned.err
        options += ["--calibration", str(plate.folder / "cal")]
    ran = inspect(cli, plate, take(plate, "bad", 7, place=place, stain=0.15), *options)
    assert ran.status == 0, ran.err
    found = result(plate)
    assert sum(map(at_stain, found["defects"])) == 1
    assert len(found["defects"]) == 1
    if whole_view:
        assert "cannot be determined from these images; assumed as in the part file" in ran.err
    else:
        assert found["placement"]["x_mm"] == pytest.approx(0.35, abs=0.1)


@pytest.mark.slow
def test_parts_of_a_batch_that_only_their_outline_shows_are_registered_one_by_one(plate):
    """Levels inside the outline do not say that the second part lies elsewhere."""
    rig, part, cache = load_rig(plate.rig), load_part(plate.folder / "plate.yaml"), PredictionCache()
    found = []
    for number, x in enumerate((0.0, 0.4)):
        images = read_image_set(take(plate, f"g{number}", number, place=Placement(x=x)))
        options = InspectOptions(fusion=None, detector="residual")
        found.append(inspect_set(rig, part, images, options=options, cache=cache).placement.x)
    assert found[1] - found[0] == pytest.approx(0.4, abs=0.1)


def test_features_that_the_neighbourhood_does_not_predict_are_reported(cli, plate):
    images = take(plate, "printed", 3)
    rng, factor = np.random.default_rng(4), np.ones((120, 160))
    rows, columns = np.mgrid[:120, :160]
    for _ in range(120):
        middle, radius = rng.uniform((20.0, 20.0), (100.0, 140.0)), rng.uniform(1.0, 4.0)
        factor[np.hypot(rows - middle[0], columns - middle[1]) < radius] = rng.uniform(0.3, 0.9)
    for path in images.glob("*.png"):
        write_png(path, (read_png(path) * factor).astype(np.uint8), metadata={})
    ran = inspect(cli, plate, images, "--no-register", "--reference", "self")
    assert ran.status == 0, ran.err
    assert "texture or relief hides a disc of 5 px that changes the light by 20 % on" in ran.err
    assert "compare with good parts (--reference: good-parts)" in ran.err


def test_a_library_call_without_a_calibration_says_what_to_do(plate):
    images = read_image_set(take(plate, "good", 1))
    rig, part = load_rig(plate.rig), load_part(plate.folder / "plate.yaml")
    with pytest.raises(InputError, match="good-parts needs a calibration"):
        inspect_set(rig, part, images, options=InspectOptions(reference="good-parts"))
