"""Vectors in kernels: numbers and not arrays, since counting references to arrays costs more than the arithmetic."""

import math
from typing import NamedTuple

from lightopt.core.arrays import Float64
from lightopt.core.kernels import kernel


class Vector(NamedTuple):
    """A point or a direction."""

    x: float
    y: float
    z: float


@kernel
def vector_at(rows: Float64, i: int) -> Vector:
    """Row i of an array of shape (k, 3)."""
    return Vector(rows[i, 0], rows[i, 1], rows[i, 2])


@kernel
def column_at(rows: Float64, j: int, first: int = 0) -> Vector:
    """Column j of three rows of an array of shape (n, k), from the first on."""
    return Vector(rows[first, j], rows[first + 1, j], rows[first + 2, j])


@kernel
def plus(a: Vector, b: Vector) -> Vector:
    """A + b."""
    return Vector(a.x + b.x, a.y + b.y, a.z + b.z)


@kernel
def minus(a: Vector, b: Vector) -> Vector:
    """A − b."""
    return Vector(a.x - b.x, a.y - b.y, a.z - b.z)


@kernel
def scaled(a: Vector, factor: float) -> Vector:
    """Factor · a."""
    return Vector(a.x * factor, a.y * factor, a.z * factor)


@kernel
def divided(a: Vector, divisor: float) -> Vector:
    """A / divisor, which is not rounded as 1/divisor · a is."""
    return Vector(a.x / divisor, a.y / divisor, a.z / divisor)


@kernel
def dot(a: Vector, b: Vector) -> float:
    """A · b."""
    return a.x * b.x + a.y * b.y + a.z * b.z


@kernel
def cross(a: Vector, b: Vector) -> Vector:
    """A × b."""
    return Vector(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


@kernel
def length(a: Vector) -> float:
    """|a|."""
    return math.sqrt(dot(a, a))
