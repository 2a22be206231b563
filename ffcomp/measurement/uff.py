"""Universal files, data set 58 (function at nodal DOF), through `pyuff`.

Files written here describe a response completely in its ID lines, as `key: value; key: value`, and in the DOF fields:
nodes 1, 2, 3 are the carriages A, B, C, moving along direction 3 (z); node 4 is the nozzle, directions 1, 2, 3 are
x, y, z. A coherence follows as function type 6, a variance as type 0; all three share a version number.

Files of others are read by those fields and by the data types of ordinate and denominator: displacement,
velocity (differentiated), acceleration, force. Values are taken to SI by the units' labels, else by data set 164.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measurement.frf import KEYS, FrequencyResponse, describe
from models.arrays import ComplexArray, FloatArray

_GENERAL, _FRF, _COHERENCE = 0, 4, 6  # function types
_DISPLACEMENT, _VELOCITY, _ACCELERATION, _FORCE = 8, 11, 12, 13  # specific data types
_REACTION, _EXCITATION, _FREQUENCY = 9, 13, 18
_KIND = {"cmd": _DISPLACEMENT, "pos": _DISPLACEMENT, "acc": _ACCELERATION, "force": _FORCE}
_UNIT = {_DISPLACEMENT: "m", _ACCELERATION: "m/s^2", _FORCE: "N"}
_NOZZLE_NODE = 4
_ID_LINE = 80  # characters
_SI = {"m": 1.0, "mm": 1e-3, "m/s": 1.0, "mm/s": 1e-3, "n": 1.0, "mn": 1e-3, "kn": 1e3, "g": 9.80665}
_SI |= dict.fromkeys(("m/s2", "m/s^2", "m/s**2", "m/s²", "m/sec2", "m/sec^2"), 1.0)
_SI |= dict.fromkeys(("mm/s2", "mm/s^2", "mm/s**2", "mm/s²"), 0.001)
_NO_LABEL = ("", "none")


@dataclass(frozen=True, eq=False)
class Dataset:
    """One response as the file has it, in SI."""

    labels: dict[str, str]  # labels
    frequency_hz: FloatArray  # (k,)
    value: ComplexArray  # (k,)
    coherence: FloatArray | None = None
    variance: FloatArray | None = None


def is_universal(path: str | Path) -> bool:
    """Tell whether a file begins as universal files do: a line `-1`, then one with the data set's number."""
    try:
        with open(path, "rb") as file:
            head = file.read(400).splitlines()[:2]
    except OSError:
        return False
    return len(head) == 2 and head[0].strip() == b"-1" and head[1].strip()[:1].isdigit()


def read_universal(path: str | Path) -> dict[int, Dataset]:
    """Read the responses of a universal file by data set number (from 1); MeasurementError if there is none."""
    sets = _sets(str(path))
    length, force = _unit_factors(sets)
    kinds = {number: _function(one) for number, one in sets.items() if one["type"] == 58}
    responses = {number: sets[number] for number, kind in kinds.items() if kind == _FRF}
    if not responses:
        raise MeasurementError(str(path), ["There is no frequency response (data set 58, function type 4) in it."])
    problems: list[str] = []
    datasets = {number: _dataset(number, one, length, force, problems) for number, one in responses.items()}
    if problems:
        raise MeasurementError(str(path), problems)
    for number, kind in kinds.items():
        mate = next((n for n, one in responses.items() if _dof(one) == _dof(sets[number])), None)
        if kind in (_COHERENCE, _GENERAL) and mate is not None:
            key = "coherence" if kind == _COHERENCE else "variance"
            datasets[mate] = replace(datasets[mate], **{key: np.real(sets[number]["data"])})
    return datasets


def write_universal(path: str | Path, responses: Iterable[FrequencyResponse]) -> None:
    """Write responses as ASCII data sets 58. Frequencies keep six digits, as the format has it."""
    sets = []
    for number, response in enumerate(responses, 1):
        sets.append(_written(number, _FRF, response, response.value))
        if response.coherence is not None:
            sets.append(_written(number, _COHERENCE, response, response.coherence))
        sets.append(_written(number, _GENERAL, response, response.variance))
    Path(path).unlink(missing_ok=True)
    _pyuff(str(path)).UFF(str(path)).write_sets(sets, mode="overwrite")


def _pyuff(path: str) -> ModuleType:
    try:
        return import_module("pyuff")  # optional, and without types
    except ImportError as error:
        rule = "Universal files need the package pyuff: pip install 'ffcomp[uff]'."
        raise MeasurementError(path, [rule]) from error


def _sets(path: str) -> dict[int, dict[str, Any]]:
    pyuff = _pyuff(path)
    try:
        file = pyuff.UFF(path)
        read = [n for n, kind in enumerate(file.get_set_types()) if int(kind) in (58, 164)]
        return {n + 1: file.read_sets(n) for n in read}
    except Exception as error:  # pyuff raises plain Exception, and whatever a broken line makes of it
        raise MeasurementError(path, [f"It is no universal file that can be read: {error}."]) from error


def _function(one: Mapping[str, Any]) -> int:
    """Return the set's function type; a general one is only ours if its ID lines say so."""
    kind = int(one["func_type"])
    return kind if kind != _GENERAL or "input" in _labels(one) else -1


