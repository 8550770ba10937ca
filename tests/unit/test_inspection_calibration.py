"""Good parts teach thresholds that hold on others, whatever the law of their scores; what they share is no defect."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace

import numpy as np
import pytest

from lightopt.cli._main import run
from lightopt.images import read_image_set
from lightopt.inspection import least_rate
from lightopt.inspection.calibration._calibration import sets_needed, tolerance_limit
from lightopt.inspection.calibration._systematic import PackedDeviations, SystematicSums, subtract_systematic
from lightopt.inspection.detection._deviation import Deviations
from lightopt.inspection.detection._residual_score import score_deviations

# --- rates


@pytest.mark.parametrize(("rate", "sets"), [(0.5, 5), (0.2, 14), (0.1, 29), (0.05, 59), (0.01, 299)])
def test_so_many_good_sets_bear_a_rate_and_one_less_does_not(rate, sets):
    assert sets_needed(rate) == sets
    peaks = list(range(sets))
    assert tolerance_limit(peaks, rate) == sets - 1
    assert tolerance_limit(peaks[1:], rate) is None
    assert least_rate(sets) <= rate < least_rate(sets - 1)


@pytest.mark.parametrize("law", ["normal", "heavy"])
@pytest.mark.parametrize(("sets", "rate"), [(29, 0.1), (60, 0.1), (200, 0.05)])
def test_the_rate_is_held_19_times_in_20_whatever_the_law(law, sets, rate):
    rng = np.random.default_rng(3)
    held = []
    for _ in range(2000):
        draws = rng.standard_normal(sets) if law == "normal" else rng.standard_cauchy(sets)
        t = tolerance_limit(draws.tolist(), rate)
        tail = 0.5 * math.erfc(t / math.sqrt(2)) if law == "normal" else 0.5 - math.atan(t) / math.pi
        held.append(tail <= rate)
    assert 0.94 < np.mean(held) < 0.995


def test_more_good_sets_than_needed_lower_the_threshold():
    assert tolerance_limit(range(100), 0.05) == 98
    assert tolerance_limit(range(100), 0.2) == 86


# --- what good sets have in common


def images(n, *, shift=0, seed=0, common=None):
    """Residuals of good sets whose parts lie `shift` pixels to the right."""
    rng = np.random.default_rng(seed)
    rows, columns = 60, 80
    usable = np.zeros((2, rows, columns), bool)
    usable[:, 10:50, 10:60] = True
    row, column = np.mgrid[:rows, :columns]
    for _ in range(n):
        z = rng.standard_normal((2, rows, columns)).astype(np.float32)
        if common is not None:
            z += np.roll(common, shift, axis=2)
        nominal = (row * columns + column - shift).astype(np.int32)
        found = Deviations(np.where(usable, z, 0), np.full(z.shape, 2.0, np.float32), usable, usable)
        yield PackedDeviations.of(found, nominal), found, nominal


def blotch():
    row, column = np.mgrid[:60, :80]
    one = 4.0 * np.exp(-((row - 30) ** 2 + (column - 30) ** 2) / 18.0)
    return np.stack([one, -one]).astype(np.float32)


def test_noise_alone_stays_noise():
    sums = SystematicSums()
    for one, *_ in images(20):
        sums.add(one)
    learned = sums.systematic()
    one, found, nominal = next(images(1, seed=9))
    z = subtract_systematic(found, learned, nominal).z[found.usable]
    assert 0.85 < z.std() < 1.0
    assert np.abs(learned.mean).max() < 1.5
    assert learned.spread.max() < 1.6


def test_what_good_sets_share_goes_wherever_the_part_lies_and_a_defect_stays():
    sums = SystematicSums()
    for shift in (0, 3):
        for one, *_ in images(12, shift=shift, seed=shift, common=blotch()):
            sums.add(one)
    learned = sums.systematic()
    _, found, nominal = next(images(1, shift=5, seed=9, common=blotch()))
    assert score_deviations(found, min_images=2).max() > 20
    after = subtract_systematic(found, learned, nominal)
    assert score_deviations(after, min_images=2).max() < 6
    assert np.all(after.scale >= found.scale)
    defect = found.z.copy()
    defect[:, 20:24, 45:49] -= 6.0
    marked = subtract_systematic(replace(found, z=defect), learned, nominal)
    assert score_deviations(marked, min_images=2).max() > 20


def test_a_set_left_out_is_as_if_it_had_not_been_added():
    sets = [one for one, *_ in images(6, common=blotch())]
    whole, five = SystematicSums(), SystematicSums()
    for one in sets:
        whole.add(one)
    for one in sets[:-1]:
        five.add(one)
    left, never = whole.systematic(but=sets[-1]), five.systematic()
    assert np.allclose(left.mean, never.mean, atol=1e-4)
    assert np.allclose(left.spread, never.spread, atol=1e-3)


def test_where_few_sets_tell_nothing_is_learned():
    sums = SystematicSums()
    for i, (_, found, nominal) in enumerate(images(6, common=blotch())):
        usable = found.usable.copy()
        if i:
            usable[:, :, :40] = False
        reported = replace(found, z=np.where(usable, found.z, 0), usable=usable, lit=usable)
        sums.add(PackedDeviations.of(reported, nominal))
    learned = sums.systematic()
    assert np.all(learned.mean[:, :, :40] == 0.0)
    assert np.all(learned.spread[:, :, :40] == 1.0)


# --- the command

RATE = 0.5
SETS = 5
FIRST = ("--posture", "0,0")


def render(bench, part, out, seed, *options):
    command = ["render", bench.rig, part, "-o", out, "-q", "--patches", "300", "--noise", seed, *FIRST, *options]
    assert run([str(word) for word in command]) == 0
    return out


@pytest.fixture(scope="module")
def good(shared_bench, tmp_path_factory):
    """Image sets of good parts that shine differently from what the part's file says, and of a bad one."""
    folder = tmp_path_factory.mktemp("good")
    text = shared_bench.part.read_text(encoding="utf-8")
    assert "sigma_rad: 0.0475" in text
    other = shared_bench.part.with_name("shinier.yaml")
    other.write_text(text.replace("sigma_rad: 0.0475", "sigma_rad: 0.049"), encoding="utf-8")
    dent = (
        "defects:\n  - {name: stain, kind: stain, size_mm: 3.5, R_d_factor: 0.6, "
        "at_pixel: {posture: {elevation_deg: 0, rotation_deg: 0}, pixel: [58, 60]}}\n"
    )
    bad = shared_bench.part.with_name("shinier-bad.yaml")
    bad.write_text(other.read_text(encoding="utf-8") + dent, encoding="utf-8")
    sets = [render(shared_bench, other, folder / f"g{i:02}", i) for i in range(2 * SETS)]
    return sets, render(shared_bench, bad, folder / "bad", 99)


