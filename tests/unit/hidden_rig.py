"""A rig that differs from its nominal one, and the corners that its images of a board show: in plain NumPy."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.transforms import Posture
from lightopt.estimate.rig_calibration import Board, BoardFit, BoardView
from lightopt.scene import PinholeCamera, Stage, place_camera

NOMINAL = place_camera(
    distance=550.0,
    elevation=np.pi / 2,
    azimuth=-np.pi / 2,
    roll=0.0,
    width=1600,
    height=1200,
    pixel_size=0.0044,
    image_distance=55.0,
)
POSTURES = [Posture(float(t), float(r)) for t in (0, -40, 40) for r in range(0, 360, 72)]
EVERYWHERE = [Posture(float(t), float(r)) for t in range(-40, 41, 20) for r in range(0, 360, 45)]


def turn(axis, angle):
    """Rotation matrix by Rodrigues' formula; angle [rad]."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def vector_of(rotation):
    """Small rotation as a vector [rad]."""
    return 0.5 * np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )


def move(points, posture, tilt_point, elevation, scales=(1.0, 1.0)):
    """Points of the part in the world; the rotary axis is Z."""
    tilt, spin = np.radians([posture.elevation_deg * scales[0], posture.rotation_deg * scales[1]])
    spun = points @ turn([0, 0, 1], spin).T
    return (spun - tilt_point) @ turn([np.cos(elevation), 0, np.sin(elevation)], tilt).T + tilt_point


def picture(points, camera):
    """Pixels of points of the world: OpenCV's model of a lens, written anew."""
    d = points - camera.position
    x, y = (d @ camera.right) / (d @ camera.forward), -(d @ camera.up) / (d @ camera.forward)
    r2, k = x**2 + y**2, camera.distortion
    radial = 1 + k.k1 * r2 + k.k2 * r2**2 + k.k3 * r2**3
    u = x * radial + 2 * k.p1 * x * y + k.p2 * (r2 + 2 * x**2)
    v = y * radial + k.p1 * (r2 + 2 * y**2) + 2 * k.p2 * x * y
    f = camera.image_distance / camera.pixel_size
    cx, cy = camera.principal_point or (camera.width / 2, camera.height / 2)
    return np.column_stack([f * u + cx, f * camera.aspect * v + cy])


@dataclass(frozen=True, kw_only=True, eq=False)
class HiddenRig:
    """The truth; lengths [mm], angles [rad]. `board` is what is known of the board; `points` are true, board frame."""

    camera: PinholeCamera
    elevation: float
    tilt_point: np.ndarray
    board: Board
    board_rotation: np.ndarray
    board_position: np.ndarray
    points: np.ndarray
    bow: np.ndarray

    def pixels(self, posture, points=None):
        """Where the camera sees points of the board, all corners by default."""
        points = self.points if points is None else points
        part = points @ self.board_rotation.T + self.board_position
        return picture(move(part, posture, self.tilt_point, self.elevation), self.camera)

    def views(self, postures=POSTURES, *, seed=0, noise=0.1, angle_deg=0.02, outliers=0.0):
        """What is found in images."""
        rng = np.random.default_rng([seed, 1])
        found = []
        for number, posture in enumerate(postures):
            tilt, spin = rng.normal(0, angle_deg, 2)
            pixels = self.pixels(Posture(posture.elevation_deg + tilt, posture.rotation_deg + spin))
            pixels = pixels + rng.normal(0, noise, pixels.shape)
            wrong = rng.random(len(pixels)) < outliers
            pixels[wrong] += rng.normal(0, 10, (wrong.sum(), 2))
            seen = np.all((pixels > 0) & (pixels < [self.camera.width, self.camera.height]), axis=1)
            found.append(BoardView(f"image {number}", posture, np.flatnonzero(seen), pixels[seen]))
        return found

    def predicted_error(self, fit: BoardFit, postures=EVERYWHERE):
        """Rms over pixels of points on the board and 10 mm above it [px]."""
        points = np.concatenate([self.points[::7], self.points[::7] + np.array([0, 0, 10])])
        found = points @ fit.board_rotation.T + fit.board_position
        point, axis = fit.stage.tilt_axis
        off = [
            self.pixels(posture, points) - picture(move(found, posture, point, np.arcsin(axis[2])), fit.camera)
            for posture in postures
        ]
        return float(np.sqrt(np.mean(np.square(off))))

    def errors(self, fit: BoardFit):
        """Fitted less true, by the names of the fit [mm, deg, px]."""
        true, found = self.camera, fit.camera
        axes, mine = (np.array([c.right, -c.up, c.forward]) for c in (true, found))
        camera_turn = np.degrees(vector_of(mine @ axes.T))
        board_turn = np.degrees(vector_of(fit.board_rotation @ self.board_rotation.T))
        point, axis = fit.stage.tilt_axis
        values = dict(zip(fit.names, fit.values, strict=True))
        return {
            **{f"camera.rotation_{a}": e for a, e in zip("xyz", camera_turn, strict=True)},
            **{f"camera.position_{a}": e for a, e in zip("xyz", found.position - true.position, strict=True)},
            "camera.focal_px": (found.image_distance - true.image_distance) / true.pixel_size,
            "camera.principal_x_px": found.principal_point[0] - true.principal_point[0],
            "camera.principal_y_px": found.principal_point[1] - true.principal_point[1],
            "camera.k1": found.distortion.k1 - true.distortion.k1,
            "tilt_axis.elevation": np.degrees(np.arcsin(axis[2]) - self.elevation),
            "tilt_axis.position_y": point[1] - self.tilt_point[1],
            "tilt_axis.position_z": point[2] - self.tilt_point[2],
            **{f"board.rotation_{a}": e for a, e in zip("xyz", board_turn, strict=True)},
            **{f"board.position_{a}": e for a, e in zip("xyz", fit.board_position - self.board_position, strict=True)},
            **{
                f"board.bow_{a}": values[f"board.bow_{a}"] - b
                for a, b in zip(("xx", "xy", "yy"), self.bow, strict=True)
            },
        }


