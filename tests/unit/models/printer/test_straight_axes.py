"""The virtual printer of straight axes: the linear model, forces against independent equations, belts of a CoreXY."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from models.arrays import FloatArray, constant
from models.effects.catalogue import effective_machine
from models.kinematics.cartesian import CARTESIAN, COREXY, CartesianKinematics
from models.machine import Machine, MotionLimits
from models.printer.printer import simulate_printer
from models.vibration.modal import Axis, ModalAxes
from models.vibration.state_space import discretise

RATE_HZ = 1600
AXES = (Axis([57.0, 90.0], [0.07, 0.05], [1.2, -0.2]), Axis([48.0], [0.07]), Axis())  # more modes compile for 10 s
OMEGA = 2 * np.pi * 48.0


def machine(motors: FloatArray = CARTESIAN, axes: tuple[Axis, ...] = AXES, **effects: dict[str, Any]) -> Machine:
    box = CartesianKinematics(constant([[0, 200], [0, 200], [0, 200]]), motors)
    return Machine("axes", box, ModalAxes.of(axes), MotionLimits(200.0, 3000.0), effects=effects)


def shaken(seconds: float = 0.5, rate_hz: int = RATE_HZ) -> FloatArray:
    """(n, 3) mm, from rest: long and short motion of x and y."""
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    grown = np.minimum(t / 0.1, 1) ** 2
    x = 20 * np.sin(2 * np.pi * 4 * t) + 0.3 * np.sin(2 * np.pi * 43 * t)
    return np.column_stack([100 + grown * x, 100 + grown * 10 * np.sin(2 * np.pi * 3 * t), 50 + 0 * t])


def linear(of: Machine, command: FloatArray) -> FloatArray:
    """The nozzle of the linear model under straight segments."""
    plant = discretise(of.vibration.state_space(np.zeros((1, 2))), 1 / RATE_HZ)
    state, found = of.vibration.steady_motion(command[0], np.zeros(3)), [command[0]]
    for before, after in pairwise(command):
        state = plant.a[0] @ state + plant.b0[0] @ before + plant.b1[0] @ after
        found.append(plant.carriage @ state)
    return np.array(found)


@pytest.mark.parametrize(("stiffer", "share"), [(0.0, 0.0), (0.2, 0.4), (0.2, 1.0)])
@pytest.mark.parametrize("motors", [CARTESIAN, COREXY], ids=["cartesian", "corexy"])
def test_it_is_the_linear_model_to_ten_nanometres(motors: FloatArray, stiffer: float, share: float) -> None:
    """Half a sample of misplaced hold would be 50 µm."""
    own = effective_machine(machine(motors, belt_damping={"share": [share, 0.5 * share, 0.0]}))
    own = replace(own, vibration=own.vibration.with_belts(np.array([stiffer, 0.0, 0.0]), motors))
    found = simulate_printer(own, shaken(), 1 / RATE_HZ, hold="linear", substeps=8).nozzle_mm
    np.testing.assert_allclose(found, linear(own, shaken()), atol=1e-5)


def test_unequal_belts_exchange_motion_as_the_response_says() -> None:
    own = machine(COREXY, belt_stiffness={"relative_change": [0.2, -0.1, 0.0]})
    t = np.arange(0, 1.5, 1 / RATE_HZ)
    command = np.column_stack([100 + np.sin(2 * np.pi * 30 * t), 100 + 0 * t, 50 + 0 * t])
    found = simulate_printer(own, command, 1 / RATE_HZ).nozzle_mm[t > 1.3, 1] - 100
    effective = own.vibration.with_belts(np.array([0.2, -0.1, 0.0]), COREXY)
    g = effective.frequency_response(np.zeros(2), np.array([30.0]), "nozzle", "nozzle")[0, 1, 0]
    assert abs(g) > 0.05
    np.testing.assert_allclose(found, (g * np.exp(2j * np.pi * 30 * t[t > 1.3])).imag, atol=2e-4)


def test_modes_with_stiffer_belts_are_those_of_the_changed_structure() -> None:
    """Two masses on springs: q the driven one and then the other one; against its eigenvalues."""
    m1, m2, k1, k2 = 0.4, 0.15, 5e4, 8e4

    def modes(k1: float) -> tuple[FloatArray, FloatArray]:
        mass, stiffness = np.array([m1, m2]), np.array([[k1 + k2, -k2], [-k2, k2]])
        square, shape = np.linalg.eigh(stiffness / np.sqrt(np.outer(mass, mass)))
        shape /= np.sqrt(mass)[:, None]
        return np.sqrt(square) / (2 * np.pi), k1 * shape[0] * shape[0] / square  # of the driven mass

    f, share = modes(k1)
    own = ModalAxes.of([Axis(f.tolist(), [0.05, 0.05], share.tolist(), m1 + m2), Axis(), Axis()])
    assert own.drive_stiffness[0] == pytest.approx(k1)
    found, expected = own.with_belts(np.array([0.3, 0, 0]), CARTESIAN), modes(1.3 * k1)
    for i in range(2):
        assert found.value(f"axes.x.frequency_hz[{i}]") == pytest.approx(expected[0][i])
        assert found.value(f"axes.x.share[{i}]") == pytest.approx(expected[1][i])


@pytest.mark.parametrize(("way", "substeps"), [(0.0, None), (2e-5, None), (2e-5, 1)])
def test_dry_friction_is_that_of_a_fine_integration(way: float, substeps: int | None) -> None:
    """Of bristles at long steps too: those of 5 µm would turn over within one at 30 mm/s."""
    rate = 6400
    command = shaken(0.4, rate)
    t, y = np.arange(len(command)) / rate, command[:, 1] / 1e3

    def equations(now: float, s: FloatArray) -> list[float]:
        u, v, bent = np.interp(now, t, y), s[1], s[2]
        r = v / 0.5e-3
        locked = 50.0 * (r - (abs(r) / 3.0 + r * r) * bent) / (1 + r * r)
        rubbing, bending = (bent, (v - abs(v) * bent) / way) if way else (np.tanh(r + bent), locked)
        return [v, OMEGA**2 * (u - s[0]) - 2 * 0.07 * OMEGA * v - 3.0 * rubbing, bending]

    judged = solve_ivp(equations, (0, t[-1]), [y[0], 0, 0], "LSODA", t, rtol=1e-8, atol=1e-11, max_step=1e-3)
    own = machine(coulomb_friction={"force_n": 3.0, "presliding_mm": 1e3 * way})
    found, smooth = (
        simulate_printer(each, command, 1 / rate, hold="linear", substeps=substeps).nozzle_mm[:, 1]
        for each in (own, machine())
    )
    assert np.abs(found - smooth).max() > 0.03  # 3/ω² are 33 µm
    print(np.abs(found - judged.y[0] * 1e3).max())
    np.testing.assert_allclose(found, judged.y[0] * 1e3, atol=1e-5 if way else 2e-4)


def test_slow_motion_lags_by_friction_over_stiffness_and_by_half_the_play() -> None:
    t = np.arange(0, 1.0, 1 / RATE_HZ)
    command = np.column_stack([100 + 0 * t, 100 + 5 * t * np.minimum(t, 1), 50 + 0 * t])
    rubbed = simulate_printer(machine(coulomb_friction={"force_n": 4.0}), command, 1 / RATE_HZ).nozzle_mm
    loose = machine(coulomb_friction={"force_n": 4.0}, belt_backlash={"width_mm": 0.06})
    plain = simulate_printer(machine(), command, 1 / RATE_HZ).nozzle_mm
    assert (plain - rubbed)[-1, 1] == pytest.approx(1e3 * 4.0 / OMEGA**2, rel=0.01)
    assert (rubbed - simulate_printer(loose, command, 1 / RATE_HZ).nozzle_mm)[-1, 1] == pytest.approx(0.03, rel=0.02)


def test_what_one_motor_of_a_corexy_does_moves_both_axes() -> None:
    t = np.arange(0, 0.6, 1 / RATE_HZ)
    command = np.column_stack([50 + 30 * t**2, 100 + 0 * t, 50 + 0 * t])
    rippled = {"amplitude_mm": [0.02, 0.0, 0.0], "pitch_mm": 4.0}
    apart = [
        simulate_printer(machine(motors, cogging=rippled), command, 1 / RATE_HZ).nozzle_mm
        - simulate_printer(machine(motors), command, 1 / RATE_HZ).nozzle_mm
        for motors in (CARTESIAN, COREXY)
    ]
    assert np.ptp(apart[0][:, 0]) == pytest.approx(0.04, rel=0.1) and not apart[0][:, 1].any()
    assert np.ptp(apart[1], axis=0)[:2] == pytest.approx([0.02, 0.02], rel=0.1)


def test_a_frame_sways_as_its_closed_form_says() -> None:
    """The sensor's response to a sine along x, with μ = M/M_f and the sway against the frame's own spring."""
    f, zeta, ratio = 18.0, 0.04, 1 / 12.0
    frame = {"mass_kg": 12.0, "frequency_hz": f, "damping_ratio": zeta, "direction": "x"}
    own = machine(axes=(Axis([57.0], [0.07]), Axis(), Axis()), frame_mode=frame)
    t = np.arange(0, 3.0, 1 / RATE_HZ)
    command = np.column_stack([100 + np.sin(2 * np.pi * 25 * t), 100 + 0 * t, 50 + 0 * t])
    felt = simulate_printer(own, command, 1 / RATE_HZ).nozzle_acceleration[t > 2.7, 0]
    s, omega = 2j * np.pi * 25.0, 2 * np.pi * np.array([57.0, f])
    mode = s**2 + 2 * 0.07 * omega[0] * s + omega[0] ** 2
    sway = s**2 + 2 * zeta * omega[1] * s + omega[1] ** 2
    # q (mode) = ω² u − s² d;  d sway = −ratio (ω² (u − q) − 2 ζ ω s q) = −ratio s² (q + d)
    q, d = np.linalg.solve([[mode, s**2], [ratio * s**2, sway + ratio * s**2]], [omega[0] ** 2, 0.0])
    expected = (s**2 * (q + d) * np.exp(2j * np.pi * 25 * t[t > 2.7])).imag / 1e3
    assert abs(d / q) > 0.05
    np.testing.assert_allclose(felt, expected, atol=1e-3 * np.abs(expected).max())


def felt_along_y(own: Machine, at: tuple[float, float, float], f: float) -> FloatArray:
    """The last periods of what the sensor feels along y, m/s², under 1 mm of f Hz along y and 0.5 mm along x."""
    t = np.arange(0, 3.0, 1 / RATE_HZ)
    wave = np.sin(2 * np.pi * f * t)
    command = np.column_stack([at[0] + 1e-3 * wave, at[1] + wave, at[2] + 0 * t])
    return simulate_printer(own, command, 1 / RATE_HZ).nozzle_acceleration[t > 2.7, 1]


@pytest.mark.parametrize("arm_mm", [0.0, 3e4])
@pytest.mark.parametrize("x_mm", [-80.0, 90.0])
def test_a_gantry_racks_as_its_closed_form_says(x_mm: float, arm_mm: float) -> None:
    """Two unknowns, the gantry's middle and its angle; so long an arm shows by a motion of a thousandth along x."""
    f, radius, share = 36.0, 150.0, 0.4
    racking = {"radius_mm": radius, "frequency_hz": 42.0, "damping_ratio": 0.05, "x_centre_mm": 100.0}
    own = machine(gantry_racking={**racking, "tool_share": share, "arm_mm": arm_mm})
    found = felt_along_y(own, (100.0 + x_mm, 100.0, 50.0), f)
    s, x, turn = 2j * np.pi * f, x_mm / 1e3, 2 * np.pi * 42.0
    mode = s**2 + 2 * 0.07 * OMEGA * s + OMEGA**2
    stiff = (radius / 1e3) ** 2 * (turn**2 + 2 * 0.05 * turn * s)
    inertia = ((radius / 1e3) ** 2 + (1 - share) * x**2) * s**2
    qx, ux = own.vibration.frequency_response(np.zeros(2), np.array([f]), "nozzle", "nozzle")[0, 0, 0], 1e-3
    drag = arm_mm / 1e3 * _driven_force(own, f) * ux if arm_mm else 0.0
    # mode · Y + μ x s² θ = ω² u;   stiff θ + inertia θ + x (s² Y + μ x s² θ) = a f_x
    equations = [[mode, share * x * s**2], [x * s**2, stiff + inertia + share * x**2 * s**2]]
    y, theta = np.linalg.solve(equations, [OMEGA**2, drag])
    t = np.arange(0, 3.0, 1 / RATE_HZ)
    expected = (s**2 * (y + x * theta) * np.exp(s * t[t > 2.7])).imag / 1e3
    assert abs(x * theta / y) > 0.1 and abs(qx) > 0
    np.testing.assert_allclose(found, expected, atol=0.01 * np.abs(expected).max())


