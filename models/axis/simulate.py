"""Simulate an axis with its effects, and what its sensors would record."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from models.arrays import FloatArray
from models.axis.kernel import NAMES, integrate_axis
from models.axis.machine import AxisMachine, AxisParameters
from models.effects.catalogue import CATALOGUE, effects_of, values_of
from models.printer.kernels.spline import slopes

LONGEST_STEP_S = 0.002
TURNS = 0.25  # of a radian may the fastest mode turn in a step
COARSE_TURNS = 0.7  # where effects are only ranked: a resonance is a thousandth off
HARDER = 2.0  # times the frequency at rest, of a spring that hardens under a loud motion
STEEP = 1.5  # a step times the rate at which friction stops what moves: the method is stable up to 2.8
MOST_SUBSTEPS = 60


@dataclass(frozen=True, eq=False)
class AxisMotion:
    """The motion of an axis, n samples."""

    t_s: FloatArray  # (n,)
    position_mm: FloatArray  # (n,) of the load; without one, of the mass
    motor_mm: FloatArray  # (n,) of the mass
    acceleration: FloatArray  # (n,) m/s², of the load; without one, of the mass
    steps: int = 0  # of the integration

    def sensed(self, machine: AxisMachine) -> dict[str, FloatArray]:
        """Return what the sensors read, by the names of a recording's signals."""
        values = values_of(machine, "sensor_gain")
        gain = 1.0 if values is None else 1.0 + float(np.atleast_1d(values["nozzle_relative_change"])[0])
        return {"pos_q": self.position_mm, "pos_motor": self.motor_mm, "acc_q": gain * self.acceleration}


def axis_effects(machine: AxisMachine) -> tuple[str, ...]:
    """Return the effects that this axis may have: what needs a spring or a command is not of one without."""
    spring, command = machine.axis.last_stiffness > 0.0, not machine.axis.by_force
    needs = dict.fromkeys(("belt_stiffness", "belt_backlash", "belt_hardening"), spring)
    needs |= {"cogging": command, "ground_spring": machine.axis.free}
    return tuple(name for name in effects_of(machine.moves) if needs.get(name, True))


def simulate_axis(
    machine: AxisMachine,
    given: FloatArray,
    dt_s: float,
    *,
    shot: int = 0,
    begin: FloatArray | None = None,
    substeps: int = 0,
    coarse: bool = False,
) -> AxisMotion:
    """Simulate an axis with its effects.

    Parameters
    ----------
    given : (n,) the input: N, straight between samples; or mm of the commanded position, a cubic spline between them.
    shot : samples after which the motion begins anew; 0: never.
    begin : (shots, 4) mm and mm/s of the last mass and of the first one at each beginning, NaN where one is not
        known; None: at rest where the input holds them.
    substeps : integration steps a sample; 0: as many as the axis needs.
    coarse : then only as many as it needs where effects are ranked.

    Raises
    ------
    ValueError
        If the motion goes to infinity, or an effect is not complete.
    """
    p = kernel_parameters(machine)
    scaled = given if machine.axis.by_force else 1e-3 * given
    rest = 0.0 if machine.axis.by_force else float(scaled[0])
    first = np.array([[rest, 0.0, rest, 0.0]]) if begin is None else 1e-3 * begin
    steps = substeps or substeps_of(p, dt_s, COARSE_TURNS if coarse else TURNS)
    scaled = np.ascontiguousarray(scaled, float)
    # a drive goes smoothly from order to order: a straight line between them would lose a percent of 100 Hz
    slope = np.empty(0) if machine.axis.by_force else slopes(np.diff(scaled))
    out = integrate_axis(scaled, slope, dt_s, steps, shot or len(given) + 1, np.ascontiguousarray(first), p)
    if not np.all(np.isfinite(out)):
        raise ValueError("With these numbers the axis moves to infinity.")
    t = np.asarray(dt_s * np.arange(len(given)), dtype=np.float64)
    return AxisMotion(t, 1e3 * out[:, 1], 1e3 * out[:, 0], out[:, 2], steps * len(given))


