"""Vectors of three in the lanes of the kernels."""

from __future__ import annotations

from models.arrays import FloatArray
from models.printer.kernels.jit import inlined
from models.printer.kernels.record import LANES, Row, Vector


@inlined
def at(m: FloatArray, row: Row, l: int) -> float:
    return m[row * LANES + l]


@inlined
def three(m: FloatArray, row: Row, l: int) -> Vector:
    return m[row * LANES + l], m[(row + 1) * LANES + l], m[(row + 2) * LANES + l]


@inlined
def put(m: FloatArray, row: Row, l: int, vector: Vector) -> None:
    m[row * LANES + l], m[(row + 1) * LANES + l], m[(row + 2) * LANES + l] = vector


@inlined
def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def scaled(f: float, a: Vector) -> Vector:
    return f * a[0], f * a[1], f * a[2]


@inlined
def plus(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def mixed(r: Vector, a: Vector, b: Vector, c: Vector) -> Vector:
    """r₀ a + r₁ b + r₂ c: the matrix with columns a, b, c times r."""
    x, y, z = r
    return x * a[0] + y * b[0] + z * c[0], x * a[1] + y * b[1] + z * c[1], x * a[2] + y * b[2] + z * c[2]


@inlined
def solved(a: Vector, b: Vector, c: Vector, r: Vector) -> Vector:
    """x of a·x = r₀, b·x = r₁, c·x = r₂."""
    bc = cross(b, c)
    return scaled(1.0 / dot(a, bc), mixed(r, bc, cross(c, a), cross(a, b)))


@inlined
def tanh(x: float) -> float:
    """To 1e-14 of it, without branches: a Padé fraction at x/32, then tanh 2a = 2 tanh a/(1 + tanh² a) five times."""
    a = min(max(x, -20.0), 20.0) / 32.0
    s = a * a
    n = a * (135135.0 + s * (17325.0 + s * (378.0 + s)))
    d = 135135.0 + s * (62370.0 + s * (3150.0 + s * 28.0))
    n, d = 2.0 * n * d, n * n + d * d
    n, d = 2.0 * n * d, n * n + d * d
    n, d = 2.0 * n * d, n * n + d * d
    n, d = 2.0 * n * d, n * n + d * d
    return 2.0 * n * d / (n * n + d * d)
