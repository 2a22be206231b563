"""The nonlinear printers, compiled. SI throughout; towers and carriages A, B, C; `printer.py` is the way in.

Up to LANES printers run side by side, each in a lane of the processor's vectors. What they hold stands in one array m:
m[row * LANES + l] is row `row` of lane l, and rows are constants, so that the compiler sees that nothing overlaps. The
loops over lanes have no branches: an effect does nothing where its numbers are zero. No lane feels its neighbours.

The unknowns are the carriages' heights q. With s_i the joint vector of arm i, h_i = −s_i·ẑ, and −h_i (s_j × s_k)/det S
the column of J = −S⁻¹ diag(h) (paper, Eq. 12) that is carriage i's,

    Ẍ = J (q̈ + w),   w_i = |Ẋ − ẑ q̇_i|²/h_i         (J̇ q̇ = J w; Eq. 13 with its sign put right)
    a = Ẍ + D d̈                                     the nozzle seen from the ground, d the frame's sway along D
    F = M₁ a + M₁ g ẑ − K η − B η̇ + joint friction   what the arms must give to the nozzle holder (Eqs. 50-55)
    m q̈ = belt(s, ṡ) − b q̇ − friction − m g − Γ F,   s = u − q (Eqs. 32, 44); Γ = Jᵀ, or rows J_iᵀ P_i (Eq. 25)
    η̈ = −a − g ẑ − (K η + B η̇)/m₂
    M_f (d̈ + 2 ζ ω ḋ + ω² d) = −Dᵀ F

d̈ is eliminated by hand: with μ = M₁/(M_f + M₁), R = I − μ D Dᵀ and ρ = 2 ζ ω ḋ + ω² d

    F = R (M₁ J (q̈ + w) + f₀) − M₁ (1 − μ) D ρ,   f₀ = M₁ g ẑ − K η − B η̇ + joint friction,

so three equations for q̈ remain. The drive (Eq. 34) is v̈ = d₀ (u_d − v) − d₂ v̇, u = v + (d₁/d₀) v̇.

Dry friction of force ℓ has a memory φ of how far it has been strained. With r = q̇/v₀,

    F = ℓ tanh(r + φ),   φ̇ = κ (r − |r| φ/φ_m − r² φ)/(1 + r²)

In quick motion φ vanishes and this is ℓ tanh(q̇/v₀), odd about the reversal. Below v₀ strain builds up over v₀/κ, ten
micrometres as in rolling guides, and then holds a carriage truly at rest under any load up to ℓ tanh φ_m. Steady
sliding, however slow, feels at least 0.93 ℓ. (Dahl's presliding, 1968, that lets go at speed.) It is smooth, and as
stiff as ℓ/v₀: `printer.py` sees to the step. With κ = 0 nothing ever holds: any load creeps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.arrays import FloatArray

LANES = 8  # numbers in a vector of 512 bits

# Every row is a numpy integer: a Python one is part of a type to numba, and each would be compiled for by itself.
# Parts of a state, three numbers each: drive, carriages, extruder against nozzle, frame (its last two idle),
# strain of the guides' and of the joints' dry friction.
V, VD, Q, QD, ETA, ETAD, D, DD, GUIDE, JOINT = np.arange(0, 30, 3)
STATES = 30

MOST_STRAIN = 3.0  # φ_m

PAGE = 64  # samples written at a time, or they would be strewn over too many places

REST_PASSES = 2000
REST_TOLERANCE_M = 1e-13

# The numbers of one printer.
NUMBERS = np.dtype(
    [
        ("towers", "f8", (3, 2)),  # m, DeltaKinematics.towers_mm
        ("arms_squared", "f8", 3),  # m²
        ("height", "f8"),  # m, joint plane above the nozzle tip
        ("to_plane", "f8", (2, 2)),  # 1/m, inverse of the joints B and C seen from A
        ("offset", "f8", 2),  # m², what is constant in the spheres' differences
        ("first_share", "f8", 3),  # σ₁ of straight axes, `models/vibration/modal.py`
        ("carriage_mass", "f8", 3),  # kg, m = m_c + m_f/2
        ("weight", "f8", 3),  # N, m g
        ("belt_k", "f8", 3),  # N/m
        ("belt_c", "f8", 3),  # N s/m
        ("guide_b", "f8", 3),  # N s/m
        ("ideal_drive", "f8", 3),  # 1: u = u_d
        ("d0", "f8", 3),  # 1/s²
        ("lead", "f8", 3),  # s, d1/d0
        ("d2", "f8", 3),  # 1/s
        ("shares", "f8", (3, 3, 3)),  # P_i of Eq. 25: arm, component of its force, component of the whole force
        ("holder_mass", "f8"),  # kg, M₁ = m_1 + 3 m_f/2
        ("extruder_mass", "f8"),  # kg, m_2
        ("mount_k", "f8", 3),  # N/m
        ("mount_b", "f8", 3),  # N s/m
        ("gravity", "f8"),  # m/s²
        # effects; zero, or what does nothing, where absent
        ("cubic", "f8", 3),  # N/m³, belt_hardening
        ("quintic", "f8", 3),  # N/m⁵
        # m, stretch at which a softening belt pulls its most, k + 3 k₃ s² + 5 k₅ s⁴ = 0: beyond, no more, no less
        ("give", "f8", 3),
        ("slope", "f8", 3),  # 1/m, belt_position_stiffness
        ("centre", "f8", 3),  # m
        ("half_play", "f8", 3),  # m, belt_backlash
        ("landing", "f8", 3),  # s/m, of its flanks
        ("bend", "f8", 3),  # 1/m, 1/a of torque_angle
        ("delay", "f8", 3),  # s, command_delay
        ("ripple", "f8", 3),  # m, cogging
        ("wave", "f8", 3),  # rad/m
        ("ahead", "f8", 3),  # rad, of the ripple
        ("second_sine", "f8", 3),  # of twice the wave, shares of the ripple
        ("second_cosine", "f8", 3),
        ("dry", "f8", 3),  # N, coulomb_friction and stribeck_friction
        ("sticking", "f8", 3),  # N, surplus at rest
        ("fading", "f8", 3),  # s/m, 1/v_s
        ("fading_power", "f8", 3),  # δ/2
        ("creep", "f8", 3),  # m/s, v₀ of the guides: wider where the run's step is too long for it
        ("hold", "f8", 3),  # 1/s, κ of the guides
        ("joint_dry", "f8"),  # N, joint_friction
        ("joint_creep", "f8"),  # m/s
        ("joint_hold", "f8"),  # 1/s
        ("least_inertia", "f8"),  # kg, that a force on one carriage moves, anywhere
        ("sway", "f8", (2, 2)),  # unit vectors along x and y, rows; frame_mode
        ("sway_share", "f8"),  # μ = M₁/(M_f + M₁)
        ("sway_k", "f8"),  # 1/s², ω²
        ("sway_b", "f8"),  # 1/s, 2 ζ ω
    ]
)
Numbers: TypeAlias = np.record
COUNT = NUMBERS.itemsize // 8

# The rows of m. Four states: at the step's beginning, where the rate is asked for, the rate, the sum of a step's rates.
BASE, NOW, RATE, SUM = np.arange(0, 4 * STATES, STATES)
# What the motors are told: time since each tower's cubic began, the cubics, highest power first, and their values.
TIME, CUBIC, TOLD, TOLD_RATE, RIPPLE, RIPPLE_RATE = np.array([120, 123, 135, 138, 141, 144])
# What one evaluation hands from loop to loop, A B C: m, m/s; a belt's stretch, m, and what of it pulls; ℓ, N; N; w.
MOTOR, MOTOR_RATE, STRETCH, SPRING, LEVEL, GUIDES, PULL, BENDING = np.arange(147, 171, 3)
# X Y Z: m, m/s; against the ground, m/s²; N; f₀, N. ρ of the frame's two directions, m/s². J, column by column.
X, XD, ACC, JOINTS, F0, RHO, J = np.arange(171, 192, 3)
# The printer's numbers, as `NUMBERS` has them.
PRINTER = 198
ROWS = PRINTER + COUNT


def _rows(*names: str) -> list[np.int64]:
    fields: Mapping[str, Any] = NUMBERS.fields or {}
    return [np.int64(PRINTER + fields[name][1] // 8) for name in names]


TOWERS, ARMS_SQUARED, HEIGHT, TO_PLANE, OFFSET = _rows("towers", "arms_squared", "height", "to_plane", "offset")
CARRIAGE_MASS, WEIGHT, BELT_K, BELT_C, GUIDE_B = _rows("carriage_mass", "weight", "belt_k", "belt_c", "guide_b")
IDEAL, D0, LEAD, D2, SHARES = _rows("ideal_drive", "d0", "lead", "d2", "shares")
(FIRST_SHARE,) = _rows("first_share")
HOLDER_MASS, EXTRUDER_MASS, MOUNT_K, MOUNT_B = _rows("holder_mass", "extruder_mass", "mount_k", "mount_b")
GRAVITY, HARDENING, QUINTIC, GIVE = _rows("gravity", "cubic", "quintic", "give")
SLOPE, CENTRE, HALF_PLAY, LANDING = _rows("slope", "centre", "half_play", "landing")
BEND, DELAY, COGGING, WAVE, AHEAD = _rows("bend", "delay", "ripple", "wave", "ahead")
SECOND_SINE, SECOND_COSINE = _rows("second_sine", "second_cosine")
DRY, STICKING, FADING, FADING_POWER = _rows("dry", "sticking", "fading", "fading_power")
CREEP, HOLD, JOINT_DRY, JOINT_CREEP, JOINT_HOLD = _rows("creep", "hold", "joint_dry", "joint_creep", "joint_hold")
SWAY, SWAY_SHARE, SWAY_K, SWAY_B = _rows("sway", "sway_share", "sway_k", "sway_b")

Vector: TypeAlias = tuple[float, float, float]
Row: TypeAlias = int | np.signedinteger
Rows: TypeAlias = NDArray[np.int64]

compiled = njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract"})
# What stands in a loop over lanes must be seen through, or the loop stays one of single numbers.
inlined = njit(error_model="numpy", nogil=True, fastmath={"contract"}, forceinline=True)


def table(printers: Sequence[Numbers]) -> FloatArray:
    """(k, COUNT): a printer a row."""
    return np.array(printers, NUMBERS).view(np.float64).reshape(len(printers), COUNT)


# --- Vectors


@inlined
def _at(m: FloatArray, row: Row, l: int) -> float:
    return m[row * LANES + l]


@inlined
def _three(m: FloatArray, row: Row, l: int) -> Vector:
    return m[row * LANES + l], m[(row + 1) * LANES + l], m[(row + 2) * LANES + l]


@inlined
def _put(m: FloatArray, row: Row, l: int, vector: Vector) -> None:
    m[row * LANES + l], m[(row + 1) * LANES + l], m[(row + 2) * LANES + l] = vector


@inlined
def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def _scaled(f: float, a: Vector) -> Vector:
    return f * a[0], f * a[1], f * a[2]


@inlined
def _plus(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def _mixed(r: Vector, a: Vector, b: Vector, c: Vector) -> Vector:
    """r₀ a + r₁ b + r₂ c: the matrix with columns a, b, c times r."""
    x, y, z = r
    return x * a[0] + y * b[0] + z * c[0], x * a[1] + y * b[1] + z * c[1], x * a[2] + y * b[2] + z * c[2]


@inlined
def _solved(a: Vector, b: Vector, c: Vector, r: Vector) -> Vector:
    """x of a·x = r₀, b·x = r₁, c·x = r₂."""
    bc = _cross(b, c)
    return _scaled(1.0 / _dot(a, bc), _mixed(r, bc, _cross(c, a), _cross(a, b)))


@inlined
def tanh(x: float) -> float:
    """To 1e-14 of it, without branches: a Padé fraction at x/32, then tanh 2a = 2 tanh a/(1 + tanh² a) five times."""
    a = min(max(x, -20.0), 20.0) / 32.0
    s = a * a
    n = a * (135135.0 + s * (17325.0 + s * (378.0 + s)))
    d = 135135.0 + s * (62370.0 + s * (3150.0 + s * 28.0))
    n, d = 2.0 * n * d, n * n + d * d
    n, d = 2.0 * n * d, n * n + d * d
    n, d = 2.0 * n * d, n * n + d * d
    n, d = 2.0 * n * d, n * n + d * d
    return 2.0 * n * d / (n * n + d * d)


# --- What the motors are told


@compiled
def slopes(rises: FloatArray) -> FloatArray:
    """(n + 1,) of the cubic spline over n even intervals, from the mean slope of each; not-a-knot at both ends.

    s_{i−1} + 4 s_i + s_{i+1} = 3 (r_{i−1} + r_i) makes the curvature continuous (de Boor, 1978, IV). At the ends, one
    cubic over two intervals: s₀ + 2 s₁ = (5 r₀ + r₁)/2, which turns the first equation to 2 s₁ + s₂ = (r₀ + 5 r₁)/2.
    """
    n, r = len(rises), rises
    if n < 3:  # a straight line, or a parabola
        bend = 0.5 * (r[n - 1] - r[0])
        return np.linspace(r[0] - bend, r[n - 1] + bend, n + 1)
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
def cubics(rows: FloatArray, dt: float) -> FloatArray:
    """(n, 3, 4): the pieces of splines through rows : (n, 3), highest power first, and a straight one at their end."""
    pieces = np.zeros((len(rows), 3, 4))
    for i in range(3):
        rises = (rows[1:, i] - rows[:-1, i]) / dt
        s = slopes(rises)
        for n in range(len(rows)):
            pieces[n, i, 2], pieces[n, i, 3] = s[n], rows[n, i]
        for n in range(len(rises)):
            pieces[n, i, 0] = (s[n] + s[n + 1] - 2.0 * rises[n]) / (dt * dt)
            pieces[n, i, 1] = (3.0 * rises[n] - 2.0 * s[n] - s[n + 1]) / dt
    return pieces


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


class Acting(NamedTuple):
    """What any lane has; where none has it, a loop is left out."""

    sticking: bool
    guides: bool
    joints: bool
    bending: bool
    ripple: bool
    delay: bool
    arms: bool


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
        t = _at(m, TIME, n)
        a, b, c = _at(m, CUBIC, n), _at(m, CUBIC + 3, n), _at(m, CUBIC + 6, n)
        m[TOLD * LANES + n] = ((a * t + b) * t + c) * t + _at(m, CUBIC + 9, n)
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
        told, told_rate, v, vd = _at(m, TOLD, n), _at(m, TOLD_RATE, n), _at(m, NOW + V, n), _at(m, NOW + VD, n)
        lead, ideal = _at(m, LEAD, n), _at(m, IDEAL, n) != 0.0
        vdd = _at(m, D0, n) * (told - v) - _at(m, D2, n) * vd
        u = (told if ideal else v + lead * vd) + _at(m, RIPPLE, n)
        ud = (told_rate if ideal else vd + lead * vdd) + _at(m, RIPPLE_RATE, n)
        stretch, half_play, give = u - _at(m, NOW + Q, n), _at(m, HALF_PLAY, n), _at(m, GIVE, n)
        stretch -= min(max(stretch, -half_play), half_play)
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


@inlined
def strain_rate(hold: float, ratio: float, speed: float, strain: float) -> float:
    """φ̇ along one direction: `hold` = κ, `ratio` = r along it, `speed` = |r|."""
    return hold * (ratio - (speed / MOST_STRAIN + speed * speed) * strain) / (1.0 + speed * speed)


@compiled
def fading(m: FloatArray) -> None:
    """ℓ with its surplus near rest, exp −|q̇/v_s|^δ; e to the −2x is (1 − tanh x)/(1 + tanh x)."""
    for n in range(3 * LANES):
        squared, power = (_at(m, NOW + QD, n) * _at(m, FADING, n)) ** 2, _at(m, FADING_POWER, n)
        m[LEVEL * LANES + n] = squared if power == 1.0 else squared**power
    for n in range(3 * LANES):
        faded = tanh(0.5 * _at(m, LEVEL, n))
        m[LEVEL * LANES + n] = _at(m, DRY, n) + _at(m, STICKING, n) * (1.0 - faded) / (1.0 + faded)


@compiled
def guide_friction(m: FloatArray) -> None:
    """Dry friction against the carriages, positive when they move up, and the rate of its strain."""
    for n in range(3 * LANES):
        ratio, strain = _at(m, NOW + QD, n) / _at(m, CREEP, n), _at(m, NOW + GUIDE, n)
        m[GUIDES * LANES + n] = _at(m, LEVEL, n) * tanh(ratio + strain)
        m[(RATE + GUIDE) * LANES + n] = strain_rate(_at(m, HOLD, n), ratio, abs(ratio), strain)


@compiled
def belts(m: FloatArray) -> None:
    """All forces on the carriages but the effector's: slack, hardening, the motors' sine, stiffness by height."""
    for n in range(3 * LANES):
        q, qd, stretch = _at(m, NOW + Q, n), _at(m, NOW + QD, n), _at(m, STRETCH, n)
        k = _at(m, BELT_K, n) * (1.0 + _at(m, SLOPE, n) * (q - _at(m, CENTRE, n)))
        squared = stretch * stretch
        harder = _at(m, HARDENING, n) + _at(m, QUINTIC, n) * squared
        spring = k * _at(m, SPRING, n) + harder * stretch * squared
        damping = _at(m, BELT_C, n) + k * abs(stretch) * _at(m, LANDING, n)
        belt = spring + damping * (_at(m, MOTOR_RATE, n) - qd)
        belt = 0.0 if abs(_at(m, MOTOR, n) - q) < _at(m, HALF_PLAY, n) else belt
        m[PULL * LANES + n] = belt - _at(m, GUIDE_B, n) * qd - _at(m, GUIDES, n) - _at(m, WEIGHT, n)
        m[(RATE + Q) * LANES + n] = qd


# --- Arms, effector, frame


@inlined
def _placed(m: FloatArray, l: int) -> Vector:
    """The nozzle of the carriages: `models.kinematics.delta.forward` for one point."""
    q = _three(m, NOW + Q, l)
    rise_b, rise_c = q[1] - q[0], q[2] - q[0]
    off_b, off_c = _at(m, OFFSET, l) + 0.5 * rise_b * rise_b, _at(m, OFFSET + 1, l) + 0.5 * rise_c * rise_c
    xb, xc, yb, yc = _at(m, TO_PLANE, l), _at(m, TO_PLANE + 1, l), _at(m, TO_PLANE + 2, l), _at(m, TO_PLANE + 3, l)
    ux, uy = xb * off_b + xc * off_c, yb * off_b + yc * off_c
    vx, vy = -(xb * rise_b + xc * rise_c), -(yb * rise_b + yc * rise_c)
    a, b = 1.0 + vx * vx + vy * vy, ux * vx + uy * vy
    drop = -(b + math.sqrt(b * b - a * (ux * ux + uy * uy - _at(m, ARMS_SQUARED, l)))) / a
    x, y = _at(m, TOWERS, l) + ux + vx * drop, _at(m, TOWERS + 1, l) + uy + vy * drop
    return x, y, q[0] - _at(m, HEIGHT, l) + drop


@inlined
def _arm(m: FloatArray, i: int, x: Vector, l: int) -> Vector:
    """s_i with the nozzle at x."""
    sx, sy = x[0] - _at(m, TOWERS + 2 * i, l), x[1] - _at(m, TOWERS + 2 * i + 1, l)
    return sx, sy, -math.sqrt(_at(m, ARMS_SQUARED + i, l) - sx * sx - sy * sy)


@compiled
def arms(m: FloatArray) -> None:
    """Where the nozzle is and how it moves, J, and w_i = |Ẋ − ẑ q̇_i|²/h_i."""
    for l in range(LANES):
        x, qd = _placed(m, l), _three(m, NOW + QD, l)
        a, b, c = _arm(m, 0, x, l), _arm(m, 1, x, l), _arm(m, 2, x, l)
        bc = _cross(b, c)
        over_det = 1.0 / _dot(a, bc)
        j_a, j_b = _scaled(a[2] * over_det, bc), _scaled(b[2] * over_det, _cross(c, a))
        j_c = _scaled(c[2] * over_det, _cross(a, b))
        xd = _mixed(qd, j_a, j_b, j_c)
        level = xd[0] * xd[0] + xd[1] * xd[1]
        sink_a, sink_b, sink_c = xd[2] - qd[0], xd[2] - qd[1], xd[2] - qd[2]
        w_a, w_b = -(level + sink_a * sink_a) / a[2], -(level + sink_b * sink_b) / b[2]
        _put(m, BENDING, l, (w_a, w_b, -(level + sink_c * sink_c) / c[2]))
        _put(m, J, l, j_a)
        _put(m, J + 3, l, j_b)
        _put(m, J + 6, l, j_c)
        _put(m, X, l, x)
        _put(m, XD, l, xd)


@compiled
def axes(m: FloatArray) -> None:
    """Straight axes by themselves, all of `rate` behind the motors: two oscillators each (`vibration/modal.py`)."""
    for l in range(LANES):
        for a in range(3):
            q, qd = _at(m, NOW + Q + a, l), _at(m, NOW + QD + a, l)
            eta, etad = _at(m, NOW + ETA + a, l), _at(m, NOW + ETAD + a, l)
            u, ud = _at(m, MOTOR + a, l), _at(m, MOTOR_RATE + a, l)
            share = _at(m, FIRST_SHARE + a, l)
            k, c, b = _at(m, BELT_K + a, l), _at(m, BELT_C + a, l), _at(m, GUIDE_B + a, l)
            p, pd = share * q - eta, share * qd - etad
            first = (k * (share * u - p) + c * (share * ud - pd) - b * pd) / _at(m, CARRIAGE_MASS + a, l)
            p, pd = (1.0 - share) * q + eta, (1.0 - share) * qd + etad
            second = _at(m, MOUNT_K + a, l) * ((1.0 - share) * u - p) - _at(m, MOUNT_B + a, l) * pd
            second /= _at(m, EXTRUDER_MASS, l)
            acceleration = first + second
            m[(RATE + Q + a) * LANES + l], m[(RATE + QD + a) * LANES + l] = qd, acceleration
            m[(RATE + ETA + a) * LANES + l] = etad
            m[(RATE + ETAD + a) * LANES + l] = share * second - (1.0 - share) * first
            m[(X + a) * LANES + l], m[(XD + a) * LANES + l], m[(ACC + a) * LANES + l] = q, qd, acceleration
            m[(PULL + a) * LANES + l] = k * (u - q)


@compiled
def joint_friction(m: FloatArray) -> None:
    """Dry friction against the nozzle holder, along its motion, and the rate of its strain."""
    for l in range(LANES):
        strain, hold = _three(m, NOW + JOINT, l), _at(m, JOINT_HOLD, l)
        ratio = _scaled(1.0 / _at(m, JOINT_CREEP, l), _three(m, XD, l))
        along, speed = _plus(ratio, strain), math.sqrt(_dot(ratio, ratio))
        size = math.sqrt(_dot(along, along))
        _put(m, JOINTS, l, _scaled(_at(m, JOINT_DRY, l) * tanh(size) / max(size, 1e-300), along))
        for a in range(3):
            m[(RATE + JOINT + a) * LANES + l] = strain_rate(hold, ratio[a], speed, strain[a])


@compiled
def holder(m: FloatArray) -> None:
    """f₀, ρ, and the extruder's own part of η̈."""
    for l in range(LANES):
        gravity, over = _at(m, GRAVITY, l), 1.0 / _at(m, EXTRUDER_MASS, l)
        for a in range(3):
            eta, etad = _at(m, NOW + ETA + a, l), _at(m, NOW + ETAD + a, l)
            mount = _at(m, MOUNT_K + a, l) * eta + _at(m, MOUNT_B + a, l) * etad
            m[(RATE + ETA + a) * LANES + l], m[(RATE + ETAD + a) * LANES + l] = etad, -over * mount
            m[(F0 + a) * LANES + l] = _at(m, JOINTS + a, l) - mount
            d, dd = _at(m, NOW + D + a, l), _at(m, NOW + DD + a, l)
            m[(RHO + a) * LANES + l], m[(RATE + D + a) * LANES + l] = _at(m, SWAY_K, l) * d + _at(m, SWAY_B, l) * dd, dd
        m[(RATE + ETAD + 2) * LANES + l] -= gravity
        m[(F0 + 2) * LANES + l] += _at(m, HOLDER_MASS, l) * gravity


