"""The camera: rays of image points, projection of points, what its lens blurs, framing of a part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Float64
from lightopt.core.kernels import kernel
from lightopt.core.transforms import azimuth_tangent, direction, elevation_tangent
from lightopt.geometry import TriangleMesh
from lightopt.optics import airy_diameter, circle_of_confusion

_UNDISTORT_STEPS = 50
_UNDISTORT_TOLERANCE = 1e-13


@dataclass(frozen=True, kw_only=True)
class Distortion:
    """OpenCV's radial and tangential lens distortion on normalised image coordinates, x right, y down."""

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    @property
    def is_zero(self) -> bool:
        return not any((self.k1, self.k2, self.p1, self.p2, self.k3))


@dataclass(frozen=True, kw_only=True)
class Lens:
    """A thin lens in the pinhole, which is the middle of its aperture."""

    aperture: float  # diameter [mm]
    focus: float  # depth of the plane in focus along the optical axis [mm]
    wavelength: float | None = None  # of the light, for diffraction [mm]; None for none


@dataclass(frozen=True, kw_only=True)
class PinholeCamera:
    """A pinhole with an image plane, in whichever frame its vectors are given (world or part)."""

    position: Float64  # pinhole [mm], shape (3,)
    # unit vectors of the image, shape (3,)
    right: Float64
    up: Float64
    forward: Float64
    width: int
    height: int
    pixel_size: float  # width of a pixel [mm]
    image_distance: float  # pinhole to image plane [mm]
    distortion: Distortion = Distortion()
    # where the optical axis meets the image [px]; None for the image's centre
    principal_point: tuple[float, float] | None = None
    aspect: float = 1.0  # focal length in rows over that in columns; 1 for square pixels
    # coefficients of ρ² and ρ⁴ in what the lens passes, ρ from the principal point in half diagonals
    vignetting: tuple[float, float] = (0.0, 0.0)
    cos4: bool = False  # whether what it passes falls with the fourth power of the cosine to the optical axis as well
    lens: Lens | None = None  # what the pinhole stands for; None for a pinhole, in which everything is in focus
    # by how much the image is off, to the right and down, for the rays to the plane in focus to end at the same image
    # points from everywhere in the lens [image distances]
    shear: tuple[float, float] = (0.0, 0.0)
    obstructions: Float64 | None = None  # corners of triangles that stand in the view, of lights [mm], shape (t, 3, 3)

    @property
    def axis_px(self) -> tuple[float, float]:
        """Column and row where the optical axis meets the image [px]."""
        return self.principal_point or (0.5 * self.width, 0.5 * self.height)

    @property
    def dims(self) -> bool:
        """Whether the lens passes less or more light away from its axis."""
        return self.cos4 or self.vignetting != (0.0, 0.0)

    @property
    def diffraction_cutoff(self) -> float | None:
        """Frequency from which on diffraction leaves no contrast [cycles/px]; None where there is no diffraction."""
        if self.lens is None or self.lens.wavelength is None:
            return None
        return self.lens.aperture * self.pixel_size / (self.lens.wavelength * self.image_distance)

    def moved(self, rotation: Float64, translation: Float64) -> PinholeCamera:
        """The camera after x' = rotation·x + translation, of shapes (3, 3) and (3,)."""
        return replace(
            self,
            position=rotation @ self.position + translation,
            right=rotation @ self.right,
            up=rotation @ self.up,
            forward=rotation @ self.forward,
            obstructions=None if self.obstructions is None else self.obstructions @ rotation.T + translation,
        )


