"""What an axis that a force drives may hide: the effects of the catalogue, and what none of them is meant for.

`EFFECTS[name](rng, size, real)` → (the table a machine file would have to hold, the axis with the effect).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from validation.blind.printer.hidden import SHARED, of_kind
from validation.blind.printer.real import Hide, Real, Rng, sign
from validation.blind.straight.drawn import AXES, masses, springs
from validation.blind.straight.single import presliding_friction

FORCED = replace(AXES, friction=(0.3, 1.5), stiction=(0.4, 1.5), grease=(2.0, 8.0), play_mm=(0.04, 0.12))
LOUD_M_PER_S2 = 4.0  # under which a coupling that hardens has its usual stretch

_SHARED = of_kind(SHARED, FORCED)


def _alone(name: str) -> Hide:
    """Return an effect of printers with the table of one axis; friction turns over as a tanh."""

    def hide(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
        table, changed = _SHARED[name](rng, size, real)
        own = {key: value[0] if isinstance(value, list) else value for key, value in table.items()}
        return own, changed.having(dry_kind=1) if name.endswith("_friction") else changed

    return hide


def bristle_friction(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide dry friction that bends before it slides."""
    force = size * rng.uniform(*FORCED.friction) * masses(real)[0]
    return presliding_friction(rng, real, float(force), rng.uniform(1.5e-5, 1.2e-4))