def _driven_force(own: Machine, f: float) -> complex:
    """Acceleration s² q_d of x's driven point for a motor that moves by one."""
    s = 2j * np.pi * f
    omega2, guides, belts, share, part, *_ = own.vibration.printer_modes()[:, :, 0].T
    return complex(s**2 * np.sum(part * share * omega2 / (s**2 + (guides + belts) * s + omega2)))


def test_a_bed_that_grows_is_a_heavier_one_at_each_height() -> None:
    own = machine(growing_bed={"growth_per_m": [0.0, 2.0, 0.0]})
    for height in (0.0, 100.0):
        slower = (1.0 + 2e-3 * height) ** -0.5
        heavier = machine(axes=(AXES[0], Axis([48.0 * slower], [0.07 * slower]), Axis()))
        found, expected = (felt_along_y(each, (100.0, 100.0, height), 36.0) for each in (own, heavier))
        np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
    low, high = (felt_along_y(own, (100.0, 100.0, height), 36.0) for height in (0.0, 100.0))
    assert np.abs(low - high).max() > 0.1 * np.abs(low).max()


def test_a_toolhead_s_mode_is_another_one_at_each_x() -> None:
    own = machine(toolhead_mode={"slope_per_m": [0.0, 1.5, 0.0], "curve_per_m2": [0.0, 8.0, 0.0], "x_centre_mm": 60.0})
    for x in (60.0, 160.0, 20.0):
        more = 1 + 1.5 * (x - 60.0) / 1e3 + 8.0 * ((x - 60.0) / 1e3) ** 2
        axes = (AXES[0], Axis([48.0 * more**0.5], [0.07 / more**0.5]), Axis())
        found, expected = (felt_along_y(each, (x, 100.0, 50.0), 36.0) for each in (own, machine(axes=axes)))
        np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())


