"""A linear delta's vibrations: three carriages on belts, joined by their arms to an effector (paper, Eqs. 14-62).

In the carriages q and the extruder's displacement against the nozzle holder, η = X₂ − X, with Ẍ = J q̈ + f:

    ⎡ m I + Γ (M₁ + M₂) J   Γ M₂ ⎤ ⎡q̈⎤   ⎡(c+b) I  0⎤ ⎡q̇⎤   ⎡k I  0⎤ ⎡q⎤   ⎡k u + c u̇ − Γ (M₁ + M₂) f⎤
    ⎣        M₂ J            M₂  ⎦ ⎣η̈⎦ + ⎣   0     B⎦ ⎣η̇⎦ + ⎣ 0   K⎦ ⎣η⎦ = ⎣            − M₂ f        ⎦

M, C and K are derived here once. With η eliminated they are Z of Eq. 29, Z(s) = (m s² + (c+b) s + k) I + Γ W(s) J,
and solved for the accelerations they are the state space of 18, three entries each:

    [ w, ẇ, q, q̇, η, η̇ ]      w of the drive filter: ẅ = u_d − d₂ ẇ − d₀ w,   u = d₀ w + d₁ ẇ    (Eq. 34)

The centripetal term f = J̇ q̇ of the planned motion is a known input. Only accelerations and relative displacements of
the effector enter, so the model holds for large motion. k, c and b may be three numbers, A B C. mm for lengths;
stiffness N/m over mass kg is 1/s² all the same.

The paper's arms are half masses at their ends. If mass is spread evenly along an arm whose ends move with Ẋ and ẑ q̇_i,
the kinetic energy is lower, m_f/6 (|Ẋ|² + Ẋ·ẑ q̇_i + q̇_i²). With the share that acts at the ends,

    T = … − ½ ν Σ |Ẋ − ẑ q̇_i|²,   ν = (1 − share) m_f/6   so that M and the forces lose
    ν Σ R_iᵀ R_i and ν Σ R_iᵀ f,   R_i = J − ẑ e_iᵀ        whatever Γ is: it is of the effector

Γ is how the carriages share the effector's load (`force_map` in the machine file):

- `virtual_work`: F_q = Jᵀ F. Six two-force rods carry exactly this, wherever the centre of mass is.
- `paper`: F_qi = J_iᵀ P_i F (Eq. 25), with the minimum-norm P_i of Eq. 22 and J_i the column of J that is
  carriage i's. For a centred mass that is a third of the virtual-work load. For checking the paper's figures.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from models.arrays import ComplexArray, FloatArray, constant, same_or_each
from models.kinematics.base import Kinematics
from models.kinematics.delta import DeltaKinematics
from models.vibration import substructures as sub
from models.vibration.base import ModelParameter, ParameterSet, PrinterFields, VibrationModel, number_at, with_numbers
from models.vibration.state_space import StateSpace
from models.vibration.substructures import Carriage, Effector

STATES = 18
W, WD, Q, QD, ETA, ETAD = (slice(3 * i, 3 * i + 3) for i in range(6))
NAMES = (
    *(f"{kind}_{letter}" for kind in ("drive", "drive_rate", "pos", "vel") for letter in "ABC"),
    *(f"{kind}_{letter}" for kind in ("extruder", "extruder_rate") for letter in "xyz"),
)

CARRIAGE = ("mass_kg", "belt_stiffness_n_per_m", "belt_damping_n_s_per_m", "guide_damping_n_s_per_m")
DRIVE = ("d0_per_s2", "d1_per_s", "d2_per_s")
EFFECTOR = ("nozzle_mass_kg", "extruder_mass_kg")
MOUNT = ("extruder_stiffness_n_per_m", "extruder_damping_n_s_per_m")


@dataclass(frozen=True, slots=True)
class EquationsOfMotion:
    """M, C and K of the six coordinates at n positions, see the top of this module."""

    mass: FloatArray  # (n, 6, 6) kg
    damping: FloatArray  # (6,) N s/m, diagonal
    stiffness: FloatArray  # (6,) N/m, diagonal


@dataclass(frozen=True, eq=False)
class DeltaVibration(VibrationModel):
    """Carriages and effector by receptance coupling."""

    carriage: Carriage
    effector: Effector
    kinematics: DeltaKinematics

    position_dependent: ClassVar[bool] = True
    channels: ClassVar[tuple[str, str, str]] = ("A", "B", "C")

    def on(self, kinematics: Kinematics) -> DeltaVibration:
        """Return the model bound to a delta's kinematics; TypeError for any other."""
        if kinematics is self.kinematics:
            return self
        if not isinstance(kinematics, DeltaKinematics):
            raise TypeError("Carriages that carry an effector need a delta's kinematics.")
        return replace(self, kinematics=kinematics)

    @property
    def nozzle_side_mass_kg(self) -> float:
        """Return M₁ of Eq. 61: the nozzle holder and the lower halves of the three arm pairs, m_1 + 3 m_f / 2."""
        return self.effector.nozzle_mass_kg + 1.5 * self.carriage.arm_pair_mass_kg

    @property
    def frequency_keys(self) -> tuple[str, ...]:
        """Return the belts' stiffness; masses can be weighed."""
        return ("carriage.belt_stiffness_n_per_m",)

    # ---- parameters

    def parameters(self) -> ParameterSet:
        """Return the uncertain numbers of the model; the geometry is calibrated and not among them."""
        names = []
        for key in self.tunable:  # three numbers, where an effect has made towers differ
            several = np.ndim(getattr(self.carriage, key.removeprefix("carriage."), 0.0)) > 0
            names += [f"{key}[{i}]" for i in range(3)] if several else [key]
        each = (ModelParameter(name, self.value(name), i, name.partition("[")[0]) for i, name in enumerate(names))
        return ParameterSet(tuple(each), len(names))

    def value(self, name: str) -> float:
        """Return one parameter, the mean where each tower has its own; KeyError if there is none of this name."""
        path, _, index = name.removesuffix("]").partition("[")
        number = number_at(self, path)
        return float(number[int(index)] if index else np.mean(number))

    def with_parameters(self, values: Mapping[str, float]) -> DeltaVibration:
        """Return the model with some parameters replaced; KeyError for an unknown name."""
        changed: dict[str, Any] = {}
        for name, value in values.items():
            path, _, index = name.removesuffix("]").partition("[")
            if index:
                array = np.array(changed.get(path, number_at(self, path)), dtype=float)
                array[int(index)] = value
                changed[path] = constant(array)
            else:
                number_at(self, path)
                changed[path] = float(value)
        changed_model: DeltaVibration = with_numbers(self, changed)
        return changed_model

    # ---- the equations

    def jacobian(self, xy: FloatArray) -> FloatArray:
        """Return J of the nozzle's motion from the actuators' at (n, 2) mm: (n, 3, 3)."""
        return self.kinematics.jacobian(xy)

    def load_map(self, j: FloatArray) -> FloatArray:
        """Return Γ, the share of each carriage, of J (n, 3, 3): F_q = Γ W X, with Γ = Jᵀ or rows J_iᵀ P_i (Eq. 27).

        (n, 3, 3) N/N; rows carriages A B C, columns X Y Z of the force.
        """
        if self.effector.force_map == "virtual_work":
            return j.transpose(0, 2, 1)
        return np.einsum("nai,iab->nib", j, sub.load_distribution(self.kinematics.tower_angles_rad, self.effector))

    def arm_inertia(self, j: FloatArray) -> FloatArray:
        """Return ν Σ R_iᵀ R_i, the mass along the arms that the carriages do not feel; j and result (n, 3, 3), kg."""
        rise = j[:, 2]  # of the nozzle, by each carriage
        both = rise[:, :, None] + rise[:, None, :]
        return np.asarray(self.carriage.arm_inertia_kg * (3 * j.transpose(0, 2, 1) @ j - both + np.eye(3)))

    def equations(self, xy: FloatArray) -> EquationsOfMotion:
        """Return M, C and K at positions (n, 2) mm."""
        carriage, effector = self.carriage, self.effector
        j, extruder = self.jacobian(xy), effector.extruder_mass_kg
        gamma = self.load_map(j)
        carriages = carriage.moving_mass_kg * np.eye(3) + (self.nozzle_side_mass_kg + extruder) * gamma @ j
        carriages = carriages - self.arm_inertia(j)
        relative = np.broadcast_to(extruder * np.eye(3), j.shape)
        return EquationsOfMotion(
            np.block([[carriages, extruder * gamma], [extruder * j, relative]]),
            np.concatenate([np.broadcast_to(sub.damping(carriage), 3), effector.extruder_damping_n_s_per_m]),
            np.concatenate([np.broadcast_to(carriage.belt_stiffness_n_per_m, 3), effector.extruder_stiffness_n_per_m]),
        )

    def receptance(self, xy: FloatArray, s: ComplexArray) -> ComplexArray:
        """Return Z⁻¹, motors held: from forces on the carriages to their positions.

        (k, 3, 3) m/N at (2,) mm and s (k,) 1/s; rows positions, columns forces.
        """
        eq, s2 = self.equations(xy[None]), s[:, None] ** 2
        mass = eq.mass[0]
        mount = eq.damping * s[:, None] + eq.stiffness  # (k, 6)
        extruder = np.diagonal(mass)[3:] * s2 + mount[:, 3:]
        z = mass[:3, :3] * s2[:, :, None] + mount[:, :3, None] * np.eye(3)
        by_axis = mass[:3, 3:].T[:, :, None] * mass[3:, None, :3]  # (3, 3, 3) kg², first the extruder's axis
        eliminated = np.tensordot(s2**2 / extruder, by_axis, axes=1)
        return np.linalg.inv(z - eliminated)

    def carriage_response(self, xy: FloatArray, s: ComplexArray) -> ComplexArray:
        """Return G of Eq. 29: Z⁻¹ (c s + k) G_e."""
        each = s[:, None]  # against carriages that may differ
        drive = sub.belt(self.carriage, each) * sub.drive_frf(self.carriage.drive, each)
        return np.asarray(self.receptance(xy, s) * drive[:, None, :])

    def effector_impedance(self, s: ComplexArray) -> ComplexArray:
        """Return the diagonal of W(s) (Eq. 61), (k, 3) N/m, columns X Y Z: nozzle position to force; s (k,) 1/s."""
        return np.asarray(s[:, None] ** 2 * sub.apparent_mass(self.effector, self.nozzle_side_mass_kg, s))

    def struck_frf(self, s: ComplexArray) -> ComplexArray:
        """Return acceleration over force of the effector by itself, hanging free (Eq. 45): (k, 3) 1/kg along X Y Z."""
        return np.asarray(1 / sub.apparent_mass(self.effector, self.effector.nozzle_mass_kg, s))

    def mechanics(self, xy: FloatArray) -> FloatArray:
        """Return d/dt of (q, η, q̇, η̇), (n, 12, 12)."""
        eq = self.equations(xy)
        state = np.zeros((len(xy), 12, 12))
        state[:, :6, 6:] = np.eye(6)
        state[:, 6:, :6] = -np.linalg.solve(eq.mass, np.broadcast_to(np.diag(eq.stiffness), eq.mass.shape))
        state[:, 6:, 6:] = -np.linalg.solve(eq.mass, np.broadcast_to(np.diag(eq.damping), eq.mass.shape))
        return state

    def nozzle_motion(self, xy: FloatArray) -> FloatArray:
        """Return the nozzle's motion from the coordinates', (n, 3, m/2), at positions (n, 2) mm."""
        j = self.jacobian(xy)
        return np.concatenate([j, np.zeros_like(j)], axis=2)

    def state_space(self, xy: FloatArray) -> StateSpace:
        """Return the plant of 18 states frozen at each of the positions (g, 2) mm."""
        g, eq, j = len(xy), self.equations(xy), self.jacobian(xy)
        forces = np.zeros((g, 6, 12 + 9))  # of (q, η, q̇, η̇), u, u̇, f
        forces[:, :, :6], forces[:, :, 6:12] = -np.diag(eq.stiffness), -np.diag(eq.damping)
        forces[:, :3, 12:15] = np.diag(eq.stiffness[:3])
        forces[:, :3, 15:18] = np.broadcast_to(self.carriage.belt_damping_n_s_per_m, 3) * np.eye(3)
        m2 = self.effector.extruder_mass_kg
        forces[:, :3, 18:], forces[:, 3:, 18:] = -(self.nozzle_side_mass_kg + m2) * self.load_map(j), -m2 * np.eye(3)
        forces[:, :3, 18:] += self.carriage.arm_inertia_kg * (3 * j.transpose(0, 2, 1) - [0, 0, 1])
        accelerations = np.linalg.solve(eq.mass, forces)
        a, inputs = np.zeros((g, STATES, STATES)), np.zeros((3, g, STATES, 3))
        a[:, Q, QD] = a[:, ETA, ETAD] = np.eye(3)
        for rows, of in ((QD, accelerations[:, :3]), (ETAD, accelerations[:, 3:])):
            for state, columns in zip((Q, ETA, QD, ETAD), np.split(of[:, :, :12], 4, axis=2), strict=True):
                a[:, rows, state] = columns
            inputs[:, :, rows] = np.moveaxis(of[:, :, 12:].reshape(g, 3, 3, 3), 2, 0)
        return self._with_drive(a, *inputs)

    def _with_drive(self, a: FloatArray, u: FloatArray, slope: FloatArray, centripetal: FloatArray) -> StateSpace:
        """Put the drive filter between command and belt: u = d₀ w + d₁ ẇ, u̇ = d₀ ẇ + d₁ (u_d − d₂ ẇ − d₀ w)."""
        carriage, eye = np.eye(STATES)[Q], np.eye(3)
        a[:, W, WD] = eye
        drive = self.carriage.drive
        if drive is None:  # an ideal drive: the filter's states idle, decoupled and stable
            a[:, WD, W], a[:, WD, WD] = -eye * 1e4, -eye * 200.0
            return StateSpace(a, u, slope, centripetal, carriage, NAMES, drive_states=6)
        d0, d1, d2 = drive.d0_per_s2, drive.d1_per_s, drive.d2_per_s
        a[:, WD, W], a[:, WD, WD] = -d0 * eye, -d2 * eye
        a[:, :, W] += d0 * u - d1 * d0 * slope
        a[:, :, WD] += d1 * u + (d0 - d1 * d2) * slope
        b_command = d1 * slope
        b_command[:, WD] += eye
        return StateSpace(a, b_command, np.zeros_like(slope), centripetal, carriage, NAMES, drive_states=6)

    def low_frequency(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return τ and C: Eq. 29 and Eq. 34 turned over and expanded at s = 0, an eighth of the time for a table."""
        carriage = self.carriage
        k, c, b = (np.broadcast_to(getattr(carriage, key), 3) for key in CARRIAGE[1:])
        moving = self.equations(xy).mass[:, :3, :3] / k[:, None]
        first, second = carriage.drive.lag if carriage.drive else (0.0, 0.0)
        return b / k + first, np.asarray(moving + np.diag(second + b / k * first - b * c / k**2))

    def steady_motion(self, q: FloatArray, qd: FloatArray) -> FloatArray:
        """Return the state with the actuators at (3,) mm, in steady motion at (3,) mm/s."""
        state = np.zeros(STATES)
        state[Q], state[QD] = q, qd
        drive = self.carriage.drive
        if drive:
            tau, _ = self.low_frequency(np.zeros((1, 2)))
            state[WD] = qd / drive.d0_per_s2
            state[W] = (q + tau * qd - drive.d2_per_s * state[WD]) / drive.d0_per_s2
        return state

    def undriven(self) -> DeltaVibration:
        """Return the model with ideal drives: motors follow their command exactly."""
        return replace(self, carriage=replace(self.carriage, drive=None))

    # ---- the nonlinear printer

    def printer_parameters(self, gravity_m_per_s2: float) -> PrinterFields:
        """Return the model's numbers for the nonlinear printer's kernels, SI."""
        carriage, effector = self.carriage, self.effector
        drive: PrinterFields = {"ideal_drive": True}
        if d := carriage.drive:
            drive = {"d0": d.d0_per_s2, "lead": d.d1_per_s / d.d0_per_s2, "d2": d.d2_per_s}
        return {
            "carriage_mass": carriage.moving_mass_kg,
            "weight": carriage.moving_mass_kg * gravity_m_per_s2,
            "belt_k": carriage.belt_stiffness_n_per_m,
            "belt_c": carriage.belt_damping_n_s_per_m,
            "guide_b": carriage.guide_damping_n_s_per_m,
            **drive,
            "shares": sub.load_distribution(self.kinematics.tower_angles_rad, effector)
            if effector.force_map == "paper"
            else np.stack([np.eye(3)] * 3),
            "holder_mass": self.nozzle_side_mass_kg,
            "arm_inertia": carriage.arm_inertia_kg,
            "extruder_mass": effector.extruder_mass_kg,
            "mount_k": effector.extruder_stiffness_n_per_m,
            "mount_b": effector.extruder_damping_n_s_per_m,
            "least_inertia": self._least_inertia(),
            "gravity": gravity_m_per_s2,
        }

    def _least_inertia(self) -> float:
        """Return the least mass, kg, that a combination of forces on the carriages moves, at the centre and the rim."""
        j = _middle_and_rim(self.kinematics)
        load = self.nozzle_side_mass_kg * self.load_map(j) @ j - self.arm_inertia(j)
        return float(np.linalg.eigvals(self.carriage.moving_mass_kg * np.eye(3) + load).real.min())

    @property
    def tunable(self) -> tuple[str, ...]:
        """Return the machine file's numbers that a measurement of vibrations may correct."""
        drive = DRIVE if self.carriage.drive is not None else ()
        return (
            *(f"carriage.{key}" for key in CARRIAGE),
            *(f"carriage.drive.{key}" for key in drive),
            *(f"effector.{key}" for key in EFFECTOR),
            *(f"effector.{key}[{i}]" for key in MOUNT for i in range(3)),
        )

    def with_belts(self, relative_change: FloatArray, motors: FloatArray) -> DeltaVibration:
        """Return the model with belts stiffer by (3,), one a carriage."""
        stiffness = same_or_each(self.carriage.belt_stiffness_n_per_m * (1 + relative_change))
        return replace(self, carriage=replace(self.carriage, belt_stiffness_n_per_m=stiffness))

    def with_guide_damping(self, added_n_s_per_m: FloatArray) -> DeltaVibration:
        """Return the model with more friction (3,) of the guides, in proportion to speed."""
        damping = same_or_each(self.carriage.guide_damping_n_s_per_m + added_n_s_per_m)
        return replace(self, carriage=replace(self.carriage, guide_damping_n_s_per_m=damping))


@lru_cache(maxsize=16)
def _middle_and_rim(kinematics: DeltaKinematics) -> FloatArray:
    """Return J (13, 3, 3) at the centre and around the rim."""
    return kinematics.jacobian(kinematics.rings(1, 12))
