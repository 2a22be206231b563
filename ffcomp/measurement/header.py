"""The columns of a recording: their names, and suggestions for names that are nearly right."""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence

_AXES = "ABCxyz"
_UNITS = {"cmd": "mm", "acc": "m_per_s2", "pos": "mm"}
KNOWN = ("t_s", *(f"{kind}_{axis}_{unit}" for kind, unit in _UNITS.items() for axis in _AXES))

# Factors to the unit of the format.
_FACTORS = {
    "acc": {"g": "9.80665", "mg": "0.00980665", "mm_per_s2": "0.001", "cm_per_s2": "0.01"},
    "mm": {"m": "1000", "um": "0.001", "cm": "10", "in": "25.4"},
    "t": {"ms": "0.001", "us": "1e-6", "ns": "1e-9"},
}
_SPELLINGS = {"mm_s2": "mm_per_s2", "m_s2": "m_per_s2", "mms2": "mm_per_s2", "ms2": "m_per_s2", "mps2": "m_per_s2"}


def signal_of(column: str) -> str | None:
    """Return a column's signal: `acc_A` of `acc_A_m_per_s2`; None if the format has no such column."""
    if column not in KNOWN:
        return None
    return "t" if column == "t_s" else column[:5]


def closest(name: str, known: Sequence[str]) -> str | None:
    """Suggest the known name nearest to a name; a wrong case decides before a wrong letter."""
    same = [one for one in known if one.lower() == name.lower()]
    return next(iter(same or difflib.get_close_matches(name, known, 1)), None)


def check_header(columns: Sequence[str]) -> list[str]:
    """List the problems of a recording's header, in full sentences."""
    if not any(name in KNOWN for name in columns) and None in [_meant(name) for name in columns]:
        return [
            f"The first line, {','.join(columns)[:60]!r}, names no column of a recording; a recording has t_s, its "
            "command (cmd_A_mm, … or cmd_x_mm, …) and what sensors measured (acc_*_m_per_s2, pos_*_mm)."
        ]
    problems = [_unknown(name) for name in dict.fromkeys(columns) if name not in KNOWN]
    problems += repeated_columns(columns)
    if "t_s" not in columns:
        problems.append("Column t_s (time, seconds) is missing; every recording needs it.")
    problems += _command(columns)
    if not any(name.startswith(("acc_", "pos_")) and name in KNOWN for name in columns):
        problems.append("No sensor column is there; a recording needs at least one of acc_*_m_per_s2 or pos_*_mm.")
    return problems


def repeated_columns(columns: Sequence[str]) -> list[str]:
    """Report columns of the same name, in full sentences."""
    twice = [name for name in dict.fromkeys(columns) if columns.count(name) > 1]
    return [f"Column {name!r} is there {columns.count(name)} times; one is needed." for name in twice]


def _command(columns: Sequence[str]) -> list[str]:
    carriages, nozzle = ([f"cmd_{axis}_mm" for axis in axes] for axes in ("ABC", "xyz"))
    found = [name for name in columns if name in carriages + nozzle]
    if any(name in carriages for name in found) and any(name in nozzle for name in found):
        return [f"The command must be of the carriages or of the nozzle, not of both; found are {', '.join(found)}."]
    needed = nozzle if any(name in nozzle for name in found) else carriages
    missing = [name for name in needed if name not in found]
    if not found:
        return [
            "The command is missing; a recording needs cmd_A_mm, cmd_B_mm, cmd_C_mm, or cmd_x_mm, cmd_y_mm, cmd_z_mm."
        ]
    return [f"Column {name} is missing; a command needs {', '.join(needed)}." for name in missing]


def _meant(name: str) -> re.Match[str] | None:
    """Match a name with another unit, or none."""
    return re.fullmatch(rf"(?:(cmd|acc|pos)_([{_AXES}])|t)(?:_(\w+))?", name)


def _unknown(name: str) -> str:
    unit = _meant(name)
    if not name:
        return "A column has no name; every column of the header needs one."
    if unit:
        return _wrong_unit(name, unit[1] or "t", unit[2] or "", unit[3] or "")
    near = closest(name, KNOWN)
    return f"Column {name!r} is unknown" + (f"; did you mean {near!r}?" if near else "; the format has no such column.")


def _wrong_unit(name: str, kind: str, axis: str, unit: str) -> str:
    needed = "t_s" if kind == "t" else f"{kind}_{axis}_{_UNITS[kind]}"
    factors = _FACTORS[kind if kind in _FACTORS else "mm"]
    factor = factors.get(_SPELLINGS.get(unit, unit))
    how = f" and multiply its numbers by {factor}" if factor else ""
    said = f"names the unit {unit!r}" if unit else "names no unit"
    return f"Column {name!r} {said}; the format asks for {needed!r}: rename it{how}."
