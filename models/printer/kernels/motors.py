"""Evaluate the commands by their splines, the motors with their drives, and the belts' forces."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from models.arrays import FloatArray
from models.printer.kernels import record as r
from models.printer.kernels.record import LANES, ActiveEffects, Rows
from models.printer.kernels.vectors import at, compiled, inlined, sine_cosine


@compiled
def slopes(rises: FloatArray) -> FloatArray:
    """Compute the knots' slopes : (n + 1,) of a not-a-knot cubic spline over n even intervals, from their mean slopes.

    s_{i−1} + 4 s_i + s_{i+1} = 3 (r_{i−1} + r_i) makes the curvature continuous (de Boor, 1978, IV). At the ends, one
    cubic over two intervals: s₀ + 2 s₁ = (5 r₀ + r₁)/2, which turns the first equation to 2 s₁ + s₂ = (r₀ + 5 r₁)/2.
    """
    n, r = len(rises), rises
    if n < 3:  # a straight line, or a parabola
        curvature = 0.5 * (r[n - 1] - r[0])
        return np.linspace(r[0] - curvature, r[n - 1] + curvature, n + 1)
    s, upper = np.empty(n + 1), np.empty(n)
    upper[1], s[1] = 0.5, 0.25 * (r[0] + 5.0 * r[1])
    for i in range(2, n - 1):
        upper[i] = 1.0 / (4.0 - upper[i - 1])
        s[i] = (3.0 * (r[i - 1] + r[i]) - s[i - 1]) * upper[i]
    s[n - 1] = (0.5 * (5.0 * r[n - 2] + r[n - 1]) - s[n - 2]) / (2.0 - upper[n - 2])
    for i in range(n - 2, 0, -1):
        s[i] -= upper[i] * s[i + 1]
    s[0], s[n] = 0.5 * (5.0 * r[0] + r[1]) - 2.0 * s[1], 0.5 * (r[n - 2] + 5.0 * r[n - 1]) - 2.0 * s[n - 1]
    return s


@compiled
def cubic_spline(rows: FloatArray, dt: float) -> FloatArray:
    """Return the cubics : (n, 3, 4) of splines through rows : (n, 3), highest power first; the last is a line."""
    cubics = np.zeros((len(rows), 3, 4))
    for i in range(3):
        rises = (rows[1:, i] - rows[:-1, i]) / dt
        s = slopes(rises)
        for n in range(len(rows)):
            cubics[n, i, 2], cubics[n, i, 3] = s[n], rows[n, i]
        for n in range(len(rises)):
            cubics[n, i, 0] = (s[n] + s[n + 1] - 2.0 * rises[n]) / (dt * dt)
            cubics[n, i, 1] = (3.0 * rises[n] - 2.0 * s[n] - s[n + 1]) / dt
    return cubics


SHORTEST = 0.25  # times its length at q_c: no belt is taken to be shorter

HALLEY_STEPS = 2  # for a motor's angle: with 0.3 of the give in the belt, exact to 1e-13 up to the peak


@compiled
def command_times(m: FloatArray, dt: float, substeps: int) -> tuple[FloatArray, Rows]:
    """Tabulate the part of the command that each motor executes, its delay late, at every half step of a row.

    Returns
    -------
    (2 substeps + 1, 3 LANES) twice: the time since a row of the command, s, and how many rows back that row is.
    """
    elapsed, rows_back = np.empty((2 * substeps + 1, 3 * LANES)), np.zeros((2 * substeps + 1, 3 * LANES), np.int64)
    for half in range(2 * substeps + 1):
        for n in range(3 * LANES):
            t = 0.5 * half * (dt / substeps) - m[r.delay * LANES + n]
            while t < 0.0:
                t += dt
                rows_back[half, n] += 1
            elapsed[half, n] = t
    return elapsed, rows_back


class Commands(NamedTuple):
    """The commands of all lanes, and when the motors execute them."""

    cubics: FloatArray  # (n, 3, 4) cubics of each row and tower, m, highest power first
    ranges: Rows  # (k, 2) first cubic of each lane's command, and the one after its last
    elapsed: FloatArray  # from `command_times`
    rows_back: Rows


@compiled
def read_command(m: FloatArray, row: int, half: int, commands: Commands, has: ActiveEffects) -> None:
    """Evaluate the command at one half step of a row."""
    if half == 0 or has.delay:
        load_cubics(m, row, commands.rows_back[half], commands.cubics, commands.ranges)
    evaluate_command(m, commands.elapsed[half])
    if has.ripple:
        cogging(m)


@compiled
def load_cubics(m: FloatArray, row: int, rows_back: Rows, cubics: FloatArray, ranges: Rows) -> None:
    """Load the cubics that the motors execute in a row of the command. Before the first row, they rest."""
    for l in range(len(ranges)):
        for i in range(3):
            interval = ranges[l, 0] + row - rows_back[i * LANES + l]
            cubic = cubics[min(max(interval, ranges[l, 0]), ranges[l, 1] - 1), i]
            for power in range(4):
                m[(r.CUBIC + 3 * power + i) * LANES + l] = (
                    cubic[power] if interval >= ranges[l, 0] or power == 3 else 0.0
                )


@inlined
def command_at(m: FloatArray, n: int, t: float) -> tuple[float, float]:
    """Return one motor's command and its rate, t seconds after the beginning of its cubic."""
    a, b, c = at(m, r.CUBIC, n), at(m, r.CUBIC + 3, n), at(m, r.CUBIC + 6, n)
    return ((a * t + b) * t + c) * t + at(m, r.CUBIC + 9, n), (3.0 * a * t + 2.0 * b) * t + c


