"""How a camera sees tangent planes: classes of foreshortening, and the axes that turns of defects are counted from."""

import math

import numpy as np

from lightopt.core.arrays import Float64, Index

# cosines of the angle to the normal in so many steps of this ratio, and directions within half a turn
FORESHORTENING, COSINES, AZIMUTHS = 0.85, 11, 8

FORESHORTENINGS = COSINES * AZIMUTHS
"""Number of classes."""


def image_axes(views: Float64, right: Float64) -> tuple[Float64, Float64]:
    """Unit vectors to the right and up in the image, at right angles to the views, each of shape (k, 3).

    views: Unit vectors from the surface to the camera, shape (k, 3)
    right: The camera's, shape (3,)
    """
    across = right - (views @ right)[:, None] * views
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return across, np.cross(views, across).astype(np.float64)


def tangent_axis(normals: Float64, right: Float64) -> Float64:
    """The image's right in tangent planes, which turns of defects are counted from towards N × it, shape (k, 3)."""
    axis = right - np.einsum("ij,ij->i", right, normals)[:, None] * normals
    return axis / np.linalg.norm(axis, axis=1, keepdims=True)


def foreshortening_classes(normals: Float64, views: Float64, right: Float64, up: Float64) -> Index:
    """The class of each point of a surface, shape (k,); `right` and `up` from :func:`image_axes`."""
    x, y, z = (np.einsum("ij,ij->i", normals, axis) for axis in (right, up, views))
    cosine = np.clip(np.rint(np.log(np.maximum(z, 1e-6)) / math.log(FORESHORTENING)), 0, COSINES - 1)
    azimuth = np.rint(np.arctan2(y, x) / math.pi * AZIMUTHS) % AZIMUTHS
    return (cosine * AZIMUTHS + np.where(cosine > 0, azimuth, 0)).astype(np.intp)


def plane_to_image(foreshortening: int, footprint: float) -> Float64:
    """Pixels to the right and down by mm along the axes of a class' tangent plane, shape (2, 2).

    footprint: Side of a pixel on a plane that faces the camera [mm]
    """
    steps, azimuth = divmod(foreshortening, AZIMUTHS)
    cosine = FORESHORTENING**steps
    sine, angle = math.sqrt(1.0 - cosine**2), math.pi * azimuth / AZIMUTHS
    normal = np.array([[sine * math.cos(angle), sine * math.sin(angle), cosine]])
    first = tangent_axis(normal, np.array([[1.0, 0.0, 0.0]]))[0]
    second = np.cross(normal[0], first)
    return np.array([[first[0], second[0]], [-first[1], -second[1]]]) / footprint
