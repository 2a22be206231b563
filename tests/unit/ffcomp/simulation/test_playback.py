"""The virtual printer as the comparison uses it, against the independent plant and against statics."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from ffcomp.comparison.methods import segments_motion
from ffcomp.metrics import contour_error
from ffcomp.simulation.command import planned_motion
from ffcomp.simulation.playback import simulate_nozzles
from models.effects.catalogue import with_effect
from models.file import load_machine
from models.kinds import delta_vibration
from models.printer.rest import static_deflection
from validation import judge

MACHINE = load_machine("mp-delta-pro")
GRAVITY = 9.80665


def test_weight_bends_the_belts_by_the_load_they_carry() -> None:
    """At the centre each belt carries its carriage and a third of the effector, and the extruder hangs on its mount."""
    carriage, effector = delta_vibration(MACHINE).carriage, delta_vibration(MACHINE).effector
    load = carriage.moving_mass_kg + (delta_vibration(MACHINE).nozzle_side_mass_kg + effector.extruder_mass_kg) / 3
    expected = -1e3 * load * GRAVITY / carriage.belt_stiffness_n_per_m
    np.testing.assert_allclose(static_deflection(MACHINE, np.zeros((1, 3)))[0], [0, 0, expected], atol=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ringing_tower"])
def test_the_independent_plant_says_the_same(name: str) -> None:
    """Other equations, another integrator and step, and no weight, which changes a violent ringing by 0.2 %."""
    case = judge.part(name)
    machine, corners = case.original.machine, case.original.corners
    for motion in (case.original.motion, segments_motion(case.segments)):
        ((t, nozzle),) = simulate_nozzles([machine], [motion], machine)
        other_t, other = judge.play(case.original.plant, motion)
        inside = (other_t > t[0]) & (other_t < t[-1])
        apart = np.linalg.norm(CubicSpline(t, nozzle)(other_t) - other, axis=1)[inside]
        wanted = case.original.trajectory.position(motion.clock.plan_time(other_t[inside]))[:, :3]
        assert rms(apart) < max(0.005 * rms(np.linalg.norm(other[inside] - wanted, axis=1)), 2e-4)
        contours = (
            contour_error(*corners, motion.clock.plan_time(at), each) for at, each in ((t, nozzle), (other_t, other))
        )
        ours, theirs = map(rms, contours)
        assert ours == pytest.approx(theirs, rel=0.02)


def rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def test_chunks_and_company_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    trajectory = judge.part("ringing_tower").original.trajectory
    motion = planned_motion(trajectory)
    short = type(motion)(motion.position, 0.0, 2.0, motion.clock)
    stiff = with_effect(MACHINE, "belt_stiffness", relative_change=0.2)
    ((_, alone),) = simulate_nozzles([MACHINE], [short], MACHINE)
    monkeypatch.setattr("ffcomp.simulation.playback.MOST_ROWS", 1000)
    (_, first), (_, second) = simulate_nozzles([MACHINE, stiff], [short], MACHINE)
    np.testing.assert_allclose(first, alone, atol=1e-9)
    assert np.abs(second - alone).max() > 1e-3
