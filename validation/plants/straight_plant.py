"""An independent printer with straight axes: masses, springs and dampers in place of modes, for tests of ours.

Every axis is a carriage of mass m₁ on its belts, and may carry a second mass m₂ on a spring, which is what the sensor
feels. The motors' belts pull with k (a CoreXY's two belts pull along x and y both). Friction is that of LuGre (Canudas
de Wit, Olsson, Åström & Lischinsky, 1995), a bristle and not a hyperbolic tangent; play has hard edges; a motor's
ripple has a third harmonic. A gantry may yaw about its middle under a toolhead whose place along x is not small, with
all terms of Lagrange's equations; the beam that carries the toolhead gives way in series with the belts of y, as a bar
on two supports does; a print makes the bed heavier. Equations, integration (Runge-Kutta of order 4 at 25.6 kHz) and
friction share nothing with `models/printer`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP_S = 1 / 25600
COREXY = np.array([[1.0, 1.0], [1.0, -1.0]])


@dataclass(frozen=True)
class Plant:
    """Two axes x and y, SI; lists are of axes or, of belts and motors, of A and B."""

    motors: tuple[tuple[float, float], tuple[float, float]] = ((1.0, 0.0), (0.0, 1.0))
    carriage_kg: tuple[float, float] = (0.4, 0.5)
    tool_kg: tuple[float, float] = (0.0, 0.0)
    belt_n_per_m: tuple[float, float] = (4e4, 3.2e4)  # of each belt
    mount_n_per_m: tuple[float, float] = (8e4, 8e4)
    guide_n_s_per_m: tuple[float, float] = (18.0, 18.0)
    belt_n_s_per_m: tuple[float, float] = (0.0, 0.0)  # of each belt, between its motor and the axes
    mount_n_s_per_m: tuple[float, float] = (2.0, 2.0)
    friction_n: tuple[float, float] = (0.0, 0.0)
    bristle_n_per_m: float = 4e5  # of LuGre's friction: in quick motion of little friction it must be softer
    play_m: tuple[float, float] = (0.0, 0.0)  # of each belt, the whole dead band
    hardening_n_per_m3: tuple[float, float] = (0.0, 0.0)
    ripple_m: tuple[float, float] = (0.0, 0.0)
    pitch_m: float = 0.8e-3
    delay_s: float = 0.0
    growth_per_m: float = 0.0  # of what moves along y, by the height of the print
    yaw_kg_m2: float = 0.0  # of the gantry about its middle, without the toolhead; zero: it cannot yaw
    yaw_hz: float = 40.0  # without the toolhead
    yaw_damping_ratio: float = 0.04
    yaw_arm_m: float = 0.0  # by which the force along x turns it
    head_kg: float = 0.0  # of what moves along y, what rides on the gantry
    middle_m: float = 0.1  # x of the middle of gantry and beam
    beam_slack: float = 0.0  # of the beam's middle, relative to that of the belts of y
    beam_m: float = 0.12  # half its length

    def axis_modes(self, axis: int) -> tuple[list[float], list[float], list[float]]:
        """Return frequencies, damping ratios and shares of one axis' felt mass under its motor, belts alike."""
        pull = np.array(self.motors)
        k1, m1, m2 = float(pull[:, axis] ** 2 @ self.belt_n_per_m), self.carriage_kg[axis], self.tool_kg[axis]
        held = self.guide_n_s_per_m[axis] + float(pull[:, axis] ** 2 @ self.belt_n_s_per_m)
        if m2 == 0.0:
            omega = np.sqrt(k1 / m1)
            return [float(omega / 2 / np.pi)], [float(held / (2 * m1 * omega))], [1.0]
        k2, mass = self.mount_n_per_m[axis], np.array([m1, m2])
        square, shape = np.linalg.eigh(np.array([[k1 + k2, -k2], [-k2, k2]]) / np.sqrt(np.outer(mass, mass)))
        shape = shape / np.sqrt(mass)[:, None]
        stretched = shape[0] - shape[1]
        damping = held * shape[0] ** 2 + self.mount_n_s_per_m[axis] * stretched**2
        omega = np.sqrt(square)
        share = k1 * shape[0] * shape[1] / square
        return (omega / 2 / np.pi).tolist(), (damping / 2 / omega).tolist(), share.tolist()


