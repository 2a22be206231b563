"""The independent printer with straight axes, and an axis by itself: masses, springs and dampers in place of modes.

It shares nothing with `models`. The motors stand at u = T c for commands c = (x, y); T is one for a bed slinger, and x
+ y, x − y for a CoreXY. Each axis a is a carriage m₁ at q, dragged by the belts, and may carry a tool m₂ at p on a
mount; sensors are on the tool, or on the carriage where there is none. The frame swings by d along unit vectors D,
seen from the ground:

    m₁ (q̈ + D d̈) = Tᵀ F − guide − g₁ q̇ + mount,   m₂ (p̈ + D d̈) = −mount − g₂ ṗ − (what hangs on the tool)
    M_f d̈ = −k_f d − c_f ḋ − Dᵀ (all that the frame does to the masses)

The beam that carries the toolhead may give way in series with the belts of y, as a bar on two supports does. A gantry
of inertia J may yaw by θ about its middle under a head of mass m_h at ξ from there, M all that moves along y; then the
head is at y + ξ θ, and with N = 2 ξ̇ θ̇ + ξ̈ θ and F what acts along the axes

    M ÿ + m_h (ξ θ̈ + N) = F_y,   (J + m_h (1 − m_h/M) ξ²) θ̈ = −k θ − c θ̇ + a F_x − m_h ξ (F_y/M + (1 − m_h/M) N)

Belts and guides are those of `shapes`. A command's row i holds at t = i h/2; classical Runge-Kutta, bristles by an
exponential step of their own. SI. `Plant` has the numbers of a printer of ours for `simulate`; the blind benchmark
sets any field of PRINTER.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from validation.plants import shapes
from validation.plants.shapes import BELTS, DAHL, GUIDES, LUGRE, SHAPED, bent, driven, guide, record_of, rippled

Array = NDArray[np.float64]

STEP_S = 1 / 25600
CHUNK_STEPS = 40_000
COREXY = np.array([[1.0, 1.0], [1.0, -1.0]])
SLIDES_M_PER_S = 2e-3  # speed below which the grip of a loose load is softer
# where the parts of a state begin; bristles last
Q, V, TOOL, TOOLV, SWAY, SWAYV, CABLE, CABLEV, MOUNT, ARM, LOOSE = 0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20
YAW, ROTOR, ROTORV, BRISTLE, STATES = 22, 24, 26, 28, 30
MOTORS = (ROTOR, ROTORV, MOUNT, ARM)
EACH = f"""{BELTS} {GUIDES}
    carriage tool ground tool_ground mount_k mount_b sway_mass sway_k sway_b loose
"""
ONE = f"""{SHAPED}
    cable_mass cable_k cable_b loose_grip beam beam_gain beam_at beam_half yaw yaw_k yaw_b yaw_at
    yaw_arm yaw_grip head
"""
PRINTER = np.dtype(
    [
        *((name, "f8", 2) for name in EACH.split()),  # of axes x, y, or of motors A, B
        *((name, "f8") for name in ONE.split()),
        ("turn", "f8", (2, 2)),  # from axes to motors
        ("sway_dir", "f8", (2, 2)),
        ("dry_kind", "i8"),  # 0 none, else of `shapes`
        ("soft_motor", "i8"),  # -1 for none
    ]
)
# beam_gain: stiffness of the whole beam over what `belt_k` states; yaw_grip: share of the guide's force in a F_x
_ONES = dict.fromkeys(("sway_mass", "cable_mass", "beam_gain", "beam_half", "yaw_grip"), 1.0)
NEUTRAL: Mapping[str, Any] = {**shapes.NEUTRAL, **_ONES}


def turn_of(kind: str) -> Array:
    """Return how motors move, (2, 2), of the axes' moves."""
    return COREXY if kind == "corexy" else np.eye(2)


def printer_of(machine: Mapping[str, Any], hidden: Mapping[str, Any]) -> Any:
    """Return the tables of a hidden printer as numbers, with fields of PRINTER set by what is hidden."""
    turn = turn_of(machine["kinematics"]["type"])
    return record_of(PRINTER, {**NEUTRAL, **machine["plant"], "turn": turn, **hidden})