@inlined
def _directions(m: FloatArray, l: int) -> tuple[Vector, Vector]:
    """The two columns of D."""
    return (_at(m, SWAY, l), _at(m, SWAY + 1, l), 0.0), (_at(m, SWAY + 2, l), _at(m, SWAY + 3, l), 0.0)


@inlined
def _swayed(m: FloatArray, vector: Vector, l: int) -> Vector:
    """R vector, R = I − μ D Dᵀ."""
    share, (d_a, d_b) = _at(m, SWAY_SHARE, l), _directions(m, l)
    return _mixed((1.0, -share * _dot(d_a, vector), -share * _dot(d_b, vector)), vector, d_a, d_b)


@inlined
def _felt(m: FloatArray, i: int, j_i: Vector, l: int) -> Vector:
    """Γ's row J_iᵀ P_i."""
    share = SHARES + 9 * i
    return _mixed(j_i, _three(m, share, l), _three(m, share + 3, l), _three(m, share + 6, l))


@inlined
def _load(m: FloatArray, l: int) -> Vector:
    """R (M₁ J w + f₀) − M₁ (1 − μ) D ρ."""
    mass, rho, (d_a, d_b) = _at(m, HOLDER_MASS, l), _three(m, RHO, l), _directions(m, l)
    bent = _mixed(_three(m, BENDING, l), _three(m, J, l), _three(m, J + 3, l), _three(m, J + 6, l))
    free = _swayed(m, _plus(_scaled(mass, bent), _three(m, F0, l)), l)
    still = -mass * (1.0 - _at(m, SWAY_SHARE, l))
    return _mixed((1.0, still * rho[0], still * rho[1]), free, d_a, d_b)