def _dof(one: Mapping[str, Any]) -> tuple[int, ...]:
    """Return the fields that a response and its coherence have in common."""
    return (*(int(one[key]) for key in ("rsp_node", "rsp_dir", "ref_node", "ref_dir", "ver_num")), len(one["x"]))


def _dataset(number: int, one: Mapping[str, Any], length: float, force: float, problems: list[str]) -> Dataset:
    labels, frequency = _labels(one), np.asarray(one["x"], dtype=np.float64)
    value = np.asarray(one["data"], dtype=np.complex128)
    kinds = [int(one[f"{part}_spec_data_type"]) for part in ("ordinate", "orddenom")]
    if "input" not in labels:
        labels["input"] = _signal(
            one, "ref", {_DISPLACEMENT: "cmd", _REACTION: "force", _EXCITATION: "force"}, kinds[1]
        )
    if "output" not in labels:
        outputs = {_DISPLACEMENT: "pos", _VELOCITY: "acc", _ACCELERATION: "acc"}
        labels["output"] = _signal(one, "rsp", outputs, kinds[0])
    for end in ("input", "output"):
        if not labels[end]:
            problems.append(
                f"Data set {number}: its {end} cannot be derived from its direction and data type "
                f"{kinds[end == 'input']}; say 'input: cmd_A; output: pos_A' (or what it is) in the ID lines."
            )
    value = value * _scale(number, one, kinds, length, force, problems)
    if kinds[0] == _VELOCITY:
        value = value * 2j * np.pi * frequency
    return Dataset(labels, frequency, value)


def _labels(one: Mapping[str, Any]) -> dict[str, str]:
    parts = ";".join(str(one.get(f"id{k}", "")) for k in range(1, 6)).split(";")
    pairs = [part.split(":", 1) for part in parts if ":" in part]
    return {key.strip().lower(): value.strip() for key, value in pairs if key.strip().lower() in KEYS}


def _signal(one: Mapping[str, Any], end: str, kinds: Mapping[int, str], kind: int) -> str:
    """Name a signal by its node, direction and data type; '' if they do not tell."""
    node, direction = int(one[f"{end}_node"]), abs(int(one[f"{end}_dir"]))
    if kind not in kinds or direction not in (1, 2, 3):
        return ""
    on_carriage = (
        node in (1, 2, 3) and direction == 3 and _EXCITATION not in (kind, int(one["orddenom_spec_data_type"]))
    )
    return f"{kinds[kind]}_{'ABC'[node - 1] if on_carriage else 'xyz'[direction - 1]}"


def _scale(
    number: int, one: Mapping[str, Any], kinds: list[int], length: float, force: float, problems: list[str]
) -> float:
    """Return the factor to SI, with the sign of the directions."""
    sign = float(np.sign(int(one["rsp_dir"]) or 1) * np.sign(int(one["ref_dir"]) or 1))
    factors = []
    for part, kind in zip(("ordinate", "orddenom"), kinds, strict=True):
        label = str(one.get(f"{part}_axis_units_lab", "")).strip().lower()
        if label not in _NO_LABEL and label not in _SI:
            problems.append(f"Data set {number}: unit {label!r} is unknown; known are {', '.join(_SI)}.")
        default = 1 / force if kind in (_REACTION, _EXCITATION) else 1 / length
        factors.append(_SI.get(label, default))
    return sign * factors[0] / factors[1]


def _unit_factors(sets: Mapping[int, Mapping[str, Any]]) -> tuple[float, float]:
    """Return data set 164's factors of length and force, from SI to the file's units."""
    units: Mapping[str, Any] = next((one for one in sets.values() if one["type"] == 164), {})
    return float(units.get("length", 1.0)) or 1.0, float(units.get("force", 1.0)) or 1.0


def _written(
    number: int, function: int, response: FrequencyResponse, data: FloatArray | ComplexArray
) -> dict[str, Any]:
    labels = [f"{key}: {value}" for key, value in describe(response).items()]
    lines = [
        "; ".join(labels[:2]),
        "; ".join(labels[2:3]),
        "NONE",
        "; ".join(labels[3:5]) or "NONE",
        *labels[5:],
        "NONE",
    ]
    one: dict[str, Any] = {"type": 58, "func_type": function, "ver_num": number, "binary": 0}
    if max(map(len, lines)) > _ID_LINE:
        rule = f"An ID line has {_ID_LINE} characters, too few for {max(lines, key=len)!r}; shorten the clock's name."
        raise MeasurementError(response.source, [rule])
    one |= {f"id{k}": line for k, line in enumerate(lines[:5], 1)}
    one |= {"x": response.frequency_hz, "data": data, "abscissa_spec_data_type": _FREQUENCY}
    for end, part, name in (("rsp", "ordinate", response.output), ("ref", "orddenom", response.input)):
        kind, axis = name.split("_")
        one[f"{end}_node"] = "ABC".find(axis) + 1 or _NOZZLE_NODE
        one[f"{end}_dir"] = "xyz".find(axis) + 1 or 3
        one[f"{part}_spec_data_type"] = _KIND[kind]
        one[f"{part}_axis_units_lab"] = _UNIT[_KIND[kind]]
    return one | {"abscissa_axis_units_lab": "Hz"}
