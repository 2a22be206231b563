"""What a plan says is commanded is what the firmware's planner makes of its G-code, and the machine can do it."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ffcomp.errors import LimitsError
from ffcomp.record.gcode_writer import Recorder, gcode_lines
from ffcomp.record.multisine import polyline_gain
from ffcomp.record.plan import Excitation, Experiment, Plan
from ffcomp.record.planning import AXES, TOWERS, ExcitationRequest, make_excitation_plan
from gcode.program import Program
from gcode.reader import read_program
from models.arrays import ComplexArray, FloatArray, constant
from models.machine import Machine
from models.vibration.state_space import discretise
from tests.support.machines import machine
from validation import kalico

SHORT = ExcitationRequest(directions=TOWERS + AXES, period_s=2.0, periods=1, highest_hz=110.0, places_mm=((0.0, 0.0),))
MOTION = re.compile(rb"\s*(G[0-4]|G9[0-2]|M204|SET_VELOCITY_LIMIT)\b")


@cache
def short() -> Plan:
    return make_excitation_plan(machine(), SHORT)


def excited(experiment: Experiment) -> Excitation:
    assert experiment.excitation is not None
    return experiment.excitation


def named(plan: Plan, direction: str) -> Experiment:
    return next(each for each in plan.experiments if excited(each).direction == direction)


def phasors(moved: FloatArray, experiment: Experiment) -> ComplexArray:
    """Of one period (k,) mm, at the lines of its band, mm."""
    return np.asarray(2.0 / len(moved) * np.fft.rfft(moved)[excited(experiment).band.lines])


def command(experiment: Experiment, t: FloatArray) -> FloatArray:
    return machine().kinematics.inverse(experiment.motion.nozzle(t))


def written(plan: Plan, printer: Machine, flavor: str) -> list[bytes]:
    return list(gcode_lines(plan, printer, Recorder(flavor)))


def segment_s(experiment: Experiment) -> float:
    return excited(experiment).band.segment_s


def dense(experiment: Experiment) -> FloatArray:
    """Times all over an experiment, not in step with its segments; (k,) s."""
    return np.linspace(0.0, experiment.duration_s, 7 * len(experiment.motion.vertices_mm))


def first_segments(program: Program, plan: Plan) -> list[int]:
    """For each experiment, the first of its moves: the one that goes where its account goes first."""
    first, found = 0, []
    for experiment in plan.experiments:
        begins = (np.abs(program.moves.start[first:, :3] - experiment.motion.vertices_mm[0]) < 1e-9).all(axis=1)
        goes_on = (np.abs(program.moves.end[first:, :3] - experiment.motion.vertices_mm[1]) < 1e-9).all(axis=1)
        first += int(np.flatnonzero(begins & goes_on)[0])
        found.append(first)
        first += len(experiment.motion.vertices_mm) - 1
    return found


# What is played


def test_a_plant_that_plays_it_shows_its_frequency_response() -> None:
    """From the first measured period alone: it has settled, and input and output are known exactly."""
    experiment = named(short(), "B")
    substeps = 16
    step = segment_s(experiment) / substeps
    periods = excited(experiment).first_knot + excited(experiment).band.knots
    carriages_mm = command(experiment, step * np.arange(periods * substeps + 1))
    plant = discretise(machine().vibration.state_space(np.zeros((1, 2))), step)
    rest = machine().equilibrium(np.array(experiment.position_mm))
    a, b0, b1 = plant.a[0], plant.b0[0], plant.b1[0]
    carriages = np.empty((len(carriages_mm) - 1, 3))
    for k in range(len(carriages)):
        rest = a @ rest + b0 @ carriages_mm[k] + b1 @ carriages_mm[k + 1]
        carriages[k] = rest[6:9]
    frequency = excited(experiment).band.frequencies_hz
    period = slice(excited(experiment).first_knot * substeps, periods * substeps)
    commanded = phasors(carriages_mm[period, 1], experiment) * polyline_gain(frequency, step)
    wanted = machine().vibration.frequency_response(np.zeros(2), frequency)[:, :, 1]
    for output in range(3):
        answer = phasors(carriages[period.start - 1 : period.stop - 1, output], experiment)
        assert np.abs(answer / commanded - wanted[:, output]).max() < 3e-3 * np.abs(wanted).max()


# What the machine can do


@pytest.mark.parametrize(
    ("changes", "rule"),
    [
        (
            {"acceleration_mm_per_s2": 40_000.0, "directions": ("A",), "lowest_hz": 80.0},
            "carriage acceleration in mm/s² would peak",
        ),
        ({"acceleration_mm_per_s2": 9_000.0, "directions": ("z",)}, "acceleration in Z, 10000 mm/s², is too low"),
    ],
)
def test_too_much_is_refused_with_an_amplitude_that_fits(changes: dict[str, object], rule: str) -> None:
    with pytest.raises(LimitsError, match=rule) as refused:
        make_excitation_plan(machine(), replace(SHORT, **changes))
    amplitude = float(re.findall(r"amplitude of (\d+) mm/s² would fit", str(refused.value))[0])
    request = replace(SHORT, **{**changes, "acceleration_mm_per_s2": amplitude})
    _make_until_it_fits(request)


def _make_until_it_fits(request: ExcitationRequest) -> None:
    """One rule's advice may meet the next rule, whose advice is smaller; but it ends."""
    for _ in range(2):
        try:
            make_excitation_plan(machine(), request)
            return
        except LimitsError as error:
            smaller = float(re.findall(r"amplitude of (\d+) mm/s² would fit", str(error))[0])
            assert smaller < request.acceleration_mm_per_s2
            request = replace(request, acceleration_mm_per_s2=smaller)
    make_excitation_plan(machine(), request)


