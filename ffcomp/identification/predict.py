"""Frequency responses that a machine file predicts, in the form of measured ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NoReturn

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measurement.frf import AXES, CARRIAGES, FrequencyResponse
from models.arrays import ComplexArray, FloatArray
from models.kinds import delta_vibration
from models.machine import Machine
from models.vibration.substructures import belt, command_frf, drive_frf


def predicted(machine: Machine, responses: Sequence[FrequencyResponse]) -> list[ComplexArray]:
    """Predict every response, (k,) each, in its units.

    Raises
    ------
    MeasurementError
        For a response whose input, output or setup the model does not have.
    """
    benches: dict[tuple[object, ...], _Assembly] = {}
    return [_one(machine, response, benches) for response in responses]


def _one(machine: Machine, response: FrequencyResponse, benches: dict[tuple[object, ...], _Assembly]) -> ComplexArray:
    s = response.s
    if not machine.vibration.position_dependent:
        return np.asarray(_straight(machine, response, s) * _differentiated(response, s))
    if response.setup == "effector":
        return _effector(machine, response, s)
    if response.setup in ("carriage", "carriage+mass"):
        return np.asarray(_carriage(machine, response, s) * _differentiated(response, s))
    place = response.position_mm or (0.0, 0.0, 0.0)
    key = (place[:2], response.frequency_hz.tobytes())
    if key not in benches:
        benches[key] = _assembly(machine, np.array(place[:2]), s)
    return np.asarray(benches[key].response(response) * _differentiated(response, s))


def _straight(machine: Machine, response: FrequencyResponse, s: ComplexArray) -> ComplexArray:
    """Of axes that do not disturb each other; their carriages are the axes themselves."""
    if response.setup != "assembly" or not response.input.startswith("cmd_"):
        _refuse(response, f"The axes answer commands, such as cmd_x; {response.input!r} ({response.setup}) is none.")
    commanded, answers = ((CARRIAGES + AXES).index(name[-1]) % 3 for name in (response.input, response.output))
    return machine.vibration.carriage_response(np.zeros(2), s)[:, answers, commanded]


def _differentiated(response: FrequencyResponse, s: ComplexArray) -> ComplexArray:
    return s**2 if response.output.startswith("acc_") else np.ones_like(s)


def _carriage(machine: Machine, response: FrequencyResponse, s: ComplexArray) -> ComplexArray:
    """Eqs. 31 and 37, position to position."""
    if not response.input.startswith("cmd_"):
        _refuse(response, f"A carriage by itself is driven by its command, not by {response.input!r}.")
    mass = delta_vibration(machine).carriage.mass_kg + response.added_mass_kg
    return command_frf(replace(delta_vibration(machine).carriage, mass_kg=mass), s)


def _effector(machine: Machine, response: FrequencyResponse, s: ComplexArray) -> ComplexArray:
    """Eq. 45: a free effector, struck along one axis, without the arms' halves."""
    kind, axis = response.input.split("_")[0], response.input.split("_")[-1]
    if kind != "force" or axis not in AXES or response.output != f"acc_{axis}":
        _refuse(
            response, f"An effector by itself is struck: force_x to acc_x, not {response.input} to {response.output}."
        )
    return delta_vibration(machine).struck_frf(s)[:, AXES.index(axis)]


@dataclass(frozen=True, eq=False)
class _Assembly:
    """The printer at one place: left · Z⁻¹ · right, with Z the carriages' impedance of Eq. 29."""

    compliance: ComplexArray  # (k, 3, 3) m/N, force on the carriages to their position
    drive: ComplexArray  # (k,) N/m, command to force: (c s + k) G_e
    j: FloatArray  # (3, 3)
    gamma: FloatArray  # (3, 3)

    def response(self, measured: FrequencyResponse) -> ComplexArray:
        left = self._carriages_of(measured.output.split("_", 1)[1])
        right, factor = self._force_of(measured)
        return np.asarray(np.einsum("i,kij,j->k", left, self.compliance, right) * factor)

    def _carriages_of(self, name: str) -> FloatArray:
        """Row that makes the output of the carriages' positions."""
        return np.eye(3)[CARRIAGES.index(name)] if name in CARRIAGES else self.j[AXES.index(name)]

    def _force_of(self, measured: FrequencyResponse) -> tuple[FloatArray, ComplexArray | float]:
        """Column of forces on the carriages, and what it is multiplied by."""
        kind, _, name = measured.input.partition("_")
        if kind == "cmd":
            to_carriages = np.eye(3) if name in CARRIAGES else np.linalg.inv(self.j)
            return np.asarray(to_carriages[:, (CARRIAGES + AXES).index(name) % 3]), self.drive
        if name in AXES:
            return self.gamma[:, AXES.index(name)], 1.0
        _refuse(measured, f"There is no input {measured.input!r}; there are cmd_A, cmd_x, force_x and their like.")


def _assembly(machine: Machine, xy: FloatArray, s: ComplexArray) -> _Assembly:
    model, here = delta_vibration(machine), machine.kinematics.jacobian(xy[None])
    j, gamma = here[0], model.load_map(here)[0]
    stiffness = (gamma * model.effector_impedance(s)[:, None, :]) @ j + model.carriage_impedance(xy, s)
    drive = belt(model.carriage, s) * drive_frf(model.carriage.drive, s)
    return _Assembly(np.linalg.inv(stiffness), drive, j, gamma)


def _refuse(response: FrequencyResponse, rule: str) -> NoReturn:
    raise MeasurementError(response.source or "response", [rule])


SMALLEST_PHASE_DEG = 10.0


def mean_absolute_percentage_accuracy(
    measured: ComplexArray, predicted: ComplexArray, smallest_phase_deg: float = SMALLEST_PHASE_DEG
) -> tuple[float, float]:
    """Compute μ_acc of magnitude and of phase, % (Eqs. 70, 71).

    Parameters
    ----------
    measured, predicted : (k,) at the same frequencies, rising; measured nowhere zero.
    smallest_phase_deg : 0 is Eq. 71 verbatim.
    """
    magnitude = np.abs(measured)
    ours, theirs = phases_deg(measured, predicted)
    relative_to = np.maximum(np.abs(ours), smallest_phase_deg)
    return (
        float(100.0 - 100 * np.mean(np.abs(magnitude - np.abs(predicted)) / magnitude)),
        float(100.0 - 100 * np.mean(np.abs(ours - theirs) / relative_to)),
    )


def log_error_db(measured: ComplexArray, predicted: ComplexArray) -> float:
    """Compute the root mean square of 20 log₁₀(|P|/|M|), dB: too large and too small count alike, resonance or not."""
    return float(np.sqrt(np.mean((20 * np.log10(np.abs(predicted) / np.abs(measured))) ** 2)))


def phases_deg(measured: ComplexArray, predicted: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Return both phases on one branch, (k,) degrees: the prediction unwrapped, the measured one nearest to it."""
    reference = np.unwrap(np.angle(predicted))
    return np.degrees(reference + np.angle(measured / predicted)), np.degrees(reference)
