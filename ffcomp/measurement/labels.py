"""Labels of a frequency response in a file: names, position, setup."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast, get_args

import numpy as np

from ffcomp.measurement.frf import FrequencyResponse, Setup
from ffcomp.measurement.header import closest

INPUTS = tuple(f"{kind}_{axis}" for kind in ("cmd", "force") for axis in "ABCxyz")
OUTPUTS = tuple(f"{kind}_{axis}" for kind in ("pos", "acc") for axis in "ABCxyz")
KEYS = ("input", "output", "position_mm", "setup", "added_mass_kg", "averages", "clock")


@dataclass(frozen=True)
class Labels:
    """Everything a file states about a response besides its lines."""

    input: str
    output: str
    setup: Setup = "assembly"
    position_mm: tuple[float, float, float] | None = None
    added_mass_kg: float = 0.0
    averages: float | None = None  # independent averages behind the coherence
    clock: str = ""


def read_labels(said: Mapping[str, str]) -> tuple[Labels | None, list[str]]:
    """Parse labels from `key: value` pairs, or return the problems, in full sentences.

    Unknown keys are ignored, unless they are nearly a known one.
    """
    problems = [unknown(f"Label {key!r}", key, KEYS) for key in said if _nearly_ours(key)]
    problems += _bad_name(said, "input", INPUTS) + _bad_name(said, "output", OUTPUTS)
    setup = said.get("setup", "assembly")
    if setup not in get_args(Setup):
        problems.append(unknown(f"Setup {setup!r}", setup, get_args(Setup)))
    position = _numbers(said, "position_mm", 3, problems)
    mass = _numbers(said, "added_mass_kg", 1, problems)
    averages = _numbers(said, "averages", 1, problems)
    if mass and mass[0] < 0:
        problems.append(f"Label 'added_mass_kg' is {mass[0]:g}; a mass that was added is not negative.")
    if averages and averages[0] < 1:
        problems.append(f"Label 'averages' is {averages[0]:g}; an estimate has at least one.")
    if problems:
        return None, problems
    given = cast("tuple[float, float, float]", tuple(position)) if position else None
    return Labels(
        said["input"],
        said["output"],
        cast(Setup, setup),
        given,
        mass[0] if mass else 0.0,
        averages[0] if averages else None,
        said.get("clock", ""),
    ), []


def describe(response: FrequencyResponse) -> dict[str, str]:
    """Write the `key: value` pairs that `read_labels` reads back."""
    said = {"input": response.input, "output": response.output, "setup": str(response.setup)}
    if response.position_mm is not None:
        said["position_mm"] = ", ".join(f"{p:.12g}" for p in response.position_mm)
    if response.added_mass_kg:
        said["added_mass_kg"] = f"{response.added_mass_kg:.12g}"
    if response.clock:
        said["clock"] = response.clock
    return said


def unknown(what: str, name: str, known: Sequence[str]) -> str:
    """Write a sentence about an unknown name, with the nearest known one."""
    near = closest(name, known)
    return f"{what} is unknown; " + (f"did you mean {near!r}?" if near else f"known are {', '.join(known)}.")


def _nearly_ours(key: str) -> bool:
    return key not in KEYS and bool(difflib.get_close_matches(key, KEYS, 1, 0.8))


def _bad_name(said: Mapping[str, str], key: str, known: Sequence[str]) -> list[str]:
    if key not in said:
        return [f"Label '{key}' is missing; say '# {key}: {known[0]}' or another of {', '.join(known)}."]
    return [] if said[key] in known else [unknown(f"The {key} {said[key]!r}", said[key], known)]


def _numbers(said: Mapping[str, str], key: str, count: int, problems: list[str]) -> list[float]:
    if key not in said:
        return []
    try:
        values = [float(part) for part in said[key].split(",")]
    except ValueError:
        values = []
    if len(values) == count and np.isfinite(values).all():
        return values
    problems.append(f"Label '{key}' is {said[key][:40]!r}; it must be {count} finite number{'s' * (count > 1)}.")
    return []
