"""The shapes of a rig in the world frame [mm], before any view of them."""

import math
from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.transforms import Posture, rigid_transform
from lightopt.scene import PanelLight, PinholeCamera, Scene, panel_corners, pixel_directions

_BORDER_STEPS = 24  # points per side of the image's border; a distorted lens bends it on the table
_FARTHEST = 1.5  # rays that rise from the table or graze it are cut at this many camera distances


@dataclass(frozen=True)
class CameraShape:
    """A camera to draw, in the world frame [mm]; corners from the image's top left clockwise.

    aperture: Front of its frustum, whose apex is the pinhole, shape (4, 3)
    body: Corners of the housing behind the pinhole, four at the front, four at the back, shape (8, 3)
    footprint: Where the image's border meets the table, shape (n, 3)
    corners: Of the footprint, shape (4, 3)
    arrow: Length of the arrows for image right and up
    """

    aperture: Float64
    body: Float64
    footprint: Float64
    corners: Float64
    arrow: float


def camera_shape(camera: PinholeCamera, size: float) -> CameraShape:
    """Shapes of a camera whose frustum is `size` long [mm]."""
    border = _border(camera)
    distance = float(np.linalg.norm(camera.position))
    slope = np.minimum(border[:, 2], -1e-12)
    reach = np.minimum(-camera.position[2] / slope, _FARTHEST * distance / np.linalg.norm(border, axis=1))
    reach = np.where(reach > 0.0, reach, _FARTHEST * distance)
    footprint = camera.position + reach[:, None] * border
    width, height = camera.width * camera.pixel_size, camera.height * camera.pixel_size
    half = 0.34 * size / max(width, height) * np.array([width, height])
    signs = ((-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0))
    corners = np.array([sx * half[0] * camera.right + sy * half[1] * camera.up for sx, sy in signs])
    front = camera.position + 0.75 * size * camera.forward + corners
    # the housing is as large as the frustum's opening; it is a sign, the true optics are the pyramid
    body = np.concatenate([camera.position + corners * 0.8, camera.position + corners * 0.8 - size * camera.forward])
    return CameraShape(
        aperture=front, body=body, footprint=footprint, corners=footprint[::_BORDER_STEPS], arrow=1.1 * size
    )


def _border(camera: PinholeCamera) -> Float64:
    """Rays through the border of the image, from its top left corner clockwise, shape (4·steps, 3)."""
    width, height = float(camera.width), float(camera.height)
    corners = np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])
    t = np.arange(_BORDER_STEPS)[:, None] / _BORDER_STEPS
    sides = [(1.0 - t) * corners[i] + t * corners[(i + 1) % 4] for i in range(4)]
    points = np.concatenate(sides)
    return pixel_directions(camera, points[:, 0], points[:, 1])


def foot_direction(light: PanelLight) -> Float64:
    """Unit vector in the table plane at the light's azimuth, shape (3,)."""
    return np.array([math.cos(light.azimuth), math.sin(light.azimuth), 0.0])


def part_box(scene: Scene, posture: Posture) -> Float64:
    """Corners of the part's own bounding box at a posture [mm], shape (8, 3)."""
    low, high = scene.mesh.bounds
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    return rigid_transform(corners, posture.matrix, scene.pivot)


def rig_size(scene: Scene) -> float:
    """Distance of the farthest light or, without lights, of the camera [mm]: what signs are sized by."""
    distances = [light.distance for light in scene.lights] or [float(np.linalg.norm(scene.camera.position))]
    return max(distances)


def square(half: float, centre: Float64) -> Float64:
    """Corners of a square of the table plane around a place [mm], shape (4, 3); `half` a side long."""
    signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return np.column_stack([centre[:2] + half * signs, np.zeros(4)])


def table_grid(scene: Scene, posture: Posture) -> tuple[float, float]:
    """Half the side of the piece of table to draw, below all lights and the part, and the step of its grid [mm]."""
    under = [np.abs(panel_corners(light)[:, :2]).max() for light in scene.lights]
    part = np.abs(part_box(scene, posture)[:, :2]).max()
    return round_up(float(max([*under, 1.2 * part, 0.4 * rig_size(scene)])))


def round_up(half: float) -> tuple[float, float]:
    """Half a side of at least `half`, a multiple of a round step, and that step [mm]."""
    step = nice_step(2.0 * half)
    return math.ceil(half / step - 1e-9) * step, step


def nice_step(span: float) -> float:
    """A round length (1, 2 or 5 times a power of ten) of about a tenth of a span; both in [mm]."""
    power = 10.0 ** math.floor(math.log10(span / 10.0))
    return next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= span / 10.0 * 0.999)
