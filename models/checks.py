"""Check a machine's model all over the bed, and its parameters against each other and its measurements.

- Stability: every vibration decays (poles in the left half-plane).
- Reciprocity: with the motors at rest, a force on one carriage moves another as much as vice versa, Y = Yᵀ,
  Y = Z⁻¹ of Eq. 29 (Rayleigh, The Theory of Sound, 1877, §§ 107-109).
- Passivity: no force at any frequency extracts more work from the machine than it supplies: the Hermitian part of the
  mobility jωY has no negative eigenvalue.
- Load: the load of a rigid effector on the carriages, Γ J, against virtual work's Jᵀ J.

A map by virtual work has all of these by construction. The paper's map (Eqs. 22-27) guarantees none.

The paper's identification determines some parameters in more than one way (Eqs. 30-49). A machine file may contain the
measurements in `[provenance.measured]`; every equation whose measurements are given is evaluated and compared with the
file's own parameter:

    natural_frequency_rad_per_s          ω_n   carriage without effector
    damping_ratio                        ζ
    added_mass_kg                        m_add
    loaded_natural_frequency_rad_per_s   ω'_n  the same with m_add on it
    loaded_damping_ratio                 ζ'
    total_effector_mass_kg               m_tot effector on the scale, without arms (Table I: m_1 + m_2)
    hammer_zero_rad_per_s                ω_z   effector hit by a hammer
    hammer_pole_rad_per_s                ω_p
    hammer_axis                          "x", "y" or "z": its direction; default: the stiffest
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from models.arrays import ComplexArray, FloatArray
from models.kinds import delta_vibration
from models.machine import Machine
from models.vibration.substructures import damping

FREQUENCIES_HZ = np.geomspace(1.0, 300.0, 120)
ROUNDING_RTOL = 1e-9  # relative to a norm: less than this is rounding


@dataclass(frozen=True)
class Extreme:
    """A largest or smallest value, with its position and frequency."""

    value: float  # number [of the quantity]: the worst over the bed
    x_mm: float  # where
    y_mm: float  # where
    frequency_hz: float | None = None  # null if the quantity does not depend on frequency


@dataclass(frozen=True)
class PhysicsChecks:
    """The worst values on the bed, relative to the 2-norm (dissipation, asymmetry) or the Frobenius norm (load)."""

    growth_per_s: Extreme  # largest real part of a pole: below zero, everything decays
    dissipation: (
        Extreme  # smallest eigenvalue of the Hermitian part of jωY, relative to it; below zero: it has a source
    )
    asymmetry: Extreme  # largest skew part of Y, relative to Y
    load_asymmetry: Extreme  # largest skew part of Γ J, relative to Γ J
    least_load: Extreme  # of one carriage moving by itself: (Γ J)_ii / (Jᵀ J)_ii; 1 by virtual work
    most_load: Extreme

    @property
    def is_passive(self) -> bool:
        """Whether the model generates no energy."""
        return self.dissipation.value > -ROUNDING_RTOL

    @property
    def is_reciprocal(self) -> bool:
        """Whether Y = Yᵀ."""
        return self.asymmetry.value < ROUNDING_RTOL


def check_physics(machine: Machine) -> PhysicsChecks:
    """Check the model on a polar grid over the bed."""
    xy, model = bed(machine), delta_vibration(machine)
    s = np.asarray(2j * np.pi * FREQUENCIES_HZ, dtype=np.complex128)
    y = np.stack([model.receptance(position, s) for position in xy])
    j = machine.kinematics.jacobian(xy)
    load = model.load_map(xy) @ j
    ratio = np.diagonal(load, axis1=1, axis2=2) / np.sum(j**2, axis=1)
    return PhysicsChecks(
        _largest(machine.vibration.poles(xy).real.max(axis=1), xy),
        _smallest(_dissipation(y), xy),
        _largest(_skew(y, 2), xy),
        _largest(_skew(load, "fro"), xy),
        _smallest(ratio.min(axis=1), xy),
        _largest(ratio.max(axis=1), xy),
    )


def unstable_positions(machine: Machine, radii: int = 6, directions: int = 24) -> FloatArray:
    """Find the positions, on a polar grid over the bed, with a vibration that does not decay.

    The pole at zero of a free axis does not count.

    Returns
    -------
    (k, 2) mm, columns X Y; empty for a stable machine.
    """
    everywhere = machine.vibration.position_dependent
    xy = bed(machine, radii, directions) if everywhere else np.array([*machine.kinematics.sample_positions.values()])
    poles = machine.vibration.poles(xy)
    vibrates = np.abs(poles) > ROUNDING_RTOL * np.abs(poles).max(axis=1, keepdims=True)
    return xy[np.any(vibrates & (poles.real >= 0), axis=1)]


def bed(machine: Machine, radii: int = 6, directions: int = 24) -> FloatArray:
    """Return the centre and rings around it out to the print radius : (n, 2) mm, columns X Y."""
    return machine.kinematics.rings(radii - 1, directions)


def _dissipation(y: ComplexArray) -> FloatArray:
    """Return the smallest eigenvalue of the Hermitian part of jωY over its norm : (n, k) for y (n, k, 3, 3)."""
    mobility = 1j * y  # ω scales both alike
    hermitian = (mobility + mobility.conj().swapaxes(-1, -2)) / 2
    return np.asarray(np.linalg.eigvalsh(hermitian)[..., 0] / np.linalg.norm(mobility, 2, axis=(-2, -1)))


def _skew(a: FloatArray | ComplexArray, norm: Literal[2, "fro"]) -> FloatArray:
    """Return the norm of the skew part over the norm of the whole : (...,) for (..., 3, 3)."""
    skew = (a - a.swapaxes(-1, -2)) / 2
    return np.asarray(np.linalg.norm(skew, norm, axis=(-2, -1)) / np.linalg.norm(a, norm, axis=(-2, -1)))


def _smallest(values: FloatArray, xy: FloatArray) -> Extreme:
    """Find the smallest of values (n,), or (n, k) with frequencies."""
    at = np.unravel_index(int(np.argmin(values)), values.shape)
    x, y = (np.round(xy[at[0]], 3) + 0.0).tolist()  # + 0.0: no minus before a zero
    return Extreme(float(values[at]), x, y, float(FREQUENCIES_HZ[at[1]]) if values.ndim == 2 else None)


def _largest(values: FloatArray, xy: FloatArray) -> Extreme:
    smallest = _smallest(-values, xy)
    return Extreme(-smallest.value, smallest.x_mm, smallest.y_mm, smallest.frequency_hz)


REDUNDANCY_RTOL = 0.05  # relative to the file; two careful measurements of one quantity may differ by this much
SAME_RTOL = 0.005  # relative to the file: the same value, rounded

GIVEN = "the number given"
AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Value:
    """A value of the quantity by another equation."""

    equation: str  # "Eq. 41: m = ω'_n²/(ω_n² − ω'_n²) m_add"
    value: float
    difference: float  # from the file's parameter, relative to it


@dataclass(frozen=True)
class Quantity:
    """A parameter of the file, with its value by every other equation."""

    key: str
    unit: str
    of_file: float
    basis: str  # how the file determines it
    others: tuple[Value, ...]  # at least one

    @property
    def spread(self) -> float:
        """Largest minus smallest of all values, the file's included, relative to the file's."""
        every = [self.of_file, *(other.value for other in self.others)]
        return (max(every) - min(every)) / abs(self.of_file)

    @property
    def the_file_uses(self) -> str:
        """Name the file's basis and the equations that agree with it."""
        same = [other.equation.partition(":")[0] for other in self.others if abs(other.difference) < SAME_RTOL]
        return f"{self.basis}, as {' and '.join(same)}" if same else self.basis

    @property
    def disagreeing(self) -> tuple[Value, ...]:
        """Values that differ from the file's by more than the tolerance."""
        return tuple(other for other in self.others if abs(other.difference) > REDUNDANCY_RTOL)


