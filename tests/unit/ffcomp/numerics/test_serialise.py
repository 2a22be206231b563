import json
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from ffcomp.numerics.serialise import json_line, to_json


class Colour(Enum):
    RED = "red"


@dataclass(frozen=True)
class Inner:
    values: np.ndarray
    _cache: int = 0


@dataclass(frozen=True)
class Outer:
    name: str
    inner: Inner
    by_layer: dict[int, float]
    path: Path | None = None


def test_dataclasses_become_objects_of_their_public_fields() -> None:
    found = to_json(Outer("a", Inner(np.arange(2.0)), {3: 1.5}, Path("x/y")))
    assert found == {"name": "a", "inner": {"values": [0.0, 1.0]}, "by_layer": {"3": 1.5}, "path": str(Path("x/y"))}


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, np.float64("nan"), np.float32("inf"), float("nan")])
def test_numbers_that_json_cannot_hold_become_null(value: float) -> None:
    assert to_json(value) is None
    assert to_json(np.array([value, 1.0])) == [None, 1.0]


def test_scalars_of_numpy_become_plain_numbers() -> None:
    found = to_json([np.float64(0.1), np.int64(3), np.bool_(True), np.float32(0.5)])
    assert found == [0.1, 3, True, 0.5]
    assert [type(each) for each in found] == [float, int, bool, float]


def test_other_containers_and_members_of_enumerations() -> None:
    assert to_json(MappingProxyType({"a": (1, Colour.RED)})) == {"a": [1, "red"]}
    assert to_json(each for each in "ab") == ["a", "b"]


def test_what_json_cannot_hold_is_refused() -> None:
    with pytest.raises(TypeError, match="type bytes cannot be written as JSON"):
        to_json({"a": b"x"})


def test_a_line_of_json_keeps_letters_and_reads_back() -> None:
    line = json_line({"unit": "µm", "value": np.nan})
    assert "µm" in line and "\n" not in line
    assert json.loads(line) == {"unit": "µm", "value": None}
