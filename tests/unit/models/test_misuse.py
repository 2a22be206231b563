"""What models refuse from Python: parts that a machine has not, names that none has, effects that lack a number."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest

from models.effects.catalogue import effect_named, values_of, with_effect
from models.file import find_by_sha256, find_machine, load_machine
from models.kinds import delta_vibration, driven_axis
from models.machine import value_of

DELTA, STRAIGHT = load_machine("mp-delta-pro"), load_machine("voron-300")


@pytest.mark.parametrize(
    ("attempt", "sentence"),
    [
        (lambda: delta_vibration(STRAIGHT), "this works for deltas only."),
        (lambda: driven_axis(DELTA), "this works for one axis by itself only."),
        (
            lambda: DELTA.vibration.on(STRAIGHT.kinematics),
            "Carriages that carry an effector need a delta's kinematics.",
        ),
        (lambda: STRAIGHT.vibration.value("axes.x.frequency_hz[7]"), "axes.x.frequency_hz[7]"),
        (lambda: STRAIGHT.vibration.value("axes.x.colour[0]"), "axes.x.colour[0]"),
        (lambda: value_of(DELTA, "carriage.colour"), "carriage.colour"),
        (lambda: effect_named("cogs"), "effects.cogs is not a known effect; known are arm_geometry"),
        (lambda: values_of(with_effect(DELTA, "cogging", teeth=1.0), "cogging"), "cogging.teeth is not a parameter of"),
        (
            lambda: values_of(with_effect(DELTA, "cogging", amplitude_mm=[0.1] * 3), "cogging"),
            "pitch_mm is missing; the",
        ),
        (lambda: find_machine("none/mine.toml"), "There is no such file."),
        (
            lambda: find_by_sha256("0" * 12, "mine"),
            f"No machine file here has the hash {'0' * 12}…; name the file with",
        ),
    ],
)
def test_a_misuse_is_said(attempt: Callable[[], object], sentence: str) -> None:
    with pytest.raises(Exception, match=re.escape(sentence)):
        attempt()
