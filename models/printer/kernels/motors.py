"""Commands, motors, drives and belts."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from models.arrays import FloatArray
from models.printer.kernels.jit import compiled
from models.printer.kernels.record import (
    CUBIC,
    GUIDES,
    LANES,
    MOTOR,
    MOTOR_RATE,
    NOW,
    PULL,
    QD,
    RATE,
    RIPPLE,
    RIPPLE_RATE,
    SPRING,
    STRETCH,
    TIME,
    TOLD,
    TOLD_RATE,
    VD,
    Acting,
    Q,
    Rows,
    V,
    parameter_rows,
)
from models.printer.kernels.vectors import at

WEIGHT, BELT_K, BELT_C, GUIDE_B = parameter_rows("weight", "belt_k", "belt_c", "guide_b")
IDEAL, D0, LEAD, D2 = parameter_rows("ideal_drive", "d0", "lead", "d2")
HARDENING, QUINTIC, GIVE = parameter_rows("cubic", "quintic", "give")
SLOPE, CENTRE, HALF_BACKLASH, LANDING = parameter_rows("slope", "centre", "half_backlash", "landing")
BEND, DELAY, COGGING, WAVE, AHEAD = parameter_rows("bend", "delay", "ripple", "wave", "ahead")
SECOND_SINE, SECOND_COSINE = parameter_rows("second_sine", "second_cosine")


@compiled
def late(m: FloatArray, dt: float, substeps: int) -> tuple[FloatArray, Rows]:
    """What each motor hears at every half of a step of a row, its `delay` after it was said.

    Returns
    -------
    (2 substeps + 1, 3 LANES): the time since a row of the command, s, and how many rows ago that one was.
    """
    since, ago = np.empty((2 * substeps + 1, 3 * LANES)), np.zeros((2 * substeps + 1, 3 * LANES), np.int64)
    for half in range(2 * substeps + 1):
        for n in range(3 * LANES):
            t = 0.5 * half * (dt / substeps) - m[DELAY * LANES + n]
            while t < 0.0:
                t += dt
                ago[half, n] += 1
            since[half, n] = t
    return since, ago


class Said(NamedTuple):
    """All commands, and when they are heard."""

    pieces: FloatArray  # (n, 3, 4) cubics of each row and tower, m, highest power first
    spans: Rows  # (k, 2) the pieces where each command begins and ends
    since: FloatArray  # from `late`
    ago: Rows


@compiled
def listen(m: FloatArray, row: int, half: int, said: Said, has: Acting) -> None:
    """What the motors are told at one half of a step of a row."""
    if half == 0 or has.delay:
        fetch(m, row, said.ago[half], said.pieces, said.spans)
    tell(m, said.since[half])
    if has.ripple:
        cogging(m)


@compiled
def fetch(m: FloatArray, row: int, ago: Rows, pieces: FloatArray, spans: Rows) -> None:
    """The cubics that the motors hear in a row of the command. Before the first row, they rest."""
    for l in range(len(spans)):
        for i in range(3):
            own = spans[l, 0] + row - ago[i * LANES + l]
            piece = pieces[min(max(own, spans[l, 0]), spans[l, 1] - 1), i]
            for power in range(4):
                m[(CUBIC + 3 * power + i) * LANES + l] = piece[power] if own >= spans[l, 0] or power == 3 else 0.0


@compiled
def tell(m: FloatArray, since: FloatArray) -> None:
    """The command and its rate."""
    for n in range(3 * LANES):
        m[TIME * LANES + n] = since[n]
    for n in range(3 * LANES):
        t = at(m, TIME, n)
        a, b, c = at(m, CUBIC, n), at(m, CUBIC + 3, n), at(m, CUBIC + 6, n)
        m[TOLD * LANES + n] = ((a * t + b) * t + c) * t + at(m, CUBIC + 9, n)
        m[TOLD_RATE * LANES + n] = (3.0 * a * t + 2.0 * b) * t + c


@compiled
def cogging(m: FloatArray) -> None:
    """The ripple of the motors' positions, and its rate."""
    for n in range(3 * LANES):
        amplitude, wave = m[COGGING * LANES + n], m[WAVE * LANES + n]
        if amplitude != 0.0:
            phase = wave * m[TOLD * LANES + n] + m[AHEAD * LANES + n]
            sine, cosine = math.sin(phase), math.cos(phase)
            up, down = m[SECOND_SINE * LANES + n], m[SECOND_COSINE * LANES + n]
            twice_sine, twice_cosine = 2.0 * sine * cosine, 1.0 - 2.0 * sine * sine
            m[RIPPLE * LANES + n] = amplitude * (sine + up * twice_sine + down * twice_cosine)
            slope = cosine + 2.0 * (up * twice_cosine - down * twice_sine)
            m[RIPPLE_RATE * LANES + n] = amplitude * wave * slope * m[TOLD_RATE * LANES + n]


@compiled
def motors(m: FloatArray) -> None:
    """u, u̇, the drives' own rates, and each belt's stretch: without its slack, and up to its give."""
    for n in range(3 * LANES):
        told, told_rate, v, vd = at(m, TOLD, n), at(m, TOLD_RATE, n), at(m, NOW + V, n), at(m, NOW + VD, n)
        lead, ideal = at(m, LEAD, n), at(m, IDEAL, n) != 0.0
        vdd = at(m, D0, n) * (told - v) - at(m, D2, n) * vd
        u = (told if ideal else v + lead * vd) + at(m, RIPPLE, n)
        ud = (told_rate if ideal else vd + lead * vdd) + at(m, RIPPLE_RATE, n)
        stretch, half_backlash, give = u - at(m, NOW + Q, n), at(m, HALF_BACKLASH, n), at(m, GIVE, n)
        stretch -= min(max(stretch, -half_backlash), half_backlash)
        stretch = min(max(stretch, -give), give)
        m[MOTOR * LANES + n], m[MOTOR_RATE * LANES + n] = u, ud
        m[STRETCH * LANES + n], m[SPRING * LANES + n] = stretch, stretch
        m[(RATE + V) * LANES + n], m[(RATE + VD) * LANES + n] = vd, vdd


@compiled
def sines(m: FloatArray) -> None:
    """A motor pulls with the sine of its angle."""
    for n in range(3 * LANES):
        bend = m[BEND * LANES + n]
        if bend != 0.0:
            m[SPRING * LANES + n] = math.sin(bend * m[STRETCH * LANES + n]) / bend


@compiled
def belts(m: FloatArray) -> None:
    """All forces on the carriages but the effector's: slack, hardening, the motors' sine, stiffness by height."""
    for n in range(3 * LANES):
        q, qd, stretch = at(m, NOW + Q, n), at(m, NOW + QD, n), at(m, STRETCH, n)
        k = at(m, BELT_K, n) * (1.0 + at(m, SLOPE, n) * (q - at(m, CENTRE, n)))
        squared = stretch * stretch
        harder = at(m, HARDENING, n) + at(m, QUINTIC, n) * squared
        spring = k * at(m, SPRING, n) + harder * stretch * squared
        damping = at(m, BELT_C, n) + k * abs(stretch) * at(m, LANDING, n)
        belt = spring + damping * (at(m, MOTOR_RATE, n) - qd)
        belt = 0.0 if abs(at(m, MOTOR, n) - q) < at(m, HALF_BACKLASH, n) else belt
        m[PULL * LANES + n] = belt - at(m, GUIDE_B, n) * qd - at(m, GUIDES, n) - at(m, WEIGHT, n)
        m[(RATE + Q) * LANES + n] = qd
