"""The variants of a surface in the form that kernels take."""

from typing import NamedTuple

from lightopt.core.arrays import Float64
from lightopt.core.kernels import kernel
from lightopt.core.vectors import Vector
from lightopt.optics import DiffuseForm, Lobe


class VariantNumbers(NamedTuple):
    """The variants of a surface in the form that kernels take."""

    lean: Float64  # normals in the points' frames, shape (t, 3)
    R_d: Float64  # of each, shape (t,)
    R_s: Float64  # of each, shape (t,)
    inverse: Float64  # 1/(2σ²) [rad⁻²], shape (t,)
    # the lobe is negligible where it is less than e^−most of its height, for the view that it is brightest in, shape
    # (t,)
    most: Float64
    lobe: Lobe  # form of all lobes, of any width
    diffuse: DiffuseForm  # form of the diffuse light of all


@kernel
def leaning(lean: Float64, t: int, n: Vector, r: Vector, a: Vector) -> Vector:
    """Normal of variant t in the frame of the vectors n (the point's normal), r (its reference) and a = n × r."""
    c0, c1, c2 = lean[t, 0], lean[t, 1], lean[t, 2]
    return Vector(c0 * n.x + c1 * r.x + c2 * a.x, c0 * n.y + c1 * r.y + c2 * a.y, c0 * n.z + c1 * r.z + c2 * a.z)
