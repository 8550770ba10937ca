"""Calibration of a rig from its folder: the plan, the calibrated rig file, the command, and wrong folders."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from lightopt.config import load_part, load_rig, load_targets
from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture, rotation_from_vector
from lightopt.estimate.rig_calibration import calibrate_rig, read_covariance, rig_deviations, write_calibration
from lightopt.estimate.rig_calibration._calibrate import _Images
from lightopt.estimate.rig_calibration._files import intervals
from lightopt.scene import Stage, build_camera, build_stage, project

RIG = Path(__file__).parents[2] / "configs" / "rigs" / "four-panel.yaml"
TARGETS = """\
format: lightopt-targets/1
board: {squares: [12, 9], square_mm: 5, marker_mm: 3.7, height_mm: 2}
"""


@pytest.fixture
def rig(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(RIG.read_text(encoding="utf-8").replace("../schema/", "schema/"), encoding="utf-8")
    return path


def corner_list(rig, *, seed=1, noise=0.05):
    """What a camera that is 3 mm and 0.2° off sees of a board, 9 views; and that camera and stage."""
    rng = np.random.default_rng(seed)
    nominal = build_camera(load_rig(rig))
    camera = nominal.moved(rotation_from_vector(np.array([0.003, -0.002, 0.004])), np.array([2.0, -1.0, 2.0]))
    camera = replace(camera, image_distance=55.4, principal_point=(806.0, 595.0))
    stage = Stage(
        tilt_point=np.array([0.0, 0.3, -0.2]), tilt_direction=np.array([1.0, 0.0, 0.002]) / np.hypot(1, 0.002)
    )
    row, column = np.divmod(np.arange(88), 11)
    points = np.column_stack([5.0 * (column - 5), 5.0 * (3.5 - row), np.full(88, 2.0)])
    views = []
    for tilt in (0.0, 40.0, -40.0):
        for turn in (10.0, 130.0, 250.0):
            rotation, shift = stage.transform(Posture(tilt, turn))
            columns, rows, _ = project(camera, points @ rotation.T + shift)
            seen = (columns > 0) & (columns < 1600) & (rows > 0) & (rows < 1200)
            pixels = np.column_stack([columns, rows])[seen] + rng.normal(0.0, noise, (seen.sum(), 2))
            views.append(
                {
                    "name": f"{tilt:g}-{turn:g}",
                    "elevation_deg": tilt,
                    "rotation_deg": turn,
                    "ids": np.flatnonzero(seen).tolist(),
                    "pixels": pixels.tolist(),
                }
            )
    return {"format": "lightopt-corners/1", "views": views}, camera, stage


@pytest.fixture
def folder(tmp_path, rig):
    made = tmp_path / "calibration"
    made.mkdir()
    (made / "targets.yaml").write_text(TARGETS, encoding="utf-8")
    corners, _, _ = corner_list(rig)
    (made / "board.json").write_text(json.dumps(corners), encoding="utf-8")
    return made


def test_the_calibrated_rig_is_the_measured_one_with_its_comments(rig, folder):
    _, camera, stage = corner_list(rig)
    found = calibrate_rig(load_rig(rig), folder)
    assert found.warnings == ()
    paths = write_calibration(found)
    text = paths[0].read_text(encoding="utf-8")
    assert "# Four square panels around a camera that looks straight down" in text
    assert "# one image each" in text
    for gone in ("distance_mm: 550", "elevation_deg: 90 ", "roll_deg", "image_distance_mm:", "pivot_mm"):
        assert gone not in text
    measured = load_rig(paths[0])
    assert measured.lights == load_rig(rig).lights
    corners = np.array([[x, y, z] for x in (-25, 25) for y in (-20, 20) for z in (0, 15)], dtype=float)
    for posture in (Posture(0, 0), Posture(30, 120), Posture(-40, 250)):
        seen = []
        for eye, table in ((camera, stage), (build_camera(measured), build_stage(measured))):
            rotation, shift = table.transform(posture)
            seen.append(np.stack(project(eye, corners @ rotation.T + shift)[:2]))
        # the board lay 0 to 0.01 mm off its height and was 1e-4 of its pitch off, as the targets allow
        assert np.abs(seen[0] - seen[1]).max() < 0.3
    low, high = measured.calibration.intervals["camera.focal_px"]
    assert low < 55.4 / 4.4e-3 < high
    arrays = np.load(paths[1])
    assert arrays["covariance"].shape == (len(arrays["names"]),) * 2
    names, covariance = read_covariance(measured)
    assert names == tuple(name for name in measured.calibration.intervals if not name.startswith("board."))
    high_less_low = [high - low for low, high in measured.calibration.intervals.values()]
    np.testing.assert_allclose(2 * 1.96 * np.sqrt(np.diag(covariance)), high_less_low, rtol=1e-3)
    figures = json.loads(paths[2].read_text(encoding="utf-8"))
    assert len(figures["board"]["views"]) == 9
    assert figures["unobservable"] == []


def test_a_calibrated_rig_can_be_calibrated_again(rig, folder, tmp_path):
    once = write_calibration(calibrate_rig(load_rig(rig), folder))[0]
    again = tmp_path / "again"
    again.mkdir()
    for name in ("targets.yaml", "board.json"):
        (again / name).write_bytes((folder / name).read_bytes())
    found = write_calibration(calibrate_rig(load_rig(once), again))[0]
    first, second = (build_camera(load_rig(path)) for path in (once, found))
    np.testing.assert_allclose(second.position, first.position, atol=0.02)
    assert found.read_text(encoding="utf-8").count("\ncalibration:") == 1


def test_deviations_of_the_rig_move_pixels_as_its_covariance_says(rig, folder):
    """Along all directions together, a pixel moves by the standard error that the fit claims for predictions."""
    board = calibrate_rig(load_rig(rig), folder).board
    points = np.array([[x, y, 2.0] for x in (-25.0, 0.0, 25.0) for y in (-18.0, 0.0, 18.0)])
    moved = np.zeros(2 * len(points))
    at = np.concatenate(project(board.camera, points)[:2])
    for camera, _ in rig_deviations(board.camera, board.stage, board.names, board.covariance):
        moved += np.square(np.concatenate(project(camera, points)[:2]) - at)
    error = float(np.sqrt(moved.mean()))
    # the board's own pose is known no better than the camera's, but their sum is
    assert error < 30.0 * board.predicted_rms
    # independent of each other, camera rotation and principal point would move it by several pixels
    apart = np.sqrt(np.diag(board.covariance))[list(board.names).index("camera.principal_x_px")]
    assert error < 0.5 * apart


def test_the_command(cli, rig, folder):
    done = cli("calibrate", rig, folder)
    assert done.status == 0, done.err
    assert "camera: pixels predicted to" in done.out
    assert "stage: tilt axis known to" in done.out
    assert len(done.out.splitlines()) <= 15
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "Calibration of four-panel" in page
    assert "Camera and stage" in page
    refused = cli("calibrate", rig, folder)
    assert refused.status == 0  # the same results
    data = json.loads((folder / "board.json").read_text(encoding="utf-8"))
    data["views"] = data["views"][:7]
    (folder / "board.json").write_text(json.dumps(data), encoding="utf-8")
    assert cli("calibrate", rig, folder).status == 2
    assert cli("calibrate", rig, folder, "--force").status == 0


def test_a_folder_without_images_says_what_to_do(rig, tmp_path):
    (tmp_path / "targets.yaml").write_text(TARGETS, encoding="utf-8")
    with pytest.raises(InputError, match=r"no image set of a calibration; .*--plan"):
        calibrate_rig(load_rig(rig), tmp_path)


def test_a_pivot_beside_the_origin_is_refused(rig, folder):
    rig.write_text(
        rig.read_text(encoding="utf-8").replace("pivot_mm: [0, 0, 0]", "pivot_mm: [1, 0, 0]"), encoding="utf-8"
    )
    with pytest.raises(InputError, match="a calibration has its origin on the rotary axis"):
        calibrate_rig(load_rig(rig), folder)


def test_the_plan_fits_the_view_and_the_stage(cli, rig, tmp_path):
    pytest.importorskip("cv2")
    made = tmp_path / "plan"
    done = cli("calibrate", rig, made, "--plan")
    assert done.status == 0, done.err
    assert "59 images to capture" in done.out
    targets = load_targets(made / "targets.yaml")
    assert targets.board.square_mm * 12 == pytest.approx(0.9 * 70.4, rel=0.05)
    low, high = load_rig(rig).stage.elevation_range_deg
    counts = {name: len(load_part(made / f"{name}.yaml").postures) for name in ("board", "ball", "plate")}
    assert counts == {"board": 15, "ball": 8, "plate": 3}
    for name in counts:
        assert all(low <= p.elevation_deg <= high for p in load_part(made / f"{name}.yaml").postures)
    assert (made / "board.pdf").read_bytes().startswith(b"%PDF")
    # a size that was measured stays
    text = (made / "targets.yaml").read_text(encoding="utf-8")
    (made / "targets.yaml").write_text(text.replace("radius_mm: 10", "radius_mm: 7.5"), encoding="utf-8")
    assert cli("calibrate", rig, made, "--plan").status == 2  # the ball's part is another
    assert cli("calibrate", rig, made, "--plan", "--force").status == 0
    assert load_targets(made / "targets.yaml").ball.radius_mm == 7.5


def test_the_plan_leaves_out_what_a_rig_cannot_measure(cli, rig, tmp_path):
    pytest.importorskip("cv2")
    text = rig.read_text(encoding="utf-8")
    flat = tmp_path / "flat.yaml"
    flat.write_text(text.replace("elevation_range_deg: [-45, 45]", "elevation_range_deg: [0, 0]"), encoding="utf-8")
    done = cli("calibrate", flat, tmp_path / "flat", "--plan")
    assert done.status == 0, done.err
    assert "no ball: it takes two tilts" in done.out
    assert not (tmp_path / "flat" / "ball.yaml").exists()
    coarse = tmp_path / "coarse.yaml"
    coarse.write_text(
        text.replace("[1600, 1200]", "[400, 300]").replace("pixel_size_um: 4.4", "pixel_size_um: 17.6"),
        encoding="utf-8",
    )
    done = cli("calibrate", coarse, tmp_path / "coarse", "--plan")
    assert done.status == 0, done.err
    assert "take a ball of at least" in done.out
    ring = RIG.with_name("ring-quadrants.yaml")
    done = cli("calibrate", ring, tmp_path / "ring", "--plan")
    assert done.status == 0, done.err
    assert "ball and plate measure panels only" in done.out
    assert " -o " + (tmp_path / "ring" / "board").as_posix() in done.out
    assert " -o " + (tmp_path / "ring" / "plate").as_posix() + " " not in done.out
    assert done.out.count("--seed 2") == 1  # its camera is simulated, and has the same noise each time
    # images of these sets are refused, too
    (tmp_path / "ring" / "ball").mkdir()
    with pytest.raises(InputError, match=r"ring-quadrants.yaml:\d+: .* is a ring: ball and plate measure panels only"):
        calibrate_rig(load_rig(ring), tmp_path / "ring")


@pytest.mark.parametrize(
    ("made", "expected"),
    [
        (("ball",), r"targets.yaml: ball: missing, but there is an image set ball"),
        (("sensor-a",), r"sensor-b: missing; sensor-a and sensor-b are captured alike"),
    ],
)
def test_image_sets_that_would_be_left_out_are_refused(rig, folder, made, expected):
    for name in made:
        (folder / name).mkdir()
    with pytest.raises(InputError, match=expected):
        calibrate_rig(load_rig(rig), folder)


def test_what_is_not_measured_anew_keeps_its_covariance(rig, folder):
    """A rig with a measured camera whose panels, then, are measured alone."""
    first = calibrate_rig(load_rig(rig), folder)
    path = write_calibration(first)[0]
    text = path.read_text(encoding="utf-8")
    path.write_text(
        text.replace("  intervals:", '  intervals:\n    "camera.sensor.black_level": [1, 2]'), encoding="utf-8"
    )
    once = load_rig(path)
    names, covariance = read_covariance(once)
    second = replace(first, rig=once, board=None)
    kept, unchanged = second.covariance
    assert kept == names
    np.testing.assert_array_equal(unchanged, covariance)
    assert dict(intervals(second)) == once.calibration.intervals
    # measured anew, they are replaced
    again = replace(first, rig=once)
    assert again.covariance[0] == names
    of_rig = sorted(name for name, _ in intervals(again) if not name.startswith("board."))
    assert of_rig == sorted(once.calibration.intervals)  # each once


def test_a_value_without_an_interval_is_no_longer_as_measured(rig, folder):
    path = write_calibration(calibrate_rig(load_rig(rig), folder))[0]
    text = path.read_text(encoding="utf-8")
    line = next(line for line in text.splitlines(keepends=True) if '"camera.focal_px":' in line)
    names, covariance = read_covariance(load_rig(path))
    path.write_text(text.replace(line, ""), encoding="utf-8")
    left, smaller = read_covariance(load_rig(path))
    assert left == tuple(name for name in names if name != "camera.focal_px")
    own = [names.index(name) for name in left]
    np.testing.assert_array_equal(smaller, covariance[np.ix_(own, own)])


def test_too_few_views_and_bad_corners_are_said(rig, folder):
    data, _, _ = corner_list(rig)
    for corner in data["views"][4]["pixels"][:30]:
        corner[0] += 6.0
    (folder / "board.json").write_text(json.dumps(data), encoding="utf-8")
    (text,) = calibrate_rig(load_rig(rig), folder).warnings
    assert "board 40-130: 30 of " in text
    assert "corners do not fit and are left out" in text
    data["views"] = [view for view in data["views"] if view["elevation_deg"] == 0.0][:2]
    (folder / "board.json").write_text(json.dumps(data), encoding="utf-8")
    found = calibrate_rig(load_rig(rig), folder)
    assert any("more postures are needed" in text for text in found.warnings)
    assert "tilt axis direction" in found.unobservable


def test_a_ball_that_is_overexposed_in_all_images_is_said_once(rig, folder, monkeypatch):
    rows, columns = np.indices((1200, 1600))
    levels = np.where(np.hypot(columns - 800, rows - 600) < 230, 255, 0).astype(np.uint8)
    shots = [
        SimpleNamespace(light=light, exposure=1.0, levels=levels, saturated=levels == 255) for light in ("a", "b", "c")
    ]
    images = _Images(load_rig(rig), folder, load_targets(folder / "targets.yaml"), RunContext())
    monkeypatch.setattr(_Images, "_by_posture", lambda *_: {Posture(20.0, 0.0): shots})
    with pytest.raises(InputError, match=r"in any image: a at .*: expose it shorter \(and 2 more\)") as raised:
        images.ball(build_camera(load_rig(rig)), 10.0)
    assert len(raised.value.messages) == 1