def substeps_of(p: FloatArray, dt_s: float, turns: float = TURNS) -> int:
    """Return how many integration steps a sample needs."""
    v = dict(zip(NAMES, p.tolist(), strict=True))
    least = min(v["mass"], v["load"] or v["mass"])
    omega = math.sqrt((v["stiffness"] + v["coupling"]) / least)
    rate = (v["damping"] + v["coupling_damping"]) / least
    if max(v["cubic"], v["quintic"]) > 0.0:
        omega *= HARDER
    if v["dry"] + v["sticking"] > 0.0:
        rate += (v["dry"] + v["sticking"]) / (v["creep"] * v["mass"])
    if v["bristle"] > 0.0:
        omega = math.hypot(omega, math.sqrt(v["bristle"] / (v["presliding"] * v["mass"])))
    longest = min(LONGEST_STEP_S, turns / max(omega, 1e-9), STEEP / max(rate, 1e-9))
    return min(max(1, math.ceil(dt_s / longest * (1 - 1e-9))), MOST_SUBSTEPS)


@lru_cache(maxsize=8)
def kernel_parameters(machine: AxisMachine) -> FloatArray:
    """Return (34,) the kernel's numbers of an axis with its effects, SI: shared by its runs, not to be written to."""
    axis = machine.axis
    p = dict.fromkeys(NAMES, 0.0) | {"fading_power": 2.0, "creep": 1.0, "presliding": 1.0}
    p |= {"mass": axis.mass_kg, "stiffness": axis.stiffness_n_per_m, "damping": axis.damping_n_s_per_m}
    p |= {
        "offset": axis.offset_n,
        "by_force": float(axis.by_force),
        "coupling_damping": axis.coupling_damping_n_s_per_m,
    }
    p |= {"load": axis.load_mass_kg or 0.0, "coupling": axis.coupling_stiffness_n_per_m or 0.0}
    for name in machine.effects:
        values = values_of(machine, name)
        if values is not None and name in effects_of(machine.moves):
            _add(p, name, {key: float(np.ravel(x)[0]) for key, x in values.items()}, axis)
    return np.array([p[name] for name in NAMES])


def _add(p: dict[str, float], name: str, v: Mapping[str, float], axis: AxisParameters) -> None:
    """Put one effect into the kernel's numbers."""
    if name in ("coulomb_friction", "stribeck_friction"):
        p["dry"] += v["force_n"]
        p["creep"], p["hold"] = 1e-3 * v["creep_mm_per_s"], v["hold_per_s"]
        if name == "stribeck_friction":
            p["sticking"], p["fading"] = v["extra_force_n"], 1e3 / v["velocity_mm_per_s"]
            p["fading_power"] = v["exponent"]
    elif name == "guide_damping":
        p["damping"] += v["added_n_s_per_m"]
    elif name == "belt_stiffness":
        p["coupling" if axis.load_mass_kg and v["at_drive"] <= 0.5 else "stiffness"] *= 1 + v["relative_change"]
    elif name == "cogging":
        p |= {"ripple": 1e-3 * v["amplitude_mm"], "wave": 2e3 * math.pi / v["pitch_mm"]}
        p |= {"phase": math.radians(v["phase_deg"])} | {k: v[k] for k in ("second_sine", "second_cosine")}
    elif name == "cogging_force":
        p |= {"sine": v["sine_n"], "cosine": v["cosine_n"], "force_wave": 2e3 * math.pi / v["pitch_mm"]}
    elif name == "belt_backlash":
        p |= {"half_backlash": 5e-4 * v["width_mm"], "landing": v["landing_s_per_m"], "play_at_drive": v["at_drive"]}
    else:
        p |= {own: factor * v[key] for key, (own, factor) in PLAIN.get(name, {}).items()}


# effect -> its key -> the kernel's number, and what it is multiplied by
PLAIN: Mapping[str, Mapping[str, tuple[str, float]]] = {
    "belt_hardening": {
        "cubic_n_per_m3": ("cubic", 1.0),
        "quintic_n_per_m5": ("quintic", 1.0),
        "at_drive": ("bends_at_drive", 1.0),
    },
    "command_delay": {"delay_s": ("delay", 1.0)},
    "friction_by_direction": {"damping_difference_n_s_per_m": ("by_direction", 1.0)},
    "ground_spring": {"stiffness_n_per_m": ("ground", 1.0)},
    "quadratic_drag": {"force_n_s2_per_m2": ("drag", 1.0)},
    "bristle_friction": {"force_n": ("bristle", 1.0), "presliding_mm": ("presliding", 1e-3)},
}


def with_effects(machine: AxisMachine, effects: Mapping[str, Mapping[str, object]]) -> AxisMachine:
    """Return the axis with these effects added or replaced."""
    unknown = [name for name in effects if name not in CATALOGUE]
    if unknown:
        raise ValueError(f"effects.{unknown[0]} is not an effect ffcomp knows.")
    return replace(machine, effects={**machine.effects, **effects})
