"""Array types, and arrays as frozen data holds them."""

from __future__ import annotations

from typing import Any

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


def same_or_each(values: FloatArray) -> Any:
    """Convert (3,) per tower to one number if all agree, else to a read-only array."""
    return float(values[0]) if np.all(values == values[0]) else constant(values)
