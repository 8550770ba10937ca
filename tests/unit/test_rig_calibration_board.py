"""Calibration by a board: the fit against rigs that are known, its intervals, and what it says of bad input."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hidden_rig import NOMINAL, POSTURES, hidden_rig, picture, true_stage, turn

from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.estimate.rig_calibration import Board, BoardView, fit_board
from lightopt.estimate.rig_calibration._board import read_corners
from lightopt.estimate.rig_calibration._joint_fit import NAMES, Origin, predict, sightings
from lightopt.scene import project


def fitted(rig, views, **options):
    return fit_board(views, rig.board, camera=NOMINAL, **options)


@pytest.fixture
def model():
    """Parameters, errors of readings, orientations and sightings, all of them away from zero."""
    rng = np.random.default_rng(3)
    board = Board(columns=4, rows=3, pitch=9.0)
    readings = np.radians([[0.0, 20.0], [-35.0, 140.0]])
    x = rng.normal(0, 0.02, len(NAMES))
    for name, value in {
        "camera.position_z": 540.0,
        "camera.focal_px": 12_400.0,
        "camera.principal_x_px": 790.0,
        "camera.principal_y_px": 610.0,
        "camera.aspect": 1.003,
        "tilt_axis.position_y": 0.4,
        "tilt_axis.position_z": -1.5,
        "tilt_axis.scale": 1.001,
        "rotary_axis.scale": 0.999,
        "board.position_z": 2.0,
    }.items():
        x[NAMES.index(name)] = value
    origin = Origin(np.array([NOMINAL.right, -NOMINAL.up, NOMINAL.forward]), turn([1, 2, 9], 0.7))
    return x, rng.normal(0, 1e-3, (2, 2)), origin, sightings(board, [np.arange(12), np.array([1, 5, 7])], readings)


def test_slopes_are_those_of_finite_differences(model):
    x, angles, origin, seen = model
    x[:3] = x[NAMES.index("board.rotation_x") : NAMES.index("board.rotation_x") + 3] = 0.0  # they are about there
    _, by_x, by_angles = predict(x, angles, origin, seen)
    for i, name in enumerate(NAMES):
        step = np.zeros(len(NAMES))
        step[i] = 1e-3 * max(abs(x[i]), 1e-2)
        ahead, behind = (predict(x + s, angles, origin, seen)[0] for s in (step, -step))
        np.testing.assert_allclose(by_x[:, :, i], (ahead - behind) / (2 * step[i]), rtol=1e-4, atol=1e-3, err_msg=name)
    for view in range(2):
        for axis in range(2):
            step = np.zeros((2, 2))
            step[view, axis] = 1e-5
            change = (predict(x, angles + step, origin, seen)[0] - predict(x, angles - step, origin, seen)[0]) / 2e-5
            expected = np.where(seen.view[:, None] == view, by_angles[:, :, axis], 0.0)
            np.testing.assert_allclose(change, expected, rtol=1e-4, atol=1e-2)


def test_the_model_is_that_of_the_scene():
    # the reference in plain NumPy, which the hidden rigs use, and the package's own camera and stage
    rig = hidden_rig(1, distortion=replace(NOMINAL.distortion, k1=-0.3, k2=2.0, p1=0.01, p2=-0.02, k3=9.0), aspect=1.01)
    for posture in POSTURES[::4]:
        rotation, shift = true_stage(rig).transform(posture)
        points = (rig.points @ rig.board_rotation.T + rig.board_position) @ rotation.T + shift
        columns, rows, _ = project(rig.camera, points)
        np.testing.assert_allclose(rig.pixels(posture), np.column_stack([columns, rows]), atol=1e-8)
        np.testing.assert_allclose(picture(points, rig.camera), np.column_stack([columns, rows]), atol=1e-8)


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (2, 3))])
def test_a_hidden_rig_is_found(seed):
    rig = hidden_rig(seed)
    fit = fitted(rig, rig.views(seed=seed))
    off = rig.errors(fit)
    assert rig.predicted_error(fit) < 0.1
    assert abs(off["camera.focal_px"]) < 0.002 * 12_500
    assert abs(off["tilt_axis.elevation"]) < 0.02
    assert np.hypot(off["tilt_axis.position_y"], off["tilt_axis.position_z"]) < 0.02
    assert fit.noise == pytest.approx(0.1, rel=0.06)
    assert fit.common_errors < 1.3
    assert (fit.unobservable, fit.faulty, fit.freed) == ((), (), ())
    sd = np.sqrt(np.diag(fit.covariance))
    score = [abs(off[name]) / s for name, s in zip(fit.names, sd, strict=True) if name in off]
    assert len(score) == 22
    assert max(score) < 4.5
    low, high = fit.intervals["camera.focal_px"]
    assert (high - low) / 2 == pytest.approx(1.96 * sd[fit.names.index("camera.focal_px")], rel=1e-3)
    assert (high + low) / 2 == pytest.approx(fit.camera.image_distance / fit.camera.pixel_size)


def test_without_noise_the_rig_is_found_exactly():
    rig = hidden_rig(5)
    rig = replace(rig, board=replace(rig.board, height=float(rig.board_position[2]), height_error=0.0, pitch_error=0.0))
    scale = np.sqrt(np.prod(np.ptp(rig.points[:, :2], axis=0) / [50.0, 35.0]))
    fit = fitted(replace(rig, board=replace(rig.board, pitch=5.0 * scale)), rig.views(noise=0.0, angle_deg=0.0))
    assert rig.predicted_error(fit) < 1e-3
    assert max(abs(error) for name, error in rig.errors(fit).items() if "px" not in name) < 0.02


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (1, 2, 3))])
def test_the_nominal_rig_may_be_3_degrees_and_millimetres_off(seed):
    rng, rig = np.random.default_rng(seed), hidden_rig(seed)
    r = turn(rng.normal(size=3), np.radians(3.0))
    camera = replace(
        NOMINAL,
        position=NOMINAL.position + rng.normal(0, 8, 3),
        right=r @ NOMINAL.right,
        up=r @ NOMINAL.up,
        forward=r @ NOMINAL.forward,
    )
    fit = fit_board(rig.views(seed=seed), rig.board, camera=camera)
    assert rig.predicted_error(fit) < 0.15


@pytest.mark.parametrize("share", [0.01, 0.05, 0.2])
def test_wrong_corners_do_not_count(share):
    rig = hidden_rig(2)
    fit = fitted(rig, rig.views(outliers=share))
    assert rig.predicted_error(fit) < 0.1
    assert fit.noise == pytest.approx(0.1, rel=0.1)
    assert sum(view.outliers for view in fit.residuals) == pytest.approx(share * 88 * 15, rel=0.4)
    assert fit.faulty == ()


def test_views_without_corners_or_with_a_line_of_them_do_no_harm():
    rig = hidden_rig(3)
    views = rig.views()
    views[0] = BoardView("empty", views[0].posture, np.zeros(0, int), np.zeros((0, 2)))
    line = np.isin(views[1].ids, np.arange(0, 88, 12))
    views[1] = BoardView("line", views[1].posture, views[1].ids[line], views[1].pixels[line])
    fit = fitted(rig, views)
    assert fit.faulty == ()
    assert [view.corners for view in fit.residuals[:2]] == [0, line.sum()]
    assert rig.predicted_error(fit) < 0.1
    with pytest.raises(InputError, match="not on a line"):
        fitted(rig, views[:2])


def test_wrong_views_are_named():
    rig = hidden_rig(3)
    views = rig.views()
    views[4] = BoardView(
        "wrong reading", Posture(0.0, views[4].posture.rotation_deg + 10), views[4].ids, views[4].pixels
    )
    views[7] = BoardView("upside down", views[7].posture, 87 - views[7].ids, views[7].pixels)
    fit = fitted(rig, views)
    assert fit.faulty == ("wrong reading", "upside down")
    assert rig.predicted_error(fit) < 0.1


@pytest.mark.parametrize(
    ("postures", "named"),
    [
        ([(0, 0)], {"focal length", "distance", "principal point", "tilt axis direction", "tilt axis position"}),
        (
            [(0, r) for r in range(0, 360, 45)],
            {"focal length", "distance", "tilt axis direction", "tilt axis position"},
        ),
        ([(30, r) for r in range(0, 360, 45)], {"focal length", "distance", "principal point"}),
        ([(t, 0) for t in (-40, -20, 0, 20, 40)], {"tilt axis direction"}),
        ([(t, r) for t in (-35, 35) for r in range(0, 360, 90)], set()),
    ],
)
def test_what_postures_leave_open_is_named(postures, named):
    rig = hidden_rig(2)
    fit = fitted(rig, rig.views([Posture(float(t), float(r)) for t, r in postures]), on_evidence=False)
    assert named <= set(fit.unobservable)
    assert bool(named) == bool(fit.unobservable)
    assert named or fit.predicted_rms < 0.1


def test_the_next_posture_lowers_the_error_as_foretold():
    rig = hidden_rig(6)
    few = [Posture(0.0, 0.0), Posture(40.0, 0.0), Posture(-40.0, 0.0), Posture(0.0, 90.0)]
    fit = fitted(rig, rig.views(few))
    more = fitted(rig, rig.views([*few, fit.next_posture[0]]))
    assert fit.next_posture[1] < 0.6 * fit.predicted_rms
    assert more.predicted_rms == pytest.approx(fit.next_posture[1], rel=0.25)


@pytest.mark.parametrize(
    ("name", "lens"),
    [
        pytest.param("aspect", {"aspect": 1.002}, marks=pytest.mark.nightly),
        ("p1", {"distortion": replace(NOMINAL.distortion, p1=0.003)}),
    ],
)
def test_a_lens_of_another_kind_is_fitted_on_evidence(name, lens):
    rig = hidden_rig(7, **lens)
    freed = fitted(rig, rig.views())
    assert freed.freed == (name,)
    held = fitted(rig, rig.views(), on_evidence=False)
    assert held.freed == ()
    assert freed.noise < held.noise
    assert f"camera.{name}" in freed.intervals


def test_errors_that_corners_have_in_common_widen_intervals():
    rig = hidden_rig(8)
    x, y = (rig.points[:, :2] / [25.0, 17.5]).T
    ripple = 0.1 * np.column_stack([0 * x, 0 * x, x**3 - x + y**3 * x])
    wavy = fitted(rig, replace(rig, points=rig.points + ripple).views(), on_evidence=False)
    plain = fitted(rig, rig.views(), on_evidence=False)
    at = plain.names.index("camera.focal_px")
    assert wavy.common_errors > 1.5
    assert wavy.covariance[at, at] > 2.0 * plain.covariance[at, at]


def test_errors_of_readings_are_found():
    rig = hidden_rig(9)
    assert fitted(rig, rig.views(angle_deg=0.1), on_evidence=False).angle_error_deg == pytest.approx(0.09, rel=0.3)
    assert fitted(rig, rig.views(angle_deg=0.02), on_evidence=False).angle_error_deg == pytest.approx(0.02, rel=0.3)


def test_a_pivot_beside_the_origin_is_moved_there():
    rig = hidden_rig(10)
    shift = np.array([30.0, -20.0, 0.0])
    moved = replace(NOMINAL, position=NOMINAL.position + shift)
    stage = replace(true_stage(rig), pivot=shift, tilt_point=shift, tilt_direction=None)
    fit = fit_board(rig.views(), rig.board, camera=moved, stage=stage)
    assert rig.predicted_error(fit) < 0.1
    np.testing.assert_array_equal(fit.stage.pivot, 0.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda views: [], "no image shows a point"),
        (lambda views: [replace(v, ids=v.ids[:4], pixels=v.pixels[:4]) for v in views], "6 points that are not on"),
        (lambda views: [replace(v, ids=v.ids + 30) for v in views], "image 0: points 30 to 117, expected 0 to 87"),
        (lambda views: [replace(v, posture=Posture(-v.posture.elevation_deg, -v.posture.rotation_deg)) for v in views],
         "do not fit the rig"),
    ],
)  # fmt: skip
def test_views_that_cannot_be_fitted_are_refused(change, message):
    rig = hidden_rig(0)
    with pytest.raises(InputError, match=message):
        fitted(rig, change(rig.views()))


def test_wrong_arguments_are_refused():
    with pytest.raises(InputError, match="listed twice"):
        BoardView("a", Posture(0, 0), np.array([1, 1]), np.zeros((2, 2)))
    with pytest.raises(InputError, match="finite pixel positions"):
        BoardView("a", Posture(0, 0), np.array([1]), np.full((1, 2), np.nan))
    with pytest.raises(InputError, match=r"expected n whole numbers.*\(2,\), \(1, 2\)"):
        BoardView("a", Posture(0, 0), np.array([1, 2]), np.zeros((1, 2)))


def test_corner_lists_are_read(tmp_path):
    path = tmp_path / "corners.json"
    view = {"name": "a", "elevation_deg": 10, "rotation_deg": 20, "ids": [3, 0], "pixels": [[1.5, 2], [3, 4.5]]}
    path.write_text(json.dumps({"format": "lightopt-corners/1", "views": [view]}))
    (found,) = read_corners(path)
    assert (found.name, found.posture, found.ids.tolist()) == ("a", Posture(10, 20), [3, 0])
    np.testing.assert_array_equal(found.pixels, [[1.5, 2], [3, 4.5]])
    for wrong, message in [
        ("{", "no corner list can be read"),
        (json.dumps([1]), 'expected {"format": "lightopt-corners/1"'),
        (json.dumps({"format": "lightopt-corners/1", "views": []}), "with at least one view"),
        (json.dumps({"format": "lightopt-corners/1", "views": [{**view, "ids": [1]}]}), "view 1: a: expected n whole"),
        (json.dumps({"format": "lightopt-corners/1", "views": [view, {"ids": []}]}), "view 2: expected.*no 'elevation"),
        (json.dumps({"format": "lightopt-corners/1", "views": [{**view, "pixels": [["x", 1]]}]}), "view 1: expected"),
        (json.dumps({"format": "lightopt-corners/1", "views": [7]}), "view 1: expected"),
    ]:
        path.write_text(wrong)
        with pytest.raises(InputError, match=message):
            read_corners(path)
    with pytest.raises(InputError, match="no corner list can be read"):
        read_corners(tmp_path / "none.json")


@pytest.mark.nightly
def test_intervals_hold_the_truth_as_often_as_they_say():
    seeds, inside, off, pixels = 600, {}, {}, []
    for seed in range(seeds):
        rig = hidden_rig(1000 + seed)
        fit = fitted(rig, rig.views(seed=seed))
        errors, sd = rig.errors(fit), dict(zip(fit.names, np.sqrt(np.diag(fit.covariance)), strict=True))
        for name, error in errors.items():
            inside.setdefault(name, []).append(abs(error) <= 1.96 * sd[name])
            off.setdefault(name, []).append(error)
        pixels.append(rig.predicted_error(fit))
    rms = {name: np.sqrt(np.mean(np.square(errors))) for name, errors in off.items()}
    assert {name: np.mean(hits) for name, hits in inside.items() if not 0.92 <= np.mean(hits) <= 0.98} == {}
    assert np.quantile(pixels, 0.95) < 0.1
    assert rms["camera.focal_px"] < 0.001 * 12_500
    assert rms["tilt_axis.elevation"] < 0.01
    assert np.hypot(rms["tilt_axis.position_y"], rms["tilt_axis.position_z"]) < 0.01
