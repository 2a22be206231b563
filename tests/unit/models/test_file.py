"""Machine files: what loads, what is refused and with which words, and the library."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import settings_for
from models.errors import MachineFileError
from models.file import LIBRARY, entries, load_machine, load_plant
from models.kinds import delta_vibration
from models.machine import ASSUMED, Machine, assumed_modes, way_to_measure

MINIMAL = """\
format = "ffcomp-machine/1"
name = "minimal"
[kinematics]
type = "delta"
arm_length_mm = 300
delta_radius_mm = 140
tower_angles_deg = [0, 120, 240]
effector_height_mm = 50
print_radius_mm = 135
print_height_mm = 300
[carriage]
mass_kg = 0.18
arm_pair_mass_kg = 0.03
belt_stiffness_n_per_m = 1e5
belt_damping_n_s_per_m = 5
guide_damping_n_s_per_m = 13
[effector]
nozzle_mass_kg = 0.5
extruder_mass_kg = 0.1
extruder_stiffness_n_per_m = [3e3, 7e3, 1e5]
extruder_damping_n_s_per_m = [20, 40, 20]
joint_radius_mm = 40
center_of_mass_mm = [0, 0, 0]
[limits]
velocity_mm_per_s = 300
acceleration_mm_per_s2 = 10000
"""


@pytest.fixture
def write(tmp_path: Path):
    def write(text: str | bytes) -> Path:
        path = tmp_path / "printer.toml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


@pytest.fixture
def problems(write):
    """What is wrong with MINIMAL after replacing one text by another."""

    def problems(*replacements: tuple[str, str], more: str = "") -> tuple[str, ...]:
        text = MINIMAL
        for old, new in replacements:
            assert old in text
            text = text.replace(old, new)
        with pytest.raises(MachineFileError) as caught:
            load_machine(write(text + more))
        return caught.value.problems

    return problems


def test_what_a_file_leaves_out_gets_the_documented_defaults(write) -> None:
    machine = load_machine(write(MINIMAL))
    assert delta_vibration(machine).carriage.drive is None
    assert delta_vibration(machine).effector.force_map == "virtual_work"
    assert machine.limits.square_corner_velocity_mm_per_s == 5.0
    assert machine.limits.carriage_velocity_mm_per_s == 500.0
    assert machine.limits.carriage_acceleration_mm_per_s2 == 30000.0
    assert (machine.steps.steps_per_mm, machine.steps.full_steps_per_mm) == (80.0, 5.0)
    assert machine.uncertainty == {"default": 0.02}
    assert machine.effects == {}
    assert machine.flavor == ""


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("ffcomp-machine/1", "ffcomp-machine/2", "format = 'ffcomp-machine/2' must be 'ffcomp-machine/1'."),
        ('"delta"', '"detla"', "kinematics.type = 'detla' must be 'delta'. Did you mean 'delta'?"),
        ('"minimal"', '""', "name = '' must not be empty."),
        ("= 140", "= 0.14", "kinematics.delta_radius_mm = 0.14 must be at least 10 (mm)."),
        ("= 0.18", "= 180", "carriage.mass_kg = 180 must be at most 20 (kg)."),
        ("0, 120, 240", "0, 120", "kinematics.tower_angles_deg = [0, 120] must be a list of three numbers"),
        (
            "[limits]",
            "[limits]\ncarriage_travel_mm = [400, 0]",
            "limits.carriage_travel_mm = [400.0, 0.0] must be the lower place first, then the higher one (mm).",
        ),
        ("effector_height_mm = 50\n", "", "kinematics.effector_height_mm is missing."),
        ("arm_length_mm = 300\n", "", "kinematics.arm_length_mm is missing; give it, or arm_lengths_mm"),
        ("mass_kg = 0.18", "mas_kg = 0.18", "carriage.mas_kg is not a key of a machine file. Did you mean 'mass_kg'?"),
        ("arm_length_mm = 300", "arm_length_mm = 275", "kinematics: the arm of tower A, 275 mm, is too short"),
        ("0, 120, 240", "0, 90, 180", "the towers must stand around the bed"),
    ],
)
def test_mistakes_are_named_with_key_value_and_rule(problems, old: str, new: str, problem: str) -> None:
    assert any(problem in sentence for sentence in problems((old, new)))


@pytest.mark.parametrize(
    ("more", "problem"),
    [
        ("[steps]\nsteps_per_mm = 4", "full_steps_per_mm = 5 must not exceed steps_per_mm = 4"),
        ("[effects]\nbelt_backlash = 1", "effects.belt_backlash = 1 must be a table."),
        ("[uncertainty]\n'carriage.mas_kg' = 0.1", "is not a number of this file. Did you mean 'carriage.mass_kg'?"),
        ("[firmware]\nflavor = 'kliper'", "firmware.flavor = 'kliper' must be"),
        ("[macros]\nreturns = ['G 1']", "macros.returns[0] = 'G 1' must be a name"),
    ],
)
def test_mistakes_in_optional_tables(problems, more: str, problem: str) -> None:
    assert any(problem in sentence for sentence in problems(more=more))


BOX = 'format = "ffcomp-machine/1"\nname = "box"\nlimits = {velocity_mm_per_s = 200, acceleration_mm_per_s2 = 3000}\n'
BOX += "kinematics = {type = 'corexy', x_range_mm = [0, 200], y_range_mm = [0, 200], z_range_mm = [0, 200]}\n[axes.x]\n"
ONE, TWO = "frequency_hz = [40]\ndamping_ratio = [0.1]\n", "frequency_hz = [40, 80]\ndamping_ratio = [0.1, 0.1]\n"
HARDENING = "[effects.belt_hardening]\ncubic_n_per_m3"
STAGE = 'format = "ffcomp-machine/1"\nname = "stage"\nkinematics.type = "axis"\n[axis]\nmass_kg = 2\n'
STAGE += "stiffness_n_per_m = 2e5\ndamping_n_s_per_m = 40\n"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (BOX + TWO, "axes.x.share is missing"),
        (BOX + "frequency_hz = [40, 60]\ndamping_ratio = [0.1]\nshare = [0.5, 0.5]", "as many numbers each"),
        (BOX + TWO + "share = [0.5, 0.4]", "must sum to 1"),
        (BOX + TWO + "share = [1.3, -0.3]\nmount_frequency_hz = 90", "must lie between the frequencies of two modes"),
        (BOX + ONE + "mass_kg = 0.4\n[axes.y]\n" + ONE, "axes.y.mass_kg is missing"),
        (BOX + ONE + HARDENING + " = 1e9", "or give cubic_n_per_m3_per_kg"),
        (BOX + ONE + "mass_kg = 0.4\n" + HARDENING + "_per_kg = 1e9", "use cubic_n_per_m3, because the axes state"),
        (BOX + ONE + "[effects.joint_friction]\nforce_n_per_kg = 1", "they have no arms"),
        (BOX + ONE + "[axes]\nexchange = 0.1", "needs the modes of both, [axes.x] and [axes.y]."),
        (
            f"{BOX}{ONE}[axes.y]\n{ONE}[axes]\nexchange = 0.1".replace("corexy", "cartesian"),
            "only for belts that move x",
        ),
        (BOX + ONE + "[effects]\ncogging = 3", "effects.cogging = 3 must be a table."),
        (BOX + ONE + "[effects.frame_mode]\ndirection = 'north'", "must be 'x', 'y', 'both', or a unit vector [x, y]."),
        (BOX + ONE + "[effects.cogging]\namplitude = 3", "of this effect. Did you mean 'amplitude_mm'?"),
        (BOX + ONE + '[firmware]\ninput_shaper = ["G28"]', "'G28' must be a command that switches an input shaper on"),
        (BOX + ONE + "carriage_velocity_mm_per_s = 1", "Did you mean 'limits.carriage_velocity_mm_per_s'?"),
        (BOX.replace("{type = 'corexy'", "3 #").replace("[axes.x]\n", ""), "kinematics = 3 must be a table."),
        ("[stepper_a]\nstep_pin: PA1\n", "This is a printer's configuration; ffcomp machines import"),
        (STAGE.replace("stiffness_n_per_m = 2e5", 'input = "position"'), "stiffness_n_per_m is missing (0 if nothing"),
        (STAGE.replace("2e5", "0") + 'input = "position"', "nothing ties the axis to its commanded position."),
        (STAGE + 'input = "force"\n[effects]\ncogging = 3', "effects.cogging = 3 must be a table."),
        (STAGE + 'input = "force"\n[uncertainty]\ndefault = 20', "uncertainty.default = 20 must be at most 10."),
        (STAGE + 'input = "force"\ndrive.gain_v_per_m = 1', "a servo law follow a position"),
        (STAGE + 'input = "voltage"\ndrive.resistance_ohm = 1', "belong together with a voltage input"),
        (STAGE + 'input = "duty"\ndrive = {force_constant_n_per_a = 1, resistance_ohm = 1}', "supply_v is missing"),
        (STAGE + 'input = "force"\ndrive.current_limit_a = 1', 'needs input = "current"'),
        (STAGE + 'input = "position"\ndrive.hold = "steps"', "a position is a cubic spline"),
        (STAGE + 'input = "position"\ndrive.rate_gain_v_s_per_m = 1', "needs axis.drive.gain_v_per_m"),
    ],
)
def test_mistakes_in_straight_axes_and_in_one_by_itself(write, text: str, problem: str) -> None:
    with pytest.raises(MachineFileError) as caught:
        load_plant(write(text))
    assert any(problem in sentence for sentence in caught.value.problems), caught.value.problems


def test_all_mistakes_are_told_at_once(problems) -> None:
    found = problems(
        ("arm_length_mm", "arm_lenght_mm"), ("= 0.18", "= 180"), ("[limits]", "[limit]"), ("= 0.5", "= 'heavy'")
    )
    for key in ("arm_length_mm is missing", "'arm_length_mm'?", "mass_kg = 180", "limits is missing", "'heavy'"):
        assert any(key in sentence for sentence in found), key


def test_broken_text_is_named_with_its_place(write) -> None:
    with pytest.raises(MachineFileError, match=r"not valid TOML: .*line 2"):
        load_machine(write("name = 1\nname\n"))
    with pytest.raises(MachineFileError, match="Byte 8 is not UTF-8"):
        load_machine(write(b"name = '\xff'"))


# --- The library


def test_the_library_prints_table_1(as_printed) -> None:
    carriage, effector = delta_vibration(as_printed).carriage, delta_vibration(as_printed).effector
    assert (carriage.mass_kg, carriage.arm_pair_mass_kg, carriage.belt_stiffness_n_per_m) == (0.179, 0.032, 1.21e5)
    assert (carriage.belt_damping_n_s_per_m, carriage.guide_damping_n_s_per_m) == (5.31, 13.4)
    assert vars(carriage.drive) == {"d0_per_s2": 1.43e5, "d1_per_s": -212.1, "d2_per_s": 36.2}
    assert (effector.nozzle_mass_kg, effector.extruder_mass_kg, effector.joint_radius_mm) == (0.542, 0.109, 39.91)
    assert effector.extruder_stiffness_n_per_m.tolist() == [3.31e3, 7.04e3, 1.29e5]
    assert effector.extruder_damping_n_s_per_m.tolist() == [20.4, 40.5, 19.6]
    assert effector.center_of_mass_mm.tolist() == [10.21, -16.52, 19.31]
    assert effector.force_map == "paper"


# --- House rules


# ---- library ----


FILES = sorted(LIBRARY.glob("*.toml"))
PAPER = ("paper", "derived")  # beginnings of an origin in the two files of the paper's machine


@pytest.fixture(params=FILES, ids=lambda path: path.stem)
def path(request: pytest.FixtureRequest) -> Path:
    return Path(request.param)


def unsourced(path: Path) -> Iterator[str]:
    """Every value whose origin is neither assumed nor one of the file's sources; none of a text needs one."""
    sources = tomllib.loads(path.read_text(encoding="utf-8"))["provenance"].get("sources", {})
    known = (ASSUMED, *(f"{title}: " for title in sources), *(PAPER if path.stem.startswith("mp-delta-pro") else ()))
    for entry in entries(path):
        stated = entry.provenance.removeprefix("x, y: ")  # of one axis after the other
        if not isinstance(entry.value, str) and not stated.startswith(known):
            yield f"{entry.key}: {entry.provenance!r}"


