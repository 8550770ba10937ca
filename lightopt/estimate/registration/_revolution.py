"""Find out whether the visible surface is a body of revolution, whose rotation is unobservable.

The facets of a mesh rotate with the model, the real part has none: where nothing but facets determines a rotation, it
is undetermined.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.transforms import rotation_z
from lightopt.estimate.registration._pixels import PixelSet, view_of_placed
from lightopt.estimate.registration._placement import PoseFrame
from lightopt.geometry import RayCaster
from lightopt.rendering import trace_samples
from lightopt.scene import Scene

# rotations to compare [rad]: within the reach of a registration, and all round, by the golden angle
ROTATIONS = np.concatenate([np.radians([1.9, 3.7, 6.0, 11.0]), np.radians(137.50776) * np.arange(5, 17)])

# facets of a body of revolution are off it by up to one chord error, two of them by up to 1.7 (measured, 24 to 720
# sections); those of spheres of even triangles by up to 2.6
DEPTH_FACTOR = 3.0

# interpolated normals are off by up to a third of the angle that a facet spans about the axis (measured likewise)
NORMAL_FACTOR = 0.5

# and, where facets are of unequal shapes, by up to a tenth of the angle between the normals of their corners (measured
# on a torus and on fillets of a knob as they are found in the wild)
CURVED_FACTOR = 0.15

# differences of depth [px] and of normals [rad] up to these are none: light depends on normals, on depth by parallax
# alone
LEAST_DEPTH_PX, LEAST_ANGLE = 0.1, math.radians(0.05)

AXIS_PRIOR = 1e-4  # weight of the part's middle for the axis, against normals: flat surface has no axis of its own


def unobservable_rotation(
    scene: Scene, frame: PoseFrame, sets: Sequence[PixelSet], pose: Float64, *, caster: RayCaster
) -> Float64:
    """Directions of poses, shape (u, 3), u = 0 or 1, in which a rotation changes only facets at the given pixels.

    The part is rotated about its middle, and about the axis to which its normals point. A pixel sees the same surface
    where its depth along the normal and its normal differ by no more than two facets may be off a common body of
    revolution: r (1 − cos Δφ/2) of their azimuthal extent Δφ; Δφ/2, or a share of the angle between the normals of
    their corners. One pixel that sees more, such as a flat, a key, a hole, or nothing, makes the rotation observable.
    """
    if not sets or scene.mesh.normals is None:
        return np.zeros((0, 3))
    nominal = [_trace(scene, frame, pixels, pose, caster) for pixels in sets]
    fitted = _axis(np.concatenate([n.points for n in nominal]), np.concatenate([n.normals for n in nominal]))

    def is_observable(axis: Float64, rotation: float) -> bool:
        # whether a rotation about an axis of the part, x and y from its middle, changes more than facets
        about, foot = rotation_z(rotation), np.array([*axis, 0.0])
        # the axis stays where the pose has it
        shift = rotation_z(float(pose[2])) @ (foot - about @ foot)
        rotated = pose.copy()
        rotated[:3] += np.array([shift[0], shift[1], rotation])
        return any(
            _differs(before, _trace(scene, frame, pixels, rotated, caster).rotated(about, foot), frame.pixel)
            for pixels, before in zip(sets, nominal, strict=True)
        )

    # normals of coarse facets are less exact than the bounding box, unless that is of an odd number of sections
    for axis in (np.zeros(2), fitted):
        if not any(is_observable(axis, float(rotation)) for rotation in ROTATIONS):
            return np.array([[axis[1], -axis[0], 1.0]])
    return np.zeros((0, 3))


@dataclass(frozen=True)
class _Surface:
    """What n pixels see: points from the part's middle and normals, in the part's axes; how far off facets may be.

    `depth` is the chord error [mm], `angle` the azimuthal extent, `bend` the greatest difference of corners' normals
    [rad] of the facets, shape (n,).
    """

    points: Float64
    normals: Float64
    depth: Float64
    angle: Float64
    bend: Float64

    def rotated(self, about: Float64, foot: Float64) -> _Surface:
        """Rotated about the vertical axis through a point."""
        return replace(self, points=(self.points - foot) @ about.T + foot, normals=self.normals @ about.T)


def _differs(before: _Surface, after: _Surface, pixel: float) -> bool:
    # whether any pixel sees more than other facets of the same body of revolution
    if len(after.points) != len(before.points):
        return True
    slope = np.hypot(before.normals[:, 0], before.normals[:, 1])
    depth = DEPTH_FACTOR * slope * np.minimum(before.depth, after.depth)
    angle = NORMAL_FACTOR * slope * np.minimum(before.angle, after.angle)
    angle += CURVED_FACTOR * np.minimum(before.bend, after.bend)
    off = np.abs(np.einsum("ij,ij->i", after.points - before.points, before.normals))
    differ = np.linalg.norm(after.normals - before.normals, axis=1)
    return bool(np.any((off > depth + LEAST_DEPTH_PX * pixel) | (differ > angle + LEAST_ANGLE)))


def _trace(scene: Scene, frame: PoseFrame, pixels: PixelSet, pose: Float64, caster: RayCaster) -> _Surface:
    # what is seen in a pose by those of the pixels that see the part
    place, middle = frame.placement(pose), np.array([*(scene.pivot + frame.middle)[:2], 0.0])
    view = view_of_placed(scene, pixels.posture, place)
    hits, surface = trace_samples(caster, scene.mesh, view.camera, *pixels.positions)
    vertices, normals = scene.mesh.vertices, scene.mesh.normals
    assert normals is not None
    faces = scene.mesh.faces[hits.face]
    facets = _facets((vertices[faces] - middle)[:, :, :2], normals[faces], 1e-6 * frame.radius)
    return _Surface(surface.points - middle, surface.normals, *facets)


def _facets(corners: Float64, normals: Float64, least: float) -> tuple[Float64, Float64, Float64]:
    # of facets: chord error r (1 − cos Δφ/2) [mm], azimuthal extent Δφ [rad], and how far their normals bend [rad]
    radius = np.linalg.norm(corners, axis=2)
    # a corner on the axis has no azimuth
    off = radius > least
    unit = corners / np.where(off, radius, 1.0)[:, :, None]
    angle, bend = np.zeros(len(corners)), np.zeros(len(corners))
    for a, b in ((0, 1), (1, 2), (2, 0)):
        cosine = np.clip(np.einsum("ij,ij->i", unit[:, a], unit[:, b]), -1.0, 1.0)
        angle = np.maximum(angle, np.where(off[:, a] & off[:, b], np.arccos(cosine), 0.0))
        bend = np.maximum(bend, np.linalg.norm(normals[:, a] - normals[:, b], axis=1))
    return radius.max(axis=1, initial=0.0) * (1.0 - np.cos(0.5 * angle)), angle, bend


def _axis(points: Float64, normals: Float64) -> Float64:
    # least squares: the vertical axis next to the lines along the normals [mm]
    across = np.stack([normals[:, 1], -normals[:, 0]], axis=1)
    moment = np.einsum("ij,ij->i", across, points[:, :2])
    prior = AXIS_PRIOR * max(len(points), 1) * np.eye(2)
    return np.linalg.solve(across.T @ across + prior, across.T @ moment)