def modes_of(plant: Mapping[str, Any], turn: Array, axis: int) -> dict[str, list[float]]:
    """Return frequencies, damping ratios and shares of an axis, as a machine file has them, by its masses and springs.

    The modes are those of the undamped axis. `belt_damping_share` is of the first mode.
    """
    pull = turn[:, axis] ** 2
    stiffness, tool = float(pull @ plant["belt_k"]), plant["tool"][axis]
    belts = float(pull @ plant.get("belt_c", np.zeros(2)))
    held = plant["guide_b"][axis] + plant["ground"][axis] + belts
    if tool == 0.0:
        mass, stiff, damp = np.array([plant["carriage"][axis]]), np.array([[stiffness]]), np.array([[held]])
    else:
        mount, damper = plant["mount_k"][axis], plant["mount_b"][axis]
        mass = np.array([plant["carriage"][axis], tool])
        stiff = np.array([[stiffness + mount, -mount], [-mount, mount]])
        damp = damper * np.array([[1.0, -1.0], [-1.0, 1.0]]) + np.diag([held, plant["tool_ground"][axis]])
    square, shape = np.linalg.eigh(stiff / np.sqrt(np.outer(mass, mass)))
    shape = shape / np.sqrt(mass)[:, None]
    omega = np.sqrt(square)
    ratio = np.einsum("im,ij,jm->m", shape, damp, shape) / (2 * omega)
    return {
        "frequency_hz": (omega / (2 * np.pi)).tolist(),
        "damping_ratio": ratio.tolist(),
        "share": (stiffness * shape[0] * shape[-1] / square).tolist(),
        "belt_damping_share": [float(belts * shape[0, 0] ** 2 / (2 * omega[0] * ratio[0]))],
    }


# ---- a printer of ours ---------------------------------------------------------------------------


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
    friction_n: tuple[float, float] = (0.0, 0.0)  # LuGre's
    bristle_n_per_m: float = 4e5
    delay_s: float = 0.0
    growth_per_m: float = 0.0  # of what moves along y, by the height of the print
    yaw_kg_m2: float = 0.0  # of the gantry about its middle, without the toolhead; zero: it cannot yaw
    yaw_hz: float = 40.0  # without the toolhead
    yaw_damping_ratio: float = 0.04
    yaw_arm_m: float = 0.0  # by which the belts' force along x turns it
    head_kg: float = 0.0  # of what moves along y, what rides on the gantry
    middle_m: float = 0.1  # x of the middle of the gantry

    def fields(self, height_mm: float = 0.0) -> dict[str, Any]:
        """Return the fields of PRINTER under a print of this height."""
        rubs, omega = np.array(self.friction_n), 2 * np.pi * self.yaw_hz
        return {
            "turn": np.array(self.motors),
            "carriage": [self.carriage_kg[0], self.carriage_kg[1] * (1.0 + self.growth_per_m * height_mm / 1e3)],
            **{"tool": self.tool_kg, "mount_k": self.mount_n_per_m, "mount_b": self.mount_n_s_per_m},
            **{"belt_k": self.belt_n_per_m, "belt_c": self.belt_n_s_per_m, "guide_b": self.guide_n_s_per_m},
            **{"ground": np.zeros(2), "tool_ground": np.zeros(2)},
            **{"dry_kind": LUGRE if rubs.any() else 0, "dry": rubs, "micro": 1.0 * (rubs > 0.0)},
            "bristle": np.where(rubs > 0.0, rubs / self.bristle_n_per_m, 1.0),
            **{"yaw": self.yaw_kg_m2, "yaw_k": self.yaw_kg_m2 * omega**2, "yaw_at": self.middle_m},
            "yaw_b": 2 * self.yaw_damping_ratio * omega * self.yaw_kg_m2,
            **{"yaw_arm": self.yaw_arm_m, "yaw_grip": 0.0, "head": self.head_kg},
        }

    def axis_modes(self, axis: int) -> tuple[list[float], list[float], list[float]]:
        """Return frequencies, damping ratios and shares of one axis' felt mass under its motor, belts alike."""
        found = modes_of(self.fields(), np.array(self.motors), axis)
        return found["frequency_hz"], found["damping_ratio"], found["share"]


