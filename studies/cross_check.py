"""Our virtual printer against MuJoCo, an engine nobody here wrote, with the arms as bodies.

    python -m studies.cross_check     studies/reports/cross_check.md, some two minutes

What is built in MuJoCo stands in `validation/plants/multibody.py`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, linear_sum_assignment

from models.file import load_machine
from models.kinds import delta_vibration, with_parts
from models.machine import Machine
from models.printer.printer import SMOOTH_STEP_S, simulate_printer
from studies.cross_check_tilt import tilt
from studies.render import save
from validation import judge
from validation.plants.multibody import AT_ENDS, STEP_S, Answer, Choice, build, energy_drift, modes, play, rest_mm

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

HEIGHT_MM = 30.0
RADII_MM, ANGLES_DEG = (50.0, 110.0), np.arange(0.0, 360.0, 60.0)
MODES = 6
MODE_AIM, RESPONSE_AIM = 0.001, 0.01

ROW_S = 1 / 3200  # of the commands
SECONDS = 2.0
LOWEST_HZ, HIGHEST_HZ, LINE_HZ, PEAK_MM, FADE_S = 5.0, 100.0, 0.5, 0.3, 0.2
SHAKEN_MM = ((95.0, 55.0, HEIGHT_MM), (-40.0, 69.0, HEIGHT_MM))
SAGGING_MM = ((0.0, 0.0, HEIGHT_MM), (110.0, 0.0, HEIGHT_MM), *SHAKEN_MM)
STAR, TOWER = "far_star", "ringing_tower"

LUMPED, UNIFORM, TUBES = Choice("lumped"), Choice("uniform"), Choice("tubes")
PAIRS, WEIGHT = replace(LUMPED, effector="parallelograms"), replace(LUMPED, gravity=True)
STEPS_S, IMPEDANCES = (2 * STEP_S, STEP_S, STEP_S / 2), (0.99, 0.999, 0.9999)
PUSH_M_PER_S, SWING_S = 0.1, 0.5
SILENT = ("uniform rods, file silent", "the same, masses refitted")


def main() -> None:
    """Measure, and write the results and the page."""
    machine = load_machine(judge.MACHINE_FILE)
    refitted = with_masses(machine, fitted_masses(machine))
    masses = np.column_stack([masses_of(machine), masses_of(refitted)]) * 1e3
    parts = (about(), frequencies(machine, refitted), responses(machine, refitted), own_error(machine))
    found = {key: value for part in parts for key, value in part.items()}
    save(
        "cross_check",
        found
        | {"carriage_g": masses[0], "nozzle_g": masses[1], "static_deflection": deflections(machine)}
        | tilt(machine, commands()["star"], np.column_stack([places(), np.full(len(places()), HEIGHT_MM)]), ROW_S),
    )


def about() -> dict[str, Any]:
    """Return how everything is measured."""
    star, tower = (judge.PARTS_S[name][0] for name in (STAR, TOWER))
    return {
        "mujoco": mujoco.__version__,
        "machine_file": judge.MACHINE_FILE.name,
        "arm_pair_g": 1e3 * delta_vibration(load_machine(judge.MACHINE_FILE)).carriage.arm_pair_mass_kg,
        "tubes_at_ends": AT_ENDS[TUBES.arms],
        "mode_aim": MODE_AIM,
        "response_aim": RESPONSE_AIM,
        "places": len(places()),
        "directions": len(ANGLES_DEG),
        "radii_mm": [round(radius) for radius in RADII_MM],
        "seconds": SECONDS,
        "rows_per_s": 1 / ROW_S,
        "star_from_s": star,
        "tower_from_s": tower,
        "multisine": {"lowest_hz": LOWEST_HZ, "highest_hz": HIGHEST_HZ, "peak_mm": PEAK_MM},
        "push_mm_per_s": PUSH_M_PER_S * 1e3,
        "push_place_mm": SHAKEN_MM[0][:2],
        "swing_s": SWING_S,
    }


# ---- frequencies ---------------------------------------------------------------------------------


def places() -> FloatArray:
    """(13, 2) mm: the centre and two rings."""
    angles = np.radians(ANGLES_DEG)
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    return np.vstack([np.zeros((1, 2)), *(radius * ring for radius in RADII_MM)])


def frequencies(machine: Machine, refitted: Machine) -> dict[str, Any]:
    """Compare the poles over the bed."""
    ours = our_poles(machine)
    natural_hz = np.abs(ours) / (2 * np.pi)
    stated = {
        "two points": (LUMPED, machine),
        "six rods": (PAIRS, machine),
        "weight": (WEIGHT, machine),
        "uniform rods": (UNIFORM, told(machine, UNIFORM)),
        "tubes": (TUBES, told(machine, TUBES)),
    }
    silent = {
        "uniform rods, file silent": (UNIFORM, machine),
        "the same, masses refitted": (UNIFORM, refitted),
        "tubes, file silent": (TUBES, machine),
    }
    return {
        "modes_hz": np.column_stack([natural_hz.min(axis=0), natural_hz.max(axis=0)]),
        "frequencies": worst_of(machine, stated),
        "silent_frequencies": worst_of(machine, silent),
    }


def worst_of(machine: Machine, compared: dict[str, tuple[Choice, Machine]]) -> list[dict[str, Any]]:
    """Compare what MuJoCo builds of the machine with a model of ours, over the bed."""
    found = {
        label: mode_differences(their_poles(machine, choice), our_poles(model))
        for label, (choice, model) in compared.items()
    }
    return [{"label": label, "of_frequency": f, "of_damping": z} for label, (f, z) in found.items()]


def told(machine: Machine, choice: Choice) -> Machine:
    """Return the machine whose file says how much of its arms acts at their ends."""
    carriage = replace(delta_vibration(machine).carriage, arm_mass_share_at_ends=AT_ENDS[choice.arms])
    return with_parts(machine, carriage=carriage)


def upper(found: ComplexArray) -> ComplexArray:
    """Those poles that swing, once each, slowest first."""
    swings = found[found.imag > 1.0]
    return swings[np.argsort(np.abs(swings))]


def our_poles(machine: Machine) -> ComplexArray:
    """(places, MODES) 1/s"""
    return np.array([upper(found) for found in machine.vibration.poles(places())])


@cache
def their_poles(machine: Machine, choice: Choice) -> ComplexArray:
    """(places, MODES) 1/s"""
    return np.array([modes(build(machine, np.append(xy, HEIGHT_MM), choice)) for xy in places()])


def matched(theirs: ComplexArray, ours: ComplexArray) -> ComplexArray:
    """Our poles in the order of theirs : (places, MODES), the nearest together."""
    pairs = [
        linear_sum_assignment(np.abs(their[:, None] - our[None]))[1] for their, our in zip(theirs, ours, strict=True)
    ]
    return np.take_along_axis(ours, np.array(pairs), axis=1)


def mode_differences(theirs: ComplexArray, ours: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Worst over the places : (MODES,) each, of frequency and of damping ratio, relative."""
    ours = matched(theirs, ours)
    of_frequency = np.abs(np.abs(ours) / np.abs(theirs) - 1)
    of_damping = np.abs((ours.real / np.abs(ours)) / (theirs.real / np.abs(theirs)) - 1)
    return of_frequency.max(axis=0), of_damping.max(axis=0)