def simulate(plant: Plant, command_mm: Array, rate_hz: float, height_mm: float = 0.0) -> dict[str, Array]:
    """Play x and y (n, 2) mm from rest at a height; between rows the command is straight.

    Returns
    -------
    Positions (n, 2) mm and accelerations (n, 2) m/s² of what the sensors are on, at the rows.
    """
    substeps = round(1 / rate_hz / STEP_S)
    grown = 1.0 + plant.growth_per_m * height_mm / 1e3
    lists = (
        (plant.carriage_kg[0], plant.carriage_kg[1] * grown),
        plant.tool_kg,
        plant.belt_n_per_m,
        plant.mount_n_per_m,
        plant.guide_n_s_per_m,
        plant.mount_n_s_per_m,
        plant.friction_n,
        plant.play_m,
        plant.hardening_n_per_m3,
        plant.ripple_m,
        plant.belt_n_s_per_m,
    )
    numbers = np.array([plant.pitch_m, plant.delay_s, *_gantry(plant), plant.bristle_n_per_m])
    found = _play(command_mm / 1e3, 1 / rate_hz, substeps, np.array(plant.motors), np.array(lists), numbers)
    return {"position_mm": 1e3 * found[0], "acceleration_m_per_s2": found[1]}


def _gantry(plant: Plant) -> list[float]:
    """Return J, K and B of the yaw, its arm, the toolhead's mass, the middle, and the beam's slack and half length."""
    inertia, omega = plant.yaw_kg_m2, 2 * np.pi * plant.yaw_hz
    spring = [inertia, inertia * omega**2, 2 * plant.yaw_damping_ratio * omega * inertia]
    return [*spring, plant.yaw_arm_m, plant.head_kg, plant.middle_m, plant.beam_slack, plant.beam_m]


@njit(cache=True)
def _turned(motors: Array, axes: Array) -> Array:
    """Return how far the motors are for the axes, (2,): numba takes seconds to compile `@`."""
    return axes[0] * motors[:, 0] + axes[1] * motors[:, 1]


@njit(cache=True)
def _motors(t: float, command: Array, dt: float, motors: Array, p: Array, numbers: Array) -> Array:
    """Return where the motors are at t and how fast, (4,) m and m/s: late, and with their ripple."""
    at = min(max((t - numbers[1]) / dt, 0.0), len(command) - 1.0)
    row = min(int(at), len(command) - 2)
    step = command[row + 1] - command[row]
    u = np.empty(4)
    u[0:2] = _turned(motors, command[row] + (at - row) * step)
    moving = 1.0 if 0.0 < at < len(command) - 1.0 else 0.0
    u[2:4] = _turned(motors, step) * (moving / dt)
    for i in range(2):
        wave = 2 * np.pi / numbers[0]
        phase = wave * u[i]
        u[i] += p[9, i] * (np.sin(phase) + 0.1 * np.sin(3 * phase))
        u[2 + i] *= 1.0 + p[9, i] * wave * (np.cos(phase) + 0.3 * np.cos(3 * phase))
    return u


@njit(cache=True)
def _pulls(y: Array, u: Array, motors: Array, p: Array, numbers: Array) -> Array:
    """Return the belts' forces on the axes, (2,) N."""
    stretch, slip, pull = u[0:2] - _turned(motors, y[0:2]), u[2:4] - _turned(motors, y[2:4]), np.zeros(2)
    for i in range(2):
        s = stretch[i] - min(max(stretch[i], -p[7, i] / 2), p[7, i] / 2)
        pull[i] = p[2, i] * s + p[8, i] * s**3 + (p[10, i] * slip[i] if s != 0.0 else 0.0)
    force = pull[0] * motors[0] + pull[1] * motors[1]
    along = min(abs((y[0] - numbers[7]) / numbers[9]), 1.0)
    force[1] /= 1.0 + numbers[8] * (1.0 - along**2) ** 2
    return force


