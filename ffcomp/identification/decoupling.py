"""Receptance decoupling: the effector's load on the carriages, recovered from the measured printer.

Eq. 29 turned round. With the measured G and sub-model 1 known,

    Γ W J = (c s + k) G_e G⁻¹ − (m s² + (c + b) s + k) I

so the load on the carriages is measured frequency by frequency, with the variance that the measured G gives it,
δ(ΓWJ) = −(c s + k) G_e G⁻¹ δG G⁻¹. Its parts then show which part of the model is wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measurement.frf import CARRIAGES, FrequencyResponse
from ffcomp.numerics.serialise import keys
from ffcomp.result import Fact, Result
from models.arrays import ComplexArray, FloatArray
from models.kinds import delta_vibration
from models.machine import Machine
from models.vibration.substructures import belt, drive_frf


@dataclass(frozen=True, eq=False)
class Decoupled:
    """The effector's impedance at one place, measured and by the machine file, N/m."""

    w: ComplexArray  # (k, 3, 3) J⁻ᵀ (ΓWJ) J⁻¹, rows force, columns motion X Y Z
    variance: FloatArray  # (k, 3, 3), E|δ|²
    model: ComplexArray  # (k, 3, 3)


def decouple(machine: Machine, responses: Sequence[FrequencyResponse]) -> Decoupled:
    """Decouple the nine responses `cmd_A` … `cmd_C` to `pos_A` … `pos_C` (or `acc_`) of one position.

    Raises
    ------
    MeasurementError
        If one of the nine is missing, or they are not of one position and one frequency grid.
    """
    g, variance, first = _square(responses)
    s = first.s
    xy = np.array((first.position_mm or (0.0, 0.0, 0.0))[:2])
    inverse = np.linalg.inv(g)
    drive = belt(delta_vibration(machine).carriage, s) * drive_frf(delta_vibration(machine).carriage.drive, s)
    carriage = delta_vibration(machine).carriage_impedance(xy, s)
    size = np.abs(inverse) ** 2
    spread = np.abs(drive[:, None, None]) ** 2 * np.einsum("kia,kab,kbj->kij", size, variance, size)
    j, gamma = machine.kinematics.jacobian(xy[None])[0], delta_vibration(machine).load_map(xy[None])[0]
    model = (gamma * delta_vibration(machine).effector_impedance(s)[:, None, :]) @ j
    load, back = drive[:, None, None] * inverse - carriage, np.linalg.inv(j)
    w, of_model = (np.einsum("ai,kab,bj->kij", back, each, back) for each in (load, model))
    return Decoupled(w, np.einsum("ai,kab,bj->kij", back**2, spread, back**2), of_model)


def _square(responses: Sequence[FrequencyResponse]) -> tuple[ComplexArray, FloatArray, FrequencyResponse]:
    """Stack G and its variance, (k, 3, 3), position to position."""
    table = {(r.output[-1], r.input[-1]): r for r in responses if r.input[:4] == "cmd_" and r.setup == "assembly"}
    needed = [[table.get((row, column)) for column in CARRIAGES] for row in CARRIAGES]
    flat = [r for row in needed for r in row if r is not None]
    if len(flat) < 9:
        missing = [f"cmd_{c} to pos_{r}" for r in CARRIAGES for c in CARRIAGES if (r, c) not in table]
        rule = f"Decoupling needs nine responses of one position; missing: {', '.join(missing)}."
        raise MeasurementError("the measurements", [rule])
    first = flat[0]
    for other in flat:
        if other.position_mm != first.position_mm or not np.array_equal(other.frequency_hz, first.frequency_hz):
            rule = f"It is not of the position and frequencies of {first.source or 'the first response'}."
            raise MeasurementError(other.source or f"{other.input} to {other.output}", [rule])
    squared = [r.s**2 if r.output.startswith("acc_") else np.ones_like(r.s) for r in flat]
    k = len(first.frequency_hz)
    g = np.stack([r.value / d for r, d in zip(flat, squared, strict=True)], axis=1).reshape(k, 3, 3)
    v = np.stack([r.variance / np.abs(d) ** 2 for r, d in zip(flat, squared, strict=True)], axis=1).reshape(k, 3, 3)
    return g, v, first