def simulate(plant: Plant, command_mm: Array, rate_hz: float, height_mm: float = 0.0) -> dict[str, Array]:
    """Play x and y (n, 2) mm from rest at a height; between rows the command is straight.

    Returns
    -------
    Positions (n, 2) mm and accelerations (n, 2) m/s² of what the sensors are on, at the rows.
    """
    substeps, rows = round(1 / rate_hz / STEP_S), len(command_mm) - 1
    p = record_of(PRINTER, {**NEUTRAL, **plant.fields(height_mm)})
    command, turn = command_mm / 1e3, np.array(plant.motors)
    state = at_rest(np.ascontiguousarray(turn @ command[0]), p)
    step, found, each = np.diff(command, axis=0), [], max(1, CHUNK_STEPS // substeps)
    for first in range(0, rows, each):
        last = min(first + each, rows)
        at = first + np.arange(2 * substeps * (last - first) + 1) / (2 * substeps) - plant.delay_s * rate_hz
        row = np.clip(at.astype(int), 0, rows - 1)
        share, moving = np.clip(at, 0.0, rows) - row, (at > 0.0) & (at < rows)
        places = (command[row] + share[:, None] * step[row]) @ turn.T
        speeds = (step[row] * (moving * rate_hz)[:, None]) @ turn.T
        h = 1 / rate_hz / substeps
        found.append(run(places, speeds, h, substeps, p, state, first / rate_hz)[1 if first else 0 :])
    out = np.concatenate(found)
    return {"position_mm": 1e3 * out[:, 0], "acceleration_m_per_s2": out[:, 1]}


# ---- the equations -------------------------------------------------------------------------------


@njit(cache=True, error_model="numpy")
def _held(y: Array, a: int, p: Any) -> float:
    """Force of the mount on the carriage of axis a, N."""
    return p.mount_k[a] * (y[TOOL + a] - y[Q + a]) + p.mount_b[a] * (y[TOOLV + a] - y[V + a])


@njit(cache=True, error_model="numpy")
def _rate(y: Array, z: Array, t: float, ud: Array, dud: Array, p: Any, w: Array, dy: Array) -> None:
    """Dy = d(state)/dt. z : (2,) bristles of the guides. w : (3, 2), row 2 leaves as the accelerations sensors feel."""
    pulls, frame, felt = w[0], w[1], w[2]
    pulls[:] = 0.0
    for i in range(2):
        u, du = rippled(ud[i], dud[i], ud[i], dud[i], i, p)
        q = p.turn[i, 0] * y[Q] + p.turn[i, 1] * y[Q + 1]
        dq = p.turn[i, 0] * y[V] + p.turn[i, 1] * y[V + 1]
        pull = driven(y, t, u, du, ud[i], q, dq, i, MOTORS, p, dy)
        pulls[0] += p.turn[i, 0] * pull
        pulls[1] += p.turn[i, 1] * pull
    if p.beam > 0.0:
        aside = min(abs((y[Q] - p.beam_at) / p.beam_half), 1.0)
        pulls[1] *= p.beam_gain / (1.0 + p.beam * (1.0 - aside * aside) ** 2)
    for a in range(2):
        on_carriage = pulls[a] - guide(y[V + a], y[Q + a], z[a], a, p) - p.ground[a] * y[V + a]
        dragged = 0.0
        if p.loose[a] > 0.0:
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
    turned = _yaw(y, p, pulls[0], frame[0], dy)
    for n in range(2):
        force = p.sway_dir[n, 0] * frame[0] + p.sway_dir[n, 1] * frame[1]
        dy[SWAY + n] = y[SWAYV + n]
        dy[SWAYV + n] = -(p.sway_k[n] * y[SWAY + n] + p.sway_b[n] * y[SWAYV + n] + force) / p.sway_mass[n]
    for a in range(2):
        shaken = p.sway_dir[0, a] * dy[SWAYV] + p.sway_dir[1, a] * dy[SWAYV + 1]
        felt[a] = dy[TOOLV + a] + a * turned
        dy[V + a] -= shaken
        dy[TOOLV + a] -= shaken
        hang = p.cable_k * y[CABLE + a] + p.cable_b * y[CABLEV + a]
        dy[CABLE + a], dy[CABLEV + a] = y[CABLEV + a], -felt[a] - hang / p.cable_mass


@njit(cache=True, error_model="numpy")
def _yaw(y: Array, p: Any, pulled: float, acts: float, dy: Array) -> float:
    """Turn the gantry under its head; returns by how much more than the gantry's middle the head accelerates."""
    dy[YAW] = dy[YAW + 1] = 0.0
    if p.yaw == 0.0:
        return 0.0
    aside, share = y[Q] - p.yaw_at, p.head / (p.carriage[1] + p.tool[1])
    moved = 2.0 * y[V] * y[YAW + 1] + dy[V] * y[YAW]
    torque = p.yaw_arm * (pulled + p.yaw_grip * (acts - pulled)) - p.yaw_k * y[YAW] - p.yaw_b * y[YAW + 1]
    torque -= p.head * aside * (dy[V + 1] + (1.0 - share) * moved)
    dy[YAW], dy[YAW + 1] = y[YAW + 1], torque / (p.yaw + p.head * (1.0 - share) * aside * aside)
    turned = aside * dy[YAW + 1] + moved
    dy[V + 1] -= share * turned
    dy[TOOLV + 1] -= share * turned
    return float(turned)


@njit(cache=True, error_model="numpy")
def at_rest(command: Array, p: Any) -> Array:
    """Return the state (STATES,) at rest under what the motors are ordered, (2,) m."""
    y = np.zeros(STATES)
    a, b, c, d = p.turn[0, 0], p.turn[0, 1], p.turn[1, 0], p.turn[1, 1]  # np.linalg.solve compiles for five seconds
    y[Q] = (d * command[0] - b * command[1]) / (a * d - b * c)
    y[Q + 1] = (a * command[1] - c * command[0]) / (a * d - b * c)
    y[TOOL : TOOL + 2] = y[Q : Q + 2]
    y[ROTOR : ROTOR + 2] = command
    return y


@njit(cache=True, error_model="numpy")
def run(command: Array, speed: Array, h: float, every: int, p: Any, state: Array, begin_s: float) -> Array:
    """Play what the motors are ordered, (2 n + 1, 2) m and m/s at half steps, from a state, which is left as the last.

    Returns (n // every + 1, 2, 2): positions in m and accelerations in m/s² of what the sensors are on.
    """
    steps = (len(command) - 1) // 2
    out = np.empty((steps // every + 1, 2, 2))
    y, z, half, full, w = state[:BRISTLE].copy(), state[BRISTLE:].copy(), np.zeros(2), np.zeros(2), np.zeros((3, 2))
    k1, k2, k3, k4 = np.zeros(BRISTLE), np.zeros(BRISTLE), np.zeros(BRISTLE), np.zeros(BRISTLE)
    for n in range(steps + 1):
        b, t = 2 * n, begin_s + n * h
        _rate(y, z, t, command[b], speed[b], p, w, k1)
        if n % every == 0:
            out[n // every, 0], out[n // every, 1] = y[TOOL : TOOL + 2], w[2]
            out[n // every, 0, 1] += (y[Q] - p.yaw_at) * y[YAW]
        if n == steps:
            break
        if p.dry_kind >= DAHL:
            for a in range(2):
                v = y[V + a] + h / 2 * k1[V + a]
                half[a], full[a] = bent(z[a], v, h / 2, a, p), bent(z[a], v, h, a, p)
        _rate(y + h / 2 * k1, half, t + h / 2, command[b + 1], speed[b + 1], p, w, k2)
        _rate(y + h / 2 * k2, half, t + h / 2, command[b + 1], speed[b + 1], p, w, k3)
        _rate(y + h * k3, full, t + h, command[b + 2], speed[b + 2], p, w, k4)
        y += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        z[:] = full
    state[:BRISTLE], state[BRISTLE:] = y, z
    return out
