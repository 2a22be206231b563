"""The engine on runs of the independent printer, whose friction has another shape than ours."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.diagnosis.diagnosis import diagnose
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.result import DiagnosisResult
from ffcomp.diagnosis.where import locate_residual
from ffcomp.measurement.recording import Recording
from models.file import LIBRARY, load_machine
from validation.plants import delta_plant

TRUTH = LIBRARY / "mp-delta-pro.toml"
CANDIDATES = ("coulomb_friction", "command_delay")
STEP_S, RATE_HZ = 1 / 12800, 1600.0
PLACES = ((-70.0, 20.0, 30.0), (40.0, -60.0, 30.0))


def made_recordings(hidden: dict[str, Any], noise: float, seed: int) -> list[Recording]:
    """A recording at each of two places, the first twice: all towers shaken by tones between 4 and 130 Hz."""
    machine = {**delta_plant.load_machine(TRUTH), **hidden}
    rng = np.random.default_rng(seed)
    t = np.arange(2 * round(0.8 / STEP_S) + 1) * STEP_S / 2
    recordings = []
    for number, place in enumerate(PLACES):
        f = rng.uniform(4, 130, (12, 3))
        tones = [0.6 / f * np.sin(2 * np.pi * f * x + 6.28 * f) for x in t[::16]]
        coarse = np.sum(tones, axis=1) * np.minimum(1.0, t[::16] / 0.3)[:, None]
        moved = np.column_stack([np.interp(t, t[::16], column) for column in coarse.T])
        command = delta_plant.carriages_of(machine, np.array([place])) + moved
        true = delta_plant.simulate(machine, command, STEP_S, gravity=True, keep_every=8)
        for repeat in (1, 2) if number == 0 else (1,):
            both = np.hstack([true["carriage_acc_m_per_s2"], true["nozzle_acc_m_per_s2"]])
            felt = both + noise * rng.standard_normal(both.shape)
            named = dict(zip((f"acc_{a}" for a in "ABCxyz"), felt.T, strict=True))
            recordings.append(Recording(f"p{number}-{repeat}.csv", true["t"], command[::16], "carriage", named, {}, {}))
    return recordings


def test_hidden_friction_is_named_with_its_force(tmp_path: Path) -> None:
    recordings = made_recordings({"towers": {"friction_n": [3.0, 3.0, 3.0]}}, 0.15, 0)
    plant = PrinterProblem(load_machine(TRUTH), recordings, CANDIDATES)
    found = diagnose(plant)
    assert (found.verdict, found.named.names) == ("effects", ("coulomb_friction",))
    assert found.intervals["effects.coulomb_friction.force_n"].value == pytest.approx(3.0, rel=0.1)
    assert all(place.after < 0.15 * place.before for place in found.held_out)

    told = DiagnosisResult(search=found)
    assert told.gap.after < 0.2 * told.gap.before and told.found[0].confidence > 0.99
    better = tmp_path / "better.toml"
    better.write_text(told.better_file("better", ["x.csv sha256:0"]), encoding="utf-8")
    machine = load_machine(better)
    assert machine.effects["coulomb_friction"]["force_n"] == pytest.approx(3.0, rel=0.1)
    closed = locate_residual(
        plant, found.estimation.whiten, found.noise, PrinterProblem(machine, recordings, ()).simulate({})
    ).total
    assert closed.nrms == pytest.approx(told.gap.after, rel=0.05)  # the file says what the fit found