def _mass_by_frequencies(omega: float, loaded: float, added: float) -> float:
    """Apply Eq. 41; NaN if the load did not slow the carriage down."""
    return loaded**2 / (omega**2 - loaded**2) * added if omega > loaded else math.nan


_ALONE, _LOADED, _ADDED = "natural_frequency_rad_per_s", "loaded_natural_frequency_rad_per_s", "added_mass_kg"
_ZETA, _LOADED_ZETA, _TOTAL = "damping_ratio", "loaded_damping_ratio", "total_effector_mass_kg"
_ZERO, _POLE = "hammer_zero_rad_per_s", "hammer_pole_rad_per_s"
_THREE, _TWO, _BOTH = (_ALONE, _LOADED, _ADDED), (_LOADED, _ADDED), (_ZERO, _POLE)
MEASURED = (_ALONE, _ZETA, _ADDED, _LOADED, _LOADED_ZETA, _TOTAL, _ZERO, _POLE)

# An equation, the keys of [provenance.measured] that it needs, and its value from the file's own numbers f and theirs.
_Way = tuple[str, tuple[str, ...], Callable[..., float]]
_MASS: tuple[_Way, ...] = (
    ("Eq. 41: m = ω'_n²/(ω_n² − ω'_n²) m_add", _THREE, lambda f, *each: _mass_by_frequencies(*each)),
    ("Eq. 36: m = k/ω_n²", (_ALONE,), lambda f, w: f["k"] / w**2),
    ("Eq. 40: m = k/ω'_n² − m_add", _TWO, lambda f, w, added: f["k"] / w**2 - added),
)
_STIFFNESS: tuple[_Way, ...] = (
    ("Eq. 36: k = m ω_n²", (_ALONE,), lambda f, w: f["m"] * w**2),
    ("Eq. 40: k = (m + m_add) ω'_n²", _TWO, lambda f, w, added: (f["m"] + added) * w**2),
    ("Eqs. 36, 41: k = m ω_n² with the m of Eq. 41", _THREE, lambda f, w, *x: _mass_by_frequencies(w, *x) * w**2),
)
_DAMPED = (_LOADED, _LOADED_ZETA, _ADDED)
_DAMPING: tuple[_Way, ...] = (
    ("Eq. 35: c + b = 2 ζ ω_n m", (_ALONE, _ZETA), lambda f, w, zeta: 2 * zeta * w * f["m"]),
    ("Eq. 39: c + b = 2 ζ' ω'_n (m + m_add)", _DAMPED, lambda f, w, zeta, added: 2 * zeta * w * (f["m"] + added)),
)
_NOZZLE: tuple[_Way, ...] = (
    ("Eq. 49: m_1 = (ω_z/ω_p)² (m_1 + m_2)", _BOTH, lambda f, z, p: (z / p) ** 2 * f["m12"]),
    ("Eq. 49: m_1 = (ω_z/ω_p)² m_tot", (*_BOTH, _TOTAL), lambda f, z, p, total: (z / p) ** 2 * total),
)
_EXTRUDER: tuple[_Way, ...] = (
    ("Eq. 49: m_2 = (1 − (ω_z/ω_p)²) (m_1 + m_2)", _BOTH, lambda f, z, p: (1 - (z / p) ** 2) * f["m12"]),
    ("Eq. 49: m_2 = (1 − (ω_z/ω_p)²) m_tot", (*_BOTH, _TOTAL), lambda f, z, p, total: (1 - (z / p) ** 2) * total),
)
_MOUNT: tuple[_Way, ...] = (
    ("Eq. 47: k = m_2 ω_z²", (_ZERO,), lambda f, z: f["m2"] * z**2),
    ("Eq. 48: k = m_1 m_2/(m_1 + m_2) ω_p²", (_POLE,), lambda f, p: f["m1"] * f["m2"] / f["m12"] * p**2),
)
_SCALE: tuple[_Way, ...] = (("the scale: m_tot", (_TOTAL,), lambda f, total: total),)
# The file's own number -> key, unit, how the file determines it, and the other ways.
QUANTITIES: Mapping[str, tuple[str, str, str, tuple[_Way, ...]]] = {
    "m": ("carriage.mass_kg + arm_pair_mass_kg/2", "kg", "Eq. 30: m_c + m_f/2", _MASS),
    "k": ("carriage.belt_stiffness_n_per_m", "N/m", GIVEN, _STIFFNESS),
    "c+b": ("carriage.belt_damping_n_s_per_m + guide_damping_n_s_per_m", "N s/m", GIVEN, _DAMPING),
    "m12": ("effector.nozzle_mass_kg + extruder_mass_kg", "kg", GIVEN, _SCALE),
    "m1": ("effector.nozzle_mass_kg", "kg", GIVEN, _NOZZLE),
    "m2": ("effector.extruder_mass_kg", "kg", GIVEN, _EXTRUDER),
    "mount": ("effector.extruder_stiffness_n_per_m[{axis}]", "N/m", GIVEN, _MOUNT),
}


