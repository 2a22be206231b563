"""Array types, and arrays as frozen data holds them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
ComplexArray = NDArray[np.complex128]


def constant(values: ArrayLike) -> FloatArray:
    """Return a read-only float copy of `values`."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array