# ---- masses chosen anew --------------------------------------------------------------------------


def masses_of(machine: Machine) -> FloatArray:
    """(2,) kg: carriage, nozzle holder."""
    return np.array([delta_vibration(machine).carriage.mass_kg, delta_vibration(machine).effector.nozzle_mass_kg])


def with_masses(machine: Machine, masses: FloatArray) -> Machine:
    carriage = replace(delta_vibration(machine).carriage, mass_kg=float(masses[0]))
    return with_parts(
        machine, carriage=carriage, effector=replace(delta_vibration(machine).effector, nozzle_mass_kg=float(masses[1]))
    )


def fitted_masses(machine: Machine) -> FloatArray:
    """(2,) kg with which our poles are nearest to those of uniform rods, relative and over the bed."""
    theirs = their_poles(machine, UNIFORM)

    def apart(masses: FloatArray) -> FloatArray:
        difference = matched(theirs, our_poles(with_masses(machine, masses))) / theirs - 1
        return np.concatenate([difference.real.ravel(), difference.imag.ravel()])

    start = masses_of(machine)
    return np.asarray(least_squares(apart, start, x_scale=start).x)


# ---- static deflection ---------------------------------------------------------------------------


def deflections(machine: Machine) -> list[dict[str, Any]]:
    """Compare where the nozzle rests under weight, seen from where it is told to be."""
    rows = []
    for place in map(np.array, SAGGING_MM):
        command = np.tile(machine.kinematics.inverse(place[None]), (2, 1))
        ours = (simulate_printer(machine, command, ROW_S).nozzle_mm[0] - place) * 1e3
        theirs = (rest_mm(build(machine, place, replace(PAIRS, gravity=True)))[0] - place) * 1e3
        apart = np.abs(ours - theirs).max()
        rows.append({"place_mm": place, "ours_um": ours, "mujoco_um": theirs, "largest_um": apart})
    return rows


