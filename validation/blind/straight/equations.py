"""A printer with straight axes that hides something: masses, springs and dampers, no modes.

The motors stand at u = T c for commands c = (x, y); T is one for a bed slinger, and x + y, x − y for a CoreXY. Each
axis a is a carriage m₁ at q, dragged by the belts, and may carry a tool m₂ at p on a mount; sensors are on the tool, or
on the carriage where there is none. The frame swings by d along unit vectors D, seen from the ground:

    m₁ (q̈ + D d̈) = Tᵀ F − guide − g₁ q̇ + mount,   m₂ (p̈ + D d̈) = −mount − g₂ ṗ − (what hangs on the tool)
    M_f d̈ = −k_f d − c_f ḋ − Dᵀ (all that the frame does to the masses)

The beam that carries the toolhead may give way in series with the belts of y, as a bar on two supports does. A gantry
of inertia J may yaw by θ about its middle under a head of mass m_h at ξ from there, M all that moves along y; then the
head is at y + ξ θ, and with N = 2 ξ̇ θ̇ + ξ̈ θ and F what acts along the axes

    M ÿ + m_h (ξ θ̈ + N) = F_y,   (J + m_h (1 − m_h/M) ξ²) θ̈ = −k θ − c θ̇ + a F_x − m_h ξ (F_y/M + (1 − m_h/M) N)

A command's row i holds at t = i h/2; classical Runge-Kutta, bristles by an exponential step of their own. SI; the
fields of a printer are explained in `numbers`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from validation.blind.printer.real import FloatArray
from validation.blind.printer.shapes import DAHL, belt, bent, guide

# where the parts of a state begin
Q, V, TOOL, TOOLV, SWAY, SWAYV, CABLE, CABLEV, MOUNT, MOUNTV, ARM, LOOSE = 0, 2, 4, 6, 8, 10, 12, 14, 16, 17, 18, 20
YAW, ROTOR, ROTORV, STATES = 22, 24, 26, 28
SLIDES_M_PER_S = 2e-3


@njit(cache=True, error_model="numpy")
def _motor(y: FloatArray, ud: FloatArray, dud: FloatArray, i: int, p: Any) -> tuple[float, float]:
    """(u, u̇) of motor i: its order, its ripple, and a bracket that gives way."""
    u, du = ud[i], dud[i]
    if p.ripple[i] != 0.0:
        w = p.ripple_wave[i]
        first, second = w * ud[i], 2.0 * w * ud[i] + p.ripple_phase
        u += p.ripple[i] * (np.sin(first) + p.ripple_second * np.sin(second))
        du += p.ripple[i] * w * dud[i] * (np.cos(first) + 2.0 * p.ripple_second * np.cos(second))
    if i == p.soft_motor:
        u, du = u + y[MOUNT], du + y[MOUNTV]
    return u, du


@njit(cache=True, error_model="numpy")
def _held(y: FloatArray, a: int, p: Any) -> float:
    """Force of the mount on the carriage of axis a, N; beyond a gap it meets a stop."""
    bent = y[TOOL + a] - y[Q + a]
    force = p.mount_k[a] * bent + p.mount_b[a] * (y[TOOLV + a] - y[V + a])
    if p.stop_k > 0.0:
        force += p.stop_k * (max(bent - p.stop_gap, 0.0) + min(bent + p.stop_gap, 0.0))
    return force


@njit(cache=True, error_model="numpy")
def _rate(
    y: FloatArray, z: FloatArray, t: float, ud: FloatArray, dud: FloatArray, p: Any, w: FloatArray, dy: FloatArray
) -> None:
    """Dy = d(state)/dt. z : (2,) bristles of the guides. w : (3, 2) leaves as the accelerations that sensors feel."""
    driven, frame, felt = w[0], w[1], w[2]
    driven[:] = 0.0
    for i in range(2):
        u, du = _motor(y, ud, dud, i, p)
        q = p.turn[i, 0] * y[Q] + p.turn[i, 1] * y[Q + 1]
        dq = p.turn[i, 0] * y[V] + p.turn[i, 1] * y[V + 1]
        sent, turning = u, du
        if p.rotor[i] > 0.0:
            u, du = y[ROTOR + i], y[ROTORV + i]
        pull = belt(u - q, du - dq, q, ud[i], y[ARM + i], t, i, p)
        if p.rotor[i] > 0.0:
            dy[ROTOR + i] = du
            dy[ROTORV + i] = (p.rotor_k[i] * (sent - u) + p.rotor_b[i] * (turning - du) - pull) / p.rotor[i]
        dy[ARM + i] = (u - q - y[ARM + i]) / p.visco_s if p.visco_k[i] > 0.0 else 0.0
        if i == p.soft_motor:
            dy[MOUNT] = y[MOUNTV]
            dy[MOUNTV] = -(pull + p.soft_k * y[MOUNT] + p.soft_b * y[MOUNTV]) / p.soft_mass
        driven[0] += p.turn[i, 0] * pull
        driven[1] += p.turn[i, 1] * pull
    if p.beam > 0.0:
        aside = (y[Q] - p.beam_at) / p.beam_half
        driven[1] *= (1.0 + p.beam) / (1.0 + p.beam * (1.0 - aside * aside) ** 2)
    for a in range(2):
        on_carriage = driven[a] - guide(y[V + a], y[Q + a], z[a], a, p) - p.ground[a] * y[V + a]
        dragged = 0.0
        if p.loose[a] > 0.0:  # a load that slides, its grip softened below some mm/s
            dragged = p.loose_grip * np.tanh((y[V + a] - y[LOOSE + a]) / SLIDES_M_PER_S)
        dy[LOOSE + a] = dragged
        dragged *= p.loose[a]
        hang = p.cable_k * y[CABLE + a] + p.cable_b * y[CABLEV + a]
        on_tool = -p.tool_ground[a] * y[TOOLV + a]
        frame[a] = on_carriage + on_tool
        dy[Q + a], dy[TOOL + a] = y[V + a], y[TOOLV + a]
        if p.tool[a] > 0.0:
            mount = _held(y, a, p)
            dy[V + a] = (on_carriage - dragged + mount) / (p.carriage[a] - p.loose[a])
            dy[TOOLV + a] = (on_tool - mount + hang) / p.tool[a]
        else:
            dy[V + a] = dy[TOOLV + a] = (on_carriage - dragged + hang) / (p.carriage[a] - p.loose[a])
    turned = _yaw(y, p, frame, dy)
    _swing(y, p, frame, dy)
    for a in range(2):
        shaken = p.sway_dir[0, a] * dy[SWAYV] + p.sway_dir[1, a] * dy[SWAYV + 1]
        felt[a] = dy[TOOLV + a] + a * turned
        dy[V + a] -= shaken
        dy[TOOLV + a] -= shaken
        hang = p.cable_k * y[CABLE + a] + p.cable_b * y[CABLEV + a]
        dy[CABLE + a], dy[CABLEV + a] = y[CABLEV + a], -felt[a] - hang / p.cable_mass


@njit(cache=True, error_model="numpy")
def _yaw(y: FloatArray, p: Any, frame: FloatArray, dy: FloatArray) -> float:
    """Turn the gantry under its head; returns by how much more than the gantry's middle the head accelerates."""
    dy[YAW] = dy[YAW + 1] = 0.0
    if p.yaw == 0.0:
        return 0.0
    aside, share = y[Q] - p.yaw_at, p.head / (p.carriage[1] + p.tool[1])
    moved = 2.0 * y[V] * y[YAW + 1] + dy[V] * y[YAW]
    torque = p.yaw_arm * frame[0] - p.yaw_k * y[YAW] - p.yaw_b * y[YAW + 1]
    torque -= p.head * aside * (dy[V + 1] + (1.0 - share) * moved)
    dy[YAW], dy[YAW + 1] = y[YAW + 1], torque / (p.yaw + p.head * (1.0 - share) * aside * aside)
    turned = aside * dy[YAW + 1] + moved
    dy[V + 1] -= share * turned
    dy[TOOLV + 1] -= share * turned
    return float(turned)