@compiled
def coupled(m: FloatArray) -> None:
    """Solve for q̈: (m I + Γ R M₁ J) q̈ = pull − Γ (R (M₁ J w + f₀) − M₁ (1 − μ) D ρ)."""
    for l in range(LANES):
        j_a, j_b, j_c = _three(m, J, l), _three(m, J + 3, l), _three(m, J + 6, l)
        mass, own, load = _at(m, HOLDER_MASS, l), _three(m, CARRIAGE_MASS, l), _load(m, l)
        a, b, c = _scaled(mass, j_a), _scaled(mass, j_b), _scaled(mass, j_c)
        a, b, c = _swayed(m, a, l), _swayed(m, b, l), _swayed(m, c, l)
        g_a, g_b, g_c = _felt(m, 0, j_a, l), _felt(m, 1, j_b, l), _felt(m, 2, j_c, l)
        pull = _plus(_three(m, PULL, l), (-_dot(g_a, load), -_dot(g_b, load), -_dot(g_c, load)))
        _put(m, PULL, l, pull)
        row_a = _dot(g_a, a) + own[0], _dot(g_a, b), _dot(g_a, c)
        row_b = _dot(g_b, a), _dot(g_b, b) + own[1], _dot(g_b, c)
        row_c = _dot(g_c, a), _dot(g_c, b), _dot(g_c, c) + own[2]
        _put(m, RATE + QD, l, _solved(row_a, row_b, row_c, pull))