def redundant_quantities(machine: Machine) -> list[Quantity]:
    """List every parameter of the file that the measurements also determine, with each value."""
    measured, model = _usable(machine), delta_vibration(machine)
    carriage, mount = model.carriage, model.effector.extruder_stiffness_n_per_m
    axis = AXES.index(measured["hammer_axis"]) if "hammer_axis" in measured else int(np.argmax(mount))
    m1, m2 = model.effector.nozzle_mass_kg, model.effector.extruder_mass_kg
    of_file = {"m": carriage.moving_mass_kg, "k": carriage.belt_stiffness_n_per_m, "c+b": damping(carriage)}
    of_file |= {"m12": m1 + m2, "m1": m1, "m2": m2, "mount": float(mount[axis])}
    quantities = []
    for name, (key, unit, basis, ways) in QUANTITIES.items():
        own = of_file[name]
        known = [way for way in ways if all(need in measured for need in way[1])]
        values = [(text, value(of_file, *(measured[need] for need in needs))) for text, needs, value in known]
        others = tuple(Value(text, value, value / own - 1) for text, value in values if math.isfinite(value))
        if others:
            quantities.append(Quantity(key.format(axis=AXES[axis]), unit, own, basis, others))
    return quantities


def redundancy_problems(machine: Machine) -> list[str]:
    """List, as sentences, unusable measurements, and quantities whose values differ by more than 5 %."""
    return [*_unusable(machine), *(_sentence(each) for each in redundant_quantities(machine) if each.disagreeing)]


