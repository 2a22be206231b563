"""The engine on our own printer as the truth: the right name among rivals, values, pairs, shapes, what is invisible.

Whether it also names what another simulator hides is tested elsewhere; here the search itself is.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ffcomp.diagnosis.diagnosis import Diagnosis, diagnose
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.result import result_of
from ffcomp.diagnosis.where import drawn_residual
from ffcomp.measurement.recording import Recording
from models.effects.catalogue import with_effect
from models.file import load_machine
from models.machine import Machine

RATE_HZ, SECONDS, NOISE = 1600.0, 0.8, 0.15
PLACES = ((0.0, 0.0, 30.0), (-60.0, 20.0, 30.0), (20.0, 60.0, 120.0))
TWO = PLACES[1:]  # enough where a search is long
Places = tuple[tuple[float, float, float], ...]
SENSORS = tuple(f"acc_{axis}" for axis in "ABCxyz")


@functools.cache
def believed() -> Machine:
    return replace(load_machine("mp-delta-pro"), uncertainty={"default": 0.02})


def command(place: tuple[float, float, float], rng: np.random.Generator) -> np.ndarray:
    """All towers shaken by tones, on top of a slow sweep."""
    t = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    f = rng.uniform(3, 120, (14, 3))
    size = rng.uniform(25, 90) / (2 * np.pi * f) ** 1.5
    tones = np.sum(size * np.sin(2 * np.pi * f * t[:, None, None] + rng.uniform(0, 6.28, f.shape)), axis=1)
    slow = np.sin(2 * np.pi * 0.9 * t)[:, None] * np.array([12.0, -7.0, 4.0])
    fade = np.minimum(1, np.minimum(t, t[-1] - t) / 0.25)[:, None]
    return np.asarray(believed().kinematics.inverse(np.array([place])) + (tones + slow) * fade)


def recordings_of(truth: Machine, places: Places) -> list[Recording]:
    """Two repeats at each place."""
    rng = np.random.default_rng(7)
    t = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    none, recordings = np.zeros(len(t), dtype=bool), []
    for i, place in enumerate(places):
        q = command(place, rng)
        blank = dict.fromkeys(SENSORS, np.zeros(len(t)))
        true = PrinterProblem(truth, [Recording("x.csv", t, q, "carriage", blank, {}, none, {})], ()).simulate({})[0]
        for repeat in (1, 2):
            felt = dict(zip(SENSORS, (true + NOISE * rng.standard_normal(true.shape)).T, strict=True))
            recordings.append(Recording(f"p{i}-{repeat}.csv", t, q, "carriage", felt, {}, none, {}))
    return recordings


def found(
    candidates: tuple[str, ...], places: Places = PLACES, **hidden: dict[str, Any]
) -> tuple[PrinterProblem, Diagnosis]:
    truth = believed()
    for name, table in hidden.items():
        truth = with_effect(truth, name, **table)
    plant = PrinterProblem(believed(), recordings_of(truth, places), candidates)
    return plant, diagnose(plant)


CASES: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
    "arm_inertia": ({"share_along": 1.0}, ("effector_mass",)),
    "sensor_gain": ({"carriage_relative_change": [0.05, 0.0, 0.0]}, ("effector_mass",)),
    "force_map": ({}, ("effector_mass",)),
}


@pytest.mark.parametrize("name", CASES)
def test_the_hidden_effect_is_named_among_rivals(name: str) -> None:
    hidden, rivals = CASES[name]
    plant, diagnosis = found((name, *rivals), **{name: hidden})
    assert diagnosis.verdict == "effects", diagnosis.rejections
    told = result_of(plant, diagnosis)
    assert list(told.effects) == [name]
    for key, value in hidden.items():
        np.testing.assert_allclose(np.array(told.effects[name][key]), value, rtol=0.03, atol=0.002)
    assert told.file.retuned == {}  # the file was right, so nothing else had to move
    assert all(place.after < 0.1 for place in diagnosis.held_out)


def test_what_no_candidate_explains_is_unknown_and_pictured() -> None:
    plant, diagnosis = found(("guide_damping",), TWO, cogging={"amplitude_mm": 0.03, "pitch_mm": 0.8})
    assert diagnosis.verdict == "unknown" and diagnosis.rejections and diagnosis.named is None
    shown = drawn_residual(plant, diagnosis)
    splits = {split.title: split for split in shown.splits}
    cycle = splits["motor's step cycle"]  # ripple follows the motor's position
    assert len(cycle.labels) == 16 and min(cycle.before) > 10
    measured, simulated = shown.overlays[0].measured, shown.overlays[0].before
    assert np.std(measured - simulated) > 5 * shown.overlays[0].noise_rms


def test_what_cannot_be_seen_is_said_to_be_invisible_and_noise_pictures_as_nothing() -> None:
    plant, diagnosis = found(("center_of_mass", "guide_damping"))
    assert diagnosis.verdict == "none"
    assert diagnosis.invisible == ["center_of_mass"]  # by virtual work the carriages do not feel it
    for split in drawn_residual(plant, diagnosis).splits:
        inner = np.array(split.after[1:-1] if "time" in split.title else split.after)  # the ends are faded out
        assert np.abs(inner).max() < 0.6, split.title  # where an effect is, hundreds
