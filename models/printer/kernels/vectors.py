"""Compile the kernels, access the lanes of their array, and compute with vectors of three components."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from models import compiled as how
from models.arrays import FloatArray
from models.printer.kernels.record import LANES, Row, Vector

_OPTIONS = {"error_model": "numpy", "nogil": True, "fastmath": {"contract"}}
SOURCES = hashlib.sha256(b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))).hexdigest()


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a kernel and cache it on disk until any file of this folder changes.

    Numba compares its cache with the function's own file only, and would keep old code of functions called from other
    files.
    """
    return how.compiled(function, _OPTIONS, SOURCES)


# Functions called in a loop over lanes have to be inlined, or the loop is not vectorised.
def inlined(function: Callable[..., Any]) -> Any:
    """Compile a function into every kernel that calls it."""
    return how.compiled(function, {**_OPTIONS, "forceinline": True}, sources=None)


def unrolled(end: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function of tuples of any length into every kernel that calls it.

    It works on the first element of its last argument and calls itself with the others; of an empty one it returns
    `end`. Of a sum that is -0.0, which the compiler leaves out.
    """

    def declare(function: Callable[..., Any]) -> Any:
        def callee(*arguments: Any) -> Any:
            return function(*arguments) if len(arguments[-1]) else end

        def at_end(*arguments: Any) -> Any:
            return end

        def compiled_in() -> Any:
            from numba.extending import overload  # slow to import

            options: Any = {**_OPTIONS, "forceinline": True}
            overload(callee, options, strict=False)(lambda *types: function if len(types[-1]) else at_end)
            return callee

        return how.with_numba(compiled_in)

    return declare


@unrolled(end=())
def plus(by: float, k: tuple[float, ...], y: tuple[float, ...]) -> Any:
    """Return y + by k."""
    return (y[0] + by * k[0], *plus(by, k[1:], y[1:]))


@inlined
def at(m: FloatArray, row: Row, l: int) -> float:
    """Return a row of lane l."""
    return m[row * LANES + l]


@inlined
def vector(m: FloatArray, row: Row, l: int) -> Vector:
    """Return three rows of lane l."""
    return m[row * LANES + l], m[(row + 1) * LANES + l], m[(row + 2) * LANES + l]


@inlined
def put(m: FloatArray, row: Row, l: int, value: Vector) -> None:
    """Store three rows of lane l."""
    m[row * LANES + l], m[(row + 1) * LANES + l], m[(row + 2) * LANES + l] = value


@inlined
def dot(a: Vector, b: Vector) -> float:
    """Return a·b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a: Vector, b: Vector) -> Vector:
    """Return a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def scale(f: float, a: Vector) -> Vector:
    """Return f a."""
    return f * a[0], f * a[1], f * a[2]


@inlined
def add(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def combine(r: Vector, a: Vector, b: Vector, c: Vector) -> Vector:
    """Return r₀ a + r₁ b + r₂ c, the matrix with columns a, b, c times r."""
    x, y, z = r
    return x * a[0] + y * b[0] + z * c[0], x * a[1] + y * b[1] + z * c[1], x * a[2] + y * b[2] + z * c[2]


@inlined
def solve(a: Vector, b: Vector, c: Vector, r: Vector) -> Vector:
    """Solve a·x = r₀, b·x = r₁, c·x = r₂ for x."""
    bc = cross(b, c)
    return scale(1.0 / dot(a, bc), combine(r, bc, cross(c, a), cross(a, b)))


@inlined
def tanh(x: float) -> float:
    """Compute tanh x to 1e-14 without branches.

    A Padé fraction at x/32, then tanh 2a = 2 tanh a/(1 + tanh² a) five times.
    """
    a = min(max(x, -20.0), 20.0) / 32.0
    s = a * a
    n = a * (135135.0 + s * (17325.0 + s * (378.0 + s)))
    d = 135135.0 + s * (62370.0 + s * (3150.0 + s * 28.0))
    n, d = 2.0 * n * d, n * n + d * d
    n, d = 2.0 * n * d, n * n + d * d
    n, d = 2.0 * n * d, n * n + d * d
    n, d = 2.0 * n * d, n * n + d * d
    return 2.0 * n * d / (n * n + d * d)


TURN = 2.0 * math.pi
S1, S2, S3, S4, S5, S6, S7, S8 = (float((-1) ** n / math.factorial(2 * n + 1)) for n in range(1, 9))
C1, C2, C3, C4, C5, C6, C7, C8 = (float((-1) ** n / math.factorial(2 * n)) for n in range(1, 9))
L1, L2, L3, L4, L5, L6, L7 = (1.0 / (2 * n + 1) for n in range(1, 8))
FRACTION_BITS = np.int64(52)
FRACTION, EXPONENT_OF_ONE = np.int64(2**52 - 1), np.int64(1023 * 2**52)
ROOT_2, LN_2, BIAS = math.sqrt(2.0), math.log(2.0), 1022.5  # of the exponent, with √2 taken out
E2, E3, E4, E5, E6, E7, E8 = (1.0 / math.factorial(n) for n in range(2, 9))


@inlined
def sine_cosine(x: float) -> tuple[float, float]:
    """Compute sin x and cos x to 1e-14 plus the rounding of x, without branches.

    With x within half a turn of zero, Taylor polynomials at a = x/3, then sin 3a = 3 sin a − 4 sin³ a and
    cos 3a = 4 cos³ a − 3 cos a.
    """
    a = (x - TURN * np.floor(x * (1.0 / TURN) + 0.5)) * (1.0 / 3.0)
    q = a * a
    s = a + a * q * (S1 + q * (S2 + q * (S3 + q * (S4 + q * (S5 + q * (S6 + q * (S7 + q * S8)))))))
    c = 1.0 + q * (C1 + q * (C2 + q * (C3 + q * (C4 + q * (C5 + q * (C6 + q * (C7 + q * C8)))))))
    return s * (3.0 - 4.0 * s * s), c * (4.0 * c * c - 3.0)


@inlined
def power(x: float, p: float) -> float:
    """Compute x to the p for x ≥ 0 and p > 0, to 1e-12 of what matters to exp −x^p, without branches.

    x = 2^n y √2, with n and y from its bits, and ln y = 2 artanh (y − 1)/(y + 1); e^z is a polynomial's 1024th power.
    """
    bits = np.float64(min(max(x, 1e-60), 1e12)).view(np.int64)
    y = np.int64((bits & FRACTION) | EXPONENT_OF_ONE).view(np.float64)
    u = (y - ROOT_2) / (y + ROOT_2)
    q = u * u
    log = 2.0 * (u + u * q * (L1 + q * (L2 + q * (L3 + q * (L4 + q * (L5 + q * (L6 + q * L7)))))))
    log += (np.int32(bits >> FRACTION_BITS) - BIAS) * LN_2
    z = min(max(p * log, -500.0), 500.0) * (1.0 / 1024.0)
    e = 1.0 + z + z * z * (E2 + z * (E3 + z * (E4 + z * (E5 + z * (E6 + z * (E7 + z * E8))))))
    for _ in range(10):
        e *= e
    return e