def friction_by_direction(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide viscous friction that is larger one way; it turns over within some mm/s."""
    difference = size * sign(rng) * rng.uniform(1.5, 6.0) * masses(real)[0]
    return {"damping_difference_n_s_per_m": difference}, real.having(direction=difference)


def quadratic_drag(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide what is pushed aside."""
    drag = size * rng.uniform(20.0, 80.0) * masses(real)[0]
    return {"force_n_s2_per_m2": drag}, real.having(drag=drag)


def ground_spring(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a hose that pulls to one place, by some thousandths more the farther it is bent."""
    stiff = size * rng.uniform(10.0, 50.0) * masses(real)[0]
    return {"stiffness_n_per_m": stiff}, real.having(hose=stiff, hose_at=rng.uniform(0.3, 0.6))


def cogging_force(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide the pull of magnets or teeth, with a second harmonic."""
    force, phase = size * rng.uniform(0.25, 1.0) * masses(real)[0], rng.uniform(0.0, 2 * np.pi)
    pitch = float(rng.choice([4.0, 5.0, 10.0, 16.0]))
    table = {"sine_n": force * np.cos(phase), "cosine_n": force * np.sin(phase), "pitch_mm": pitch}
    second = rng.uniform(0.03, 0.1)
    fields = {"tooth_wave": 2e3 * np.pi / pitch, "tooth_phase": phase, "tooth_second": second}
    return table, real.having(tooth=force, **fields)


def command_delay(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a force that acts later than it is recorded; the delay wanders by a hundredth."""
    delay = size * rng.uniform(4e-4, 2e-3)
    wander = {"delay_pace": rng.uniform(15.0, 40.0), "delay_phase": rng.uniform(0.0, 2 * np.pi)}
    return {"delay_s": delay}, real.having(delay=delay, **wander)


def belt_stiffness(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a coupling that is stiffer or softer than the file says."""
    change = size * sign(rng) * rng.uniform(0.12, 0.25)
    stiff = [k * (1 + change) for k in real.machine["plant"]["belt_k"]]
    return {"relative_change": change}, real.changed("plant", belt_k=stiff)


def belt_hardening(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a coupling that hardens: half as much again at about its usual stretch, a fifth power beyond."""
    stretch = rng.uniform(0.6, 1.5) * LOUD_M_PER_S2 * _softness(real)
    cubic = size * 0.5 * springs(real) / stretch**2
    return {"cubic_n_per_m3": float(cubic[0])}, real.having(cubic=cubic, quintic=0.1 * cubic / stretch**2)


def _softness(real: Real) -> float:
    """Return by how much the coupling is stretched by 1 m/s², m."""
    plant = real.machine["plant"]
    return float(plant["tool"][0] / max(plant["belt_k"][0], 1e-9)) or 1.0


OF_AXES = (
    friction_by_direction,
    quadratic_drag,
    ground_spring,
    cogging_force,
    command_delay,
    belt_stiffness,
    belt_hardening,
)
EFFECTS: Mapping[str, Hide] = {
    **{name: _alone(name) for name in ("coulomb_friction", "stribeck_friction")},
    "bristle_friction": bristle_friction,
    **{name: _alone(name) for name in ("guide_damping", "belt_backlash")},
    **{hide.__name__: hide for hide in OF_AXES},
}


def pendulum_gravity(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide an arm, not balanced, that hangs down somewhere near where the axis begins."""
    force, angle = size * rng.uniform(0.3, 1.5) * masses(real)[0], rng.uniform(-90.0, 90.0)
    wave = {"weight_wave": 1 / real.machine["rim_m"], "weight_at": np.radians(angle)}
    return {"force_n": force, "angle_deg": angle}, real.having(weight=force, **wave)


def friction_by_load(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide teeth that rub in proportion to what they pass on."""
    share = size * rng.uniform(0.05, 0.25)
    return {"share": share}, real.having(load=share)


TURNING: Mapping[str, Hide] = {
    **EFFECTS,
    "pendulum_gravity": pendulum_gravity,
    "friction_by_load": friction_by_load,
}


# ---- outside the catalogue -----------------------------------------------------------------------


def warming_motor(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide magnets that weaken while the motor works; before the next run they cool."""
    return {}, real.having(fade=size * rng.uniform(0.12, 0.25), fade_s=rng.uniform(0.5, 1.5))


def weak_amplifier(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide an amplifier that gives less than it says the more is asked of it."""
    return {}, real.having(limit=rng.uniform(4.0, 8.0) * masses(real)[0] / size if size > 0 else 0.0)


def commutation(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a motor whose force for one ampere goes up and down from magnet to magnet."""
    pitch = rng.uniform(8e-3, 16e-3)
    wave = {"commute_wave": 2 * np.pi / pitch, "commute_phase": rng.uniform(0.0, 2 * np.pi)}
    return {}, real.having(commute=size * rng.uniform(0.1, 0.25), **wave)


def swinging_cable(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a heavy cable that hangs on the end, and swings by itself."""
    mass, omega = size * rng.uniform(0.06, 0.15) * masses(real)[0], 2 * np.pi * rng.uniform(6.0, 16.0)
    fields = {"cable_k": mass * omega**2, "cable_b": 2 * rng.uniform(0.05, 0.15) * omega * mass}
    return {}, real.having(cable_mass=mass if size > 0 else 1.0, **fields)


def loose_load(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a load that slides where it is pushed harder than friction holds it."""
    plant = real.machine["plant"]
    carries = plant["tool"][0] or plant["carriage"][0]
    return {}, real.having(loose=[size * rng.uniform(0.15, 0.3) * carries] * 2, loose_grip=rng.uniform(0.8, 2.0))


def bent_rail(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a place where the rail pinches: dry friction there and nowhere else."""
    where = {"bump_at": rng.uniform(-8e-3, 8e-3), "bump_wide": rng.uniform(3e-3, 8e-3)}
    return {}, real.having(bump=size * rng.uniform(1.0, 2.5) * masses(real)[0], **where)


def unbalanced_spindle(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a spindle on the axis whose unbalance pushes it to and fro."""
    wave = 2 * np.pi * rng.uniform(20.0, 60.0)
    return {}, real.having(spin=size * rng.uniform(0.3, 1.0) * masses(real)[0], spin_wave=wave)


OUTSIDE: Mapping[str, Hide] = {
    hide.__name__: hide
    for hide in (
        warming_motor,
        weak_amplifier,
        commutation,
        swinging_cable,
        loose_load,
        bent_rail,
        unbalanced_spindle,
    )
}
