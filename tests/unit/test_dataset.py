"""``lightopt dataset``: layouts of MVTec AD, COCO and YOLO, masks, marks of invisible defects, runs that go on."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from lightopt import load_part, load_rig
from lightopt.config import RangesConfig
from lightopt.dataset import DatasetOptions, _dataset, _draws, _formats, _pose, _visibility
from lightopt.defects import expected_change
from lightopt.images import read_exr, read_png
from lightopt.rendering import render_posture
from lightopt.scene import Lens, build_catalogue, build_scene

CATALOGUE = """\
defect_catalogue:
  - {name: knock, kind: dent, size_mm: 4, slope_deg: 8, size_range: [0.5, 1.5]}
  - {name: line, kind: scratch, size_mm: [6, 1.5], slope_deg: 12, slope_range: [0.1, 1]}
  - {name: "a spot: dark", kind: stain, size_mm: [4, 3], R_d_factor: 0.4}
"""
RANGES = """\
format: lightopt-ranges/1
samples_per_pose: 3
defective: 0.8
pose: {shift_mm: 0.5, rotation_deg: 1}
split: {train: 0.5, val: 0.25, test: 0.25}
"""
FACTORS = _draws.Factors((1.0, 1.0), (1.0, 1.0), (1.0, 1.0), {})
VIEWS = ("light1", "light3", "fused")
SIZE = (160, 120)


def with_catalogue(bench):
    bench.part.write_text(bench.part.read_text(encoding="utf-8") + CATALOGUE, encoding="utf-8")
    (bench.folder / "ranges.yaml").write_text(RANGES, encoding="utf-8")
    return bench


@pytest.fixture(scope="module")
def made(shared_bench, tmp_path_factory):
    """A dataset of twelve samples in four poses, made by one thread."""
    from lightopt.cli._main import run

    bench = with_catalogue(shared_bench.make(tmp_path_factory.mktemp("dataset") / "bench"))
    assert run([*command(bench), "--threads", "1", "-q"]) == 0
    return bench


def command(bench, out=None, *, images=12, seed=3):
    return [
        *("dataset", str(bench.rig), str(bench.part), "-o", str(out or bench.out)),
        *("--images", str(images), "--seed", str(seed), "--ranges", str(bench.folder / "ranges.yaml")),
    ]


def samples_of(folder):
    records = [json.loads(p.read_text(encoding="utf-8")) for p in sorted((folder / "poses").glob("*.json"))]
    return [sample for record in records for sample in record["samples"]]


# --- what is written


@pytest.mark.slow
@pytest.mark.usefixtures("real_template_banks")
def test_the_same_bytes_by_two_threads(made, tmp_path, cli, snapshot):
    ran = cli(*command(made, tmp_path / "again"), "--threads", 2)
    assert (ran.status, ran.err) == (0, "")
    first, second, *paths = ran.out.splitlines()
    assert first == "12 samples, 24 images, 4 poses"
    assert "visible in the images of their sample" in second
    assert paths == [str(tmp_path / "again" / name) for name in ("dataset.json", "datasheet.md", "samples.csv")]
    assert snapshot(tmp_path / "again") == snapshot(made.out)


def test_there_are_defects_of_each_fate(made):
    defects = [one for sample in samples_of(made.out) for one in sample["defects"]]
    assert {one["kind"] for one in defects} == {"dent", "scratch", "stain"}
    for view in ("stack", "light1", "light3"):
        assert {one["visibility"][view]["visible"] for one in defects} == {True, False}, view


def test_the_table_says_where_each_sample_is_and_poses_stay_together(made):
    rows = list(csv.DictReader((made.out / "samples.csv").read_text(encoding="utf-8").splitlines()))
    assert [int(row["sample"]) for row in rows] == list(range(12))
    assert {row["split"] for row in rows} == {"train", "val", "test"}
    for row in rows:
        assert {other["split"] for other in rows if other["pose"] == row["pose"]} == {row["split"]}
        for view in VIEWS:
            assert read_png(made.out / row[view]).shape == SIZE[::-1]
    assert {(row["elevation_deg"], row["rotation_deg"]) for row in rows} == {("0.0", "0.0"), ("-10.0", "170.0")}


@pytest.mark.parametrize("view", VIEWS)
def test_a_reader_of_mvtec_ad_finds_a_mask_for_each_bad_image(made, view):
    # as anomalib reads a category: split, label and name are the last three parts of a path; masks and bad images of
    # the test pair by their order, and the name of an image is in that of its mask
    root = made.out / view / "images"
    found = sorted(path.relative_to(root).parts for path in root.rglob("*.png"))
    assert {len(parts) for parts in found} == {3}
    assert {split for split, _, _ in found} <= {"train", "test", "ground_truth"}
    assert {label for split, label, _ in found if split == "train"} == {"good"}
    bad = [parts[1:] for parts in found if parts[0] == "test" and parts[1] != "good"]
    masks = [parts[1:] for parts in found if parts[0] == "ground_truth"]
    assert len(bad) == len(masks) > 0
    for (kind, image), (of_kind, mask) in zip(bad, masks, strict=True):
        assert kind == of_kind
        assert image.removesuffix(".png") in mask
        levels = read_png(root / "ground_truth" / of_kind / mask)
        assert set(np.unique(levels)) == {0, 255}


@pytest.mark.parametrize("view", VIEWS)
def test_a_detector_of_mvtec_ad_is_tested_in_poses_that_it_has_not_learnt(made, view):
    poses: dict[str, set[int]] = {"train": set(), "test": set()}
    for one in samples_of(made.out):
        parts = one["files"][view].split("/")
        if parts[1] == "images":
            poses[parts[2]].add(one["pose"])
        mask = _formats.mask_name(one["files"][view])
        assert mask is None or (made.out / mask).is_file()
        shown = any(each["visibility"][view]["visible"] for each in one["defects"])
        assert (mask is not None) == shown
        assert (parts[1] == "train_defects") == (shown and one["split"] == "train")
    assert poses["train"]
    assert poses["test"]
    assert not poses["train"] & poses["test"]


@pytest.mark.parametrize("view", VIEWS)
def test_coco_lists_images_masks_and_marks(made, view):
    samples, seen = {one["sample"]: one for one in samples_of(made.out)}, 0
    for split in ("train", "val", "test"):
        found = json.loads((made.out / view / f"coco-{split}.json").read_text(encoding="utf-8"))
        categories = {one["id"]: one["name"] for one in found["categories"]}
        images = {one["id"]: one for one in found["images"]}
        assert len({one["id"] for one in found["annotations"]}) == len(found["annotations"])
        for number, image in images.items():
            assert samples[number - 1]["split"] == split
            assert (image["width"], image["height"]) == SIZE
            assert (made.out / view / image["file_name"]).is_file()
        for one in found["annotations"]:
            defects = samples[one["image_id"] - 1]["defects"]
            defect = next(each for each in defects if each["box_px"] == one["bbox"])
            assert categories[one["category_id"]] == defect["kind"]
            assert one["iscrowd"] == (not defect["visibility"][view]["visible"])
            # COCO: run lengths for what is left out, polygons for objects
            assert isinstance(one["segmentation"], dict if one["iscrowd"] else list)
            mask = filled(one["segmentation"])
            row, column = np.nonzero(mask)
            assert one["area"] == mask.sum()
            assert one["bbox"] == [column.min(), row.min(), np.ptp(column) + 1, np.ptp(row) + 1]
            seen += 1
    assert seen == sum(len(one["defects"]) for one in samples.values())


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # its own, of NumPy 2
@pytest.mark.parametrize("view", VIEWS)
def test_pycocotools_loads_and_evaluates_a_dataset(made, view, capsys):
    coco = pytest.importorskip("pycocotools.coco")
    evaluation = pytest.importorskip("pycocotools.cocoeval")
    samples = {one["sample"]: one for one in samples_of(made.out)}
    for split in ("train", "test"):
        found = coco.COCO(made.out / view / f"coco-{split}.json")
        found.info()
        for one in found.loadAnns(found.getAnnIds()):
            np.testing.assert_array_equal(found.annToMask(one), filled(one["segmentation"]))
        visible = found.loadAnns(found.getAnnIds(iscrowd=False))
        own = [one for one in samples.values() if one["split"] == split]
        assert len(visible) == sum(each["visibility"][view]["visible"] for one in own for each in one["defects"]) > 0
        # a detector that finds all that is visible, and nothing else
        keys = "image_id", "category_id"
        results = [
            {key: one[key] for key in keys} | {"segmentation": found.annToRLE(one), "score": 1.0} for one in visible
        ]
        detections = found.loadRes(results)
        judged = evaluation.COCOeval(found, detections, "segm")
        judged.evaluate()
        judged.accumulate()
        judged.summarize()
        assert judged.stats[0] == pytest.approx(1.0)
    assert "Average Precision" in capsys.readouterr().out


def filled(segmentation):
    """The mask of a segmentation: of polygons the pixels whose centres are inside, by counting crossed edges."""
    width, height = SIZE
    mask = np.zeros((height, width), np.bool_)
    if isinstance(segmentation, dict):
        assert segmentation["size"] == [height, width]
        assert sum(segmentation["counts"]) == width * height
        mask.reshape(-1)[_formats.pixels_of(segmentation)] = True
        return mask
    y, x = np.mgrid[:height, :width] + 0.5
    for polygon in segmentation:
        corners = np.reshape(polygon, (-1, 2))
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            crossed = (a[1] > y) != (b[1] > y)
            mask ^= crossed & (x < a[0])  # edges are vertical or horizontal
    return mask


def test_outlines_and_run_lengths_are_the_mask():
    rng, width, height = np.random.default_rng(1), *SIZE
    for density in (0.02, 0.3, 0.6):
        mask = np.zeros((height, width), np.bool_)
        mask[40:60, 70:90] = rng.random((20, 20)) < density
        pixels = np.flatnonzero(mask)
        runs = _formats.run_lengths(pixels, height, width)
        np.testing.assert_array_equal(filled(runs), mask)
        shapes = _formats.outlines(pixels, width)
        if shapes is not None:
            np.testing.assert_array_equal(filled(shapes), mask)
    ring = np.zeros((height, width), np.bool_)
    ring[10:20, 10:20], ring[13:16, 13:16] = True, False
    assert _formats.outlines(np.flatnonzero(ring), width) is None
    corners = np.array([0, width - 1, (height - 1) * width, height * width - 1])
    np.testing.assert_array_equal(_formats.pixels_of(_formats.run_lengths(corners, height, width)), corners)


@pytest.mark.parametrize("view", VIEWS)
def test_yolo_has_a_box_around_each_visible_defect(made, view):
    listed = 0
    for sample in samples_of(made.out):
        name = sample["files"][view]
        names = (made.out / view / f"{sample['split']}.txt").read_text(encoding="utf-8").splitlines()
        own = f"./{name.removeprefix(f'{view}/')}"
        assert (own in names) == ("/invisible/" not in name)
        if own not in names:
            continue
        listed += 1
        # as YOLO finds the labels of an image
        label = (made.out / view / own.replace("/images/", "/labels/")).with_suffix(".txt")
        rows = [line.split() for line in label.read_text(encoding="utf-8").splitlines()]
        visible = [one for one in sample["defects"] if one["visibility"][view]["visible"]]
        kinds = ["dent", "scratch", "stain"]
        assert [kinds[int(row[0])] for row in rows] == [one["kind"] for one in visible]
        for row, one in zip(rows, visible, strict=True):
            middle_x, middle_y, width, height = (float(x) for x in row[1:])
            box = (middle_x - width / 2) * SIZE[0], (middle_y - height / 2) * SIZE[1], width * SIZE[0], height * SIZE[1]
            assert box == pytest.approx(one["box_px"], abs=1e-3)
    assert listed
    assert "  2: stain\n" in (made.out / view / "data.yaml").read_text(encoding="utf-8")


def test_a_pose_has_normals_and_nominal_images(made):
    channels = read_exr(made.out / "poses" / "pose-000000.exr")
    assert set(channels) == {*(f"{k}.{axis}" for k in "PN" for axis in "XYZ"), "light1.Y", "light3.Y"}
    length = np.sqrt(sum(channels[f"N.{axis}"] ** 2 for axis in "XYZ"))
    assert set(np.unique(np.round(length, 3))) == {0.0, 1.0}
    good = next(one for one in samples_of(made.out) if one["pose"] == 0)
    level = read_png(made.out / good["files"]["light1"]).astype(np.float64)
    nominal = np.clip(channels["light1.Y"], 0.0, 255.0)
    assert np.median(np.abs(level - nominal)[length > 0.5]) < 5.0


def test_the_datasheet_names_what_is_random_and_what_is_shared(made):
    text = (made.out / "datasheet.md").read_text(encoding="utf-8")
    for words in ("± 0.5 mm along X and Y, ± 1°", "Up to 3 samples share a pose", "0.05 false alarms", "| stain |"):
        assert words in text


# --- masks and marks are those of rendered images


@pytest.fixture(scope="module")
def pose(made):
    """The first pose of the dataset with a sample of several defects, and what it is made from."""
    rig, part = load_rig(made.rig), load_part(made.part)
    # without noise, what differs is the defects
    options = DatasetOptions(images=3, seed=5, fusion=None)
    ranges = RangesConfig(format="lightopt-ranges/1", defects=(5, 5), defective=1.0)
    factors, catalogue = _draws.factors_of(ranges, rig, part), build_catalogue(part)
    setup = _draws.Setup(rig, part, options, ranges, factors, catalogue, threads=1)
    draw = _draws.draw_poses(setup)[0]
    rendered = _pose.render_pose(setup, draw)
    sample = _draws.draw_sample(setup, 0)
    limits = _pose.posture_limits(setup, draw.posture)
    return rendered, sample, limits, catalogue


def silent(rendered, sample, **lights):
    """The pose by a camera of 16 bits without noise, and the sample with the nominal reflectance and no dust."""
    sensor = replace(rendered.scene.sensor, bit_depth=16, read_noise_levels=0.0, electrons_per_level=None)
    plain = replace(sample, R_d=1.0, R_s=1.0, gains=(1.0, 1.0), dust=np.zeros((0, 2)), places=np.zeros((0, 3)))
    return replace(rendered, scene=replace(rendered.scene, sensor=sensor)), replace(plain, **lights)


def levels_of(images):
    return [levels.ravel() * (255.0 / 65535.0) for levels in images.levels]


def test_masks_are_where_rendered_images_differ(pose):
    rendered, sample, limits, _ = pose
    images = _pose.sample_images(*silent(rendered, sample), limits)
    assert len(images.defects) >= 3
    spoilt = replace(rendered.waved, defects=tuple(one.placed for one in images.defects))
    whole = np.ones(SIZE[::-1], np.bool_)
    truth = render_posture(spoilt, rendered.view.posture, caster=rendered.caster, averaged=whole, threads=1)
    mask = np.zeros(whole.size, np.bool_)
    for one in images.defects:
        mask[one.pixels] = True
    for level, exact, good in zip(levels_of(images), truth.lights, rendered.actual.lights, strict=True):
        expected, before = (np.clip(image.level.ravel(), 0.0, 255.0) for image in (exact, good))
        # off the masks nothing changes; in them what a rendering of all pixels has, to what few rays in each leave
        np.testing.assert_allclose(level[~mask], before[~mask], atol=0.003)
        assert np.abs(level - expected)[mask].mean() < 0.05 * np.abs(expected - before)[mask].mean() + 0.05
        assert mask[np.abs(exact.level - good.level).ravel() > 0.5].mean() > 0.98


def test_brightness_and_dust_are_those_of_linear_images(pose):
    rendered, sample, limits, _ = pose
    plain = _pose.sample_images(*silent(rendered, sample, kinds=()), limits)
    place = float(np.argmax(rendered.view.predicted[0].ravel()[rendered.flat] > 20.0)) + 0.5
    brighter = {"R_d": 1.1, "R_s": 0.9, "gains": (0.5, 2.0)}
    dust = {"dust": np.array([[3.0, 80.0]]), "places": np.array([[place / len(rendered.flat), 0.5, 0.5]])}
    lit = _pose.sample_images(*silent(rendered, sample, kinds=(), **brighter, **dust), limits)
    ((pixels, cover, _),) = _pose._dust(rendered, replace(sample, **dust))
    assert cover.max() == 1.0
    clean = np.setdiff1d(np.arange(SIZE[0] * SIZE[1]), pixels)
    for light, (got, before) in enumerate(zip(levels_of(lit), levels_of(plain), strict=True)):
        image, gain = rendered.actual.lights[light], brighter["gains"][light]
        expected = gain * (1.1 * image.diffuse.ravel() + 0.9 * image.specular.ravel())
        np.testing.assert_allclose(got[clean], np.clip(expected, 0.0, 255.0)[clean], atol=0.01)
        np.testing.assert_allclose(before, np.clip(image.level.ravel(), 0.0, 255.0), atol=0.003)
        grain = gain * 80.0 * image.diffuse.ravel() / 45.0
        inner = pixels[cover == 1.0]
        np.testing.assert_allclose(got[inner], np.clip(grain, 0.0, 255.0)[inner], atol=0.01)


@pytest.mark.nightly
def test_a_lens_blurs_defects_over_their_masks(pose, made):
    _, sample, limits, _ = pose
    scene = build_scene(load_rig(made.rig), load_part(made.part), defects=False)
    blurred = replace(scene, camera=replace(scene.camera, lens=Lens(aperture=4.0, focus=480.0)))
    setup = replace(pose[0].setup, ranges=RangesConfig(format="lightopt-ranges/1"), factors=FACTORS)
    setup.__dict__["scene"] = blurred
    draw = _draws.draw_poses(setup)[0]
    seen = _pose.render_pose(setup, draw)
    assert seen.blur > 1.0
    images = _pose.sample_images(*silent(seen, sample, rng=np.random.default_rng(1)), limits)
    spoilt = replace(seen.waved, defects=tuple(one.placed for one in images.defects))
    truth = render_posture(spoilt, draw.posture, caster=seen.caster, threads=1)
    mask = np.zeros(SIZE[0] * SIZE[1], np.bool_)
    for one in images.defects:
        mask[one.pixels] = True
    beyond = 0
    for level, exact, good in zip(levels_of(images), truth.lights, seen.actual.lights, strict=True):
        expected, before = (np.clip(image.level.ravel(), 0.0, 255.0) for image in (exact, good))
        changed = np.abs(level - before) > 0.1
        np.testing.assert_allclose(level[changed], expected[changed], atol=0.02)
        beyond += int((changed & ~mask).sum())
    assert beyond


def test_marks_are_the_statistic_of_inspections(pose):
    rendered, sample, limits, _ = pose
    images = _pose.sample_images(rendered, sample, limits)
    view, deviation = rendered.view, rendered.deviation
    for one in images.defects:
        spoilt = replace(rendered.waved, defects=(one.placed,))
        whole = np.ones(SIZE[::-1], np.bool_)
        truth = render_posture(spoilt, view.posture, caster=rendered.caster, averaged=whole, threads=1)
        energies = []
        for light, exact in enumerate(truth.lights):
            good, varied, noise, limit = (
                a.astype(np.float64) for a in (view.predicted[light], exact.level, deviation[light], view.limit[light])
            )
            change = expected_change(good, varied, deviation=noise, limit=limit)
            judged = np.zeros(whole.shape, np.bool_)
            judged.reshape(-1)[one.pixels] = True
            energies.append(float((change[judged & view.clean] ** 2).sum()))
        threshold = limits.thresholds[one.placed.name]
        for name, each in one.visibility.items():
            if name != "stack":
                assert each.visible == (each.z >= threshold)
        if one.placed.shape.kind != "scratch":  # of which the best segment counts
            found = [one.visibility[name].z for name in ("light1", "light3")]
            assert found == pytest.approx(np.sqrt(energies), rel=0.1, abs=0.3)
            assert one.visibility["stack"].z == pytest.approx(np.sqrt(sum(energies)), rel=0.1, abs=0.3)


def test_a_scratch_is_as_visible_as_its_best_segment_and_no_image_decides_alone(pose):
    *_, catalogue = pose
    line = next(one for one in catalogue if one.shape.kind == "scratch")
    narrow = replace(line, shape=replace(line.shape, length=12.0, width=0.5))  # segments of 3 mm
    along = np.linspace(0.0, 12.0, 120)
    level, noise = np.full((2, 120), 50.0), np.ones((2, 120))
    change = np.where(along < 3.0, 2.0, 1.0)
    how = {"deviation": noise, "limit": np.full((2, 120), 250.0), "along": along}
    whole, alone = _visibility.visibility_in_images(narrow, 5.0, level, level + change, **how)
    assert [one.z for one in alone] == pytest.approx([np.sqrt(4.0 * 30)] * 2, rel=0.05)
    assert whole.z == pytest.approx(np.sqrt(2.0) * alone[0].z)
    assert whole.visible
    only_first = np.stack([level[0] + change, level[1]])
    whole, alone = _visibility.visibility_in_images(narrow, 5.0, level, only_first, **how)
    assert alone[0].visible
    assert not whole.visible
    dark = np.stack([level[0], np.zeros(120)])
    whole, _ = _visibility.visibility_in_images(narrow, 5.0, dark, dark + change * [[1.0], [0.0]], **how)
    assert whole.visible  # the other light does not reach it


# --- runs that go on, are refused, or replace


@pytest.mark.slow
def test_a_stopped_run_goes_on_and_a_finished_one_is_left_alone(made, tmp_path, cli, snapshot, monkeypatch):
    folder = tmp_path / "set"
    count, write = [0], _dataset.write_png

    def stop(*arguments, **options):
        count[0] += 1
        if count[0] == 25:
            raise KeyboardInterrupt
        return write(*arguments, **options)

    monkeypatch.setattr(_dataset, "write_png", stop)
    assert cli(*command(made, folder)).status == 130
    monkeypatch.undo()
    assert not json.loads((folder / "dataset.json").read_text(encoding="utf-8"))["complete"]
    shutil.copytree(folder, tmp_path / "other")
    assert cli(*command(made, tmp_path / "other", images=2, seed=4), "--force").status == 0
    assert cli(*command(made, tmp_path / "new", images=2, seed=4)).status == 0
    assert snapshot(tmp_path / "other") == snapshot(tmp_path / "new"), "nothing of the pose that was stopped is left"
    (tmp_path / "other" / "poses" / "pose-000000.json").write_text('{"files": 1}', encoding="utf-8")
    assert cli(*command(made, tmp_path / "other", images=2, seed=5), "--force").status == 0
    ran = cli(*command(made, folder))
    assert (ran.status, ran.err) == (0, "")
    assert ran.out.startswith("12 samples, 24 images, 4 poses (")
    assert snapshot(folder) == snapshot(made.out)
    next((folder / "light1" / "images").rglob("*.png")).unlink()
    assert "(3 of them existed already)" in cli(*command(made, folder)).out
    assert snapshot(folder) == snapshot(made.out)
    (folder / "poses" / "pose-000001.json").write_text('{"files": 1}', encoding="utf-8")
    assert "(3 of them existed already)" in cli(*command(made, folder)).out
    assert snapshot(folder) == snapshot(made.out)
    monkeypatch.setattr(_draws, "build_scene", None)
    assert "(4 of them existed already)" in cli(*command(made, folder)).out


@pytest.mark.slow
def test_a_dataset_of_other_inputs_is_refused_or_replaced(made, tmp_path, cli, snapshot):
    folder = tmp_path / "set"
    shutil.copytree(made.out, folder)
    (folder / "mine.txt").write_text("mine", encoding="utf-8")
    ran = cli(*command(made, folder, images=2, seed=4))
    assert ran.status == 2
    assert ran.err.startswith(f"error: {folder} already has a dataset of other inputs or with other options (")
    assert "options.seed: previously 3, now 4" in ran.err
    assert "--force" in ran.err
    assert cli(*command(made, folder, images=2, seed=4), "--force").status == 0
    assert cli(*command(made, tmp_path / "new", images=2, seed=4)).status == 0
    assert (folder / "mine.txt").read_text(encoding="utf-8") == "mine"
    (folder / "mine.txt").unlink()
    assert snapshot(folder) == snapshot(tmp_path / "new")


def test_a_folder_with_files_of_others_is_refused(made, tmp_path, cli):
    (tmp_path / "light1").mkdir()
    ran = cli(*command(made, tmp_path), "--force")
    assert ran.status == 2
    assert ran.err == (f"error: {tmp_path} has light1, which no dataset lists; choose another folder\n")


# --- what is wrong


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--fusion", "mean"), '--fusion: expected paper, median, minimum, second-largest or none, found "mean"'),
        (("--false-alarms", "0"), "--false-alarms: expected a number from 1e-9 to 1, found 0"),
        (("--images", "2000000"), "--images: expected 1 to 1,000,000 samples, found 2000000"),
    ],
)
def test_wrong_options_are_named(made, tmp_path, cli, options, words):
    ran = cli(*command(made, tmp_path / "x"), *options)
    assert ran.status == 2
    assert words in ran.err
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("samples_per_pose: 3", "samples_per_pose: 0", ":2: samples_per_pose: expected a whole number from 1 to 1000"),
        ("test: 0.25", "test: 0.5", ":5: split.test: expected shares train, val and test that add up to 1, found 1.25"),
        ("defective", "defectiv", ':3: unknown key "defectiv"; did you mean "defective"?'),
        ("defective: 0.8", "R_d: [1.2, 1.1]", ":3: R_d: expected [low, high], found the low end 1.2 above"),
        ("defective: 0.8", "fit: nowhere.json", ":3: fit: no such file"),
        ("defective: 0.8", "fit: ranges.yaml", "cannot be read as the fit.json of a fit"),
        ("lightopt-ranges/1", "lightopt-part/1", "this is a part (lightopt-part/1); expected the ranges of a dataset"),
    ],
)
def test_wrong_ranges_are_named_with_their_line(bench, cli, old, new, words):
    with_catalogue(bench)
    bench.edit("ranges.yaml", old, new)
    ran = cli(*command(bench))
    assert ran.status == 2
    assert words in ran.err
    assert not bench.out.exists()


def test_a_light_may_not_have_the_name_of_a_folder(bench, cli):
    with_catalogue(bench).edit("rig.yaml", "name: light3", "name: Fused")
    ran = cli(*command(bench))
    assert ran.status == 2
    assert "a dataset has a folder Fused; give the light another name" in ran.err


def test_a_missing_package_is_named(bench, cli, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)
    ran = cli(*command(with_catalogue(bench)), "--stacks")
    assert ran.status == 2
    assert "--stacks: needs the package h5py; install it with: pip install lightopt[hdf5]" in ran.err


def test_intervals_of_a_fit_and_of_a_calibrated_rig_are_limits(bench):
    fit = {
        "format": "lightopt-fit/1",
        "values": {
            "R_d": {"interval_95": [40.5, 49.5]},
            "R_s": {"interval_95": [None, 13000.0]},
            "sigma_rad": {"interval_95": [0.046, 0.049]},
        },
        "gains": {"light1": {"interval_95": [0.9, 1.2]}},
    }
    (bench.folder / "fit.json").write_text(json.dumps(fit), encoding="utf-8")
    (bench.folder / "ranges.yaml").write_text("format: lightopt-ranges/1\nfit: fit.json\n", encoding="utf-8")
    from lightopt.config import load_ranges

    rig, part = load_rig(bench.rig), load_part(bench.part)
    found = _draws.factors_of(load_ranges(bench.folder / "ranges.yaml"), rig, part)
    assert found.R_d == pytest.approx((0.9, 1.1))
    assert found.R_s == (0.95, 1.05)  # an open interval limits nothing
    assert found.sigma == pytest.approx((0.046 / 0.0475, 0.049 / 0.0475))
    assert found.gains == {"light1": pytest.approx((0.9, 1.2)), "light3": (0.97, 1.03)}
    # of a table, the fit finds the factor on its angles
    fit["values"]["width_factor"] = {"interval_95": [0.8, 1.1]}
    (bench.folder / "fit.json").write_text(json.dumps(fit), encoding="utf-8")
    (bench.folder / "lobe.csv").write_text("0,1\n", encoding="utf-8")
    bench.edit("part.yaml", "sigma_rad: 0.0475", "model: measured, table: lobe.csv, width_factor: 2")
    found = _draws.factors_of(load_ranges(bench.folder / "ranges.yaml"), rig, load_part(bench.part))
    assert found.sigma == pytest.approx((0.4, 0.55))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"R_d": {"interval_95": [1.0]}}, "fit.json: R_d: expected interval_95: [low, high], found [1.0]"),
        ({"R_d": {"interval_95": ["a", 1.0]}}, "fit.json: R_d: expected interval_95: [low, high], found ['a', 1.0]"),
        ({"R_d": {"interval_95": [49.5, 40.5]}}, "R_d: expected interval_95: [low, high], found [49.5, 40.5]"),
        ({"R_d": {"interval_95": [-2.0, -1.0]}}, "R_d: expected interval_95: [low, high], found [-2.0, -1.0]"),
        ({"R_d": 45.0}, "fit.json: R_d: expected interval_95: [low, high], found 45.0"),
        ([45.0], "expected the fit.json that a fit wrote"),
    ],
)
def test_a_fit_that_was_edited_wrongly_is_refused(bench, cli, values, words):
    with_catalogue(bench).edit("ranges.yaml", "defective: 0.8", "fit: fit.json")
    (bench.folder / "fit.json").write_text(json.dumps({"format": "lightopt-fit/1", "values": values}), encoding="utf-8")
    ran = cli(*command(bench))
    assert ran.status == 2
    assert words in ran.err


def test_stacks_have_what_the_images_have(bench, cli):
    h5py = pytest.importorskip("h5py")
    with_catalogue(bench)
    assert cli(*command(bench, images=2), "--stacks", "-q").status == 0
    with h5py.File(bench.out / "stacks" / "pose-000000.h5") as file:
        samples = json.loads(file.attrs["samples"])
        assert list(file.attrs["lights"]) == ["light1", "light3"]
        assert file["normals"].shape == (3, *SIZE[::-1])
        for number, sample in enumerate(samples):
            for light, name in enumerate(file.attrs["lights"]):
                image = read_png(bench.out / sample["files"][name])
                np.testing.assert_array_equal(file["levels"][number, light], image)
            np.testing.assert_array_equal(file["fused"][number], read_png(bench.out / sample["files"]["fused"]))
            for label, defect in enumerate(sample["defects"], 1):
                own = _formats.pixels_of(defect["mask"])
                assert (file["defect"][number].reshape(-1)[own] == label).mean() > 0.9


@pytest.mark.slow
def test_postures_without_samples_and_parts_that_leave_the_view_are_said(bench, cli):
    with_catalogue(bench)
    ranges = bench.folder / "ranges.yaml"
    ranges.write_text(RANGES.replace("shift_mm: 0.5", "shift_mm: 60"), encoding="utf-8")
    wanted = "the part leaves the view in 1 pose of 1, as in pose 0; lower shift_mm of the ranges"
    for again in (False, True):  # the second run goes on with what is there
        if again:
            manifest = bench.out / "dataset.json"
            content = json.loads(manifest.read_text(encoding="utf-8"))
            manifest.write_text(json.dumps({**content, "complete": False}), encoding="utf-8")
        ran = cli(*command(bench, images=2))
        assert ran.status == 0, ran.err
        assert "no sample is in posture (-10°, 170°); more samples, or fewer samples per pose, help" in ran.err
        assert wanted in ran.err