def inspect(cli, bench, sets, *options, out="out"):
    return cli(
        "inspect", bench.rig, bench.part, *sets, "-o", bench.folder / out, "--no-register", "--fusion", "none", *options
    )


def learned(cli, bench, sets, *options, out="cal"):
    ran = inspect(cli, bench, sets, "--calibrate", "--false-alarms", RATE, *options, out=out)
    assert ran.status == 0, ran.err
    reported = f"{SETS} good sets support a rate of {RATE} (share of good parts with a false alarm in a posture)"
    assert reported in ran.out
    return bench.folder / out / "calibration.json"


@pytest.fixture(scope="module")
def taught(shared_bench, good, tmp_path_factory):
    """What the first half of the good sets taught."""
    out = tmp_path_factory.mktemp("taught")
    command = ["inspect", shared_bench.rig, shared_bench.part, *good[0][:SETS], "-o", out, "--no-register", "-q"]
    options = ["--fusion", "none", "--calibrate", "--false-alarms", RATE]
    assert run([str(word) for word in (*command, *options)]) == 0
    return out / "calibration.json"


def found(folder):
    return json.loads((folder / "defects.json").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_a_calibration_holds_its_rate_on_other_good_sets_and_finds_defects(cli, bench, good, taught):
    sets, bad = good
    path = taught
    plain = inspect(cli, bench, sets[SETS:], out="plain")
    held = inspect(cli, bench, sets[SETS:], "--calibration", path, out="held")
    assert (plain.status, held.status) == (0, 0)
    alarms = {
        name: sum(bool(found(bench.folder / name / one.name)["defects"]) for one in sets[SETS:])
        for name in ("plain", "held")
    }
    assert alarms["plain"] == SETS  # the model is wrong, and every good part looks bad
    assert alarms["held"] <= 3  # more than the rate allows with a probability of 0.3 at most, and a fixed seed
    ran = inspect(cli, bench, [bad], "--calibration", path, out="bad")
    assert ran.status == 0
    result = found(bench.folder / "bad")
    assert result["provenance"]["inputs"]["calibration"]["file"] == "calibration.json"
    assert result["provenance"]["options"]["false_alarms"] == RATE
    truth = read_image_set(bad).manifest.extra["defects"][0]
    assert any(math.dist(one["position_mm"], truth["position_mm"]) < 2.0 for one in result["defects"])


@pytest.mark.usefixtures("real_template_banks")
def test_the_same_good_sets_give_the_same_bytes(cli, bench, good, taught, snapshot):
    learned(cli, bench, good[0][:SETS], "--threads", "1")
    assert snapshot(bench.folder / "cal") == snapshot(taught.parent)


@pytest.mark.slow
def test_the_template_detector_is_calibrated_by_its_scores(cli, bench, good):
    sets, _ = good
    bench.edit("part.yaml", ", {elevation_deg: -10, rotation_deg: 170}", "")
    options = ("--detector", "template", "--fusion", "median", "--calibrate", "--false-alarms", "0.5")
    ran = cli("inspect", bench.rig, bench.part, *sets[:5], "-o", bench.out, "--no-register", *options)
    assert ran.status == 0
    content = json.loads((bench.out / "calibration.json").read_text(encoding="utf-8"))
    assert len(content["postures"][0]["peaks"]) == 5
    assert content["files"] == []
    options = ("--detector", "template", "--fusion", "median", "--calibration", bench.out)
    ran = cli("inspect", bench.rig, bench.part, sets[6], "-o", bench.folder / "t", "--no-register", *options)
    assert (ran.status, ran.err) == (0, "")
    assert found(bench.folder / "t")["postures"][0]["threshold"] == pytest.approx(
        max(content["postures"][0]["peaks"]), abs=1e-3
    )


def test_a_rate_that_the_good_sets_do_not_bear_is_refused(cli, bench, good, taught):
    ran = inspect(cli, bench, good[0][:8], "--calibrate")
    assert ran.status == 2
    assert "8 good sets support a false-alarm rate of 0.312 per posture or more with 95 % confidence" in ran.err
    assert "0.05 needs 59" in ran.err
    assert "a rate of 0.313" in ran.err
    assert not bench.out.exists()
    ran = inspect(cli, bench, good[0][-1:], "--calibration", taught, "--false-alarms", "0.1")
    assert ran.status == 2
    assert "0.1 needs 29" in ran.err


def test_another_rig_part_or_way_to_inspect_is_refused(cli, bench, good, taught):
    path, one = taught, good[0][-1:]

    def refused(*options, sets=one):
        ran = inspect(cli, bench, sets, "--calibration", path, *options, out="refused")
        assert ran.status == 2
        assert "Traceback" not in ran.err
        assert not (bench.folder / "refused").exists()
        return ran.err

    assert "--min-images: calibration.json was made with 2, found 1" in refused("--min-images", "1")
    bench.edit("part.yaml", "R_d: 45.0", "R_d: 46.0")
    differs = (
        "part.yaml: placement, reflectance, regions, surface, bounces, how the mesh is read or the catalogue of "
        "defects differ"
    )
    assert differs in refused()
    bench.edit("part.yaml", "R_d: 46.0", "R_d: 45.0")
    text = bench.part.read_text(encoding="utf-8")
    region = "{name: a, box_mm: {low: [0, 0, 0], high: [9, 9, 99]}, reflectance: {R_d: 9, R_s: 9, sigma_rad: 0.1}}"
    changes = ("surface: {waviness_deg: 0.1, waviness_mm: 1.5}", "inspection: {bounces: 1}", f"regions: [{region}]")
    for change in changes:
        bench.part.write_text(f"{text}{change}\n", encoding="utf-8")
        assert differs in refused()
    bench.part.write_text(text, encoding="utf-8")
    bench.edit("rig.yaml", "gain: 0.8", "gain: 0.81")
    assert "rig.yaml: camera, sensor, lights or stage differ" in refused()
    bench.edit("rig.yaml", "gain: 0.81", "gain: 0.8")
    text = bench.part.read_text(encoding="utf-8")
    bench.part.write_text(text + "inspection: {most_defects: 3}\n", encoding="utf-8")
    assert inspect(cli, bench, one, "--calibration", path, out="limits").status == 0


def test_images_that_were_taken_in_another_way_are_refused(cli, bench, good, taught, tmp_path):
    path = taught
    few = render(bench, bench.part, tmp_path / "few", 1, "--light", "light1")
    ran = inspect(cli, bench, [few], "--calibration", path)
    assert ran.status == 2
    assert "expected the images that calibration.json was made for, light1 ×1; light3 ×1, found light1 ×1" in ran.err
    ran = inspect(cli, bench, [*good[0][:SETS], few], "--calibrate", "--false-alarms", RATE, out="mixed")
    assert ran.status == 2
    assert "under other lights or exposures" in ran.err


def test_files_that_are_no_calibration_are_refused(cli, bench, good, taught):
    path = shutil.copytree(taught.parent, bench.folder / "cal") / "calibration.json"
    one = good[0][-1:]
    other = bench.folder / "other.json"
    for text, said in [
        ("{", "not a calibration that lightopt wrote"),
        ('{"format": "lightopt-fit/1"}', 'format "lightopt-fit/1", expected lightopt-calibration/1'),
        ('{"format": "lightopt-calibration/1"}', "not a calibration that lightopt wrote"),
    ]:
        other.write_text(text, encoding="utf-8")
        ran = inspect(cli, bench, one, "--calibration", other)
        assert ran.status == 2
        assert said in ran.err
    assert "cannot be read" in inspect(cli, bench, one, "--calibration", bench.folder / "none.json").err
    maps = path.parent / "posture_0_0" / "calibration.exr"
    maps.write_bytes(maps.read_bytes()[:-1] + b"x")
    assert "not the maps that" in inspect(cli, bench, one, "--calibration", path).err
    maps.unlink()
    assert "with its maps beside it" in inspect(cli, bench, one, "--calibration", path).err


@pytest.mark.parametrize("option", [("--evaluate",), ("--fail-on-defect",)])
def test_options_of_an_inspection_are_none_of_a_calibration(cli, bench, good, option):
    ran = inspect(cli, bench, good[0][:SETS], "--calibrate", *option)
    assert ran.status == 2
    assert f"{option[0]}: cannot be combined with --calibrate" in ran.err
