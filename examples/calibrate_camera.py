"""Calibrate the camera and the stage's axes with a ChArUco board, here with rendered images of a rig that is off.

Needs OpenCV: pip install 'lightopt[opencv]'. Print the board that this draws without scaling, and measure its pitch.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from lightopt import build_scene, load_part, load_rig, render
from lightopt.config import BoardTargetConfig
from lightopt.core.transforms import Posture, rotation_from_vector
from lightopt.estimate.rig_calibration import BoardImage, board_grid, board_mesh, find_corners, fit_board
from lightopt.geometry import stl_bytes
from lightopt.report.rig import board_sheet

RIG = Path(__file__).parents[1] / "configs" / "rigs" / "four-panel.yaml"
BOARD = BoardTargetConfig(squares=(12, 9), square_mm=5.0, marker_mm=3.75)
PART = """
format: lightopt-part/1
name: board
mesh: {file: board.stl, units: mm, normals: facet}
placement: {anchor: rest_on_table}
reflectance: {R_d: 200, R_s: 0, sigma_rad: 0.2}
"""


def main(folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    board_sheet(BOARD, folder / "board.pdf", paper="a4")
    (folder / "board.stl").write_bytes(stl_bytes(board_mesh(BOARD, margin=2.0)))
    (folder / "part.yaml").write_text(PART)
    nominal = build_scene(load_rig(RIG), load_part(folder / "part.yaml"), lights=["light1"])
    postures = [Posture(tilt, turn) for tilt in (-35.0, 0.0, 35.0) for turn in (10.0, 100.0, 190.0)]
    turned = rotation_from_vector(np.radians([0.2, -0.3, 0.5]))
    real = replace(
        nominal,
        postures=tuple(postures),
        camera=nominal.camera.moved(turned, np.array([1.0, -2.0, 3.0])),
        stage=replace(nominal.stage, tilt_point=np.array([0.0, 0.3, -1.0])),
    )
    images = [
        BoardImage(str(shown.posture), shown.posture, shown.lights[0].level)
        for shown in render(real, shadows=False, supersample=2)
    ]
    brightest = max(image.pixels.max() for image in images)
    views, problems = find_corners(images, BOARD, full_scale=1.2 * brightest)
    for problem in problems:
        print(problem)
    fit = fit_board(views, board_grid(BOARD), camera=nominal.camera, stage=nominal.stage)
    print(f"corners ±{fit.noise:.3f} px, predicted pixels ±{fit.predicted_rms:.3f} px")
    print(f"not determined: {', '.join(fit.unobservable) or 'nothing'}")
    for name, (low, high) in fit.intervals.items():
        print(f"{name:24} {low:12.4f} to {high:12.4f}")
    print(f"camera at {fit.camera.position}, in truth at {real.camera.position}")
    print(f"tilt axis through {fit.stage.tilt_axis[0]}, in truth {real.stage.tilt_axis[0]}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "board"))