@njit(cache=True)
def _rate(y: Array, u: Array, motors: Array, p: Array, numbers: Array) -> Array:
    """Return d/dt of carriages, their rates, tools, their rates, bristles, yaw and its rate: (12,)."""
    q, v, tool, tool_v, bristle = y[0:2], y[2:4], y[4:6], y[6:8], y[8:10]
    force, rate = _pulls(y, u, motors, p, numbers), np.zeros(12)
    for a in range(2):
        rate[a], rate[4 + a] = v[a], tool_v[a]
        total = force[a] - p[4, a] * v[a]
        if p[6, a] > 0.0:
            slip = v[a] - numbers[10] * abs(v[a]) / p[6, a] * bristle[a]
            rate[8 + a] = slip
            total -= numbers[10] * bristle[a] + 1.0 * slip
        if p[1, a] > 0.0:
            mount = p[3, a] * (q[a] - tool[a]) + p[5, a] * (v[a] - tool_v[a])
            rate[6 + a] = mount / p[1, a]
            total -= mount
        rate[2 + a] = total / p[0, a]
        if p[1, a] == 0.0:
            rate[4 + a], rate[6 + a] = v[a], rate[2 + a]
    if numbers[2] > 0.0:
        _yaw(y, rate, force[0], p, numbers)
    return rate


@njit(cache=True)
def _yaw(y: Array, rate: Array, pulled: float, p: Array, numbers: Array) -> None:
    """Let the gantry turn: Lagrange's equations of its middle and its angle, with the toolhead at x from the middle."""
    inertia, stiffness, damping, arm, head, middle = numbers[2:8]
    x, mass = y[0] - middle, p[0, 1]
    swung = head * (2.0 * y[2] * y[11] + rate[2] * y[10])
    f = mass * rate[3] - swung
    torque = -stiffness * y[10] - damping * y[11] - x * swung + arm * pulled
    m11, m12, m22 = mass, head * x, inertia + head * x * x
    determinant = m11 * m22 - m12 * m12
    middle_rate, turn = (m22 * f - m12 * torque) / determinant, (m11 * torque - m12 * f) / determinant
    rate[3], rate[10], rate[11] = middle_rate, y[11], turn
    # what the sensor is on
    rate[5] = y[3] + x * y[11] + y[2] * y[10]
    rate[7] = middle_rate + x * turn + 2.0 * y[2] * y[11] + rate[2] * y[10]


@njit(cache=True)
def _play(command: Array, dt: float, substeps: int, motors: Array, p: Array, numbers: Array) -> tuple[Array, Array]:
    place, felt = np.empty((len(command), 2)), np.empty((len(command), 2))
    y, h = np.zeros(12), dt / substeps
    y[0:2] = command[0]
    y[4:6] = command[0]
    for n in range(len(command)):
        t = n * dt
        place[n] = y[4:6]
        felt[n] = _rate(y, _motors(t, command, dt, motors, p, numbers), motors, p, numbers)[6:8]
        for i in range(substeps):
            begin = t + i * h
            middle = _motors(begin + h / 2, command, dt, motors, p, numbers)
            k1 = _rate(y, _motors(begin, command, dt, motors, p, numbers), motors, p, numbers)
            k2 = _rate(y + h / 2 * k1, middle, motors, p, numbers)
            k3 = _rate(y + h / 2 * k2, middle, motors, p, numbers)
            k4 = _rate(y + h * k3, _motors(begin + h, command, dt, motors, p, numbers), motors, p, numbers)
            y += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return place, felt
