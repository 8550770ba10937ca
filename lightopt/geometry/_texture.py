"""Brushing along the texture coordinates of a mesh file."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from lightopt.core.arrays import Float64, Index, Int32
from lightopt.core.kernels import kernel
from lightopt.core.vectors import cross, dot, minus, vector_at
from lightopt.geometry._load_mesh import LoadedMesh, corner_angles
from lightopt.geometry._topology import merge_rows

_ON_A_LINE = 1e-6  # area of a triangle's texture coordinates, over that of the rectangle around them, that is none
_PLACES = 1e6  # of a texture from 0 to 1 that differ


@dataclass(frozen=True, eq=False)
class TextureBrushing:
    """Brushed as a texture runs; in a face of the file the direction turns evenly from corner to corner."""

    corners: Float64  # of the file's faces [mm], shape (m, 3, 3)
    directions: Float64  # unit vectors at them; 0 in faces without direction, shape (m, 3, 3)
    source: Int32  # the file's face of which each face of the mesh is a piece

    def along(self, points: Float64, face: Int32 | Index) -> Float64:
        return _along_texture(self.corners, self.directions, self.source[face], points)

    def moved(self, rotation: Float64, translation: Float64) -> "TextureBrushing":
        return replace(self, corners=self.corners @ rotation.T + translation, directions=self.directions @ rotation.T)


def texture_brushing(loaded: LoadedMesh, along: Literal["u", "v"]) -> TextureBrushing:
    """The field of directions in which one texture coordinate grows and the other one stays; of a mesh that has them.

    Faces that share a vertex, and its place in the texture, share the direction there, as they do the normal: the mean
    of theirs, weighted by their angles. So it does not depend on how the surface is cut into triangles. Textures repeat
    with period 1, so that a seam from 1 to 0 is none. Facets that are shaded flat have a direction of their own.
    """
    mesh, texture = loaded.mesh, loaded.texture
    assert texture is not None
    corners = mesh.vertices[mesh.faces]
    run, turn = texture[:, 1:] - texture[:, :1], corners[:, 1:] - corners[:, :1]
    area = run[:, 0, 0] * run[:, 1, 1] - run[:, 0, 1] * run[:, 1, 0]
    # not where a coordinate is missing, which is NaN
    plain = np.flatnonzero(np.abs(area) > _ON_A_LINE * np.abs(run).max(axis=1).prod(axis=1))
    # ∂P/∂u or ∂P/∂v but for sign and length, which do not count
    other = run[plain, :, 1 if along == "u" else 0, None]
    own = turn[plain, 0] * other[:, 1] - turn[plain, 1] * other[:, 0]
    own = np.repeat(own / np.linalg.norm(own, axis=1, keepdims=True), 3, axis=0)
    if mesh.normals is not None:
        place = np.rint(_PLACES * texture[plain]) % _PLACES
        vertex = mesh.faces[plain, :, None].astype(np.float64)
        first, number = merge_rows(np.concatenate([vertex, place], axis=2).reshape(-1, 3))
        sign = np.where(np.einsum("ij,ij->i", own, own[first][number]) < 0.0, -1.0, 1.0)
        weight = sign * corner_angles(mesh.vertices, mesh.faces[plain]).ravel()
        sums = np.stack([np.bincount(number, weight * column, len(first)) for column in own.T], axis=1)
        own = sign[:, None] * (sums / np.linalg.norm(sums, axis=1, keepdims=True))[number]
    directions = np.zeros_like(corners)
    directions[plain] = own.reshape(-1, 3, 3)
    return TextureBrushing(corners, directions, np.arange(len(corners), dtype=np.int32))


@kernel
def _along_texture(corners: Float64, directions: Float64, faces: Int32, points: Float64) -> Float64:
    # directions at the corners, weighted by the points' barycentric coordinates
    result = np.empty((len(points), 3))
    for i in range(len(points)):
        own, at = corners[faces[i]], directions[faces[i]]
        a = vector_at(own, 0)
        p, q, w = minus(vector_at(own, 1), a), minus(vector_at(own, 2), a), minus(vector_at(points, i), a)
        n = cross(p, q)
        u, v = dot(cross(w, q), n) / dot(n, n), dot(cross(p, w), n) / dot(n, n)
        for axis in range(3):
            result[i, axis] = (1.0 - u - v) * at[0, axis] + u * at[1, axis] + v * at[2, axis]
    return result