@njit(cache=True, error_model="numpy")
def _swing(y: FloatArray, p: Any, frame: FloatArray, dy: FloatArray) -> None:
    """Evaluate the frame's two ways to swing, against what it does to the masses."""
    for n in range(2):
        force = p.sway_dir[n, 0] * frame[0] + p.sway_dir[n, 1] * frame[1]
        dy[SWAY + n] = y[SWAYV + n]
        dy[SWAYV + n] = -(p.sway_k[n] * y[SWAY + n] + p.sway_b[n] * y[SWAYV + n] + force) / p.sway_mass[n]


@njit(cache=True, error_model="numpy")
def _bristles(y: FloatArray, z: FloatArray, span: float, p: Any, out: FloatArray) -> None:
    """Every bristle after `span`, its slider going on at the same speed."""
    for a in range(2):
        out[a] = bent(z[a], y[V + a], span, p)


@njit(cache=True, error_model="numpy")
def run(command: FloatArray, speed: FloatArray, h: float, every: int, p: Any) -> FloatArray:
    """Play what the motors are ordered, (2 n + 1, 2) m and m/s at half steps, from rest.

    Returns (n // every + 1, 2, 2): positions in m and accelerations in m/s² of what the sensors are on.
    """
    steps = (len(command) - 1) // 2
    out = np.empty((steps // every + 1, 2, 2))
    y, w, z, half, full = np.zeros(STATES), np.zeros((3, 2)), np.zeros(2), np.zeros(2), np.zeros(2)
    k1, k2, k3, k4 = np.zeros(STATES), np.zeros(STATES), np.zeros(STATES), np.zeros(STATES)
    a, b, c, d = (
        p.turn[0, 0],
        p.turn[0, 1],
        p.turn[1, 0],
        p.turn[1, 1],
    )  # numba takes five seconds to compile `np.linalg.solve`
    y[Q] = (d * command[0, 0] - b * command[0, 1]) / (a * d - b * c)
    y[Q + 1] = (a * command[0, 1] - c * command[0, 0]) / (a * d - b * c)
    y[TOOL : TOOL + 2] = y[Q : Q + 2]
    y[ROTOR : ROTOR + 2] = command[0]
    for n in range(steps + 1):
        b, t = 2 * n, n * h
        _rate(y, z, t, command[b], speed[b], p, w, k1)
        if n % every == 0:
            out[n // every, 0], out[n // every, 1] = y[TOOL : TOOL + 2], w[2]
            out[n // every, 0, 1] += (y[Q] - p.yaw_at) * y[YAW]
        if n == steps:
            break
        if p.dry_kind >= DAHL:
            _bristles(y + h / 2 * k1, z, h / 2, p, half)
            _bristles(y + h / 2 * k1, z, h, p, full)
        _rate(y + h / 2 * k1, half, t + h / 2, command[b + 1], speed[b + 1], p, w, k2)
        _rate(y + h / 2 * k2, half, t + h / 2, command[b + 1], speed[b + 1], p, w, k3)
        _rate(y + h * k3, full, t + h, command[b + 2], speed[b + 2], p, w, k4)
        y += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        z[:] = full
    return out
