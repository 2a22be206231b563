"""The paper's identification, step by step (Eqs. 30-49 and 63-69, corrected), with standard uncertainties.

    carriage alone, carriage with a known mass     → m, k, c, b and the drive's d₀ d₁ d₂     (Eqs. 30-43)
    effector struck by a hammer, and its weight    → m₁, m₂, and b_j, k_j of that axis       (Eqs. 45-49)
    the whole printer, one axis after the other    → b_j, k_j                                (Eqs. 63-69)

The paper fits rational functions with free coefficients (Eqs. 42, 47, 66) and then solves their equations for the
parameters. At 40 dB that is ill-conditioned for the whole printer: the extruder is well damped along x and y (ζ = 0.5
and 0.7), so a pole cancels a zero, and coefficients scatter by 8 to 40 %. Here the coefficients are kept to those
equations while fitting, by output error, and the parameters of the steps before are held by their uncertainties. χ² of
each step says whether its responses agree with them.

Corrected: Eq. 68's s² term is (c+b) b_j, without α; α is the ratio of load to carriage motion, σ_j² of J at the
centre (1/3 along z), not Eq. 69, which forgets that X is not q; M₁ holds the arms' lower halves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.identification.direct import NEUTRAL_DRIVE
from ffcomp.identification.output_error import CARRIAGE, DAMPING, DRIVE, EFFECTOR_MASSES, STIFFNESS, fit_machine
from ffcomp.identification.uncertainty import Estimate, lognormal
from ffcomp.measurement.frf import AXES, FrequencyResponse
from ffcomp.numerics.serialise import keys
from models.kinds import delta_vibration, with_parts
from models.machine import Machine, with_values

SETUPS = ("carriage", "carriage+mass", "effector", "assembly")


@dataclass(frozen=True, eq=False)
class Step:
    """The result of one step."""

    json_keys: ClassVar = keys(step="title", chi_squared_per_degree_of_freedom="consistency", numbers="estimates")

    title: str
    estimates: Mapping[str, Estimate]  # by the names of the machine file
    consistency: float  # χ² by degree of freedom: 1 if noise explains its residual


@dataclass(frozen=True, eq=False)
class PaperIdentification:
    """The machine of all steps, its numbers, and each step."""

    machine: Machine
    estimates: Mapping[str, Estimate]  # each from the step that determines it best
    steps: Sequence[Step]

    def __getitem__(self, title: str) -> Step:
        return next(step for step in self.steps if step.title == title)


def identify_as_paper(
    start: Machine, responses: Sequence[FrequencyResponse], total_mass_kg: float, total_sd_kg: float = 0.0
) -> PaperIdentification:
    """Run every step of the paper, from responses of all four setups.

    Parameters
    ----------
    start : gives the kinematics, the arms' mass and the limits; its vibration parameters only begin the search.

    Raises
    ------
    MeasurementError
        If one of the four measurements is missing.
    SolverError
    """
    for setup in SETUPS:
        if all(response.setup != setup for response in responses):
            rule = f"No response with the setup {setup!r} is there; the paper's steps need it."
            raise MeasurementError("the measurements", [rule])
    parts = delta_vibration(start).carriage
    machine = with_parts(start, carriage=replace(parts, drive=parts.drive or NEUTRAL_DRIVE))
    alone = [r for r in responses if r.setup in SETUPS[:2]]
    carriage = _step("carriage", machine, alone, (*CARRIAGE, *DRIVE))
    machine = _with(machine, carriage.estimates)
    struck = [r for r in responses if r.setup == "effector"]
    hammers = [_hammer_step(machine, r, total_mass_kg, total_sd_kg / total_mass_kg) for r in struck]
    clearest = min(hammers, key=lambda step: step.estimates[EFFECTOR_MASSES[1]].relative_sd)
    machine = _with(machine, *(step.estimates for step in hammers), clearest.estimates)
    masses = {name: clearest.estimates[name] for name in EFFECTOR_MASSES}
    known = {name: (e.value, e.sd) for name, e in {**carriage.estimates, **masses}.items()}
    assembly = []
    for axis, *mount in zip(AXES, STIFFNESS, DAMPING, strict=True):
        moved = [r for r in responses if r.setup == "assembly" and r.input == f"cmd_{axis}"]
        if moved:
            assembly.append(_step(f"assembly {axis}", machine, moved, mount, known))
    mounts = [each for step in (*hammers, *assembly) for each in step.estimates.items() if each[0] not in masses]
    sharpest = dict(sorted(mounts, key=lambda each: -each[1].relative_sd))
    found = {**carriage.estimates, **masses, **sharpest}
    return PaperIdentification(_with(machine, found), found, (carriage, *hammers, *assembly))


def _hammer_step(machine: Machine, struck: FrequencyResponse, total_kg: float, relative_sd: float) -> Step:
    """Identify both masses and the mount along the struck axis from the free effector's accelerance and its weight.

    A hammer's gain multiplies all of them alike (Eq. 45), and the weight divides it out: it needs no calibration.
    """
    i = AXES.index(struck.input[-1])
    names = (*EFFECTOR_MASSES, STIFFNESS[i], DAMPING[i])
    fitted = fit_machine(machine, [struck], unknowns=names)
    values = np.array([fitted.estimates[name].value for name in names])
    of_total = np.append(values[:2] / values[:2].sum(), [0.0, 0.0])
    over_total = np.eye(len(names)) - of_total  # of the logarithms
    sd = np.sqrt(np.diag(over_total @ fitted.covariance @ over_total.T) + relative_sd**2)
    scaled = values * total_kg / values[:2].sum()
    each = zip(names, scaled.tolist(), sd.tolist(), strict=True)
    return Step(f"hammer {AXES[i]}", {name: lognormal(value, spread) for name, value, spread in each}, fitted.misfit)


def _step(
    title: str,
    machine: Machine,
    responses: Sequence[FrequencyResponse],
    names: Sequence[str],
    known: Mapping[str, tuple[float, float]] | None = None,
) -> Step:
    """Fit some numbers, and hold the known ones by their uncertainties."""
    fitted = fit_machine(machine, responses, known, unknowns=(*(known or {}), *names))
    return Step(title, {name: fitted.estimates[name] for name in names}, fitted.misfit)


def _with(machine: Machine, *found: Mapping[str, Estimate]) -> Machine:
    return with_values(machine, {name: e.value for each in found for name, e in each.items()})
