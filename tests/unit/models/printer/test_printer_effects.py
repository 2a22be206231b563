"""Each effect of the virtual printer against what physics says of it, and all of them together."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from models.arrays import constant
from models.effects.catalogue import CATALOGUE, effective_machine, with_effect
from models.effects.effect import Effect
from models.kinds import delta_vibration, with_parts
from models.machine import Machine
from models.printer.parameters import GRAVITY_M_PER_S2
from models.printer.printer import PrinterMotion, simulate_printer
from tests.support.effects import TABLES

RATE_HZ = 1600
CENTRE = np.array([[0.0, 0.0, 40.0]])


def on_z(machine: Machine, lift_mm: np.ndarray, **options: Any) -> PrinterMotion:
    """All three carriages alike, from the centre of the bed: the nozzle moves straight up and down."""
    return simulate_printer(machine, machine.kinematics.inverse(CENTRE) + lift_mm[:, None], 1 / RATE_HZ, **options)


def times(seconds: float) -> np.ndarray:
    return np.arange(round(seconds * RATE_HZ) + 1) / RATE_HZ


def steady(machine: Machine, speed_mm_per_s: float, seconds: float = 0.6) -> PrinterMotion:
    """Upwards at one speed, gently begun: the rate rises as a half cosine over 0.2 s."""
    t = times(seconds)
    x = np.clip(t / 0.2, 0, 1)
    lift = speed_mm_per_s * (np.maximum(t - 0.2, 0) + 0.1 * (x - np.sin(np.pi * x) / np.pi))
    return on_z(machine, lift, gravity=False)


def shaking(machine: Machine, **options: Any) -> PrinterMotion:
    """A third of a second of motion with everything in it; the towers do different things."""
    t = times(0.3)[:, None]
    path = np.hstack([8 * np.sin(40 * t) + 0.2 * np.sin(300 * t), 6 * np.sin(47 * t), 3 * np.sin(55 * t)])
    q = machine.kinematics.inverse(CENTRE + [[15, -20, 0]] + path * (1 - np.exp(-((12 * t) ** 2))))
    return simulate_printer(machine, q, 1 / RATE_HZ, **options)


def stretch_m(motion: PrinterMotion) -> np.ndarray:
    return (motion.motor_mm - motion.carriage_mm) / 1e3


def weight(machine: Machine) -> float:
    """N on each belt at rest at the centre."""
    effector = delta_vibration(machine).nozzle_side_mass_kg + delta_vibration(machine).effector.extruder_mass_kg
    return GRAVITY_M_PER_S2 * (delta_vibration(machine).carriage.moving_mass_kg + effector / 3)


def rest_stretch(machine: Machine) -> np.ndarray:
    return stretch_m(on_z(machine, np.zeros(3)))[-1]


# --- Friction


def belt_work(motion: PrinterMotion, machine: Machine, period: slice) -> float:
    """J that one belt's spring does over a period."""
    force = delta_vibration(machine).carriage.belt_stiffness_n_per_m * stretch_m(motion)[period, 0]
    return float(np.sum(force * np.gradient(motion.carriage_mm[:, 0])[period])) / 1e3


