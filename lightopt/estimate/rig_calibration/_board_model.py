"""Where a camera sees a board on a tilt and rotary stage, and how that changes with each parameter.

The world is fixed by the stage: Z is the rotary axis at tilt reading 0, X the tilt axis projected onto the plane normal
to Z. The tilt axis has the direction (cos ε, 0, sin ε) and passes through (0, p_y, p_z).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from lightopt.core.arrays import Float64, Index
from lightopt.core.transforms import rotation_from_vector
from lightopt.estimate.rig_calibration._board import Board
from lightopt.scene import Stage

# every parameter of the model, in this order; lengths [mm], angles [rad], image [px]
NAMES = (
    *(f"camera.rotation_{axis}" for axis in "xyz"),  # about the camera's own axes: x right, y down, z forward
    *(f"camera.position_{axis}" for axis in "xyz"),  # world
    "camera.focal_px",
    "camera.principal_x_px",
    "camera.principal_y_px",
    "camera.aspect",
    *(f"camera.{name}" for name in ("k1", "k2", "p1", "p2", "k3")),
    "tilt_axis.elevation",  # ε
    "tilt_axis.position_y",
    "tilt_axis.position_z",
    "tilt_axis.scale",
    "rotary_axis.scale",
    *(f"board.rotation_{axis}" for axis in "xyz"),  # about the world's axes at posture (0, 0)
    *(f"board.position_{axis}" for axis in "xyz"),
    "board.scale",
    "board.pitch_ratio",
    "board.bow_xx",
    "board.bow_xy",
    "board.bow_yy",
)
AT = {name: i for i, name in enumerate(NAMES)}
CAMERA_ROTATION, CAMERA_POSITION = slice(0, 3), slice(3, 6)
BOARD_ROTATION = slice(AT["board.rotation_x"], AT["board.rotation_x"] + 3)
BOARD_POSITION = slice(AT["board.position_x"], AT["board.position_x"] + 3)
LENS = slice(AT["camera.k1"], AT["camera.k1"] + 5)
BOW = slice(AT["board.bow_xx"], AT["board.bow_xx"] + 3)


@dataclass(frozen=True, eq=False)
class Origin:
    """Orientations that the rotation parameters start from, each of shape (3, 3)."""

    camera: Float64  # rows are the camera's right, down and forward, world frame
    board: Float64  # board frame to world at posture (0, 0)

    def moved(self, x: Float64) -> "Origin":
        """With the rotation parameters of `x` in it, so that they are 0 next."""
        return replace(
            self,
            camera=rotation_from_vector(x[CAMERA_ROTATION]) @ self.camera,
            board=rotation_from_vector(x[BOARD_ROTATION]) @ self.board,
        )


@dataclass(frozen=True, eq=False)
class Sightings:
    """Points of the board that images show, N in K views."""

    points: Float64  # board frame [mm], shape (N, 2)
    half: Float64  # half the board's sides [mm], which the bow is measured at
    view: Index  # number of the view, shape (N,)
    readings: Float64  # tilt and rotation of each view [rad], shape (K, 2)


def sightings(board: Board, ids: list[Index], readings: Float64) -> Sightings:
    """Sight of the points of each view; readings [rad], shape (K, 2)."""
    points = board.points
    view = np.repeat(np.arange(len(ids)), [len(i) for i in ids])
    return Sightings(points[np.concatenate(ids)], np.abs(points).max(axis=0), view, readings)


def stage_of(x: Float64) -> Stage:
    """The stage with these parameters."""
    epsilon = x[AT["tilt_axis.elevation"]]
    return Stage(
        pivot=np.zeros(3),
        tilt_point=np.array([0.0, x[AT["tilt_axis.position_y"]], x[AT["tilt_axis.position_z"]]]),
        tilt_direction=np.array([np.cos(epsilon), 0.0, np.sin(epsilon)]),
        tilt_scale=float(x[AT["tilt_axis.scale"]]),
        rotary_scale=float(x[AT["rotary_axis.scale"]]),
    )


def predict(
    x: Float64, angles: Float64, origin: Origin, seen: Sightings, *, slopes: bool = True
) -> tuple[Float64, Float64, Float64]:
    """Pixels (column, row) [px], shape (N, 2); NaN behind the camera.

    Also their derivatives by all of NAMES, shape (N, 2, P), and by the errors of tilt and rotation of their own view,
    shape (N, 2, 2); both empty without `slopes`.

    x: Parameters, shape (P,)
    angles: Errors of tilt and rotation [rad], shape (K, 2)
    """
    flat = seen.points * np.exp(x[AT["board.scale"]] + 0.5 * x[AT["board.pitch_ratio"]] * np.array([1.0, -1.0]))
    along = seen.points / seen.half
    bends = np.column_stack([along[:, 0] ** 2, along[:, 0] * along[:, 1], along[:, 1] ** 2])
    on_board = np.column_stack([flat, bends @ x[BOW]])
    board = rotation_from_vector(x[BOARD_ROTATION]) @ origin.board
    turned = on_board @ board.T
    q = turned + x[BOARD_POSITION]

    scales = x[[AT["tilt_axis.scale"], AT["rotary_axis.scale"]]]
    actual = (seen.readings + angles)[seen.view]
    tilt, turn = (scales * actual).T
    spin = _matrices(np.array([0.0, 0.0, 1.0]), turn)
    epsilon = x[AT["tilt_axis.elevation"]]
    u, across = np.array([np.cos(epsilon), 0.0, np.sin(epsilon)]), np.array([-np.sin(epsilon), 0.0, np.cos(epsilon)])
    lift = _matrices(u, tilt)
    point = np.array([0.0, x[AT["tilt_axis.position_y"]], x[AT["tilt_axis.position_z"]]])
    v = np.einsum("nij,nj->ni", spin, q)
    lifted = np.einsum("nij,nj->ni", lift, v - point)
    camera = rotation_from_vector(x[CAMERA_ROTATION]) @ origin.camera
    seen_at = (lifted + point - x[CAMERA_POSITION]) @ camera.T

    pixels, by_point, by_lens = _image(x, seen_at)
    if not slopes:
        return pixels, np.zeros((0, 2, 0)), np.zeros((0, 2, 0))
    to_camera = np.einsum("ij,njk->nik", camera, lift)
    from_part = np.einsum("nij,njk->nik", to_camera, spin)
    moves = np.zeros((len(q), 3, len(NAMES)))  # of the point in the camera's frame
    moves[:, :, CAMERA_ROTATION] = -_cross_matrices(seen_at)
    moves[:, :, CAMERA_POSITION] = -camera
    y, c, s = v - point, np.cos(tilt)[:, None], np.sin(tilt)[:, None]
    turned_axis = np.cross(across, y) * s + (across * (y @ u)[:, None] + u * (y @ across)[:, None]) * (1.0 - c)
    moves[:, :, AT["tilt_axis.elevation"]] = turned_axis @ camera.T
    held = camera - to_camera
    moves[:, :, AT["tilt_axis.position_y"]], moves[:, :, AT["tilt_axis.position_z"]] = held[:, :, 1], held[:, :, 2]
    by_tilt = np.cross(u, lifted) @ camera.T
    by_turn = np.einsum("nij,nj->ni", to_camera, np.cross([0.0, 0.0, 1.0], v))
    moves[:, :, AT["tilt_axis.scale"]] = by_tilt * actual[:, :1]
    moves[:, :, AT["rotary_axis.scale"]] = by_turn * actual[:, 1:]
    moves[:, :, BOARD_ROTATION] = np.einsum("nij,njk->nik", from_part, -_cross_matrices(turned))
    moves[:, :, BOARD_POSITION] = from_part
    in_plane = np.stack([flat, 0.5 * flat * [1.0, -1.0]], axis=2)  # by scale and ratio
    moves[:, :, [AT["board.scale"], AT["board.pitch_ratio"]]] = from_part @ np.einsum(
        "ij,njk->nik", board[:, :2], in_plane
    )
    moves[:, :, BOW] = np.einsum("nij,j,nk->nik", from_part, board[:, 2], bends)
    by_all = by_point @ moves
    by_all[:, :, AT["camera.focal_px"] : LENS.stop] = by_lens
    return pixels, by_all, by_point @ np.stack([scales[0] * by_tilt, scales[1] * by_turn], axis=2)


def _image(x: Float64, points: Float64) -> tuple[Float64, Float64, Float64]:
    # pixels of points in the camera's frame (x right, y down, z forward), and their derivatives by the point and by
    # focal length, principal point, aspect and the lens's five; OpenCV's model of distortion
    f, cx, cy, aspect = x[AT["camera.focal_px"] : LENS.start]
    k1, k2, p1, p2, k3 = x[LENS]
    z = np.where(points[:, 2] > 0.0, points[:, 2], np.nan)
    a, b = points[:, 0] / z, points[:, 1] / z
    r2 = a * a + b * b
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    lens_a = a * radial + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a * a)
    lens_b = b * radial + p1 * (r2 + 2.0 * b * b) + 2.0 * p2 * a * b
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * k3 * r2))
    j_aa = radial + slope * a * a + 2.0 * p1 * b + 6.0 * p2 * a
    j_ab = slope * a * b + 2.0 * p1 * a + 2.0 * p2 * b
    j_bb = radial + slope * b * b + 6.0 * p1 * b + 2.0 * p2 * a
    by_point = np.empty((len(points), 2, 3))
    by_point[:, 0, 0], by_point[:, 0, 1] = f * j_aa / z, f * j_ab / z
    by_point[:, 1, 0], by_point[:, 1, 1] = f * aspect * j_ab / z, f * aspect * j_bb / z
    by_point[:, :, 2] = -(by_point[:, :, 0] * a[:, None] + by_point[:, :, 1] * b[:, None])
    by_lens = np.zeros((len(points), 2, 9))
    by_lens[:, 0, 0], by_lens[:, 1, 0] = lens_a, aspect * lens_b
    by_lens[:, 0, 1] = by_lens[:, 1, 2] = 1.0
    by_lens[:, 1, 3] = f * lens_b
    for i, (da, db) in enumerate(
        [
            (a * r2, b * r2),
            (a * r2**2, b * r2**2),
            (2.0 * a * b, r2 + 2.0 * b * b),
            (r2 + 2.0 * a * a, 2.0 * a * b),
            (a * r2**3, b * r2**3),
        ]
    ):
        by_lens[:, 0, 4 + i], by_lens[:, 1, 4 + i] = f * da, f * aspect * db
    return np.column_stack([f * lens_a + cx, f * aspect * lens_b + cy]), by_point, by_lens


def _matrices(axis: Float64, angles: Float64) -> Float64:
    # rotations about one axis, shape (n, 3, 3)
    return np.asarray(Rotation.from_rotvec(angles[:, None] * axis).as_matrix(), np.float64)


def _cross_matrices(vectors: Float64) -> Float64:
    # [v]× of each, shape (n, 3, 3)
    matrices = np.zeros((len(vectors), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrices[:, k, j], matrices[:, j, k] = vectors[:, i], -vectors[:, i]
    return matrices