@compiled
def followers(m: FloatArray) -> None:
    """What q̈ brings with it: a, and of frame and extruder d̈ = −(1 − μ) ρ − μ Dᵀ (Ẍ + f₀/M₁) and η̈."""
    for l in range(LANES):
        share, rho, (d_a, d_b) = _at(m, SWAY_SHARE, l), _three(m, RHO, l), _directions(m, l)
        speeding = _plus(_three(m, RATE + QD, l), _three(m, BENDING, l))
        acc = _mixed(speeding, _three(m, J, l), _three(m, J + 3, l), _three(m, J + 6, l))
        shake = _plus(acc, _scaled(1.0 / _at(m, HOLDER_MASS, l), _three(m, F0, l)))
        sway_a = -(1.0 - share) * rho[0] - share * _dot(d_a, shake)
        sway_b = -(1.0 - share) * rho[1] - share * _dot(d_b, shake)
        acc = _mixed((1.0, sway_a, sway_b), acc, d_a, d_b)
        _put(m, ACC, l, acc)
        _put(m, RATE + DD, l, (sway_a, sway_b, 0.0))
        _put(m, RATE + ETAD, l, _plus(_three(m, RATE + ETAD, l), _scaled(-1.0, acc)))


# --- All together


@compiled
def _any(m: FloatArray, row: Row, rows: int) -> bool:
    found = False
    for n in range(row * LANES, (row + rows) * LANES):
        found |= m[n] != 0.0
    return found