def _sentence(quantity: Quantity) -> str:
    ways = "; ".join(
        f"{way.value:.4g} by {way.equation.replace(': ', ' (', 1)}), {100 * way.difference:+.0f} %"
        for way in quantity.disagreeing
    )
    return (
        f"{quantity.key} = {quantity.of_file:.4g} {quantity.unit}, but the measured numbers give {ways}. "
        f"Together they spread over {100 * quantity.spread:.0f} %."
    )


def _usable(machine: Machine) -> dict[str, Any]:
    """Select the valid entries of [provenance.measured]."""
    measured: Mapping[str, Any] = machine.provenance.get("measured", {})
    return {key: value for key, value in measured.items() if not _wrong(key, value)}


def _unusable(machine: Machine) -> list[str]:
    measured: Mapping[str, Any] = machine.provenance.get("measured", {})
    wrong = [_wrong(key, value) for key, value in measured.items()]
    usable = _usable(machine)
    if _ALONE in usable and _LOADED in usable and usable[_LOADED] >= usable[_ALONE]:
        wrong.append(
            f"provenance.measured.{_LOADED} = {usable[_LOADED]:g} must be below {_ALONE} = {usable[_ALONE]:g}: "
            "a load slows a carriage down (Eq. 41)."
        )
    return [sentence for sentence in wrong if sentence]


def _wrong(key: str, value: object) -> str:
    """Return the problem with an entry; '' if there is none."""
    if key == "hammer_axis":
        return "" if value in AXES else f"provenance.measured.{key} = {value!r} must be one of 'x', 'y', 'z'."
    if key not in MEASURED:
        near = difflib.get_close_matches(key, (*MEASURED, "hammer_axis"), 1)
        return f"provenance.measured.{key} is not a known key, so it is ignored" + (
            f"; did you mean {near[0]!r}?" if near else "."
        )
    good = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and value > 0
    return "" if good else f"provenance.measured.{key} = {value!r} must be a number above zero."
