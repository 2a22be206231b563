"""A measured frequency response with its variance.

Signals are named as the columns of a recording, without the unit: `cmd_A` `cmd_x` (commanded position), `pos_A` `pos_x`
(position), `acc_A` `acc_x` (acceleration), `force_x` (a hammer on the effector). Values are SI: position to
position is dimensionless, position to acceleration 1/s², force to acceleration 1/kg.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, cast, get_args

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


def variance_from_coherence(value: ComplexArray, coherence: FloatArray, averages: float) -> FloatArray:
    """Compute E|δH|² = |H|² (1 − γ²)/(γ² n) of an H1 estimate from n independent averages (Bendat & Piersol, 2010).

    Parameters
    ----------
    value : (k,) complex.
    coherence : (k,) γ², between 0 and 1.

    Returns
    -------
    (k,)
    """
    gamma2 = np.clip(coherence, 1e-12, 1.0)
    return np.asarray(np.abs(value) ** 2 * (1 - gamma2) / (gamma2 * averages))


CARRIAGES, AXES = "ABC", "xyz"
INPUTS = tuple(f"{kind}_{axis}" for kind in ("cmd", "force") for axis in CARRIAGES + AXES)
OUTPUTS = tuple(f"{kind}_{axis}" for kind in ("pos", "acc") for axis in CARRIAGES + AXES)
KEYS = ("input", "output", "position_mm", "setup", "added_mass_kg", "averages", "clock")


@dataclass(frozen=True)
class ResponseLabels:
    """Everything a file states about a response besides its lines."""

    input: str
    output: str
    setup: Setup = "assembly"
    position_mm: tuple[float, float, float] | None = None
    added_mass_kg: float = 0.0
    averages: float | None = None  # independent averages behind the coherence
    clock: str = ""


def read_labels(comments: Mapping[str, str]) -> tuple[ResponseLabels | None, list[str]]:
    """Parse labels from `key: value` pairs, or return the problems, in full sentences.

    Unknown keys are ignored, unless they are nearly a known one.
    """
    others = [key for key in comments if key not in KEYS]
    mistyped = [key for key in others if difflib.get_close_matches(key, KEYS, 1, 0.8)]
    problems = [unknown(f"Label {key!r}", key, KEYS) for key in mistyped]
    problems += _bad_name(comments, "input", INPUTS) + _bad_name(comments, "output", OUTPUTS)
    setup = comments.get("setup", "assembly")
    if setup not in get_args(Setup):
        problems.append(unknown(f"Setup {setup!r}", setup, get_args(Setup)))
    position = _numbers(comments, "position_mm", 3, problems)
    mass = _numbers(comments, "added_mass_kg", 1, problems)
    averages = _numbers(comments, "averages", 1, problems)
    if mass and mass[0] < 0:
        problems.append(f"Label 'added_mass_kg' is {mass[0]:g}; a mass that was added is not negative.")
    if averages and averages[0] < 1:
        problems.append(f"Label 'averages' is {averages[0]:g}; an estimate has at least one.")
    if problems:
        return None, problems
    place = cast("tuple[float, float, float]", tuple(position)) if position else None
    return ResponseLabels(
        comments["input"],
        comments["output"],
        cast(Setup, setup),
        place,
        mass[0] if mass else 0.0,
        averages[0] if averages else None,
        comments.get("clock", ""),
    ), []


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


def _bad_name(comments: Mapping[str, str], key: str, known: Sequence[str]) -> list[str]:
    if key not in comments:
        return [f"Label '{key}' is missing; say '# {key}: {known[0]}' or another of {', '.join(known)}."]
    return [] if comments[key] in known else [unknown(f"The {key} {comments[key]!r}", comments[key], known)]


def _numbers(comments: Mapping[str, str], key: str, count: int, problems: list[str]) -> list[float]:
    if key not in comments:
        return []
    try:
        values = [float(part) for part in comments[key].split(",")]
    except ValueError:
        values = []
    if len(values) == count and np.isfinite(values).all():
        return values
    problems.append(f"Label '{key}' is {comments[key][:40]!r}; it must be {count} finite number{'s' * (count > 1)}.")
    return []