@compiled
def acting(m: FloatArray) -> Acting:
    sticking = _any(m, STICKING, 3)
    guides, joints = sticking or _any(m, DRY, 3), _any(m, JOINT_DRY, 1)
    return Acting(
        sticking, guides, joints, _any(m, BEND, 3), _any(m, COGGING, 3), _any(m, DELAY, 3), _any(m, ARMS_SQUARED, 3)
    )


@compiled
def rate(m: FloatArray, has: Acting) -> None:
    """The rows RATE = d/dt of NOW, as the motors are told; the nozzle's motion is kept."""
    motors(m)
    if has.bending:
        sines(m)
    if has.sticking:
        fading(m)
    if has.guides:
        guide_friction(m)
    if not has.arms:
        axes(m)
        return
    belts(m)
    arms(m)
    if has.joints:
        joint_friction(m)
    holder(m)
    coupled(m)
    followers(m)


@compiled
def laid_out(states: FloatArray, numbers: FloatArray) -> FloatArray:
    """m with these printers : (k, STATES) and (k, COUNT) in its first lanes. Idle lanes work on zeros and NaN."""
    m = np.zeros(ROWS * LANES)
    for l in range(len(states)):
        for n in range(STATES):
            m[(BASE + n) * LANES + l] = states[l, n]
            m[(NOW + n) * LANES + l] = states[l, n]
        for n in range(COUNT):
            m[(PRINTER + n) * LANES + l] = numbers[l, n]
    for n in range(3 * LANES):
        m[LEVEL * LANES + n] = m[DRY * LANES + n]
    return m


