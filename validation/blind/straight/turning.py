"""An axis that turns: that of `forced`, seen as an angle about its middle; file and runs are in rad, N m, kg m².

All that is pushed is pushed at the rim, `rim_m` from the middle: a torque is its force times the rim, an angle its way
through the rim. Every other axis is driven by a current whose torque constant the file knows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from validation.blind.printer.real import FloatArray, Labels, Reading, Rng, Tables
from validation.blind.straight import forced

# ending of a key, what stands for it of an axis that turns, and the power of the rim by which numbers grow
ENDINGS = (
    ("_n_s2_per_m2", "_n_m_s2_per_rad2", 3),
    ("_n_s_per_m", "_n_m_s_per_rad", 2),
    ("_n_per_m3", "_n_m_per_rad3", 4),
    ("_n_per_m", "_n_m_per_rad", 2),
    ("_kg", "_kg_m2", 2),
    ("_mm_per_s", "_rad_per_s", -1),
    ("_mm", "_rad", -1),
    ("_n", "_n_m", 1),
)


def turned(key: str, value: float, rim_m: float) -> tuple[str, float]:
    """Return a key and its number at the rim as those of the angle."""
    for ending, other, power in ENDINGS:
        if key.endswith(ending):
            stem = key.removesuffix(ending).replace("force", "torque").replace("mass", "inertia")
            return f"{stem}{other}", value * rim_m**power * (1e-3 if ending.startswith("_mm") else 1.0)
    return key, value


def draw_machine(rng: Rng, names: Sequence[str] = ()) -> Tables:
    """Draw an axis, its rim, and its motor."""
    machine = forced.draw_machine(rng, names)
    machine["rim_m"] = float(rng.uniform(0.02, 0.04))
    machine["n_m_per_a"] = float(rng.uniform(0.05, 0.5)) if rng.random() < 0.5 else 0.0  # 0: the torque is recorded
    return machine


def file_of(machine: Tables, error: float, rng: Rng) -> Tables:
    """Write what its owner's file says: every number off by a normal error."""
    written, constant = forced.file_of(machine, error, rng), machine["n_m_per_a"]
    numbers = {key: value for key, value in written["axis"].items() if key != "input"}
    axis: Tables = {"input": "current" if constant else "force", "unit": "rad"}
    axis |= dict(turned(key, value, machine["rim_m"]) for key, value in numbers.items())
    if constant:
        axis["drive"] = {"torque_constant_n_m_per_a": constant}
    return {**written, "axis": axis}


def restated(tables: Labels, real: Tables, file: Tables) -> Labels:
    """Return the effects in the file's terms."""
    said = {"axis": {"coupling_stiffness_n_per_m": _at_rim(file, real["rim_m"])}}
    found = forced.restated(tables, real, said)
    return {name: dict(turned(key, x, real["rim_m"]) for key, x in table.items()) for name, table in found.items()}


def _at_rim(file: Tables, rim_m: float) -> float:
    return float(file["axis"].get("coupling_stiffness_n_m_per_rad", 0.0)) / rim_m**2


def given(machine: Tables, times: FloatArray, reading: Reading, rng: Rng) -> dict[str, FloatArray]:
    """Return the column of the torque, or of the current that makes it, as it is recorded."""
    torque = machine["rim_m"] * forced.given(machine, times, reading, rng)["force_n"]
    return {"current_a": torque / machine["n_m_per_a"]} if machine["n_m_per_a"] else {"torque_n_m": torque}


def columns(machine: Tables, measured: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return what the sensors say at the rim, mm and m/s², by the columns of an axis that turns."""
    units = {"pos": ("rad", 1e-3), "acc": ("rad_per_s2", 1.0)}
    return {f"{c}_{units[c[:3]][0]}": x * units[c[:3]][1] / machine["rim_m"] for c, x in measured.items()}