def place_camera(*, distance: float, elevation: float, azimuth: float, roll: float, **image: Any) -> PinholeCamera:
    """Camera at ``distance·d(elevation, azimuth)``, looking at the origin; lengths [mm], angles [rad], world frame.

    image: The fields of the camera that say what it images: width, height, pixel_size, image_distance, distortion
    """
    d = direction(elevation=elevation, azimuth=azimuth)
    e_phi = azimuth_tangent(azimuth=azimuth)
    e_theta = elevation_tangent(elevation=elevation, azimuth=azimuth)
    c, s = np.cos(roll), np.sin(roll)
    return PinholeCamera(
        position=distance * d, right=c * e_phi + s * e_theta, up=-s * e_phi + c * e_theta, forward=-d, **image
    )


def pose_camera(*, position: Float64, rotation: Float64, **image: Any) -> PinholeCamera:
    """Camera at a position [mm], world frame; `rotation` turns its own axes (x right, y down, z ahead) to the world's.

    image: As of :func:`place_camera`
    """
    right, down, forward = rotation.T
    return PinholeCamera(position=position, right=right, up=-down, forward=forward, **image)


def through_lens(camera: PinholeCamera, place: Float64) -> PinholeCamera:
    """The pinhole at a place in the lens of a camera, in the unit disc, to the right and up, shape (2,).

    The mean of the images of all places is that of the lens: each has the perspective, and hides what it hides, of the
    light that passes the lens there.
    """
    assert camera.lens is not None
    right, up = 0.5 * camera.lens.aperture * place
    return replace(
        camera,
        position=camera.position + right * camera.right + up * camera.up,
        lens=None,
        shear=(float(right) / camera.lens.focus, -float(up) / camera.lens.focus),
    )


def blur_diameter(camera: PinholeCamera, depth: Float64) -> Float64:
    """Diameter of the disc that the lens makes of a point, diffraction included [px], of the shape of `depth`.

    depth: Along the optical axis [mm]
    """
    lens = camera.lens
    if lens is None:
        return np.zeros_like(depth)
    confusion = circle_of_confusion(
        depth, focus=lens.focus, aperture=lens.aperture, image_distance=camera.image_distance
    )
    cutoff = camera.diffraction_cutoff
    return np.hypot(confusion / camera.pixel_size, 0.0 if cutoff is None else airy_diameter(cutoff))


def typical_blur(camera: PinholeCamera, points: Float64) -> float:
    """Root mean square of :func:`blur_diameter` over points of a surface, shape (k, 3), frame of the camera."""
    if camera.lens is None or not len(points):
        return 0.0
    return float(np.sqrt(np.mean(blur_diameter(camera, (points - camera.position) @ camera.forward) ** 2)))


def pixel_directions(camera: PinholeCamera, columns: Float64, rows: Float64) -> Float64:
    """Directions of the rays through image points, not normalised, shape (k, 3), frame of the camera's vectors.

    columns, rows: Image points [px], shape (k,): pixel (column 0, row 0) has its centre at (0.5, 0.5)
    """
    scale = camera.pixel_size / camera.image_distance
    column, row = camera.axis_px
    x = (columns - column) * scale
    y = (rows - row) * (scale / camera.aspect)
    if not camera.distortion.is_zero:
        x, y = _undistort(camera.distortion, x, y)
    x, y = x - camera.shear[0], y - camera.shear[1]
    return _directions(x, y, camera.forward, camera.right, camera.up)


@kernel
def _directions(x: Float64, y: Float64, forward: Float64, right: Float64, up: Float64) -> Float64:
    directions = np.empty((len(x), 3))
    for i in range(len(x)):
        for axis in range(3):
            directions[i, axis] = forward[axis] + x[i] * right[axis] - y[i] * up[axis]
    return directions