@compiled
def _lean(m: FloatArray, weight: float, by: float) -> None:
    """The rate counts so much in this step, and is followed so far to where it is asked for next."""
    for n in range(STATES * LANES):
        m[SUM * LANES + n] += weight * m[RATE * LANES + n]
        m[NOW * LANES + n] = m[BASE * LANES + n] + by * m[RATE * LANES + n]


@compiled
def _land(m: FloatArray, by: float) -> None:
    for n in range(STATES * LANES):
        y = m[BASE * LANES + n] + by * (m[SUM * LANES + n] + m[RATE * LANES + n])
        m[BASE * LANES + n], m[NOW * LANES + n], m[SUM * LANES + n] = y, y, 0.0


@compiled
def _step(m: FloatArray, row: int, half: int, h: float, said: Said, has: Acting) -> None:
    """Classical Runge-Kutta of order 4; the rate at a row's beginning is there already."""
    if half != 0:
        rate(m, has)
    _lean(m, 1.0, 0.5 * h)
    listen(m, row, half + 1, said, has)
    rate(m, has)
    _lean(m, 2.0, 0.5 * h)
    rate(m, has)
    _lean(m, 2.0, h)
    listen(m, row, half + 2, said, has)
    rate(m, has)
    _land(m, h / 6.0)


