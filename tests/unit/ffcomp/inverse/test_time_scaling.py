"""Where a machine cannot follow, the plan is slower there, and only there; and it is said."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from ffcomp.errors import LimitsError
from ffcomp.firmware.program import PlannedProgram, plan_program, plan_section
from ffcomp.inverse.feasible import SolvedSection, solve_feasible
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.settings import Settings, SlowingSettings, settings_for
from ffcomp.inverse.solve import solve
from ffcomp.inverse.time_scaling import LayerOf, PlannedSection, Replanner
from ffcomp.planner.limits import planner_limits
from ffcomp.planner.segment_timing import segment_speeds
from ffcomp.planner.trajectory import Section, Trajectory
from gcode.program import Moves, Program
from gcode.reader import read_program
from models.arrays import FloatArray
from models.file import load_machine
from models.machine import Machine

START = (-60.0, 20.0, 0.3)
# a gentle line, a square that is driven fast, a gentle line; each line of its own number
CORNERS = b"""G1 X-40 Y20 F3000
G1 X-40 Y50 F12000
G1 X-60 Y50
G1 X-60 Y20
G1 X-30 Y20
G1 X0 Y20 F3000
"""


@pytest.fixture(scope="module")
def planned(machine: Machine) -> PlannedProgram:
    return plan_program(read_program(CORNERS, start=START, flavor="klipper"), machine)


def limited(machine: Machine, **limits: Any) -> Machine:
    return replace(machine, limits=replace(machine.limits, **limits))


def inverter_of(machine: Machine) -> InverseModel:
    return InverseModel(machine, settings_for(machine))


def solved(
    inverter: InverseModel,
    planned: PlannedProgram,
    run: Section,
    machine: Machine,
    replan: Callable[[Moves, float], Trajectory] | None = None,
    program: Program | None = None,
    layer_of: LayerOf = lambda move: None,
    **options: Any,
) -> SolvedSection:
    state, limits = machine.equilibrium(planned.trajectory.origin[run.first, :3]), planner_limits(machine)
    model = InverseModel(machine, replace(inverter.settings, **options)) if options else inverter
    reference = Reference(planned.trajectory, run, model.settings)
    request = PlannedSection(
        program or planned.program,
        planned.trajectory,
        run,
        reference,
        state,
        Replanner(limits, replan or partial(plan_section, limits), layer_of),
    )
    return solve_feasible(model, request)


def dense_peaks(vertices: FloatArray, machine: Machine, settings: Settings) -> tuple[float, float]:
    """Highest velocity and acceleration of a carriage, from a hundred samples a segment of the nozzle's polygon."""
    many = 100
    share = np.arange(many)[None, :, None] / many
    resting = np.concatenate([vertices[:1], vertices, vertices[-1:]])
    nozzle = (resting[:-1, None] + share * np.diff(resting, axis=0)[:, None]).reshape(-1, 3)
    heights = machine.kinematics.compiled().inverse(nozzle)
    velocity = np.diff(heights, axis=0) / (settings.segment_s / many)
    change = (velocity[many:] - velocity[:-many]) / settings.segment_s
    return float(np.abs(velocity).max()), float(np.abs(change).max())


def error_um(found: SolvedSection, inverter: InverseModel) -> float:
    reference, nozzle = found.reference, found.reference.substeps(found.reference.knots)[0]
    command = inverter.executed(reference, found.solution.vertices)
    response, _ = inverter.respond(reference, command, inverter.machine.equilibrium(nozzle[0]))
    return 1e3 * float(np.sqrt(((response - nozzle[1:]) ** 2).sum(axis=1)).max())


@pytest.mark.parametrize(
    ("limits", "names"),
    [
        ({"carriage_velocity_mm_per_s": 120.0}, {"velocity"}),
        ({"step_rate_hz": 9600.0}, {"velocity"}),  # 120 mm/s at 80 steps/mm
        ({"carriage_acceleration_mm_per_s2": 6000.0}, {"acceleration"}),
        (
            {"carriage_velocity_mm_per_s": 140.0, "carriage_acceleration_mm_per_s2": 5000.0},
            {"velocity", "acceleration"},
        ),
    ],
)
def test_limits_below_the_plan_are_held_at_every_instant(
    machine: Machine, planned: PlannedProgram, limits: dict[str, float], names: set[str]
) -> None:
    tight = limited(machine, **limits)
    inverter, run = inverter_of(tight), planned.sections[0]
    found = solved(inverter, planned, run, tight)
    velocity, acceleration = dense_peaks(found.solution.vertices, machine, inverter.settings)
    assert velocity <= inverter.limits.velocity_mm_per_s[0] * (1 + 1e-6)
    assert acceleration <= inverter.limits.acceleration_mm_per_s2 * (1 + 1e-4)
    assert found.solution.utilisation <= 1.001
    assert error_um(found, inverter) < 25.0
    assert found.slowed and {record.limit for record in found.slowed} <= names
    assert 0 < found.lost_s < 0.6 * (run.end_t - run.begin_t)
    assert found.section.end_t - run.end_t == pytest.approx(found.lost_s)
    touched = {line for record in found.slowed for line in range(record.first_line, record.last_line + 1)}
    assert touched and touched <= {1, 2, 3, 4, 5, 6}
    for record in found.slowed:
        assert record.asked > 1.0 and record.factor < 1.0
        assert f"times its {record.limit} limit" in record.sentence()