@pytest.mark.parametrize(
    ("name", "share"), [("coulomb_friction", 1.0), ("joint_friction", 1 / 3)], ids=["guides", "joints"]
)
def test_dry_friction_takes_4fa_a_cycle(printer: Machine, name: str, share: float) -> None:
    t = times(1.0)
    lift = 10 * np.cos(4 * np.pi * t) - 10
    rough = with_effect(printer, name, force_n=3.0)
    second = slice(RATE_HZ // 2, RATE_HZ)
    work = [belt_work(on_z(machine, lift, gravity=False), machine, second) for machine in (rough, printer)]
    assert work[0] - work[1] == pytest.approx(4 * share * 3.0 * 0.010, rel=0.02)


def test_friction_holds_a_carriage_off_its_command(printer: Machine) -> None:
    """After a move up and after a move down to one height the carriages rest apart, and stay there."""
    rough = with_effect(printer, "coulomb_friction", force_n=3.0)
    t = times(1.2)
    move = np.where(t < 0.3, (1 - np.cos(np.pi * t / 0.3)) / 2, 1.0)
    up, down = (on_z(rough, 5 * sign * (move - 1), gravity=False) for sign in (1, -1))
    apart = down.carriage_mm[:, 0] - up.carriage_mm[:, 0]
    hysteresis = 2e3 * 3.0 / delta_vibration(printer).carriage.belt_stiffness_n_per_m
    assert 0.5 * hysteresis < apart[-1] < 1.01 * hysteresis
    assert apart[-1] == pytest.approx(apart[-RATE_HZ // 4], rel=0.01)


def test_sticking_friction_fades_with_speed(printer: Machine) -> None:
    sticky = with_effect(printer, "stribeck_friction", force_n=2.0, extra_force_n=1.5, velocity_mm_per_s=20.0)
    for speed in (1.0, 20.0, 100.0):
        more = stretch_m(steady(sticky, speed, 1.0)) - stretch_m(steady(printer, speed, 1.0))
        expected = 2.0 + 1.5 * np.exp(-((speed / 20) ** 2))
        force = delta_vibration(printer).carriage.belt_stiffness_n_per_m * more[-RATE_HZ // 4 :].mean(axis=0)
        np.testing.assert_allclose(force, expected, rtol=0.04)


# --- Belts and motors


def test_viscous_friction_lags_by_its_force(printer: Machine) -> None:
    slow = with_effect(printer, "guide_damping", added_n_s_per_m=[0.0, 10.0, 20.0])
    lag = stretch_m(steady(slow, 100.0))[-1] - stretch_m(steady(printer, 100.0))[-1]
    np.testing.assert_allclose(delta_vibration(printer).carriage.belt_stiffness_n_per_m * lag, [0, 1, 2], atol=0.01)


def test_a_hardening_belt_obeys_its_cubic(printer: Machine) -> None:
    for cubic in (1e13, -5e12):
        s = rest_stretch(with_effect(printer, "belt_hardening", cubic_n_per_m3=cubic))
        force = delta_vibration(printer).carriage.belt_stiffness_n_per_m * s + cubic * s**3
        np.testing.assert_allclose(force, weight(printer), rtol=1e-6)


def test_an_overloaded_soft_belt_keeps_its_peak_force(printer: Machine) -> None:
    """At constant speed through more viscous friction than the belt can pull, the carriage falls behind in balance."""
    k, cubic = delta_vibration(printer).carriage.belt_stiffness_n_per_m, -2e13
    peak = 2 / 3 * k * np.sqrt(k / (-3 * cubic))
    soft = with_effect(printer, "belt_hardening", cubic_n_per_m3=cubic)
    speed = 120.0  # mm/s: 3.2 N at the guides' damping alone
    motion = steady(with_effect(soft, "guide_damping", added_n_s_per_m=30.0), speed)
    carriage_speed = RATE_HZ * np.diff(motion.carriage_mm[-2:], axis=0)[0]
    behind = speed - carriage_speed
    resisting = (delta_vibration(printer).carriage.guide_damping_n_s_per_m + 30.0) * carriage_speed / 1e3
    np.testing.assert_allclose(
        resisting, peak + delta_vibration(printer).carriage.belt_damping_n_s_per_m * behind / 1e3, rtol=0.01
    )
    assert behind.min() > 10


def test_play_is_a_hysteresis_of_its_width(printer: Machine) -> None:
    loose = with_effect(printer, "belt_backlash", width_mm=0.1)
    t = times(2.0)
    motion, tight = (on_z(machine, 3 * np.sin(np.pi * t) ** 3, gravity=False) for machine in (loose, printer))
    more = 1e3 * (stretch_m(motion) - stretch_m(tight))[:, 0]
    going_up, going_down = (np.abs(t - centre) < 0.03 for centre in (1 / 3, 2 / 3))
    np.testing.assert_allclose(more[going_up].mean() - more[going_down].mean(), 0.1, rtol=0.02)


def test_cogging_is_a_wave_of_the_motor(printer: Machine) -> None:
    """At 2 mm/s and 0.8 mm a wave, 2.5 Hz, the carriages follow the ripple to 1 %."""
    rippled = steady(with_effect(printer, "cogging", amplitude_mm=0.02, pitch_mm=0.8), 2.0, 1.4)
    ripple = (rippled.carriage_mm - steady(printer, 2.0, 1.4).carriage_mm)[RATE_HZ // 2 :, 0]
    assert np.ptp(ripple) / 2 == pytest.approx(0.02, rel=0.01)
    rising = np.flatnonzero((ripple[:-1] < 0) & (ripple[1:] >= 0))
    np.testing.assert_allclose(np.diff(rising) / RATE_HZ, 0.8 / 2.0, rtol=0.02)


def test_a_motors_torque_is_a_sine_of_its_lag(printer: Machine) -> None:
    k, a = delta_vibration(printer).carriage.belt_stiffness_n_per_m, 0.06e-3
    s = rest_stretch(with_effect(printer, "torque_angle", amplitude_mm=1e3 * a))
    np.testing.assert_allclose(s, a * np.arcsin(weight(printer) / (k * a)), rtol=1e-6)
    assert s[0] > 1.05 * rest_stretch(printer)[0]
    shared = rest_stretch(with_effect(printer, "torque_angle", amplitude_mm=1e3 * a, belt_share=0.3))
    lag = weight(printer) / (k * a)  # the belt's part of the stretch is in proportion to the force
    np.testing.assert_allclose(shared, a * (0.7 * np.arcsin(lag) + 0.3 * lag), rtol=1e-6)


def test_a_lost_step_is_a_whole_wave(printer: Machine) -> None:
    """A jerk beyond the peak of the sine makes the carriages slip, by whole multiples of 2 π a."""
    a = 0.1
    jerk = np.concatenate([np.zeros(20), np.full(1200, 3.0)])  # more than anything can follow
    slipped = on_z(with_effect(printer, "torque_angle", amplitude_mm=a), jerk, hold="linear", gravity=False)
    waves = (slipped.motor_mm[-1] - slipped.carriage_mm[-1]) / (2 * np.pi * a)
    np.testing.assert_allclose(waves, np.round(waves), atol=1e-3)
    assert np.round(waves).min() >= 1


# --- Masses, mounts, geometry


def test_the_true_geometry_places_the_nozzle(printer: Machine) -> None:
    off = with_effect(printer, "arm_geometry", arm_length_mm=[0.5, 0.0, -0.5], delta_radius_mm=0.3)
    motion = on_z(off, np.zeros(3), gravity=False)
    nominal = printer.kinematics.inverse(CENTRE)
    np.testing.assert_allclose(motion.nozzle_mm[-1], effective_machine(off).kinematics.forward(nominal)[0], atol=1e-9)
    assert np.abs(motion.nozzle_mm[-1] - CENTRE[0]).max() > 0.1


# --- The frame


@pytest.mark.parametrize("frequency", [12.0, 20.0, 31.0])
def test_the_frame_answers_as_a_mass_on_a_spring(printer: Machine, frequency: float) -> None:
    """With Ẍ the nozzle's motion on the frame, a/Ẍ = M_f (s² + 2ζωs + ω²)/((M_f + M₁) s² + M_f (2ζωs + ω²)).

    At the frame's own frequency that is a dip: the ground hardly feels the nozzle.
    """
    effector = replace(
        delta_vibration(printer).effector, extruder_mass_kg=1e-4, extruder_damping_n_s_per_m=constant([0.1] * 3)
    )
    frame = {"mass_kg": 4.0, "frequency_hz": 20.0, "damping_ratio": 0.05, "direction": "x"}
    machine = with_effect(with_parts(printer, effector=effector), "frame_mode", **frame)
    t = times(2.0)
    path = CENTRE + np.column_stack([np.sin(2 * np.pi * frequency * t) * np.minimum(t / 0.5, 1), 0 * t, 0 * t])
    motion = simulate_printer(machine, machine.kinematics.inverse(path), 1 / RATE_HZ, gravity=False, substeps=16)
    last = slice(-RATE_HZ - 1, -1)  # whole periods of every frequency here
    wave = np.exp(-2j * np.pi * frequency * t[last])
    s, omega = 2j * np.pi * frequency, 2 * np.pi * 20
    relative = s**2 * np.sum((motion.nozzle_mm - CENTRE)[last, 0] * wave) / 1e3
    m, sway = delta_vibration(machine).nozzle_side_mass_kg, 2 * 0.05 * omega * s + omega**2
    expected = 4.0 * (s**2 + sway) / ((4.0 + m) * s**2 + 4.0 * sway)
    assert np.sum(motion.nozzle_acceleration[last, 0] * wave) / relative == pytest.approx(expected, rel=2e-3)


# --- All of them

MOVING = [effect for effect in CATALOGUE.values() if effect.kind != "sensor" and "carriages" in effect.of]


@pytest.fixture
def everything(printer: Machine) -> Machine:
    machine = printer
    for name, table in TABLES.items():
        machine = with_effect(machine, name, **table)
    return machine


@pytest.mark.parametrize("effect", [effect for effect in MOVING if effect.amplitudes], ids=lambda e: e.name)
def test_without_amplitude_there_is_no_effect(printer: Machine, effect: Effect) -> None:
    neutral = {p.name: np.full(3, p.neutral) if p.size == "vector3" else p.neutral for p in effect.amplitudes}
    machine = with_effect(printer, effect.name, **{**TABLES[effect.name], **neutral})
    bare = shaking(printer)
    motion = shaking(machine)
    for field in ("carriage_mm", "nozzle_mm", "carriage_acceleration", "nozzle_acceleration", "motor_mm"):
        np.testing.assert_array_equal(getattr(motion, field), getattr(bare, field))


@pytest.mark.parametrize("effect", MOVING, ids=lambda e: e.name)
def test_every_probe_shows(everything: Machine, effect: Effect) -> None:
    """A step of a parameter by its probe moves a carriage or the nozzle, and not by millimetres."""
    base = shaking(everything)
    for parameter in effect.parameters:
        if parameter.size == "direction":
            continue
        value = np.asarray(everything.effects[effect.name].get(parameter.name, parameter.absent)) + parameter.probe
        table = {**everything.effects[effect.name], parameter.name: value}
        moved = np.abs(shaking(with_effect(everything, effect.name, **table)).nozzle_mm - base.nozzle_mm).max()
        assert 1e-7 < moved < 0.5, parameter.name


def test_all_effects_together_stay_stable(everything: Machine) -> None:
    t = times(1.5)
    stop = (1 - np.cos(np.pi * np.minimum(t, 1.0)))[:, None]
    path = CENTRE + np.hstack([40 * np.sin(9 * stop), 30 * np.sin(11 * stop), 5 * np.sin(30 * stop)])
    motion = simulate_printer(everything, everything.kinematics.inverse(path), 1 / RATE_HZ)
    assert np.abs(motion.nozzle_acceleration).max() < 200
    assert np.abs(motion.nozzle_mm - path).max() < 5
    assert RATE_HZ * np.abs(np.diff(motion.carriage_mm[-RATE_HZ // 10 :], axis=0)).max() < 0.1
    assert np.abs(motion.nozzle_acceleration[-RATE_HZ // 10 :]).max() < 0.5


def test_a_turn_of_120_degrees_turns_towers_effects_too(printer: Machine, everything: Machine) -> None:
    effector = replace(
        delta_vibration(printer).effector,
        extruder_stiffness_n_per_m=constant([5e3, 5e3, 1e5]),
        extruder_damping_n_s_per_m=constant([30, 30, 20]),
        center_of_mass_mm=constant([0, 0, 15]),
    )
    level = ("extruder_mount", "center_of_mass")  # these would have to be turned in the plane
    tables = {name: table for name, table in everything.effects.items() if name not in level}
    rolled = {
        name: {key: [v[2], v[0], v[1]] if isinstance(v, list) else v for key, v in table.items()}
        for name, table in tables.items()
    }
    here, there = (with_parts(replace(printer, effects=each), effector=effector) for each in (tables, rolled))
    t = times(0.3)[:, None]
    command = 340 + np.hstack([3 * np.sin(40 * t), 2 * np.sin(50 * t), 1 * np.sin(33 * t)]) * np.sin(5 * t)
    motion = simulate_printer(here, command, 1 / RATE_HZ)
    turned = simulate_printer(there, np.roll(command, 1, axis=1), 1 / RATE_HZ)
    np.testing.assert_allclose(turned.carriage_mm, np.roll(motion.carriage_mm, 1, axis=1), atol=1e-6)
    np.testing.assert_allclose(np.hypot(*turned.nozzle_mm[:, :2].T), np.hypot(*motion.nozzle_mm[:, :2].T), atol=1e-6)
