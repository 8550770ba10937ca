"""Drawings of a rig and of the conventions: what is drawn is where the program has it."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture, direction
from lightopt.geometry import TriangleMesh
from lightopt.images import read_png
from lightopt.lights import PanelLight, panel_corners, place_light
from lightopt.optics import Reflectance, Sensor
from lightopt.report import rig_drawing
from lightopt.report._pictures import DPI, figure_image, fixed_style
from lightopt.report._rig_drawing import draw_stage
from lightopt.report._rig_elements import BORDER_STEPS, ParallelView, Pen, camera_shape, part_box, round_up
from lightopt.scene import Scene, Stage, place_camera, project
from lightopt.scene._camera import Distortion


def _frames():
    path = Path(__file__).resolve().parents[2] / "scripts" / "frames_drawing.py"
    spec = importlib.util.spec_from_file_location("frames_drawing", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclasses ask for it
    spec.loader.exec_module(module)
    return module


FRAMES = _frames()

BOX_FACES = np.array(
    [
        [0, 2, 1],
        [0, 3, 2],
        [4, 5, 6],
        [4, 6, 7],
        [0, 1, 5],
        [0, 5, 4],
        [1, 2, 6],
        [1, 6, 5],
        [2, 3, 7],
        [2, 7, 6],
        [3, 0, 4],
        [3, 4, 7],
    ]
)


def block(x: float = 40.0, y: float = 30.0, z: float = 20.0) -> TriangleMesh:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [-1, -1, 2], [1, -1, 2], [1, 1, 2], [-1, 1, 2]])
    return TriangleMesh(corners * [x / 2, y / 2, z / 2], BOX_FACES.astype(np.int32))


def panel(name: str, azimuth: float, *, elevation: float = 60.0, distance: float = 330.0) -> PanelLight:
    return place_light(
        name=name,
        distance=distance,
        elevation=np.radians(elevation),
        azimuth=np.radians(azimuth),
        size=(60.0, 40.0),
        points=4,
    )


def scene_of(
    lights: tuple[PanelLight, ...],
    *,
    postures: tuple[Posture, ...] = (Posture(0, 0),),
    elevation: float = 90.0,
    distortion: Distortion = Distortion(),  # noqa: B008
) -> Scene:
    camera = place_camera(
        distance=550.0,
        elevation=np.radians(elevation),
        azimuth=np.radians(270.0),
        roll=0.0,
        width=1600,
        height=1200,
        pixel_size=0.0044,
        image_distance=55.0,
        distortion=distortion,
    )
    return Scene(
        camera=camera,
        lights=lights,
        mesh=block(),
        reflectance=Reflectance(R_d=45.0, R_s=12500.0, sigma=0.0475, full_scale=255.0),
        sensor=Sensor(bit_depth=8),
        stage=Stage(),
        postures=postures,
    )


FOUR = tuple(panel(f"light{i + 1}", 45.0 + 90 * i) for i in range(4))


@pytest.mark.slow
def test_rig_drawing_is_deterministic(tmp_path: Path) -> None:
    scene = scene_of(FOUR)
    first = rig_drawing(scene, tmp_path / "1.png").read_bytes()
    assert rig_drawing(scene, tmp_path / "2.png").read_bytes() == first


@pytest.mark.slow
@pytest.mark.parametrize(
    "scene",
    [
        scene_of((panel("only", 0.0),)),
        scene_of((panel("past the zenith", -60.0, elevation=110.0), panel("top", 0.0, elevation=90.0))),
        scene_of(tuple(panel(f"l{i}", 15.0 * i, elevation=30.0) for i in range(24))),
        scene_of((panel("near", 10.0, distance=40.0), panel("far", 100.0, distance=3000.0))),
        scene_of(FOUR[:2], elevation=105.0, postures=(Posture(30, 40), *(Posture(0, i) for i in range(20)))),
        scene_of(FOUR, elevation=0.0, distortion=Distortion(k1=-0.3)),
        scene_of((), postures=()),
    ],
)
def test_any_rig_can_be_drawn_within_its_borders(scene: Scene, tmp_path: Path) -> None:
    picture = read_png(rig_drawing(scene, tmp_path / "rig.png"), colour=True)
    for border in (picture[:6], picture[-6:], picture[:, :6], picture[:, -20:]):
        assert border.min() == 255
    assert (picture < 200).any(axis=2).mean() > 0.01


def test_bad_paths(tmp_path: Path) -> None:
    for draw in (lambda path: rig_drawing(scene_of(FOUR), path), FRAMES.frames_drawing):
        with pytest.raises(InputError, match=r"ends in \.png"):
            draw(tmp_path / "a.svg")
        with pytest.raises(InputError, match="cannot be written"):
            draw(tmp_path / "none" / "a.png")
    assert list(tmp_path.iterdir()) == []


def test_frames_drawing_is_deterministic(tmp_path: Path) -> None:
    first = FRAMES.frames_drawing(tmp_path / "1.png").read_bytes()
    assert FRAMES.frames_drawing(tmp_path / "2.png").read_bytes() == first


@pytest.mark.parametrize("panel", FRAMES.frame_panels(), ids=lambda panel: panel.title.split()[0])
@fixed_style()
def test_every_convention_is_drawn_within_its_panel(panel) -> None:
    figure = Figure(figsize=(590 / DPI, 560 / DPI), dpi=DPI)
    axes = figure.add_axes((0.1, 0.1, 0.8, 0.8))
    axes.set_axis_off()
    panel.draw(axes)
    assert len(axes.texts) > 2
    drawn = np.asarray(figure_image(figure)).min(axis=2) < 250
    assert drawn.any()
    for border in (drawn[:8], drawn[-8:], drawn[:, :8], drawn[:, -8:]):
        assert not border.any()


def test_footprint_is_what_the_camera_sees_of_the_table() -> None:
    for elevation in (90.0, 60.0, 105.0):
        camera = scene_of(FOUR, elevation=elevation, distortion=Distortion(k1=-0.2)).camera
        shape = camera_shape(camera, 40.0)
        assert np.allclose(shape.footprint[:, 2], 0.0, atol=1e-9)
        columns, rows, _ = project(camera, shape.footprint[::BORDER_STEPS])
        assert np.allclose(columns, [0, 1600, 1600, 0], atol=1e-6)
        assert np.allclose(rows, [0, 0, 1200, 1200], atol=1e-6)


def test_rays_that_miss_the_table_are_cut() -> None:
    shape = camera_shape(scene_of(FOUR, elevation=0.0).camera, 40.0)
    assert np.isfinite(shape.footprint).all()
    assert np.abs(shape.footprint).max() < 2 * 550


def test_panel_corners_are_the_panel() -> None:
    light = panel("a", 45.0)
    corners = panel_corners(light)
    assert np.allclose(corners.mean(axis=0), 330.0 * direction(elevation=np.radians(60), azimuth=np.radians(45)))
    assert np.allclose(np.linalg.norm(np.diff(corners, axis=0), axis=1), [60.0, 40.0, 60.0])


@fixed_style()
def test_part_is_drawn_where_the_view_places_it() -> None:
    posture = Posture(30, 40)
    scene = scene_of(FOUR, postures=(posture,))
    axes = Figure().add_subplot()
    pen = Pen(axes, ParallelView(elevation=0.4, azimuth=-1.2))
    pen.part(scene, posture)
    drawn, expected = axes.dataLim, pen.view.place(part_box(scene, posture))
    # the block's own box is the block
    assert np.allclose(drawn.min, expected.min(axis=0))
    assert np.allclose(drawn.max, expected.max(axis=0))


@fixed_style()
def test_stage_axes_stay_in_their_picture() -> None:
    for posture in (Posture(0, 0), Posture(-45, 300), Posture(40, 10)):
        scene = scene_of(FOUR, postures=(posture,))
        figure = Figure(figsize=(520 / DPI, 420 / DPI), dpi=DPI)
        axes = figure.add_axes((0.05, 0.05, 0.85, 0.85))
        axes.set_axis_off()
        axes.margins(0.08)
        draw_stage(axes, scene, posture)
        drawn = np.asarray(figure_image(figure)).min(axis=2) < 250
        assert drawn.any()
        for border in (drawn[:2], drawn[-2:], drawn[:, :2], drawn[:, -2:]):
            assert not border.any()


@pytest.mark.parametrize(("span", "step"), [(1.0, 0.1), (99.0, 10.0), (101.0, 20.0), (380.0, 50.0), (7000.0, 1000.0)])
def test_steps_are_round(span: float, step: float) -> None:
    half, used = round_up(span / 2)
    assert used == pytest.approx(step)
    assert half >= span / 2
    assert half / used == pytest.approx(round(half / used))
