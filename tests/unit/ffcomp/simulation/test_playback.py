"""The virtual printer as the comparison uses it; `e2e/test_simulate_cli.py` has it next to the independent plant."""

from __future__ import annotations

import numpy as np
import pytest

from ffcomp.simulation.command import planned_motion
from ffcomp.simulation.playback import simulate_nozzles
from models.effects.catalogue import with_effect
from models.file import load_machine
from validation import judge

MACHINE = load_machine("mp-delta-pro")


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
