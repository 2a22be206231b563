"""Responses as universal files (data set 58) whose ID lines and DOF fields describe them completely.

A coherence follows as function type 6, a variance as type 0; all three share a version number.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ffcomp.measurement.frf import FrequencyResponse, describe

GENERAL, FRF, COHERENCE = 0, 4, 6  # function types
KIND = {"cmd": 8, "pos": 8, "acc": 12, "force": 13}  # specific data types
UNIT = {8: "m", 12: "m/s^2", 13: "N"}


def write_universal(path: Path, responses: Sequence[FrequencyResponse]) -> None:
    sets = []
    for number, response in enumerate(responses, 1):
        sets.append(_set(number, FRF, response, response.value))
        if response.coherence is not None:
            sets.append(_set(number, COHERENCE, response, response.coherence))
        sets.append(_set(number, GENERAL, response, response.variance))
    pytest.importorskip("pyuff").UFF(str(path)).write_sets(sets, mode="overwrite")


def _set(number: int, function: int, response: FrequencyResponse, data: NDArray[np.generic]) -> dict[str, Any]:
    labels = [f"{key}: {value}" for key, value in describe(response).items()]
    lines = ["; ".join(labels[:2]), "; ".join(labels[2:3]), "NONE", "; ".join(labels[3:5]) or "NONE", "NONE"]
    one: dict[str, Any] = {"type": 58, "func_type": function, "ver_num": number, "binary": 0}
    one |= {f"id{k}": line for k, line in enumerate(lines, 1)}
    one |= {"x": response.frequency_hz, "data": data, "abscissa_spec_data_type": 18}
    for end, part, name in (("rsp", "ordinate", response.output), ("ref", "orddenom", response.input)):
        kind, axis = name.split("_")
        one[f"{end}_node"] = "ABC".find(axis) + 1 or 4
        one[f"{end}_dir"] = "xyz".find(axis) + 1 or 3
        one[f"{part}_spec_data_type"] = KIND[kind]
        one[f"{part}_axis_units_lab"] = UNIT[KIND[kind]]
    return one | {"abscissa_axis_units_lab": "Hz"}