def test_a_place_at_the_rim_is_refused_with_one_that_fits() -> None:
    request = replace(SHORT, directions=("x",), places_mm=((134.9, 0.0),))
    with pytest.raises(LimitsError, match="reaches") as refused:
        make_excitation_plan(machine(), request)
    in_by = float(re.findall(r"a place ([\d.]+) mm farther in", str(refused.value))[0])
    assert 0.0 < in_by < 10.0
    make_excitation_plan(machine(), replace(request, places_mm=((134.9 - in_by, 0.0),)))


# Files


@pytest.mark.parametrize("flavor", ["klipper", "marlin", "reprapfirmware"])
def test_a_file_moves_nothing_but_the_nozzle_and_puts_limits_back(flavor: str) -> None:
    lines = written(short(), machine(), flavor)
    program = read_program(b"".join(lines), flavor=flavor)
    codes = [line.split(b";")[0] for line in lines]
    assert not any(re.search(rb"\bE[-\d]|^M1(04|09|40|90)\b", code) for code in codes)
    assert codes.index(b"G28\n") < next(i for i, code in enumerate(codes) if code.startswith(b"G1"))
    assert np.ptp(program.moves.end[:, 3]) == 0.0
    rests = [code for code in codes if code.startswith(b"G4 P500")]
    assert len(rests) == 2 * len(short().experiments)  # to settle, and behind
    opened = {"klipper": b"ACCEL=100000 ", "marlin": b"M204 P100000", "reprapfirmware": b"M204 P100000"}[flavor]
    closed = {"klipper": b"ACCEL=10000 ", "marlin": b"M204 P10000 ", "reprapfirmware": b"M204 P10000 "}[flavor]
    told = [opened in code for code in codes if opened in code or closed in code]
    assert told == [True, False] * len(short().experiments)


# The real host


@pytest.mark.kalico
def test_the_real_host_plays_the_account() -> None:
    """Within 10 nm and 1 µs all along; of the towers, only the excited one steps."""
    geometry = replace(
        machine().kinematics,
        arm_lengths_mm=constant([kalico.ARM_LENGTH_MM] * 3),
        delta_radii_mm=constant([kalico.RADIUS_MM] * 3),
        tower_angles_deg=constant([210.0, 330.0, 90.0]),
        print_radius_mm=120.0,
    )
    limits = replace(machine().limits, acceleration_mm_per_s2=3000.0)
    printer = replace(machine(), kinematics=geometry, limits=limits)
    plan = make_excitation_plan(printer, replace(SHORT, directions=("A", "C", "y", "z"), places_mm=((30.0, -20.0),)))
    lines = b"".join(written(plan, printer, "klipper")).splitlines()
    text = b"\n".join(line for line in lines if MOTION.match(line)) + b"\n"
    theirs = kalico.kalico_plan(text)
    program = read_program(text, start=kalico.START_MM)
    goes = np.abs(program.moves.end - program.moves.start).max(axis=1) > 1e-9
    for first, experiment in zip(first_segments(program, plan), plan.experiments, strict=True):
        first = int(goes[:first].sum())
        _assert_played(theirs, first, experiment)


def _assert_played(theirs: dict[str, FloatArray], first: int, experiment: Experiment) -> None:
    last = first + len(experiment.motion.vertices_mm) - 1
    begins = theirs["moves"][first, 0]
    assert np.abs(theirs["moves"][first:last, 0] - begins - experiment.motion.trajectory.start_t).max() < 1e-6
    t = dense(experiment)[:-1]
    assert np.abs(kalico.sample(theirs["moves"], begins + t) - experiment.motion.nozzle(t)).max() < 1e-5
    steps = [_steps(theirs, tower, begins, experiment.duration_s) for tower in "abc"]
    if excited(experiment).direction in TOWERS:
        assert [count > 50 for count in steps] == [tower == excited(experiment).direction for tower in TOWERS]
        assert sorted(steps)[1] <= 1
    else:
        assert min(steps) > 20


def _steps(theirs: dict[str, FloatArray], tower: str, begins: float, duration: float) -> int:
    t = theirs[f"step_t_{tower}"]
    return int(((t >= begins) & (t < begins + duration)).sum())
