"""Runs played in pieces are what they are in one go."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from models.effects.catalogue import with_effect
from models.file import load_machine
from models.printer import playback
from models.printer.playback import simulate_batch
from models.printer.printer import PrinterMotion

FloatArray = NDArray[np.float64]

MACHINE = load_machine("mp-delta-pro")
ROW_S, AFTER = 1e-3, 96


def carriages(motion: PrinterMotion) -> FloatArray:
    return motion.carriage_mm


def curves(seconds: float, seed: int) -> FloatArray:
    """Smooth, out of rest to some 150 mm/s."""
    phase, t = np.random.default_rng(seed).uniform(0, 2 * np.pi, 4), np.arange(0.0, seconds, ROW_S)
    x = 12.0 * np.sin(2 * np.pi * 1.3 * t + phase[0]) + 4.0 * np.sin(2 * np.pi * 3.1 * t + phase[1])
    y = 12.0 * np.sin(2 * np.pi * 1.1 * t + phase[2]) + 4.0 * np.sin(2 * np.pi * 2.7 * t + phase[3])
    grown = np.minimum(t, 0.5) ** 2 * (3.0 - 4.0 * np.minimum(t, 0.5)) * 4.0
    return MACHINE.kinematics.inverse(np.stack([grown * x, grown * y, np.full(len(t), 20.0)], axis=1))


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        ("coulomb_friction", {"force_n": 3.0}),
        ("frame_mode", {"mass_kg": 8.0, "frequency_hz": 18.0, "damping_ratio": 0.04, "direction": "both"}),
        ("command_delay", {"delay_s": [0.001, 0.002, 0.003]}),
        ("torque_angle", {"amplitude_mm": 0.15}),  # a motor that is torn along loses steps
    ],
)
def test_pieces_are_as_good_as_the_whole(name: str, numbers: dict[str, float], monkeypatch: pytest.MonkeyPatch) -> None:
    machine = with_effect(MACHINE, name, **numbers)
    command = curves(5.0, 1)
    (pieces,) = simulate_batch(machine, [command], [None], ROW_S, AFTER, carriages)
    monkeypatch.setattr(playback, "LANES", 1)
    (whole,) = simulate_batch(machine, [command], [None], ROW_S, AFTER, carriages)
    assert len(whole) == len(command) + AFTER
    assert 1e3 * np.abs(pieces - whole).max() < 0.3  # µm
    assert np.abs(pieces - whole).max() > 0.0  # it has been cut


def test_a_run_hears_the_one_before_it_and_only_that() -> None:
    first, second = curves(1.0, 1), curves(1.0, 2)
    second = second + first[-1] - second[0]
    joined = simulate_batch(MACHINE, [first, second], [None, 5], ROW_S, AFTER, carriages)
    apart = simulate_batch(MACHINE, [first, second], [None, None], ROW_S, AFTER, carriages)
    assert np.array_equal(joined[0][: len(first)], apart[0][: len(first)])
    ringing = np.abs(joined[1] - apart[1]).max(axis=1)
    assert ringing[:20].max() > 0.01 and ringing[-200:].max() < 1e-3


def test_what_the_printer_cannot_do_is_said() -> None:
    with pytest.raises(ValueError, match="must be finite"):
        simulate_batch(MACHINE, [np.full((50, 3), np.nan)], [None], ROW_S, AFTER, carriages)
