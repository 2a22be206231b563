"""Explanations that fit equally: the set is named with the recording that tells them apart, and it does."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest

from ffcomp.diagnosis.diagnosis import Outcome, diagnose
from ffcomp.diagnosis.next_experiment import AFTER_S, BEFORE_S, separations
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.result import DiagnosisResult
from ffcomp.diagnosis.sentences import what_to_do
from ffcomp.diagnosis.words import digits
from ffcomp.measurement.recording import Recording
from ffcomp.numerics.serialise import to_json
from ffcomp.record.moves import Request, make_plan
from models.arrays import FloatArray
from models.file import load_machine
from models.machine import Machine

RATE_HZ, SECONDS, NOISE = 800.0, 0.9, 0.2  # m/s²
NAMES = ("belt_stiffness", "belt_position_stiffness")
TRUTH = {"effects.belt_position_stiffness.slope_per_m": 1.0, "effects.belt_position_stiffness.q_centre_mm": 0.0}
HERE = (100.0, 100.0)
SIGNALS = ("acc_x", "acc_y")


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    """A bed slinger whose file is well known: a belt that is off is no retuning."""
    text = 'format = "ffcomp-machine/1"\nname = "box"\n[kinematics]\ntype = "cartesian"\n'
    text += "".join(f"{axis}_range_mm = [0.0, 200.0]\n" for axis in "xyz")
    text += "".join(
        f"[axes.{axis}]\nfrequency_hz = [{hertz}]\ndamping_ratio = [0.06]\nshare = [1.0]\n"
        for axis, hertz in (("x", 48.0), ("y", 36.0))
    )
    text += "[limits]\nvelocity_mm_per_s = 300.0\nacceleration_mm_per_s2 = 5000.0\n[uncertainty]\ndefault = 0.005\n"
    path = tmp_path_factory.mktemp("machine") / "box.toml"
    path.write_text(text, encoding="utf-8")
    return load_machine(path)


def tones(seed: int) -> Callable[[FloatArray], FloatArray]:
    """Twelve tones around one place, from rest to rest."""
    f = np.random.default_rng(seed).uniform(4, 110, (12, 2))

    def nozzle(t: FloatArray) -> FloatArray:
        window = np.clip(np.minimum(t, SECONDS - t) / 0.2, 0, 1)[:, None] ** 2
        moved = window * sum(0.6 / each * np.sin(2 * np.pi * each * t[:, None] + 6.28 * each) for each in f)
        return np.column_stack([np.array(HERE) + moved, np.full(len(t), 30.0)])

    return nozzle


def recorded(
    machine: Machine,
    truth: Mapping[str, float],
    motions: Sequence[tuple[str, Callable[[FloatArray], FloatArray], float]],
) -> list[Recording]:
    """Record motions twice on the virtual printer with what it hides, with white noise."""
    rng, found = np.random.default_rng(0), []
    for name, nozzle, seconds in motions:
        t = np.arange(0.0, seconds + BEFORE_S + AFTER_S, 1 / RATE_HZ)
        silent = dict.fromkeys(SIGNALS, np.zeros(len(t)))
        blank = Recording(f"{name}-1.csv", t, nozzle(t - BEFORE_S), "nozzle", silent, {}, {})
        true = PrinterProblem(machine, [blank], ()).simulate(truth)[0]
        n = len(true)  # rows beyond a length that is transformed quickly are left out
        blank = replace(blank, time_s=blank.time_s[:n], command=blank.command[:n])
        for repeat in (1, 2):
            felt = true + NOISE * rng.standard_normal(true.shape)
            named = dict(zip(SIGNALS, felt.T, strict=True))
            found.append(replace(blank, source=f"{name}-{repeat}.csv", acceleration=named))
    return found


def asked(machine: Machine, runs: Sequence[Recording]) -> tuple[Outcome, DiagnosisResult]:
    """Diagnose runs, with what separates the explanations."""
    problem = PrinterProblem(machine, runs, NAMES)
    found = diagnose(problem)
    return found, DiagnosisResult(search=found, separations=separations(problem, found))


def planned(machine: Machine, command: str) -> tuple[str, Callable[[FloatArray], FloatArray], float]:
    """Return the motion that a proposed command line plans."""
    words = shlex.split(command)
    said = dict(zip(words[3::2], words[4::2], strict=True))
    assert words[:3] == ["ffcomp", "record", "plan"]
    assert (said["-m"], said["-o"]) == (machine.path, "separate.gcode")
    x, y = said["--at"].split(",")
    request = Request(
        places_mm=[(float(x), float(y))],
        kinds=[said["--kind"]],
        seconds=0.5 * float(said["--seconds"]),  # half of it tells as well, in half of the time
        height_mm=float(said.get("--height-mm", 30)),
        acceleration_mm_per_s2=float(said["--amplitude-mm-per-s2"]) if "--amplitude-mm-per-s2" in said else None,
    )
    motion = make_plan(machine, request).experiments[0].motion
    return "separate", motion.nozzle, motion.duration_s


def test_a_set_is_told_apart_by_the_recording_that_it_names(machine: Machine) -> None:
    runs = recorded(machine, TRUTH, [("a", tones(1), SECONDS), ("b", tones(2), SECONDS)])
    found, told = asked(machine, runs)
    assert found.named is not None  # at one place both fit: the set is named, with what separates it
    assert {*found.named.names, *found.confounded} == set(NAMES)
    (one,) = told.separations
    assert one.tells and one.there > 10 * one.now and one.position_mm[:2] != HERE
    sentence = one.sentence
    assert sentence.startswith("Record ffcomp record plan -m ")
    assert f"there the predictions differ by {digits(one.there, 2)} times the noise; in these runs by 0.0" in sentence
    assert sentence in what_to_do(told)
    (written,) = to_json(told)["separate"]
    assert written["separates"] and written["record"] == one.command and written["said"] == sentence

    # recorded as proposed, by the printer as it really is: the verdict is alone, and right
    found, told = asked(machine, [*runs[:2], *recorded(machine, TRUTH, [planned(machine, one.command)])])
    assert found.named is not None and found.named.names == ("belt_position_stiffness",)
    assert not found.confounded and not told.separations
    assert told.found[0].confidence > 0.99
