"""The pictures of frequency responses. Run from anywhere: python docs/examples/frf_pictures.py [FOLDER]"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from ffcomp.identification.predict import predicted
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.report.drawing import write_figure
from ffcomp.report.model import bode_figure
from ffcomp.responses.result import frequency_responses
from ffcomp.responses.view import View
from models.file import load_machine
from models.kinds import delta_vibration, with_parts
from models.machine import Machine

FREQUENCIES_HZ = np.arange(0.5, 125.1, 0.5)
PLACES = [np.array([0.0, 0.0]), np.array([-80.0, 0.0])]


def main(folder: Path) -> None:
    machine = load_machine("mp-delta-pro")
    found = frequency_responses(machine, View(), FREQUENCIES_HZ, [], as_if_measured(machine))
    write_figure(bode_figure(found), folder / "frf_measured.png")
    print(found.verdict)


def as_if_measured(machine: Machine) -> list[FrequencyResponse]:
    """Nobody's printer: a belt 6 % stiffer and a guide 30 % more damped than the file says, and 3 % of noise."""
    carriage = delta_vibration(machine).carriage
    real = with_parts(
        machine,
        carriage=replace(
            carriage,
            belt_stiffness_n_per_m=1.06 * carriage.belt_stiffness_n_per_m,
            guide_damping_n_s_per_m=1.3 * carriage.guide_damping_n_s_per_m,
        ),
    )
    generator = np.random.default_rng(1)
    return [_noisy(real, letter, place, generator) for place in PLACES for letter in "ABC"]


def _noisy(real: Machine, letter: str, place: np.ndarray, generator: np.random.Generator) -> FrequencyResponse:
    lines = FREQUENCIES_HZ[3:]
    where = (float(place[0]), float(place[1]), 30.0)
    nothing = np.zeros(len(lines))
    empty = FrequencyResponse(
        f"cmd_{letter}", f"pos_{letter}", lines, nothing.astype(complex), nothing, position_mm=where
    )
    noise = 0.03 / np.sqrt(2) * (generator.normal(size=len(lines)) + 1j * generator.normal(size=len(lines)))
    return replace(empty, value=predicted(real, [empty])[0] * (1 + noise), source="simulated")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[1])
