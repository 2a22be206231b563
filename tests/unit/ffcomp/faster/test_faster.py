"""A print under a bound is quicker than sliced, keeps the bound and the limits, and leaves alone what must be kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp import compensate
from ffcomp.errors import LimitsError
from ffcomp.faster.bound import Bound
from ffcomp.faster.program import FasterProgram, faster_program
from ffcomp.firmware.program import PlannedProgram, plan_program
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.settings import settings_for
from ffcomp.inverse.solve import solve
from gcode.program import Program
from gcode.reader import read_program
from models.file import load_machine
from tests.support import prints
from tests.support.contour import contour_error_in_order

SQUARES = b"""M83
;LAYER_CHANGE
;TYPE:Perimeter
G1 X20 Y0 E.7 F1800
G1 X20 Y20 E.7
G1 X0 Y20 E.7
;LAYER_CHANGE
;TYPE:Perimeter
G1 X0 Y0 E.7 F1800
G1 X20 Y0 E.7
;TYPE:External perimeter
G1 X20 Y20 E.7
G1 X0 Y20 E.7
;TYPE:Bridge infill
G1 X0 Y0 E.7
"""


@pytest.fixture(scope="module")
def model() -> InverseModel:
    machine = replace(load_machine("mp-delta-pro"), uncertainty={"default": 0.0})
    return InverseModel(machine, settings_for(machine))


@pytest.fixture(scope="module")
def squares() -> Program:
    return read_program(SQUARES, "squares", start=(0.0, 0.0, 0.3), flavor="klipper")


def planned(found: FasterProgram, model: InverseModel) -> PlannedProgram:
    return plan_program(found.program, model.machine)


def of(program: Program, model: InverseModel, um: float, **more: object) -> FasterProgram:
    bound = Bound(um, max_flow_mm3_per_s=15.0, min_layer_time_s=0.0)
    return faster_program(program, model, replace(bound, **more))  # type: ignore[arg-type]


def test_it_is_quicker_and_the_response_keeps_the_bound(squares: Program, model: InverseModel) -> None:
    """The judge knows no clock: distance of the predicted response to the squares' sides, in their order."""
    found = of(squares, model, 25.0)
    quick = planned(found, model)
    assert quick.trajectory.end_t < 0.75 * found.plan.end_t
    (section,) = quick.sections
    reference = Reference(quick.trajectory, section, model.settings)
    state = model.machine.equilibrium(squares.moves.start[0, :3])
    solution = solve(model, reference, state)
    response, _ = model.respond(reference, model.executed(reference, solution.vertices), state)
    corners = np.vstack([squares.moves.start[:, :3], squares.moves.end[-1:, :3]])
    error = contour_error_in_order(corners, response)
    assert solution.utilisation <= 1.0
    assert np.percentile(error, 99) < 25e-3
    assert error.max() < 2.5 * 25e-3


def test_what_is_not_known_costs_time_and_the_percentile_is_near_the_bound(squares: Program) -> None:
    times = []
    for sd in (0.0, 0.05):
        machine = replace(load_machine("mp-delta-pro"), uncertainty={"default": sd})
        own = InverseModel(machine, replace(settings_for(machine), robust=True))
        found = of(squares, own, 15.0, change_speed=("bridge infill", "First layer"))
        times.append(planned(found, own).trajectory.end_t)
    assert times[1] > 1.02 * times[0]
    assert 0.6 < found.p99 <= 1.0


def test_a_bound_that_no_speed_holds_is_told_with_what_is_held_and_nothing_is_written_if_strict(tmp_path: Path) -> None:
    """1.1 µm are less than what segments and rests leave."""
    source, target = tmp_path / "squares.gcode", tmp_path / "out.gcode"
    source.write_bytes(prints.squares(2))
    bound: dict[str, Any] = {"output": target, "max_error_um": 1.1, "change_speed": ("first layer",)}
    found = compensate(source, "mp-delta-pro", **bound)
    assert found.compensated is not None
    held = found.compensated.contour_p99_um
    assert 1.02 * 1.1 < held < 2.5
    said, times = found.to_dict()["faster"], ("print_time_s", "original_print_time_s", "actuator_limit_s")
    assert said["contour_p99_um"] == held < said["contour_max_um"] and min(said[key] for key in times) > 0.0
    assert sum(each["print_time_s"] for each in said["by_feature"].values()) > 0.0
    (sentence,) = [each for each in found.warning_lines if each.startswith("The bound")]
    assert f"bound of 1.1 µm is not held: for 99 % of the time the predicted error is below {held:.2g} µm" in sentence
    target.write_text("old")
    with pytest.raises(LimitsError):
        compensate(source, "mp-delta-pro", **bound, strict=True)
    assert target.read_text() == "old"


def test_what_keeps_the_slicers_motion_may_miss_the_bound_and_the_program_tells_by_how_much(
    squares: Program, model: InverseModel
) -> None:
    missed = of(squares, model, 1.0)
    assert missed.p99 > 1.2 and of(squares, model, 25.0).p99 <= 1.0


def test_first_layer_and_bridges_keep_the_slicers_motion(squares: Program, model: InverseModel) -> None:
    moves, was = of(squares, model, 25.0).program.moves, squares.moves
    kept = [0, 1, 2, 7]
    assert np.array_equal(moves.speed[kept], was.speed[kept])
    assert np.array_equal(moves.acceleration[kept], was.acceleration[kept], equal_nan=True)
    assert (moves.speed[3:7] > was.speed[3:7]).all()
