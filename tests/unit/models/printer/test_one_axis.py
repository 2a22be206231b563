"""One axis by itself: closed forms, and what its machine file may say."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from models.effects.catalogue import CATALOGUE, effects_of, with_effects
from models.errors import MachineFileError
from models.file import entries, load_machine, load_plant, updated_text
from models.kinds import driven_axis, is_one_axis, machine_of_axis
from models.machine import Machine
from models.printer.one_axis import AxisMotion, axis_effects, axis_parameters, simulate_axis, substeps_of
from models.vibration.driven_axis import Drive, DrivenAxis

DT = 1e-3
FREE = machine_of_axis("free", DrivenAxis("force", 100.0, 0.0, 500.0))
SPRUNG = machine_of_axis("sprung", DrivenAxis("position", 2.0, 2e5, 40.0))
TWO = machine_of_axis("two", DrivenAxis("force", 1.0, 0.0, 0.0, 3.0, 4e4, 0.0))
FILE = """
format = "ffcomp-machine/1"
name = "lift"
[kinematics]
type = "axis"
[axis]
input = "position"
mass_kg = 2.0
stiffness_n_per_m = 2.0e5
damping_n_s_per_m = 40.0
"""


def moved(machine: Machine, given: np.ndarray, **effects: Any) -> AxisMotion:
    return simulate_axis(with_effects(machine, effects), given, DT)


def test_a_constant_force_against_friction_in_closed_form() -> None:
    """M v̇ = F − F_c − b v from rest: x = v_∞ (t − τ (1 − exp(−t/τ))), τ = M/b."""
    tau, top = 100.0 / 500.0, (120.0 - 20.0) / 500.0
    found = moved(FREE, np.full(400, 120.0), coulomb_friction={"force_n": 20.0})
    t = found.t_s
    expected = 1e3 * top * (t - tau * (1 - np.exp(-t / tau)))
    np.testing.assert_allclose(found.position_mm, expected, atol=0.05)  # mm of 35: it begins to slide within 0.5 mm/s
    held = moved(FREE, np.full(400, 15.0), coulomb_friction={"force_n": 20.0})
    assert np.abs(held.position_mm).max() < 0.1


def test_a_spring_follows_its_command_as_an_oscillator() -> None:
    """A step of 1 mm: x = 1 − e^(−ζωt) (cos ω_d t + ζω/ω_d sin ω_d t)."""
    omega, decay = np.sqrt(2e5 / 2.0), 40.0 / 4.0
    damped = np.sqrt(omega**2 - decay**2)
    u = np.concatenate([np.zeros(30), np.ones(300)])
    x = simulate_axis(SPRUNG, u, 1e-4).position_mm[30:]
    t = 1e-4 * (np.arange(300) + 0.5)  # the command rises along one sample
    expected = 1 - np.exp(-decay * t) * (np.cos(damped * t) + decay / damped * np.sin(damped * t))
    np.testing.assert_allclose(x, expected, atol=2e-3)


def test_two_masses_swing_against_each_other_about_their_middle() -> None:
    omega = np.sqrt(4e4 * (1 / 1.0 + 1 / 3.0))
    push = np.where(np.arange(2000) < 5, 100.0, 0.0)
    found = moved(TWO, push)
    stretch = found.position_mm - found.motor_mm
    middle = (found.motor_mm + 3 * found.position_mm)[10:] / 4
    assert np.ptp(np.diff(middle)) < 1e-6 * np.ptp(middle)  # no force: the middle goes on
    turns = np.flatnonzero(np.diff(np.sign(stretch[10:])))
    assert np.pi / (DT * np.mean(np.diff(turns))) == pytest.approx(omega, rel=2e-3)


@pytest.mark.parametrize("s0", [1e-6, 1e-3, 0.02, 1.0])
def test_bristles_take_work_as_they_bend_at_any_speed(s0: float) -> None:
    """½ M v² = (F − F_C) x + F_C s₀ (1 − exp(−x/s₀)) from rest, however quickly they relax."""
    light = machine_of_axis("light", DrivenAxis("force", 1.0, 0.0, 0.0))
    found = moved(light, np.full(300, 20.0), bristle_friction={"force_n": 15.0, "presliding_mm": s0})
    x, v = found.position_mm, found.speed / 1e3
    work = 1e-3 * ((20.0 - 15.0) * x + 15.0 * s0 * (1 - np.exp(-x / s0)))
    np.testing.assert_allclose(0.5 * v**2, work, atol=1e-6 * work.max())


def test_bristles_stribeck_load_and_play_together_as_a_stiff_solver_finds() -> None:
    table: dict[str, dict[str, float]] = {
        "bristle_friction": {"force_n": 5.0, "presliding_mm": 0.003},
        "stribeck_friction": {"force_n": 2.0, "extra_force_n": 3.0, "velocity_mm_per_s": 20.0},
        "friction_by_load": {"share": 0.4},
        "belt_backlash": {"width_mm": 0.1, "landing_s_per_m": 2.0},
    }

    def rates(t: float, y: Any) -> list[float]:
        q, v, strain, bent = y
        u, u_rate = 5e-3 * np.sin(12.0 * t), 0.06 * np.cos(12.0 * t)
        stretch = u - q - np.clip(u - q, -5e-5, 5e-5)
        drive = 2e5 * (stretch + 2.0 * abs(stretch) * (u_rate - v))
        level, r = 2.0 + 3.0 * np.exp(-((v / 0.02) ** 2)) + 0.4 * abs(drive), v / 5e-4
        force = drive - 40.0 * v - level * np.tanh(r + strain) - 5.0 * bent
        locked = 50.0 * (r - (abs(r) / 3 + r**2) * strain) / (1 + r**2)
        return [v, force / 2.0, locked, (v - abs(v) * bent) / 3e-6]

    t = DT * np.arange(800)
    stiff = solve_ivp(rates, (0, t[-1]), np.zeros(4), "LSODA", t, rtol=1e-8, atol=1e-10, max_step=DT)
    found = moved(SPRUNG, 5.0 * np.sin(12.0 * t), **table)
    np.testing.assert_allclose(found.position_mm, 1e3 * stiff.y[0], atol=2e-4)


def test_a_late_command_is_late() -> None:
    slow = 5.0 * np.sin(2 * np.pi * np.arange(2000) * DT)
    late = moved(SPRUNG, slow, command_delay={"delay_s": 0.01}).position_mm[510:1500]
    np.testing.assert_allclose(late, moved(SPRUNG, slow).position_mm[500:1490], atol=2e-3)


LOADED = machine_of_axis("loaded", DrivenAxis("position", 2.0, 2e5, 40.0, 1.0, 8e4, 10.0))


def test_what_is_named_after_belts_is_of_the_spring_that_the_file_says() -> None:
    """A drive's change of stiffness is the drive's stiffness; its play lets both masses lag by half of it."""
    slow = 5.0 * np.sin(2 * np.pi * np.arange(2000) * DT)
    softer = machine_of_axis("softer", DrivenAxis("position", 2.0, 1.6e5, 40.0, 1.0, 8e4, 10.0))
    told = moved(LOADED, slow, belt_stiffness={"relative_change": -0.2, "at_drive": 1})
    np.testing.assert_allclose(told.position_mm, moved(softer, slow).position_mm, atol=1e-12)
    lag = {}
    for at in (0, 1):
        play = {"width_mm": 0.1, "at_drive": at}
        loose, tight = (
            moved(LOADED, slow, coulomb_friction={"force_n": 5.0}, **dict.fromkeys(names, play))
            for names in (["belt_backlash"], [])
        )
        lag[at] = float(np.median(np.abs(tight.motor_mm - loose.motor_mm)[1100:1400]))
    assert lag[1] == pytest.approx(0.05, rel=0.1) and lag[0] < 0.01  # of the coupling the motor's side feels little
    loud = 5.0 * np.sin(2 * np.pi * 8 * np.arange(600) * DT)
    bent = [moved(LOADED, loud, belt_hardening={"cubic_n_per_m3": 1e12, "at_drive": at}).position_mm for at in (0, 1)]
    plain = moved(LOADED, loud).position_mm
    assert min(np.std(bent[0] - plain), np.std(bent[1] - plain), np.std(bent[0] - bent[1])) > 0.01
    one = [moved(SPRUNG, slow, belt_hardening={"cubic_n_per_m3": 1e12, "at_drive": at}).position_mm for at in (0, 1)]
    np.testing.assert_array_equal(*one)  # it has one spring
    soft = {"cubic_n_per_m3": -1e10, "at_drive": 1}
    pulled = [np.abs(moved(own, 5 * loud, belt_hardening=soft).force).max() for own in (SPRUNG, LOADED)]
    np.testing.assert_allclose(pulled, 2 / 3 * 2e5 * np.sqrt(2e5 / 3e10), rtol=1e-3)  # its peak force


PROBES: dict[str, tuple[Machine, dict[str, Any]]] = {
    "belt_backlash": (SPRUNG, {"width_mm": 0.05}),
    "belt_damping": (SPRUNG, {"share": 0.5}),
    "belt_hardening": (SPRUNG, {"cubic_n_per_m3": 1e13}),
    "belt_stiffness": (SPRUNG, {"relative_change": 0.2}),
    "bristle_friction": (FREE, {"force_n": 5.0, "presliding_mm": 0.5}),
    "cogging": (SPRUNG, {"amplitude_mm": 0.01, "pitch_mm": 1.0}),
    "cogging_force": (FREE, {"sine_n": 3.0, "cosine_n": 0.0, "pitch_mm": 2.0}),
    "command_delay": (SPRUNG, {"delay_s": 2e-3}),
    "coulomb_friction": (FREE, {"force_n": 5.0}),
    "friction_by_direction": (FREE, {"damping_difference_n_s_per_m": 50.0}),
    "friction_by_load": (FREE, {"share": 0.2}),
    "ground_spring": (FREE, {"stiffness_n_per_m": 500.0}),
    "guide_damping": (FREE, {"added_n_s_per_m": 100.0}),
    "pendulum_gravity": (FREE, {"force_n": 500.0}),
    "quadratic_drag": (FREE, {"force_n_s2_per_m2": 1000.0}),
    "sensor_gain": (FREE, {"nozzle_relative_change": 0.1}),
    "sensor_lag": (FREE, {"delay_s": [2e-3, 0.0, 0.0], "time_constant_s": [3e-3, 0.0, 0.0]}),
    "stribeck_friction": (FREE, {"force_n": 2.0, "extra_force_n": 5.0, "velocity_mm_per_s": 5.0}),
}


@pytest.mark.parametrize("name", effects_of("axis"))
def test_every_effect_of_an_axis_does_something_at_any_step(name: str) -> None:
    machine, values = PROBES[name]
    given = (60.0 if machine is FREE else 5.0) * np.sin(2 * np.pi * 2 * np.arange(800) * DT)
    own = with_effects(machine, {name: values})
    plain, found = moved(machine, given), simulate_axis(own, given, DT)
    assert name in axis_effects(machine)
    kind = "acc_q" if name == "sensor_gain" else "pos_q"
    seen, felt = plain.sensed(machine)[kind], found.sensed(own)[kind]
    assert np.std(felt - seen) > 1e-3 * np.std(seen)
    finer = simulate_axis(own, given, DT, substeps=8 * substeps_of(axis_parameters(own), DT)).position_mm
    change = np.abs(found.position_mm - plain.position_mm).max()
    assert np.abs(found.position_mm - finer).max() < 0.02 * change + 1e-4


SERVO = Drive(0.5, 4.0, 12.0, gain_v_per_m=2e5, rate_gain_v_s_per_m=80.0)


def test_a_servo_law_is_a_spring_and_a_damper_as_far_as_its_supply_goes() -> None:
    """F = k_t/R (g (u − q) + h (u̇ − q̇)) − k_t²/R q̇, and no voltage beyond the supply."""
    per_volt = 0.5 / 4.0
    servo = machine_of_axis("servo", DrivenAxis("position", 2.0, 0.0, 40.0, drive=SERVO))
    plain = DrivenAxis("position", 2.0, 2e5 * per_volt, 40.0 + 0.5 * per_volt, drive_damping_n_s_per_m=80.0 * per_volt)
    quiet = 0.02 * np.sin(2 * np.pi * 5 * np.arange(800) * DT)
    same = [simulate_axis(m, quiet, DT).position_mm for m in (servo, machine_of_axis("plain", plain))]
    np.testing.assert_allclose(*same, rtol=1e-12)
    loud = simulate_axis(servo, 100 * quiet, DT)
    assert np.abs(loud.force).max() == pytest.approx(12.0 * per_volt)


def test_a_voltage_drives_a_motor_to_the_speed_at_which_it_induces_as_much() -> None:
    """Without friction V = k_t q̇ in the end; a current makes k_t i; forces per volt need no constant."""
    motor = Drive(0.5, 0.1)
    free = machine_of_axis("motor", DrivenAxis("voltage", 2.0, 0.0, 0.0, drive=motor))
    assert simulate_axis(free, np.full(20_000, 3.0), DT).speed[-1] == pytest.approx(1e3 * 3.0 / 0.5, rel=1e-6)
    by_current = machine_of_axis("motor", DrivenAxis("current", 2.0, 0.0, 0.0, drive=Drive(0.5, current_limit_a=4.0)))
    assert simulate_axis(by_current, np.full(9, 10.0), DT).acceleration[-1] == pytest.approx(0.5 * 4.0 / 2.0)
    duty = DrivenAxis("duty", 2.0, 0.0, 0.0, drive=Drive(0.5, 0.1, 6.0))
    np.testing.assert_allclose(duty.force_of(np.array([0.5, 2.0])), [0.5 * 6.0 * 5.0, 6.0 * 5.0])
    np.testing.assert_allclose(duty.force_of(np.array([0.5, 2.0]), np.array([4.0, 8.0])), [0.5 * 4.0 * 5.0, 8.0 * 5.0])


@pytest.mark.parametrize("late", [0.0, 0.42])
def test_a_force_that_a_controller_holds_moves_a_mass_exactly(late: float) -> None:
    """Under a constant force v → v e^(−bt/M) + F/b (1 − e^(−bt/M)); what is late jumps within a sample."""
    mass, b, force = 2.0, 40.0, 50.0 * np.random.default_rng(2).standard_normal(300)
    machine = machine_of_axis("held", DrivenAxis("force", mass, 0.0, b, drive=Drive(hold="steps")))
    found = moved(machine, force, **({"command_delay": {"delay_s": late * DT}} if late else {}))
    q = v = 0.0
    exact = [(q, v)]
    for before, now in zip(np.roll(force, 1)[:-1], force[:-1], strict=True):
        for f, t in ((before if len(exact) > 1 else force[0], late * DT), (now, (1 - late) * DT)):
            left, top = np.exp(-b * t / mass), f / b
            q, v = q + top * t + (v - top) * mass / b * (1 - left), top + (v - top) * left
        exact.append((q, v))
    np.testing.assert_allclose(np.column_stack([found.position_mm, found.speed]), 1e3 * np.array(exact), atol=2e-5)
    straight = machine_of_axis("straight", DrivenAxis("force", mass, 0.0, b))
    assert np.abs(moved(straight, force).speed - found.speed).max() > 1.0


def test_damping_across_the_drive_follows_a_steady_speed_and_answers_as_its_linear_model() -> None:
    """q/u = (s c + k)/(m s² + (b + c) s + k): of one sine, and no lag at a steady speed from c alone."""
    axis = DrivenAxis("position", 2.0, 2e4, 5.0, drive_damping_n_s_per_m=60.0)
    machine, t = machine_of_axis("belt", axis), np.arange(6000) * DT
    s = 2j * np.pi * 12.0
    response = axis.carriage_response(np.zeros((1, 2)), np.array([s]))[0, 0, 0]
    assert response == pytest.approx((60.0 * s + 2e4) / (2.0 * s**2 + 65.0 * s + 2e4))
    late = t > 4.0
    steady = simulate_axis(machine, np.sin(2 * np.pi * 12.0 * t), DT).position_mm[late]
    np.testing.assert_allclose(steady, (response * np.exp(s * t[late])).imag, atol=2e-4)
    lag = 10.0 * t[-1] - simulate_axis(machine, 10.0 * t, DT).position_mm[-1]
    assert lag == pytest.approx(10.0 * 5.0 / 2e4, rel=1e-3)
    assert axis.low_frequency(np.zeros((1, 2)))[0][0] == pytest.approx(5.0 / 2e4)


def test_a_pendulum_swings_as_its_energy_says_and_rests_where_it_is_held() -> None:
    """½ J q̇² + M (1 − cos q) is constant; M sin q = F at rest."""
    arm = machine_of_axis("arm", DrivenAxis("force", 0.2, 0.0, 0.0, unit="rad"))
    begin = np.array([[1500.0, 0.0, 1500.0, 0.0]])
    swung = with_effects(arm, {"pendulum_gravity": {"force_n": 3.0}})
    free = simulate_axis(swung, np.zeros(3000), DT, begin=begin)
    energy = 0.5 * 0.2 * (free.speed / 1e3) ** 2 + 3.0 * (1 - np.cos(free.position_mm / 1e3))
    np.testing.assert_allclose(energy, energy[0], rtol=1e-5)
    damped = machine_of_axis("arm", DrivenAxis("force", 0.2, 0.0, 1.0, unit="rad"))
    held = with_effects(damped, {"pendulum_gravity": {"force_n": 3.0, "angle_deg": -20.0}})
    at_rest = simulate_axis(held, np.full(8000, 1.5), DT).position_mm[-1]
    assert at_rest / 1e3 == pytest.approx(np.arcsin(0.5) - np.radians(20.0), abs=1e-4)


def test_several_lines_of_cogging_add_up_and_are_stated_by_pitch_or_by_turn(tmp_path: Path) -> None:
    force, table = np.full(500, 30.0), {"sine_n": [3.0, 1.0], "cosine_n": [0.0, 2.0], "pitch_mm": [2.0, 0.7]}
    both = moved(FREE, force, cogging_force=table)
    q = both.position_mm
    lines = 3.0 * np.sin(np.pi * q) + np.sin(2 * np.pi * q / 0.7) + 2.0 * np.cos(2 * np.pi * q / 0.7)
    np.testing.assert_allclose(100.0 * both.acceleration, 30.0 - 500.0 * both.speed / 1e3 - lines, atol=1e-9)
    path = tmp_path / "motor.toml"
    path.write_text(
        TURNING + "[effects.cogging_force]\nsine_a = [0.8, 0.5]\ncosine_a = [0, 0]\nlines_per_turn = [7, 28]\n"
    )
    assert load_plant(path).effects["cogging_force"]["pitch_mm"] == pytest.approx([2e3 * np.pi / 7, 2e3 * np.pi / 28])
    path.write_text(path.read_text().replace("[7, 28]", "[7]"))
    with pytest.raises(MachineFileError, match="as many numbers each"):
        load_plant(path)


TURNING = """
format = "ffcomp-machine/1"
name = "motor"
[kinematics]
type = "axis"
[axis]
unit = "rad"
input = "current"
inertia_a_s2_per_rad = 0.0035
stiffness_a_per_rad = 0.0
damping_a_s_per_rad = 0.003
[uncertainty]
"axis.inertia_a_s2_per_rad" = 0.3
"""


def test_an_axis_that_turns_has_words_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "motor.toml"
    path.write_text(TURNING + "[effects.coulomb_friction]\ncurrent_a = 0.4\ncreep_rad_per_s = 0.02\n")
    found = load_plant(path)
    assert driven_axis(found).mass_kg == 0.0035 and found.uncertainty["axis.mass_kg"] == 0.3
    assert found.effects["coulomb_friction"] == {"force_n": 0.4, "creep_mm_per_s": pytest.approx(20.0)}
    shown = {entry.key: (entry.value, entry.unit) for entry in entries(path)}
    assert shown["axis.inertia_a_s2_per_rad"] == (0.0035, "A s²/rad")
    assert shown["effects.coulomb_friction.creep_rad_per_s"] == (pytest.approx(0.02), "rad/s")
    text = updated_text(path, {"axis.mass_kg": 0.004, "effects.coulomb_friction.creep_mm_per_s": 30.0})
    assert "inertia_a_s2_per_rad = 0.004" in text and "creep_rad_per_s = 0.03\n" in text
    path.write_text(TURNING.replace("0.0035", "-1.0"))
    with pytest.raises(MachineFileError, match=r"axis.inertia_a_s2_per_rad = -1.0 must be at least .* \(A s²/rad\)"):
        load_plant(path)


def test_the_file_of_an_axis(tmp_path: Path) -> None:
    path = tmp_path / "lift.toml"
    path.write_text(FILE)
    found = load_plant(path)
    assert is_one_axis(found) and driven_axis(found).mass_kg == 2.0
    assert found.vibration.tunable == ("axis.mass_kg", "axis.stiffness_n_per_m", "axis.damping_n_s_per_m")
    with pytest.raises(MachineFileError, match="no G-code"):
        load_machine(path)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (("2.0e5", "0.0"), "nothing ties the axis to its commanded position"),
        (("damping_n", "load_mass_kg = 1.0\ndamping_n"), "belong together"),
        (("damping_n", "coupling_damping_n_s_per_m = 1.0\ndamping_n"), "needs axis.load_mass_kg and axis.coupling"),
        (('lift"', 'lift"\n[effects.effector_mass]\nadded_kg = 0.1'), "does not apply to one axis by itself"),
        (
            ('name = "lift"', 'name = "lift"\n[effects.coulomb_friction]\nforce_n = 1.0\npresliding_mm = 0.02'),
            "presliding_mm is only for printers",
        ),
        (('"position"', '"torque"'), "must be 'position', 'force', 'current', 'voltage' or 'duty'"),
    ],
)
def test_mistakes_in_the_file_of_an_axis(change: tuple[str, str], sentence: str, tmp_path: Path) -> None:
    path = tmp_path / "lift.toml"
    path.write_text(FILE.replace(*change))
    with pytest.raises(MachineFileError, match=sentence):
        load_plant(path)


def test_a_printer_has_no_effect_of_an_axis(tmp_path: Path) -> None:
    text = Path(str(load_machine("mp-delta-pro").path)).read_text()
    path = tmp_path / "delta.toml"
    path.write_text(text + "\n[effects.ground_spring]\nstiffness_n_per_m = 5.0\n")
    with pytest.raises(MachineFileError, match="does not apply to a delta"):
        load_machine(path)
    assert CATALOGUE["ground_spring"].of == ("axis",)
    path.write_text(text + "\n[effects.belt_stiffness]\nrelative_change = 0.1\nat_drive = 1\n")
    with pytest.raises(MachineFileError, match="at_drive is only for one axis by itself"):
        load_machine(path)