@compiled
def evaluate_command(m: FloatArray, elapsed: FloatArray) -> None:
    """Evaluate the command and its rate."""
    for n in range(3 * LANES):
        m[r.TIME * LANES + n] = elapsed[n]
    for n in range(3 * LANES):
        m[r.COMMAND * LANES + n], m[r.COMMAND_RATE * LANES + n] = command_at(m, n, at(m, r.TIME, n))


@compiled
def cogging(m: FloatArray) -> None:
    """Evaluate the ripple of the motors' positions, and its rate."""
    for n in range(3 * LANES):
        ripple = rippled(m, n, at(m, r.COMMAND, n), at(m, r.COMMAND_RATE, n))
        m[r.RIPPLE * LANES + n], m[r.RIPPLE_RATE * LANES + n] = ripple


@inlined
def rippled(m: FloatArray, n: int, command: float, rate: float) -> tuple[float, float]:
    """Return the ripple of one motor's position under a command, and its rate."""
    second = at(m, r.second_sine, n), at(m, r.second_cosine, n)
    return ripple(at(m, r.ripple, n), at(m, r.wave, n), at(m, r.phase, n), second[0], second[1], command, rate)


@inlined
def ripple(
    amplitude: float, wave: float, phase: float, up: float, down: float, command: float, rate: float
) -> tuple[float, float]:
    """Return a (sin θ + s₂ sin 2θ + c₂ cos 2θ), θ = wave u + φ, and its rate."""
    sine, cosine = sine_cosine(wave * command + phase)
    twice_sine, twice_cosine = 2.0 * sine * cosine, 1.0 - 2.0 * sine * sine
    slope = cosine + 2.0 * (up * twice_cosine - down * twice_sine)
    return amplitude * (sine + up * twice_sine + down * twice_cosine), amplitude * wave * slope * rate


@compiled
def motors(m: FloatArray) -> None:
    """Evaluate u, u̇, the drives' rates, and each belt's stretch, less its backlash and up to its peak-force stretch."""
    for n in range(3 * LANES):
        command, command_rate, v, vd = (
            at(m, r.COMMAND, n),
            at(m, r.COMMAND_RATE, n),
            at(m, r.NOW + r.V, n),
            at(m, r.NOW + r.VD, n),
        )
        lead, ideal = at(m, r.lead, n), at(m, r.ideal_drive, n) != 0.0
        vdd = at(m, r.d0, n) * (command - v) - at(m, r.d2, n) * vd
        u = (command if ideal else v + lead * vd) + at(m, r.RIPPLE, n)
        ud = (command_rate if ideal else vd + lead * vdd) + at(m, r.RIPPLE_RATE, n)
        stretch = effective_stretch(m, n, u - at(m, r.NOW + r.Q, n))
        m[r.MOTOR * LANES + n], m[r.MOTOR_RATE * LANES + n] = u, ud
        m[r.STRETCH * LANES + n], m[r.SPRING * LANES + n] = stretch, stretch
        m[(r.RATE + r.V) * LANES + n], m[(r.RATE + r.VD) * LANES + n] = vd, vdd