def project(camera: PinholeCamera, points: Float64) -> tuple[Float64, Float64, Float64]:
    """Image points (columns, rows) [px] and depth along the optical axis [mm] of points; each of shape (k,).

    Points at or behind the pinhole have a depth ≤ 0 and image points of NaN. Points so far out that the lens model
    turns back on itself, which would put them into the image again, are given where they belong: well outside of it.

    points: [mm], shape (k, 3), frame of the camera's vectors
    """
    offset = points - camera.position
    depth = offset @ camera.forward
    safe = np.where(depth > 0.0, depth, np.nan)
    x = (offset @ camera.right) / safe + camera.shear[0]
    y = -(offset @ camera.up) / safe + camera.shear[1]
    scale = camera.image_distance / camera.pixel_size
    if not camera.distortion.is_zero:
        r2 = x * x + y * y
        folded = r2 > _fold(camera.distortion)
        away = np.maximum(1.0, (camera.width + camera.height) / (scale * np.sqrt(np.where(folded, r2, 1.0))))
        lens_x, lens_y = _distort(camera.distortion, x, y)
        x, y = np.where(folded, away * x, lens_x), np.where(folded, away * y, lens_y)
    column, row = camera.axis_px
    return x * scale + column, y * (scale * camera.aspect) + row, depth


def surface_share(camera: PinholeCamera, points: Float64) -> Float64 | None:
    """As :func:`lens_share`, of points of a surface [mm], shape (k, 3), frame of the camera's vectors."""
    return lens_share(camera, *project(camera, points)[:2]) if camera.dims else None


def lens_share(camera: PinholeCamera, columns: NDArray[Any], rows: NDArray[Any]) -> Float64 | None:
    """Share of the light that the lens passes to image points [px], 1 on its axis; None where it is 1 everywhere."""
    if not camera.dims:
        return None
    column, row = camera.axis_px
    r2 = ((columns - column) ** 2 + (rows - row) ** 2) / (0.25 * (camera.width**2 + camera.height**2))
    v2, v4 = camera.vignetting
    share = np.maximum(0.0, 1.0 + r2 * (v2 + r2 * v4))
    if camera.cos4:
        scale = camera.pixel_size / camera.image_distance
        share /= (1.0 + scale**2 * ((columns - column) ** 2 + ((rows - row) / camera.aspect) ** 2)) ** 2
    return share


def pixel_footprint(camera: PinholeCamera, distance: float) -> float:
    """Side of a pixel's footprint on a plane facing the camera at `distance` [mm] from the pinhole [mm]."""
    return camera.pixel_size / camera.image_distance * distance


def surface_footprint(camera: PinholeCamera, points: Float64) -> float:
    """The same at the typical depth of points of a surface, shape (k, 3), frame of the camera; at 1 mm for none."""
    depth = (points - camera.position) @ camera.forward
    return pixel_footprint(camera, float(np.median(depth)) if len(depth) else 1.0)


def _distort(distortion: Distortion, x: Float64, y: Float64) -> tuple[Float64, Float64]:
    d = distortion
    r2 = x * x + y * y
    radial = 1.0 + r2 * (d.k1 + r2 * (d.k2 + r2 * d.k3))
    return (
        x * radial + 2.0 * d.p1 * x * y + d.p2 * (r2 + 2.0 * x * x),
        y * radial + d.p1 * (r2 + 2.0 * y * y) + 2.0 * d.p2 * x * y,
    )


def _fold(distortion: Distortion) -> float:
    # square of the radius from which on the radial model turns back, d(r·radial)/dr = 0; the tangential terms of real
    # lenses are too small to matter
    d = distortion
    # in 1/r², so that the leading coefficient is never small
    roots = np.roots([1.0, 3.0 * d.k1, 5.0 * d.k2, 7.0 * d.k3])
    ahead = roots.real[(np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0.0)]
    with np.errstate(over="ignore"):  # a coefficient next to 0 folds at infinity
        return float(1.0 / ahead.max()) if len(ahead) else np.inf