def test_only_the_moves_concerned_become_slower(machine: Machine, planned: PlannedProgram) -> None:
    """The gentle lines at both ends keep their speed; every other run of the plan keeps its shape."""
    tight = limited(machine, carriage_velocity_mm_per_s=100.0)
    found = solved(inverter_of(tight), planned, planned.sections[0], tight)
    (record,) = found.slowed
    assert (record.first_line, record.last_line) == (2, 5)
    assert record.sentence().startswith(f"line 2-5: would have to be slowed to {100 * record.factor:.0f} %")
    before, after = planned.trajectory, found.trajectory
    speeds = [np.abs(plan.velocity(plan.start_t + 0.5 * plan.duration)[:, :3]).max(axis=1) for plan in (before, after)]
    np.testing.assert_allclose(speeds[1][[0, 5]], speeds[0][[0, 5]], rtol=1e-6)
    assert np.any(speeds[1][1:5] < 0.8 * speeds[0][1:5])
    assert after.end_t == pytest.approx(before.end_t + found.lost_s)


def test_strict_refuses_with_the_same_sentence(machine: Machine, planned: PlannedProgram) -> None:
    tight = limited(machine, carriage_velocity_mm_per_s=100.0)
    inverter = inverter_of(tight)
    found = solved(inverter, planned, planned.sections[0], tight)
    with pytest.raises(LimitsError) as caught:
        solved(inverter, planned, planned.sections[0], tight, slowing=SlowingSettings(strict=True))
    assert str(caught.value) == found.slowed[0].sentence()
    assert caught.value.exit_code == 6


def test_what_the_command_needs_beyond_its_plan_makes_moves_slower(machine: Machine, planned: PlannedProgram) -> None:
    inverter, run = inverter_of(machine), planned.sections[0]
    settings = replace(inverter.settings, bandwidth_hz=112.0, lead_s=0.004, compliance_s2=(1.0, 1.0, 1.0))
    free = solved(InverseModel(machine, settings), planned, run, machine).solution.utilisation
    tight = limited(machine, carriage_acceleration_mm_per_s2=0.7 * free * 30000.0)
    found = solved(InverseModel(tight, settings), planned, run, tight)
    assert found.slowed and 0.0 < found.lost_s < 0.01 * (run.end_t - run.begin_t)
    assert found.solution.utilisation <= 1.001
    assert error_um(found, InverseModel(tight, settings)) < 25.0


def test_a_path_beyond_the_travel_is_refused(machine: Machine, planned: PlannedProgram) -> None:
    heights = machine.kinematics.compiled().inverse(planned.program.moves.end[:, :3])
    top = float(heights[:5].max()) - 1.0
    tight = limited(machine, carriage_travel_mm=(0.0, top))
    with pytest.raises(LimitsError, match=r"line \d: the path needs carriage [ABC] at .* it travels from 0 to"):
        solved(inverter_of(tight), planned, planned.sections[0], tight)


def test_segments_can_be_played_in_their_time(machine: Machine) -> None:
    """A lift whose plan asks for more than the firmware has for Z: no G-code file can raise that."""
    planned = plan_program(
        read_program(b"G1 X-40 Y20 F3000\nG1 Z20 F12000\nG1 X-60 F3000\n", start=START, flavor="klipper"), machine
    )
    settings = settings_for(machine)
    output = replace(settings.output, z_acceleration_mm_per_s2=5000.0)
    inverter, (run,) = InverseModel(machine, replace(settings, output=output)), planned.sections

    def behind_um(vertices: FloatArray, wanted: Reference) -> float:
        each = np.full(len(vertices) - 1, settings.segment_s)
        speeds = segment_speeds(vertices, np.diff(wanted.extrusion()), each, output)
        return 1e3 * float(((speeds.duration - each) * speeds.cruise).max())

    wanted = Reference(planned.trajectory, run, inverter.settings)
    plain = solve(inverter, wanted, machine.equilibrium(np.array(START)))
    assert behind_um(plain.vertices, wanted) > 10.0
    found = solved(inverter, planned, run, machine)
    assert behind_um(found.solution.vertices, found.reference) <= 1.0
    (record,) = found.slowed
    assert (record.first_line, record.carriage) == (2, "")
    assert record.last_line in (2, 3)  # a segment may hold the end of the lift and the beginning of what follows
    assert "firmware's own acceleration" in record.sentence()
    assert 0 < found.lost_s < 0.1
    assert found.solution.utilisation <= 1.0


# ---- reference ----


START_REFERENCE = (0.0, 0.0, 0.3)


def planned_of_reference(text: bytes) -> PlannedProgram:
    return plan_program(read_program(text, start=START_REFERENCE, flavor="klipper"), load_machine("mp-delta-pro"))


@pytest.mark.parametrize("early_s", [0.0, 1e-12, 1e-6])
def test_no_reference_holds_the_place_of_the_next_section(early_s: float) -> None:
    """Where a plan was slowed down, rounding lets the next section begin before this one ends, and elsewhere."""
    text = b"G28\nG90\nM83\nG1 X10 Y10 Z5 F6000\nG1 X20 Y10 E1\nT1\nG1 X60 Y60\nG1 X70 Y60 E1\n"
    machine = load_machine("voron-300")
    planned_of_reference = plan_program(read_program(text), machine)
    plan, section = planned_of_reference.trajectory, planned_of_reference.sections[0]
    start_t = plan.start_t.copy()
    start_t[section.last] = section.end_t - early_s
    reference = Reference(replace(plan, start_t=start_t), section, Settings(substeps=4))
    knots = np.arange(-5, reference.knots + 6)
    for nozzle in (reference.at_knots(knots), reference.substeps(reference.knots + 4)[0]):
        np.testing.assert_allclose(nozzle[-1], [20.0, 10.0, 5.0], atol=1e-9)
        assert np.abs(np.diff(nozzle, axis=0)).max() < 1.0
    assert reference.extrusion()[-1] == pytest.approx(planned_of_reference.program.moves.end[section.last - 1, 3])