def test_every_number_is_from_a_source_or_assumed(path: Path) -> None:
    assert list(unsourced(path)) == []


def test_the_motors_can_do_what_the_plan_asks_of_them(path: Path) -> None:
    """Without a margin the compensation would slow every fast move down."""
    machine = load_machine(path)
    centre = np.array([[*machine.kinematics.centre_mm, 0.0]])
    actuators = np.linalg.inv(machine.kinematics.jacobian(centre)[0])[:, :2]  # per mm of the nozzle along x and y
    demand = np.linalg.norm(actuators, axis=1).max()
    assert machine.limits.carriage_velocity_mm_per_s > demand * machine.limits.velocity_mm_per_s
    assert machine.limits.carriage_acceleration_mm_per_s2 > demand * machine.limits.acceleration_mm_per_s2


def test_an_inverse_can_be_made(path: Path) -> None:
    machine = load_machine(path)
    model = InverseModel(machine, replace(settings_for(machine), one_model=True))  # of the bed's middle: quick
    assert 60.0 <= model.settings.bandwidth_hz <= 0.46 * 250.0
    assert np.isfinite(model.control_weight) and model.control_weight > 0
    assert model.gains is not None


# ---- provenance ----


@pytest.fixture
def voron() -> Machine:
    return load_machine("voron-300")


def with_origin(machine: Machine, **origins: str) -> Machine:
    changed = {f"axes.{axis}.frequency_hz": origin for axis, origin in origins.items()}
    return replace(machine, provenance={**machine.provenance, **changed})


def test_measured_axes_are_told_from_assumed_ones(voron: Machine) -> None:
    measured = "identified 2026-11-22 by ffcomp identify fit; 90 % interval 51.8 to 52.1"
    half = assumed_modes(with_origin(voron, x=measured))
    assert half is not None
    assert half.startswith("The modes of voron-300 are assumed in part (axes.y.frequency_hz), not measured")
    assert assumed_modes(with_origin(voron, x=measured, y=measured)) is None


@pytest.mark.parametrize(
    ("machine", "flavor", "test"),
    [
        ("voron-300", "klipper", "TEST_RESONANCES"),
        ("ender-3", "marlin", "ffcomp record plan"),
        ("kossel", "klipper", "ffcomp record plan"),
    ],
)
def test_modes_are_measured_with_what_the_firmware_offers(machine: str, flavor: str, test: str) -> None:
    """Klipper's own test is enough for straight axes; a delta's modes depend on the position."""
    assert way_to_measure(replace(load_machine(machine), flavor=flavor)).startswith(f"`{test} ")
