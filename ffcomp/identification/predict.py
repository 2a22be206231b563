"""Frequency responses that a machine file predicts, in the form of measured ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measurement.frf import AXES, CARRIAGES, FrequencyResponse
from models.arrays import ComplexArray, FloatArray
from models.kinds import delta_vibration
from models.machine import Machine
from models.vibration.substructures import command_frf, with_added_mass

# J and the carriages' response (k, 3, 3), by kind of input, place and frequencies
_Known = dict[tuple[object, ...], tuple[FloatArray, ComplexArray]]


def predicted(machine: Machine, responses: Sequence[FrequencyResponse]) -> list[ComplexArray]:
    """Predict every response, (k,) each, in its units.

    Raises MeasurementError for a response whose input, output or setup the model does not have.
    """
    known: _Known = {}
    return [_one(machine, response, known) for response in responses]


def _one(machine: Machine, response: FrequencyResponse, known: _Known) -> ComplexArray:
    commanded, straight = response.input.startswith("cmd_"), not machine.vibration.position_dependent
    if straight and not (commanded and response.setup == "assembly"):
        rule = f"The axes answer commands, such as cmd_x; {response.input!r} ({response.setup}) is none."
        _refuse(response, rule)
    if response.setup == "effector":
        return _struck(machine, response)
    if response.setup == "assembly":
        h = _assembled(machine, response, known)
    elif commanded:  # Eqs. 31 and 37, position to position
        h = command_frf(with_added_mass(delta_vibration(machine).carriage, response.added_mass_kg), response.s)
    else:
        _refuse(response, f"A carriage by itself is driven by its command, not by {response.input!r}.")
    return np.asarray(response.s**2 * h if response.output.startswith("acc_") else h)


def _struck(machine: Machine, response: FrequencyResponse) -> ComplexArray:
    """Eq. 45: a free effector, struck along one axis, without the arms' halves."""
    kind, axis = response.input.split("_")[0], response.input.split("_")[-1]
    if kind != "force" or axis not in AXES or response.output != f"acc_{axis}":
        _refuse(
            response, f"An effector by itself is struck: force_x to acc_x, not {response.input} to {response.output}."
        )
    return delta_vibration(machine).struck_frf(response.s)[:, AXES.index(axis)]


def _assembled(machine: Machine, response: FrequencyResponse, known: _Known) -> ComplexArray:
    """Predict the whole printer at one place: G of Eq. 29 of a command, Z⁻¹ Γ of a force on the nozzle."""
    kind, _, name = response.input.partition("_")
    if kind != "cmd" and name not in AXES:
        _refuse(response, f"There is no input {response.input!r}; there are cmd_A, cmd_x, force_x and their like.")
    xy = np.array((response.position_mm or (0.0, 0.0))[:2])
    place = (kind, *xy.tolist(), response.frequency_hz.tobytes())
    if place not in known:
        of_kind = machine.vibration.carriage_response if kind == "cmd" else delta_vibration(machine).receptance
        known[place] = machine.vibration.jacobian(xy[None])[0], of_kind(xy, response.s)
    (j, carriages), output = known[place], response.output[-1]
    if kind == "cmd":
        to_carriages = np.eye(3) if name in CARRIAGES else np.linalg.inv(j)
    else:
        to_carriages = delta_vibration(machine).load_map(j[None])[0]
    answer = carriages @ to_carriages[:, (CARRIAGES + AXES).index(name) % 3]  # (k, 3)
    return np.asarray(answer @ j[AXES.index(output)] if output in AXES else answer[:, CARRIAGES.index(output)])


def _refuse(response: FrequencyResponse, rule: str) -> NoReturn:
    raise MeasurementError(response.source or "response", [rule])


SMALLEST_PHASE_DEG = 10.0


def mean_absolute_percentage_accuracy(
    measured: ComplexArray, predicted: ComplexArray, smallest_phase_deg: float = SMALLEST_PHASE_DEG
) -> tuple[float, float]:
    """Compute μ_acc of magnitude and of phase, % (Eqs. 70, 71).

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