@inlined
def effective_stretch(m: FloatArray, n: int, stretch: float) -> float:
    """Return the effective stretch of a belt: less the backlash, and limited to the peak-force stretch."""
    return effective(stretch, at(m, r.half_backlash, n), at(m, r.peak_stretch, n))


@inlined
def effective(stretch: float, half_backlash: float, peak: float) -> float:
    """Return a stretch less the backlash, and limited to the peak-force stretch."""
    stretch -= min(max(stretch, -half_backlash), half_backlash)
    return min(max(stretch, -peak), peak)


@compiled
def torque_angle(m: FloatArray) -> None:
    """Replace the effective stretch s by a sin θ, s = a ((1 − b) θ + b sin θ): a stepper's torque, a belt in series."""
    for n in range(3 * LANES):
        m[r.SPRING * LANES + n] = torque(m, n, at(m, r.STRETCH, n))


@inlined
def torque(m: FloatArray, n: int, stretch: float) -> float:
    """Return a sin θ of one motor; the stretch itself without the effect."""
    inverse, share = at(m, r.inverse_amplitude, n), at(m, r.belt_share, n)
    electric = inverse * stretch
    angle = electric
    sine, cosine = sine_cosine(electric)
    for _ in range(HALLEY_STEPS):
        off, slope = (1.0 - share) * angle + share * sine - electric, 1.0 - share + share * cosine
        angle -= off / (slope + 0.5 * off * share * sine / slope)
        sine, cosine = sine_cosine(angle)
    return sine / inverse if inverse != 0.0 else stretch


@inlined
def stiffness_by_length(m: FloatArray, n: int, q: float) -> float:
    """Return k(q)/k of a belt, 1/(1 − r (q − q_c)): a force stretches all of its free length, and that goes with q."""
    return 1.0 / max(1.0 - at(m, r.slope, n) * (q - at(m, r.centre, n)), SHORTEST)


@inlined
def belt_force(
    k: float, c: float, spring: float, stretch: float, slip: float, landing: float, cubic: float, quintic: float
) -> float:
    """Return k s + k₃ s³ + k₅ s⁵ + (c + k λ |s|) ṡ; `spring` stands for s in its first part (a motor's a sin θ)."""
    squared = stretch * stretch
    force = k * spring + (cubic + quintic * squared) * stretch * squared
    return force + (c + k * abs(stretch) * landing) * slip


@inlined
def drive_of_axes(
    m: FloatArray, n: int, motor: float, q: float, stretch: float, spring: float, slip: float
) -> tuple[float, float]:
    """Return u + g(s) − s of a belt of straight axes, and its part of ẇ; both are those of q where it is slack."""
    k, over = at(m, r.uneven, n) + stiffness_by_length(m, n, q), 1.0 / at(m, r.motor_k, n)
    cubic, quintic = over * at(m, r.cubic, n), over * at(m, r.quintic, n)
    force = belt_force(k, 0.0, spring, stretch, slip, at(m, r.landing, n), cubic, quintic)
    slack = abs(motor - q) < at(m, r.half_backlash, n)
    return q + (0.0 if slack else force), 0.0 if slack else slip


@compiled
def belts(m: FloatArray) -> None:
    """Sum the forces on the carriages except the effector's: belt, viscous and dry friction, weight."""
    for n in range(3 * LANES):
        q, qd, stretch = at(m, r.NOW + r.Q, n), at(m, r.NOW + r.QD, n), at(m, r.STRETCH, n)
        k = at(m, r.belt_k, n) * stiffness_by_length(m, n, q)
        slip, landing = at(m, r.MOTOR_RATE, n) - qd, at(m, r.landing, n)
        cubic, quintic = at(m, r.cubic, n), at(m, r.quintic, n)
        belt = belt_force(k, at(m, r.belt_c, n), at(m, r.SPRING, n), stretch, slip, landing, cubic, quintic)
        belt = 0.0 if abs(at(m, r.MOTOR, n) - q) < at(m, r.half_backlash, n) else belt
        m[r.PULL * LANES + n] = belt - at(m, r.guide_b, n) * qd - at(m, r.GUIDES, n) - at(m, r.weight, n)
        m[(r.RATE + r.Q) * LANES + n] = qd
