"""A force-driven axis: closed forms, and a real one whose friction is published."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from ffcomp.diagnose.diagnosis import Diagnosis, diagnose
from ffcomp.diagnose.problem import InfeasibleParameters
from ffcomp.errors import MeasurementError
from studies.emps_axis import (
    CANDIDATES,
    FRICTION,
    MASS,
    OFFSET,
    VISCOUS,
    AxisProblem,
    ForceDriven,
    read_emps,
)

EMPS = Path(os.environ.get("FFCOMP_DATA", Path(__file__).parents[5] / "shared" / "data")) / "emps"
FITTED, PULSES = EMPS / "DATA_EMPS.mat", EMPS / "DATA_EMPS_PULSES.mat"
DRAG = "effects.quadratic_drag.force_n_s2_per_m2"


# ---- closed forms --------------------------------------------------------------------------------


def pushed(force_n: float, position_mm: np.ndarray) -> AxisProblem:
    t = np.arange(len(position_mm)) / 1000.0
    return AxisProblem([ForceDriven("pushed", t, np.full(len(t), force_n), position_mm)], 100.0, 500.0)


def test_a_constant_force_against_friction_in_closed_form() -> None:
    """M v̇ = F − F_c − F_v v from rest: x = v_∞ (t − τ (1 − exp(−t/τ))), τ = M/F_v."""
    tau, top = 100.0 / 500.0, (120.0 - 20.0) / 500.0
    t = np.arange(300) / 1000.0
    wanted = 1e3 * top * (t - tau * (1 - np.exp(-t / tau)))
    (moved,) = pushed(120.0, wanted).simulate({FRICTION: 20.0})
    np.testing.assert_allclose(moved[100:200, 0], wanted[100:200], atol=5e-3)  # mm; a shot begins at a measured speed
    (slower,) = pushed(120.0, wanted).simulate({FRICTION: 21.0})
    assert (moved - slower)[199, 0] == pytest.approx(1e3 * 0.01 * 0.099**2 / 2, rel=0.2)  # 1 N on 100 kg, damped


def test_dry_friction_holds_what_pushes_less() -> None:
    (held,) = pushed(19.0, np.zeros(100)).simulate({FRICTION: 20.0})
    assert np.abs(held).max() < 2e-2  # mm: it creeps, at less than 0.2 mm/s
    (slipped,) = pushed(30.0, np.zeros(100)).simulate({FRICTION: 20.0})
    assert slipped[-1, 0] > 10 * np.abs(held).max()


def test_every_shot_begins_where_the_axis_was_measured() -> None:
    measured = 40 * np.sin(np.arange(1000) / 200)
    (simulated,) = pushed(0.0, measured).simulate({})
    np.testing.assert_array_equal(simulated[::100, 0], measured[::100])


def test_forces_that_drive_it_to_infinity_are_impossible() -> None:
    with pytest.raises(InfeasibleParameters), np.errstate(over="ignore", invalid="ignore"):
        pushed(1e4, np.zeros(1000)).simulate({DRAG: -1e6})


def test_what_is_no_emps_file_is_refused(tmp_path: Path) -> None:
    from scipy.io import savemat

    savemat(tmp_path / "x.mat", {"t": np.zeros(3), "qm": np.zeros(3), "gtau": 1.0})
    with pytest.raises(MeasurementError, match="'vir' is missing"):
        read_emps(tmp_path / "x.mat")


# ---- the real axis -------------------------------------------------------------------------------


@cache
def found() -> Diagnosis:
    if not FITTED.is_file():
        pytest.skip("the EMPS data set is not beside the project")
    return diagnose(AxisProblem([read_emps(FITTED)], 50.0, 100.0))


def test_the_real_axis_has_dry_friction_of_the_published_size() -> None:
    """Published: M 95.1 kg, F_v 203.5 N s/m, F_c 20.4 N, offset −3.2 N (Janot, Gautier and Brunot, 2019)."""
    told = found()
    assert not told.noise.from_repeats
    assert told.named is not None and told.named.names == ("coulomb_friction",)
    assert told.final.values[MASS] == pytest.approx(95.1, rel=0.01)
    assert told.final.values[VISCOUS] == pytest.approx(203.5, rel=0.05)
    assert told.final.values[FRICTION] == pytest.approx(20.4, rel=0.05)
    assert told.final.values[OFFSET] == pytest.approx(-3.2, abs=0.35)
    assert len(told.held_out) == 6
    for place in told.held_out:  # stretches of time left out of the fit
        assert place.before > 5 and place.after < 0.1 * place.before
    assert {c.name for c in CANDIDATES} > {"coulomb_friction"}


def test_what_was_fitted_to_one_recording_holds_for_the_other() -> None:
    told, axis = found(), AxisProblem([read_emps(PULSES)], 50.0, 100.0)

    def rms(values: dict[str, float]) -> float:
        errors = [r.measured - y for r, y in zip(axis.observations, axis.simulate(values), strict=True)]
        return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))

    assert rms(told.final.values) < 0.3 * rms(told.base.values)


def test_pulses_are_in_the_motors_force_already() -> None:
    """Where `pulses_N` jumps by 5, the force jumps by 5 times the gain in the same sample."""
    from scipy.io import loadmat

    if not PULSES.is_file():
        pytest.skip("the EMPS data set is not beside the project")
    data = loadmat(PULSES)
    jumps = np.diff(data["pulses_N"].astype(float).ravel())
    force = np.diff(read_emps(PULSES).force_n)
    at = np.flatnonzero(jumps)
    ratio = np.median(force[at] / jumps[at])
    assert ratio == pytest.approx(float(data["gtau"].item()), rel=0.03)