def _undistort(distortion: Distortion, x: Float64, y: Float64) -> tuple[Float64, Float64]:
    # Newton's method on both coordinates; a lens whose model folds over inside the image does not converge and gives
    # NaN, which the scene's construction refuses
    d = distortion
    ux, uy = x.copy(), y.copy()
    error = np.full(x.shape, np.inf)
    for _ in range(_UNDISTORT_STEPS):
        fx, fy = _distort(d, ux, uy)
        fx, fy = fx - x, fy - y
        error = np.maximum(np.abs(fx), np.abs(fy))
        if error.size == 0 or error.max() <= _UNDISTORT_TOLERANCE:
            break
        r2 = ux * ux + uy * uy
        radial = 1.0 + r2 * (d.k1 + r2 * (d.k2 + r2 * d.k3))
        slope = 2.0 * (d.k1 + r2 * (2.0 * d.k2 + 3.0 * d.k3 * r2))
        jxx = radial + slope * ux * ux + 2.0 * d.p1 * uy + 6.0 * d.p2 * ux
        jxy = slope * ux * uy + 2.0 * d.p1 * ux + 2.0 * d.p2 * uy
        jyy = radial + slope * uy * uy + 6.0 * d.p1 * uy + 2.0 * d.p2 * ux
        determinant = jxx * jyy - jxy * jxy
        ux -= (jyy * fx - jxy * fy) / determinant
        uy -= (jxx * fy - jxy * fx) / determinant
    lost = ~((error <= 1e-9) & (ux * ux + uy * uy <= _fold(d)))
    ux[lost] = np.nan
    uy[lost] = np.nan
    return ux, uy


_WINDOW_MARGIN_PX = 2


@dataclass(frozen=True, kw_only=True)
class Framing:
    # width and height of the box around the part's vertices in the image [px]; NaN where some are behind the camera
    size: tuple[float, float]
    # from that box to the image's left, top, right and bottom, by name; below 0 where the part leaves the image [px]
    margins: Mapping[str, float]
    # depth of the part's vertices along the optical axis [mm]
    nearest: float
    farthest: float
    footprint: tuple[float, float]  # side of a pixel's footprint at the nearest and at the farthest depth [mm]

    @property
    def outside(self) -> bool:
        beyond = (-margin >= side for margin, side in zip(self.margins.values(), 2 * self.size, strict=True))
        return self.farthest <= 0.0 or any(beyond)

    @property
    def inside(self) -> bool:
        return self.nearest > 0.0 and min(self.margins.values()) >= 0.0


def frame_part(camera: PinholeCamera, mesh: TriangleMesh) -> Framing:
    """Where the part lies in the image; camera and mesh in the same frame."""
    columns, rows, depth = project(camera, mesh.vertices)
    nearest, farthest = float(depth.min()), float(depth.max())
    left, top, right, bottom = map(float, (columns.min(), rows.min(), columns.max(), rows.max()))
    return Framing(
        size=(right - left, bottom - top),
        margins={"left": left, "top": top, "right": camera.width - right, "bottom": camera.height - bottom},
        nearest=nearest,
        farthest=farthest,
        footprint=(pixel_footprint(camera, nearest), pixel_footprint(camera, farthest)),
    )


def screen_window(camera: PinholeCamera, mesh: TriangleMesh) -> tuple[int, int, int, int]:
    """Columns and rows [left, top, right, bottom) outside which no ray of the camera can meet the part.

    The corners of the part's bounding box bound its image, since a pinhole keeps straight lines straight; a distorted
    lens does not, and gets the whole image.
    """
    whole = (0, 0, camera.width, camera.height)
    if not camera.distortion.is_zero:
        return whole
    low, high = mesh.bounds
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    columns, rows, depth = project(camera, corners)
    if depth.min() <= 0.0:
        return whole
    left = max(0, int(np.floor(columns.min())) - _WINDOW_MARGIN_PX)
    top = max(0, int(np.floor(rows.min())) - _WINDOW_MARGIN_PX)
    right = min(camera.width, int(np.ceil(columns.max())) + _WINDOW_MARGIN_PX)
    bottom = min(camera.height, int(np.ceil(rows.max())) + _WINDOW_MARGIN_PX)
    return left, top, max(left, right), max(top, bottom)