@dataclass(frozen=True)
class Part:
    """One statement of the model, held against the measured load."""

    json_keys: ClassVar = keys("name", "statement", "error", "noise", "holds")

    name: str
    statement: str
    error: float  # the contradiction, as a share of the measured load (rms over frequencies, variance-weighted)
    noise: float  # the same of noise alone

    @property
    def holds(self) -> bool:
        """Beyond the noise there is less than the noise again, or less than half a percent."""
        return self.error**2 - self.noise**2 < max(self.noise, 0.005) ** 2


def evaluate_parts(decoupled: Decoupled) -> list[Part]:
    """Evaluate symmetry (energy), directions (geometry and force map), and each axis of W (masses and mount)."""
    w, variance, model = decoupled.w, decoupled.variance, decoupled.model
    size = np.einsum("kii->k", np.abs(w)) / 3
    odd = (w - w.transpose(0, 2, 1)) / 2
    off = ~np.eye(3, dtype=bool)
    mirrored = (variance + variance.transpose(0, 2, 1)) / 4
    parts = [
        _part("force map", "the load is symmetric: no motion round a loop gains energy", odd, mirrored, size, off),
        _part("directions", "each axis of the nozzle's motion needs a force along itself only", w, variance, size, off),
    ]
    for i, axis in enumerate("xyz"):
        only = np.zeros((3, 3), dtype=bool)
        only[i, i] = True
        statement = f"the force along {axis} is the model's w_{axis} (masses, mount stiffness and damping along {axis})"
        parts.append(_part(f"effector {axis}", statement, w - model, variance, np.abs(w[:, i, i]), only))
    return parts


def _part(
    name: str,
    statement: str,
    error: ComplexArray,
    variance: FloatArray,
    size: FloatArray,
    mask: np.typing.NDArray[np.bool_],
) -> Part:
    """Compute the weighted rms over frequencies of |error|/size over the entries of `mask`."""
    e = np.sum(np.abs(error[:, mask]) ** 2, axis=1) / size**2
    v = np.sum(variance[:, mask], axis=1) / size**2
    weight = 1 / (v + np.median(v) * 1e-3 + 1e-12)
    weight /= np.sum(weight)
    return Part(name, statement, float(np.sqrt(np.sum(weight * e))), float(np.sqrt(np.sum(weight * v))))


@dataclass(frozen=True)
class PlaceParts:
    """The model's statements at one place."""

    position_mm: tuple[float, float, float] | None
    parts: tuple[Part, ...]


@dataclass(frozen=True, eq=False, repr=False)
class Decoupling(Result):
    """Which parts of a delta's model hold, at each place."""

    title = "Parts of the model"
    schema = "ffcomp-identify-decouple/1"
    json_keys: ClassVar = keys("machine", "places")

    machine: Machine
    places: Sequence[PlaceParts]

    @property
    def headline(self) -> str:
        """Which parts are wrong."""
        wrong = dict.fromkeys(part.name for place in self.places for part in place.parts if not part.holds)
        return f"Wrong in {self.machine.name}: {', '.join(wrong)}." if wrong else "Every part of the model holds."

    @property
    def facts(self) -> list[Fact]:
        """Each part at each place."""
        return [
            (
                f"{part.name} at {x:g}, {y:g} mm",
                f"{'holds' if part.holds else 'WRONG'}: {100 * part.error:.1f} % off (noise {100 * part.noise:.1f} %), "
                f"where {part.statement}",
            )
            for place in self.places
            for x, y in [(place.position_mm or (0.0, 0.0))[:2]]
            for part in place.parts
        ]


def parts_of_places(machine: Machine, responses: Sequence[FrequencyResponse]) -> list[PlaceParts]:
    """Evaluate the parts at each place where the printer was measured."""
    places = list(dict.fromkeys(r.position_mm for r in responses if r.setup == "assembly")) or [None]
    return [
        PlaceParts(place, tuple(evaluate_parts(decouple(machine, [r for r in responses if r.position_mm == place]))))
        for place in places
    ]
