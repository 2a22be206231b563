"""The numbers of an axis by itself are found from its runs, and their intervals hold the truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ffcomp.errors import RequestError
from ffcomp.identification.axis_fit import fit_runs
from ffcomp.identification.fitting import fit_files
from ffcomp.identification.request import FitRequest
from ffcomp.measurement.axis_run import AxisRun
from models.file import load_plant
from models.kinds import driven_axis, is_one_axis, machine_of_axis
from models.printer.one_axis import simulate_axis
from models.vibration.driven_axis import DrivenAxis

RATE = 400.0
FREE = DrivenAxis("force", 8.0, 0.0, 25.0, offset_n=-1.5)
SPRUNG = DrivenAxis("position", 2.0, 3e4, 60.0)
TWO = DrivenAxis("force", 3.0, 0.0, 40.0, 2.0, 2e4, 10.0)


def run_of(true: DrivenAxis, seed: int = 5) -> AxisRun:
    rng = np.random.default_rng(seed)
    t = np.arange(1600) / RATE
    wave = np.interp(t, np.linspace(0, t[-1], 60), np.r_[0.0, rng.normal(size=58), 0.0])
    given = 20.0 * wave if true.by_force else 3.0 * np.convolve(wave, np.hanning(21) / 10, "same")
    motion = simulate_axis(machine_of_axis("true", true), given, 1 / RATE)
    felt = {"pos_q": motion.position_mm, "pos_motor": motion.motor_mm}
    noisy = {name: x + 1e-3 * rng.normal(size=len(t)) for name, x in felt.items()}
    return AxisRun("run.csv", t, given, true.input, {}, noisy if true.load_mass_kg else {"pos_q": noisy["pos_q"]})


@pytest.mark.parametrize("true", [FREE, SPRUNG, TWO])
def test_the_numbers_come_back(true: DrivenAxis) -> None:
    keys = ("mass_kg",) if true.by_force else ()  # where a position drives, only ratios to the mass show
    wrong = {n: 1.2 * getattr(true, n) for n in (*keys, "stiffness_n_per_m", "damping_n_s_per_m")}
    start = machine_of_axis("start", replace(true, **wrong, offset_n=0.0))
    found = fit_runs(start, [run_of(true)], {})
    assert found.after < 0.2 * found.before
    for name, e in found.estimates.items():
        truth = getattr(true, name.removeprefix("axis."))
        rough = 0.3 if name == "axis.coupling_damping_n_s_per_m" else 0.02  # shots begin at a smoothed speed
        assert abs(e.value - truth) < max(4 * e.sd, rough * abs(truth)), name


def test_what_is_known_is_believed_as_far_as_its_uncertainty() -> None:
    start = machine_of_axis("start", FREE)
    found = fit_runs(start, [run_of(FREE)], {"axis.mass_kg": (9.0, 1e-6)})
    assert found.estimates["axis.mass_kg"].value == pytest.approx(9.0, abs=1e-3)
    with pytest.raises(RequestError, match=r"axis\.mass_kg"):
        fit_runs(start, [run_of(FREE)], {"effector.total_mass_kg": (1.0, 0.1)})


def test_a_fitted_file_is_a_machine_file(tmp_path: Path) -> None:
    file, data = tmp_path / "stage.toml", tmp_path / "push.csv"
    file.write_text(
        'format = "ffcomp-machine/1"\nname = "stage"\n[kinematics]\ntype = "axis"\n[axis]\ninput = "force"\n'
        "mass_kg = 10.0\nstiffness_n_per_m = 0.0\ndamping_n_s_per_m = 20.0\n"
    )
    run = run_of(FREE)
    table = np.column_stack([run.time_s, run.drive, run.position["pos_q"]])
    np.savetxt(data, table, delimiter=",", header="t_s,force_n,pos_q_mm", comments="")
    fit = fit_files(load_plant(file), FitRequest(data=(data,), machine=str(file), name="fitted"))
    fit.write(tmp_path / "fitted.toml")
    found = load_plant(tmp_path / "fitted.toml")
    assert is_one_axis(found)
    assert driven_axis(found).mass_kg == pytest.approx(8.0, rel=0.01) and driven_axis(found).offset_n == pytest.approx(
        -1.5, rel=0.05
    )
    assert fit.to_dict()["nrms"]["after"] < 0.05
    with pytest.raises(RequestError, match="--method"):
        fit_files(load_plant(file), FitRequest(data=(data,), machine=str(file), name="fitted", method="stepwise"))