# ---- responses -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Difference:
    """Of two answers to one command: µm, and shares of what vibrates."""

    vibration_um: float
    nozzle_um: float
    of_nozzle: float  # of the nozzle's vibration, motors' motion taken off
    of_error: float  # of nozzle minus command
    of_carriages: float  # of the carriages' vibration, motors' motion taken off
    of_acceleration: float  # the nozzle's, of what it has beyond the command's


def responses(machine: Machine, refitted: Machine) -> dict[str, Any]:
    """Compare the answers to the same commands."""
    rows = [
        {"command": label, "mujoco": kind} | asdict(found)
        for label, path in commands().items()
        for kind, found in differences(machine, refitted, path)
    ]
    silent = [row for row in rows if row["mujoco"] in SILENT]
    swinging = our_poles(machine)
    return {
        "responses": [row for row in rows if row not in silent],
        "silent_responses": silent,
        "least_damping_ratio": np.min(-swinging.real / np.abs(swinging)),
    }


def differences(machine: Machine, refitted: Machine, path: FloatArray) -> Iterator[tuple[str, Difference]]:
    """What MuJoCo builds of the machine, and how far from it we are."""
    weighed = replace(PAIRS, gravity=True)
    yield "two points", compared(machine, path, played(machine, path, LUMPED))
    yield "six rods, weight", compared(machine, path, played(machine, path, weighed), gravity=True)
    rods = played(machine, path, UNIFORM)
    yield "uniform rods", compared(told(machine, UNIFORM), path, rods)
    yield "tubes", compared(told(machine, TUBES), path, played(machine, path, TUBES))
    yield SILENT[0], compared(machine, path, rods)
    yield SILENT[1], compared(refitted, path, rods)


def commands() -> dict[str, FloatArray]:
    """What the nozzle is told, (n, 3) mm, a row each ROW_S, from rest."""
    due = ROW_S * np.arange(round(SECONDS / ROW_S) + 1, dtype=np.float64)
    found = {}
    for label, name in (("star", STAR), ("tower", TOWER)):
        found[label] = judge.sample_print(name, *judge.PARTS_S[name]).trajectory.position(due)[:, :3]
    for seed, place in enumerate(SHAKEN_MM):
        found[f"excited at {place[0]:g}, {place[1]:g}"] = np.array(place) + multisine(due, seed)
    return found


def multisine(t: FloatArray, seed: int) -> FloatArray:
    """(n, 3) mm: random phases, faded in from rest."""
    f = np.arange(LOWEST_HZ, HIGHEST_HZ + LINE_HZ / 2, LINE_HZ)
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, (3, len(f)))
    waves = np.sin(2 * np.pi * f * t[:, None, None] + phase) @ (1 / f)
    fade = np.sin(np.pi / 2 * np.minimum(t / FADE_S, 1.0)) ** 2
    return PEAK_MM * fade[:, None] * waves / np.abs(waves).max()


def played(machine: Machine, path: FloatArray, choice: Choice) -> Answer:
    """MuJoCo's answer at the command's rows."""
    found = play(machine, path[0], machine.kinematics.inverse(path), ROW_S, choice)
    every = round(ROW_S / choice.step_s)
    return Answer(found.t_s[::every], found.nozzle_mm[::every], found.carriage_mm[::every])