@compiled
def _note(m: FloatArray, note: FloatArray) -> None:
    """note : (7, 3 LANES), see `run`."""
    for n in range(3 * LANES):
        note[0, n], note[1, n], note[2, n] = _at(m, NOW + Q, n), _at(m, NOW + QD, n), _at(m, RATE + QD, n)
        note[3, n], note[4, n], note[5, n] = _at(m, X, n), _at(m, XD, n), _at(m, ACC, n)
        note[6, n] = _at(m, MOTOR, n)


@compiled
def _write_up(notes: FloatArray, first: int, rows: int, scale: FloatArray, samples: tuple[FloatArray, ...]) -> None:
    """The first of the notes : (PAGE, 7, 3 LANES), each quantity scaled, as samples : (k, n, 3) from row `first`."""
    for part, kept in enumerate(samples):
        for l in range(len(kept)):
            for n in range(rows):
                for i in range(3):
                    kept[l, first + n, i] = scale[part] * notes[n, part, i * LANES + l]


@compiled
def _blank(k: int, rows: int) -> tuple[FloatArray, ...]:
    """Arrays of their own, so that who keeps one does not keep them all."""
    size = (k, rows, 3)
    a, b, c, d = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    return a, b, c, d, np.empty(size), np.empty(size), np.empty(size)


