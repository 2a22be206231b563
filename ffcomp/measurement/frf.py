"""A measured frequency response with its variance.

Signals are named as the columns of a recording, without the unit: `cmd_A` `cmd_x` (commanded position), `pos_A` `pos_x`
(position), `acc_A` `acc_x` (acceleration), `force_x` (a hammer on the effector). Values are SI: position to
position is dimensionless, position to acceleration 1/s², force to acceleration 1/kg.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from ffcomp.measurement.table import closest
from models.arrays import ComplexArray, FloatArray

# The measured setup: the carriage alone on its belt (with the arms' upper halves, Eq. 30), the same with a known
# mass added, the effector alone, taken off its arms, or the whole printer.
Setup = Literal["carriage", "carriage+mass", "effector", "assembly"]


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """The response of `output` to `input`."""

    input: str
    output: str
    frequency_hz: FloatArray  # (k,) Hz, rising, above zero
    value: ComplexArray  # (k,) SI
    variance: FloatArray  # (k,) of the complex value, E|δ|², SI²; half of it in each of real and imaginary part
    setup: Setup = "assembly"
    position_mm: tuple[float, float, float] | None = None  # of the nozzle; None where nothing depends on it
    added_mass_kg: float = 0.0  # on the carriage
    coherence: FloatArray | None = None  # (k,) if it was measured
    source: str = ""  # file name
    clock: str = ""  # responses with the same clock share one unknown delay; empty: measured with the command's own

    @property
    def s(self) -> ComplexArray:
        """(k,) jω, 1/s."""
        return np.asarray(2j * np.pi * self.frequency_hz, dtype=np.complex128)

    def between(self, lowest_hz: float, highest_hz: float) -> FrequencyResponse:
        """Restrict to a band, both ends included."""
        keep = (self.frequency_hz >= lowest_hz) & (self.frequency_hz <= highest_hz)
        return replace(
            self,
            frequency_hz=self.frequency_hz[keep],
            value=self.value[keep],
            variance=self.variance[keep],
            coherence=None if self.coherence is None else self.coherence[keep],
        )


CARRIAGES, AXES = "ABC", "xyz"
CARRIAGES_AS_AXES = str.maketrans(CARRIAGES, AXES)  # of straight axes: cmd_A is cmd_x
SIGNALS = {
    end: tuple(f"{kind}_{axis}" for kind in kinds for axis in CARRIAGES + AXES)
    for end, kinds in {"input": ("cmd", "force"), "output": ("pos", "acc")}.items()
}
NUMBERS = {"position_mm": 3, "added_mass_kg": 1, "averages": 1}  # how many each label has
KEYS = ("input", "output", "position_mm", "setup", "added_mass_kg", "averages", "clock")


def read_labels(comments: Mapping[str, str]) -> tuple[dict[str, Any], list[str]]:
    """Parse `key: value` pairs to fields of a response and `averages`, and list the problems, in full sentences.

    Unknown keys are ignored, unless they are nearly a known one.
    """
    labels: dict[str, Any] = {key: comments[key] for key in KEYS if key in comments}
    mistyped = [key for key in comments if key not in KEYS and difflib.get_close_matches(key, KEYS, 1, 0.8)]
    problems = [unknown(f"Label {key!r}", key, KEYS) for key in mistyped]
    for key, known in SIGNALS.items():
        if key not in labels:
            problems.append(f"Label '{key}' is missing; say '# {key}: {known[0]}' or another of {', '.join(known)}.")
    for key, known in {**SIGNALS, "setup": get_args(Setup)}.items():
        if labels.get(key, known[0]) not in known:
            problems.append(unknown(f"The {key} {labels[key]!r}", labels[key], known))
    for key, count in NUMBERS.items():
        if key not in labels:
            continue
        text = labels.pop(key)
        try:
            values = tuple(float(part) for part in text.split(","))
        except ValueError:
            values = ()
        if len(values) != count or not np.isfinite(values).all():
            problems.append(f"Label '{key}' is {text[:40]!r}; it must be {count} finite number{'s' * (count > 1)}.")
        else:
            labels[key] = values if count > 1 else values[0]
    if labels.get("added_mass_kg", 0.0) < 0:
        problems.append(f"Label 'added_mass_kg' is {labels['added_mass_kg']:g}; a mass that was added is not negative.")
    if labels.get("averages", 1.0) < 1:
        problems.append(f"Label 'averages' is {labels['averages']:g}; an estimate has at least one.")
    return labels, problems


def describe(response: FrequencyResponse) -> dict[str, str]:
    """Write the `key: value` pairs that `read_labels` reads back."""
    comments = {"input": response.input, "output": response.output, "setup": str(response.setup)}
    if response.position_mm is not None:
        comments["position_mm"] = ", ".join(f"{p:.12g}" for p in response.position_mm)
    if response.added_mass_kg:
        comments["added_mass_kg"] = f"{response.added_mass_kg:.12g}"
    if response.clock:
        comments["clock"] = response.clock
    return comments


def unknown(what: str, name: str, known: Sequence[str]) -> str:
    """Write a sentence about an unknown name, with the nearest known one."""
    near = closest(name, known)
    return f"{what} is unknown; " + (f"did you mean {near!r}?" if near else f"known are {', '.join(known)}.")