def compared(model: Machine, path: FloatArray, theirs: Answer, *, gravity: bool = False) -> Difference:
    """How far the printer that is `model` for us is from what MuJoCo answered."""
    found = simulate_printer(model, model.kinematics.inverse(path), ROW_S, gravity=gravity)
    ours = Answer(found.t_s, found.nozzle_mm, found.carriage_mm)
    return difference(model, path, found.motor_mm, ours, theirs)


def difference(model: Machine, path: FloatArray, held: FloatArray, ours: Answer, theirs: Answer) -> Difference:
    """held : (n, 3) mm, where the motors hold the carriages' belts."""
    vibration = rms(moved(ours.nozzle_mm - model.kinematics.forward(held)))
    apart = ours.nozzle_mm - theirs.nozzle_mm
    return Difference(
        vibration_um=vibration * 1e3,
        nozzle_um=rms(apart) * 1e3,
        of_nozzle=rms(apart) / vibration,
        of_error=rms(apart) / rms(moved(ours.nozzle_mm - path)),
        of_carriages=rms(ours.carriage_mm - theirs.carriage_mm) / rms(moved(ours.carriage_mm - held)),
        of_acceleration=rms(accelerations(apart)) / rms(accelerations(ours.nozzle_mm - path)),
    )


def moved(values: FloatArray) -> FloatArray:
    """Seen from the first row: static deflection is no vibration."""
    return values - values[0]


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(values**2, axis=1))))


def accelerations(values: FloatArray) -> FloatArray:
    return np.diff(values, 2, axis=0) / ROW_S**2


# ---- MuJoCo's own error --------------------------------------------------------------------------


def own_error(machine: Machine) -> dict[str, Any]:
    """Find how far MuJoCo's answer depends on its step and on the give of its constraints."""
    path = commands()["star"]
    settings = [(step, max(IMPEDANCES)) for step in STEPS_S] + [(STEP_S, d) for d in IMPEDANCES[:-1]]
    choices = [replace(LUMPED, step_s=step, impedance=d) for step, d in settings]
    answers = {choice: played(machine, path, choice) for choice in choices}
    finest = answers[replace(LUMPED, step_s=min(STEPS_S))]
    rows = []
    for choice, answer in answers.items():
        ours = compared(machine, path, answer)
        rows.append(
            {
                "steps_per_s": 1 / choice.step_s,
                "impedance": choice.impedance,
                "used": choice == LUMPED,
                "from_finest_nm": rms(answer.nozzle_mm - finest.nozzle_mm) * 1e6,
                "from_ours_nm": ours.nozzle_um * 1e3,
                "of_vibration": ours.of_nozzle,
            }
        )
    return {
        "own_error": rows,
        "extrapolated_nm": extrapolated_nm(machine, path, answers),
        "halved_step_nm": our_own_nm(machine, path),
        "energy": energy(machine),
    }


def extrapolated_nm(machine: Machine, path: FloatArray, answers: dict[Choice, Answer]) -> float:
    fine, usual = (answers[replace(LUMPED, step_s=step)] for step in sorted(STEPS_S)[:2])
    limit = fine.nozzle_mm + (fine.nozzle_mm - usual.nozzle_mm) / 3
    return compared(machine, path, replace(fine, nozzle_mm=limit)).nozzle_um * 1e3


def our_own_nm(machine: Machine, path: FloatArray) -> float:
    command = machine.kinematics.inverse(path)
    steps = math.ceil(ROW_S / SMOOTH_STEP_S)
    usual, fine = (simulate_printer(machine, command, ROW_S, substeps=n, gravity=False) for n in (steps, 2 * steps))
    return rms(usual.nozzle_mm - fine.nozzle_mm) * 1e6


def energy(machine: Machine) -> list[dict[str, float]]:
    """Find by how much MuJoCo's energy changes after a push, without dampers."""
    rows = []
    for step in STEPS_S:
        printer = build(machine, np.array(SHAKEN_MM[0]), replace(LUMPED, step_s=step, damped=False))
        rows.append({"steps_per_s": 1 / step, "change": energy_drift(printer, PUSH_M_PER_S, SWING_S)})
    return rows


if __name__ == "__main__":
    main()