@compiled
def _leave(m: FloatArray, l: int, states: FloatArray) -> None:
    """States : (k, STATES) of lane l."""
    for n in range(STATES):
        states[l, n] = _at(m, NOW + n, l)


@compiled
def run(
    states: FloatArray,
    numbers: FloatArray,
    pieces: FloatArray,
    spans: Rows,
    first: int,
    dt: float,
    substeps: int,
    scale: FloatArray,
) -> tuple[FloatArray, ...]:
    """Integrate k printers side by side, from row `first` of their commands to the last.

    Parameters
    ----------
    states : (k, STATES) SI, left as the last ones.
    numbers : (k, COUNT), from `table`.
    pieces, spans : see `Said`. A command's last piece is only begun.
    scale : (7,), what the results are multiplied by.

    Returns
    -------
    Seven of (k, rows of the longest, 3): carriages' and nozzle's position, velocity, acceleration, and the motors'
    positions at each row's beginning. What follows a command's last row means nothing.
    """
    m, rows = laid_out(states, numbers), spans[:, 1] - spans[:, 0] - first
    since, ago = late(m, dt, substeps)
    said, has = Said(pieces, spans, since, ago), acting(m)
    notes, samples = np.empty((PAGE, 7, 3 * LANES)), _blank(len(states), rows.max())
    for n in range(rows.max()):
        listen(m, first + n, 0, said, has)
        rate(m, has)
        _note(m, notes[n % PAGE])
        if n % PAGE == PAGE - 1 or n == rows.max() - 1:
            _write_up(notes, n - n % PAGE, n % PAGE + 1, scale, samples)
        for l in range(len(states)):
            if n == rows[l] - 1:
                _leave(m, l, states)
        for half in range(0, 2 * substeps, 2):
            _step(m, first + n, half, dt / substeps, said, has)
    return samples


@compiled
def _yield(m: FloatArray, l: int) -> float:
    """Every carriage gives way by what its forces leave over, divided by its belt's stiffness. The longest way, m."""
    moved = 0.0
    for i in range(3):
        above = _at(m, SLOPE + i, l) * (_at(m, NOW + Q + i, l) - _at(m, CENTRE + i, l))
        squared = _at(m, STRETCH + i, l) ** 2
        harder = (3.0 * _at(m, HARDENING + i, l) + 5.0 * _at(m, QUINTIC + i, l) * squared) * squared
        move = _at(m, PULL + i, l) / (_at(m, BELT_K + i, l) * (1.0 + max(above, 0.0)) + max(harder, 0.0))
        m[(NOW + Q + i) * LANES + l] += move
        if not abs(move) <= moved:  # NaN too
            moved = abs(move)
    return moved


@compiled
def rest(states: FloatArray, numbers: FloatArray) -> FloatArray:
    """From states : (k, STATES) with the drives at their command: let belts and extruder give way until all balance.

    Returns
    -------
    (k,) m, how far the last pass still moved a carriage.
    """
    m, moved = laid_out(states, numbers), np.full(len(states), np.inf)
    has = acting(m)
    for n in range(3 * LANES):
        m[TOLD * LANES + n] = m[(NOW + V) * LANES + n]
    cogging(m)
    for l in range(len(states)):
        m[(NOW + ETA + 2) * LANES + l] = -_at(m, EXTRUDER_MASS, l) * _at(m, GRAVITY, l) / _at(m, MOUNT_K + 2, l)
    for _ in range(REST_PASSES):
        rate(m, has)
        for l in range(len(states)):
            if not moved[l] < REST_TOLERANCE_M:
                moved[l] = _yield(m, l)
        if moved.max() < REST_TOLERANCE_M:
            break
    for l in range(len(states)):
        _leave(m, l, states)
    return moved