PROBES: dict[str, dict[str, Any]] = {
    "coulomb_friction": {"force_n": [1.0, 2.0, 0.0]},
    "stribeck_friction": {"force_n": 0.5, "extra_force_n": 1.0, "velocity_mm_per_s": 10.0},
    "belt_backlash": {"width_mm": [0.02, 0.05, 0.0]},
    "belt_hardening": {"cubic_n_per_m3": [-1e10, 1e11, 0.0]},
    "belt_position_stiffness": {"slope_per_m": [0.3, -0.2, 0.0], "q_centre_mm": 100.0},
    "belt_stiffness": {"relative_change": [0.1, -0.1, 0.0]},
    "belt_damping": {"share": [0.3, 0.6, 0.0]},
    "guide_damping": {"added_n_s_per_m": 10.0},
    "command_delay": {"delay_s": [0.001, 0.002, 0.0]},
    "cogging": {"amplitude_mm": [0.01, 0.02, 0.0], "pitch_mm": 0.8},
    "torque_angle": {"amplitude_mm": 1.0},
    "frame_mode": {"mass_kg": 12.0, "frequency_hz": 18.0, "damping_ratio": 0.04, "direction": "both"},
    "gantry_racking": {"radius_mm": 150.0, "frequency_hz": 42.0, "damping_ratio": 0.05, "x_centre_mm": 60.0},
    "growing_bed": {"growth_per_m": [0.0, 2.0, 0.0]},
    "toolhead_mode": {"slope_per_m": 1.0, "curve_per_m2": 0.0, "x_centre_mm": 60.0},
}