def hidden_rig(seed=0, *, bow=0.1, **camera) -> HiddenRig:
    """A rig whose camera is 1° and some millimetres off, the tilt axis 0.1° and 0.3 mm, and a board that is bowed.

    bow: Of the board's corners [mm]
    camera: Further fields of the camera
    """
    rng = np.random.default_rng([seed, 0])
    rotation = turn(rng.normal(size=3), np.radians(1.0))
    lens = replace(NOMINAL.distortion, k1=rng.normal(0, 0.1))
    fields = {"principal_point": tuple(rng.normal([800, 600], 10)), "distortion": lens, **camera}
    true = replace(
        NOMINAL,
        position=NOMINAL.position + rng.normal(0, 3, 3),
        right=rotation @ NOMINAL.right,
        up=rotation @ NOMINAL.up,
        forward=rotation @ NOMINAL.forward,
        image_distance=NOMINAL.image_distance * (1 + rng.normal(0, 0.005)),
        **fields,
    )
    board = Board(columns=11, rows=8, pitch=5.0, pitch_error=1e-4, height=2.0, height_error=0.005)
    row, column = np.divmod(np.arange(88), 11)
    flat = np.column_stack([column - 5.0, 3.5 - row]) * 5.0 * (1 + rng.normal(0, 1e-4))
    flat = flat * (1 + np.array([0.5, -0.5]) * rng.normal(0, 5e-4))
    x, y = (flat / [25.0, 17.5]).T
    terms = bow / np.sqrt(3) * rng.normal(size=3)
    rise = terms @ [x * x, x * y, y * y]
    tip = turn([*rng.normal(size=2), 0], np.radians(0.3))
    return HiddenRig(
        camera=true,
        elevation=np.radians(rng.normal(0, 0.1)),
        tilt_point=np.array([0.0, rng.normal(0, 0.3), rng.normal(0, 1)]),
        board=board,
        board_rotation=tip @ turn([0, 0, 1], rng.uniform(-np.pi, np.pi)),
        board_position=np.array([*rng.normal(0, 1, 2), 2.0 + rng.normal(0, 0.005)]),
        points=np.column_stack([flat, rise]),
        bow=terms,
    )


def true_stage(rig: HiddenRig) -> Stage:
    """The stage of a hidden rig."""
    direction = np.array([np.cos(rig.elevation), 0, np.sin(rig.elevation)])
    return Stage(pivot=np.zeros(3), tilt_point=rig.tilt_point, tilt_direction=direction)
