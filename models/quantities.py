"""Names of a machine's quantities: suffix and unit of every key of a machine file, and of columns.

Internally all is mm, s, N, kg. One axis by itself may turn (rad, N m, kg m²), and the force of a motor with an unknown
constant is given by its current or voltage (A, V). Its file and its reports then write

    torque_n_m, inertia_kg_m2, stiffness_n_m_per_rad, pitch_rad        for force_n, mass_kg, stiffness_n_per_m, pitch_mm

for the same number; only lengths change, from mm to rad: internally, 1 rad is 1 m.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

# Suffix of a key and its unit: f a force, w a length, l a small length, m force over acceleration. Longer suffixes
# come first.
_ENDINGS = (
    ("_{m}", "{M}"),
    ("_{f}_s2_per_{w}2", "{F} s²/{W}²"),
    ("_{f}_s_per_{w}", "{F} s/{W}"),
    ("_{l}_per_s2", "{L}/s²"),
    ("_{l}_per_s", "{L}/s"),
    ("_{f}_per_{w}5", "{F}/{W}⁵"),
    ("_{f}_per_{w}3", "{F}/{W}³"),
    ("_{f}_per_{w}", "{F}/{W}"),
    ("_{f}_per_a", "{F}/A"),
    ("_v_s_per_{w}", "V s/{W}"),
    ("_v_per_{w}", "V/{W}"),
    ("_s_per_{w}", "s/{W}"),
    ("_{w}_per_s2", "{W}/s²"),
    ("_per_{w}", "1/{W}"),
    ("_per_{l}", "1/{L}"),
    ("_per_s2", "1/s²"),
    ("_per_s", "1/s"),
    ("_deg", "degrees"),
    ("_ohm", "Ω"),
    ("_hz", "Hz"),
    ("_{l}", "{L}"),
    ("_{f}", "{F}"),
    ("_a", "A"),
    ("_v", "V"),
)
_TOKEN = {"N": "n", "N m": "n_m", "A": "a", "V": "v"}
_NOUN = {"N": "force", "N m": "torque", "A": "current", "V": "voltage"}
_KEY = re.compile(r"\b(?:(?:axis|effects)\.)[\w.]+\w")
_SIGNALS = {
    "acc": ("acceleration", "{W}/s²"),
    "pos": ("position", "{L}"),
    "vel": ("speed", "{L}/s"),
    "force": ("force of the drive", "{F}"),
}
RAD_PER_MM = 1e-3


@dataclass(frozen=True)
class Quantities:
    """The words of one machine; without arguments, those of printers."""

    way: Literal["m", "rad"] = "m"
    force: Literal["N", "A", "V"] = "N"  # an axis that turns has N m for N
    per_kilogram: bool = False  # for forces and masses of effects, on axes of unknown mass

    @property
    def plain(self) -> bool:
        """Whether files and reports use the internal keys and numbers."""
        return self.way == "m" and self.force == "N"

    @property
    def turns(self) -> bool:
        """Whether the axis is rotary."""
        return self.way == "rad"

    @property
    def force_unit(self) -> str:
        """Return the unit of a force."""
        return "N m" if self.turns and self.force == "N" else self.force

    @property
    def length_unit(self) -> str:
        """Return the unit of a position."""
        return "rad" if self.turns else "mm"

    @cached_property
    def _parts(self) -> dict[str, str]:
        f, w = self.force_unit, self.way
        mass = {"N": "kg", "N m": "kg m²"}.get(f, f"{f} s²/{w}")
        token = {"kg": "kg", "kg m²": "kg_m2"}.get(mass, f"{_TOKEN[f]}_s2_per_{w}")
        of_key = {"f": _TOKEN[f], "w": w, "l": self.length_unit, "m": token}
        return of_key | {"F": f, "W": w, "L": self.length_unit, "M": mass}

    @cached_property
    def endings(self) -> dict[str, str]:
        """Return every ending of a key, and the unit it stands for."""
        return {ending.format(**self._parts): unit.format(**self._parts) for ending, unit in _ENDINGS}

    def unit_of(self, key: str) -> str:
        """Return the unit that a key's name ends in, '' if none."""
        return next((unit for ending, unit in self.endings.items() if key.endswith(ending)), "")

    def key(self, name: str) -> str:
        """Return the key in files and reports: `axis.mass_kg` is `axis.inertia_kg_m2` on a rotary axis."""
        path, dot, last = name.rpartition(".")
        last, bracket, index = last.partition("[")
        return f"{path}{dot}{self._renamed(last, PLAIN, self)}{bracket}{index}"

    def inside(self, key: str) -> str:
        """Return the internal key for a file's key; an internal key is returned unchanged."""
        path, dot, last = key.rpartition(".")
        last, bracket, index = last.partition("[")
        return f"{path}{dot}{self._renamed(last, self, PLAIN)}{bracket}{index}"

    @staticmethod
    def _renamed(key: str, of: Quantities, to: Quantities) -> str:
        if of is to or of == to:
            return key
        for template, _ in _ENDINGS:
            ending = template.format(**of._parts)
            if key.endswith(ending):
                stem = key.removesuffix(ending) + template.format(**to._parts)
                nouns = {_NOUN[of.force_unit]: _NOUN[to.force_unit]} if of.force_unit != to.force_unit else {}
                if of.way != to.way or nouns:
                    nouns |= {"mass": "inertia"} if not to.plain else {"inertia": "mass"}
                return "_".join(nouns.get(word, word) for word in stem.split("_"))
        return key

    def scale(self, name: str) -> float:
        """Return the factor from internal numbers to files and reports; `name` is internal."""
        ending = next((t for t, _ in _ENDINGS if name.partition("[")[0].endswith(t.format(**PLAIN._parts))), "")
        return RAD_PER_MM ** (ending.count("{l}") * (-1 if "per_{l}" in ending else 1)) if self.turns else 1.0

    def signal(self, name: str) -> tuple[str, str, float]:
        """Return a signal's meaning, its unit, and the factor from internal numbers."""
        kind, unit = next((words for start, words in _SIGNALS.items() if name.startswith(start)))
        return kind, unit.format(**self._parts), RAD_PER_MM if self.turns and "{L}" in unit else 1.0

    def value(self, name: str, number: Any) -> Any:
        """Return a number, or a list of them, in the units of files and reports; `name` is internal."""
        return _scaled(number, self.scale(name))

    def unit(self, unit: str) -> str:
        """Return the unit in files and reports for an internal unit."""
        same = (template for _, template in _ENDINGS if template.format(**PLAIN._parts) == unit)
        return next(same, unit).format(**self._parts)

    def sentence(self, text: str) -> str:
        """Return a sentence with the keys and units of this machine's file."""
        if self.plain:
            return text
        text = _KEY.sub(lambda match: self.key(match[0]), text)
        return re.sub(r"\(([^()]+)\)", lambda match: f"({self.unit(match[1])})", text)

    def read(self, table: Mapping[str, Any]) -> dict[str, Any]:
        """Return a file's table with internal keys and numbers; internal keys are left unchanged."""
        out: dict[str, Any] = {}
        for key, value in table.items():
            name = self.inside(key)
            if isinstance(value, dict):
                out[key] = self.read(value)
            elif name == key or name in table:  # stated twice: the reader reports the unknown key
                out[key] = value
            else:
                out[name] = _scaled(value, 1.0 / self.scale(name))
        return out


def _scaled(value: Any, scale: float) -> Any:
    """Return a number or list times a scale; other values unchanged."""
    if isinstance(value, list):
        return [_scaled(each, scale) for each in value]
    return scale * value if scale != 1.0 and isinstance(value, int | float) and not isinstance(value, bool) else value


PLAIN = Quantities()