FRICTIONS = {
    "stribeck_friction": {"force_n": 1.0, "extra_force_n": 0.5, "velocity_mm_per_s": 10.0},
    "coulomb_friction": {"force_n": 1.0},
}


@pytest.mark.parametrize(
    "tables",
    [
        *({name: table} for name, table in PROBES.items()),
        FRICTIONS,
        {"stribeck_friction": {**FRICTIONS["stribeck_friction"], "exponent": 1.2}},
        {name: PROBES[name] for name in ("frame_mode", "coulomb_friction", "growing_bed")},
        {name: PROBES[name] for name in ("gantry_racking", "toolhead_mode", "belt_backlash", "command_delay")},
        {"torque_angle": {"amplitude_mm": 1.0, "belt_share": 0.1}, "cogging": PROBES["cogging"]},
    ],
    ids="+".join,
)
def test_a_mode_that_takes_no_part_in_the_motion_changes_nothing(tables: dict[str, Any]) -> None:
    axes = (Axis([57.0], [0.07]), Axis([48.0], [0.07]), Axis())
    more = (Axis([40.0, 57.0], [0.05, 0.07], [0.0, 1.0]), *axes[1:])
    each = (machine(COREXY, each, **tables) for each in (axes, more))
    one, other = (simulate_printer(own, shaken(0.2), 1 / RATE_HZ, substeps=8) for own in each)
    for name in ("nozzle_mm", "carriage_mm", "motor_mm"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-7)
    np.testing.assert_allclose(one.nozzle_acceleration, other.nozzle_acceleration, atol=1e-6)
    np.testing.assert_allclose(one.carriage_acceleration, other.carriage_acceleration, atol=1e-6)
    np.testing.assert_allclose(one.state.values[:4], other.state.values[:4], atol=1e-9)
