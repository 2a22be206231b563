"""Effects between a command and its carriage: delay, motor, belt, backlash."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from models.arrays import FloatArray
from models.effects.effect import AT_DRIVE, EACH, Effect, Terms, Values, amplitude, shape
from models.machine import Machine
from models.vibration.driven_axis import DrivenAxis

_drive = partial(Effect, of_motors=True)
ANY = ("carriages", "axes", "axis")


def _with_belts(machine: Machine, values: Values) -> Machine:
    """Scale the belts' stiffness, or the drive's of an axis by itself."""
    change, model = values["relative_change"], machine.vibration
    if float(values["at_drive"]) > 0.5 and isinstance(model, DrivenAxis):
        return replace(machine, vibration=model.with_drive(1 + float(change[0])))
    return replace(machine, vibration=model.with_belts(change, machine.kinematics.motors))


BELT_STIFFNESS = _drive(
    name="belt_stiffness",
    title="A drive stiffer or softer than in the file",
    physics="Tension, wear and temperature change a belt's stiffness.",
    equation="k → k (1 + r)",
    parameters=(
        amplitude("relative_change", "r, of belt stiffness", (-0.9, 10), (-0.3, 0.3), 0.02, EACH, usual=lambda s: 1.0),
    ),
    in_data="Resonances shift together; with one tower's belt, only the modes of that tower.",
    confounded_with={
        "effector_mass": "Two places on the bed: mass shifts the modes by other factors.",
        "belt_position_stiffness": "Two heights: only there the shift depends on the carriage's height.",
        "torque_angle": "Two amplitudes: a belt's stiffness is the same for both.",
        "coulomb_friction": "Two amplitudes: a stiffness is the same for both.",
    },
    fold=_with_belts,
    of_axis=(AT_DRIVE,),
    of=ANY,
    needs="spring",
    remedy=(
        "Check the belts' tension{where}, and tension them alike (same note when plucked); check couplings, clamps and "
        "shafts."
    ),
    corrects_file=True,
)


BELT_DAMPING = _drive(
    name="belt_damping",
    title="Damping in the drive",
    physics=(
        "Part of an axis' damping is in its belts, between motor and carriage, and not in the guides, between carriage "
        "and frame. The resonance has the same height, but with damping in the belts the carriage lags less at speed."
    ),
    equation="q/u = (s c λ + k)/(m λ² + c λ + k),  c = 2 ζ ω m",
    parameters=(
        amplitude(
            "share",
            "s: fraction of the guides' damping that is in the belts",
            (0, 1),
            (0, 0.6),
            0.1,
            EACH,
            usual=lambda s: 1.0,
        ),
    ),
    in_data="Nearly as if all channels were early by 2 ζ s/ω, mostly near the resonance and above.",
    confounded_with={
        "sensor_time_offset": "Tones above the resonance: there an offset keeps turning the phase, belts do so once.",
        "command_delay": "Tones above the resonance: there a delay keeps turning the phase, belts do so once.",
        "guide_damping": "The resonance: guide damping changes its height, the belts' share does not.",
    },
    fold=lambda machine, values: replace(machine, vibration=machine.vibration.with_belt_damping(values["share"])),
    of=("axes", "axis"),
    needs="command",
    remedy="Nothing to repair: put the damping{where} in the file's belt_damping_share, or drive_damping.",
    corrects_file=True,
)


BELT_POSITION_STIFFNESS = _drive(
    name="belt_position_stiffness",
    title="Belt stiffness that depends on the free length",
    physics="The free length of the belt between motor and carriage changes as the carriage travels.",
    equation="k(q) = k / (1 − r (q − q_c)), 4 k at most",
    parameters=(
        amplitude("slope_per_m", "r", (-5, 5), (-1, 1), 0.05, EACH),
        shape("q_centre_mm", "q_c: the height where k is the file's", (-1000, 10000), (100, 800), 10.0, EACH),
    ),
    in_data="Resonances differ between low and high prints at the same XY position.",
    confounded_with={"belt_stiffness": "Two heights: a constant change is the same at both."},
    terms=lambda values, _: {"slope": values["slope_per_m"], "centre": values["q_centre_mm"] / 1e3},
    remedy="Check the belts' tension at both ends of the travel{where}, and look for misaligned pulleys.",
)


def _hardening_terms(values: Values, printer: Terms) -> Terms:
    cubic, quintic = values["cubic_n_per_m3"], values["quintic_n_per_m5"]
    at_drive = "stiffness" in printer and float(values["at_drive"]) > 0.5
    peak = _peak_stretch(np.full(3, printer["stiffness"]) if at_drive else printer["motor_k"], cubic, quintic)
    return {"cubic": cubic, "quintic": quintic, "peak_stretch": peak, "hardens_at_drive": values["at_drive"]}


def _peak_stretch(stiffness: FloatArray, cubic: FloatArray, quintic: FloatArray) -> FloatArray:
    """Return the least stretch s > 0 with k + 3 k₃ s² + 5 k₅ s⁴ = 0 : (3,) m; infinite where the force has no peak."""
    inside = 9 * cubic**2 - 20 * stiffness * quintic
    # 2 k/(−3 k₃ + √…) is the smaller root s², and holds for k₅ = 0 too
    below = -3 * cubic + np.sqrt(np.maximum(inside, 0.0))
    softens = (inside >= 0) & (below > 0)
    return np.where(softens, np.sqrt(2 * stiffness / np.where(softens, below, 1.0)), np.inf)


BELT_HARDENING = _drive(
    name="belt_hardening",
    title="A drive that stiffens or softens as it stretches",
    physics="Teeth settle and fibres straighten, so the belt's force is not quite proportional to its stretch.",
    equation="F = k s + k₃ s³ + k₅ s⁵, s = u − q; constant beyond its peak, if it has one",
    parameters=(
        amplitude(
            "cubic_n_per_m3",
            "k₃; negative softens",
            (-1e15, 1e15),
            (-5e11, 2e12),
            1e11,
            EACH,
            on_printers=(0.0, 1e15),  # softening of the same third order is a motor's sine there
            usual=lambda s: max(s.stiffness_n_per_m, 1.0) / s.stretch_m**2,
        ),
        shape("quintic_n_per_m5", "k₅", (-1e24, 1e24), (-1e18, 2e18), 1e17, EACH, default=0.0),
    ),
    in_data=(
        "Resonances shift with amplitude. A sine input causes harmonics: the third and, because weight has already "
        "stretched the belts, the second."
    ),
    confounded_with={
        "torque_angle": "Its cubic part is the same, k₃ = −k/(6a²); only a larger stretch separates the two.",
        "belt_stiffness": "Two amplitudes: only here the stiffness depends on them.",
    },
    of_axis=(AT_DRIVE,),
    of=ANY,
    terms=_hardening_terms,
    needs="spring",
    remedy=(
        "Tension the belts{where}: a belt that stiffens under load is slack, or its clamp yields. Check couplings, end "
        "stops and preload."
    ),
)


def _play_terms(values: Values, printer: Terms) -> Terms:
    half, landing = values["width_mm"] / 2e3, values["landing_s_per_m"]
    return {"half_backlash": half, "landing": landing, "play_at_drive": values["at_drive"]}


BELT_BACKLASH = _drive(
    name="belt_backlash",
    title="Backlash in the drive",
    physics="A loose pulley, gear, key or joint moves freely through a dead band; spring and damper act outside it.",
    equation="F = k (s − w/2 sgn s) + c ṡ for |s| > w/2, else 0",
    parameters=(
        amplitude(
            "width_mm",
            "w: the full dead band",
            (0, 1000),
            (0.01, 0.2),
            0.02,
            EACH,
            on_printers=(0, 5),
            usual=lambda s: 1e3 * s.stretch_m,
        ),
        shape(
            "landing_s_per_m",
            "λ: damping of an impact on the flanks (Hunt & Crossley, 1975)",
            (0, 100),
            (0, 0.5),
            0.05,
            EACH,
            default=0.0,
        ),
    ),
    in_data=(
        "Knocks when the belt's force changes sign. A vertical belt always carries the weight, so backlash shows only "
        "where the motion pushes harder than gravity pulls."
    ),
    confounded_with={
        "coulomb_friction": "Friction acts when the motion reverses, backlash only when the drive's force does.",
        "belt_hardening": "Small motions: both are softest there, but only backlash knocks.",
        "torque_angle": "Slack softens small forces, a motor's torque softens large ones.",
    },
    of_axis=(AT_DRIVE,),
    of=ANY,
    terms=_play_terms,
    needs="spring",
    remedy=(
        "Look for backlash{where}: loose pulley screws, keys, couplings or belt clamps, worn gears, arms or joints."
    ),
)


TORQUE_ANGLE = _drive(
    name="torque_angle",
    title="Motors near their holding torque",
    physics="A stepper's torque is a sine of the angle between rotor and field: soft near its peak.",
    equation="F = k a sin θ, s = u − q = a ((1 − b) θ + b sin θ)",
    parameters=(
        amplitude(
            "amplitude_mm",
            "a: a quarter wave is π a / 2; four full steps are 2 π a",
            (0.01, 100),
            (0.1, 2),
            0.5,
            EACH,
            power=-2,
        ),
        shape(
            "belt_share",
            "b: the belt's fraction of the compliance between motor and carriage",
            (0, 0.45),
            (0, 0.3),
            0.05,
            default=0.0,
        ),
    ),
    in_data="Nothing at normal current; near the peak force k a, softer resonances and lost steps (slips of 2 π a).",
    confounded_with={
        "belt_hardening": "The same to third order; only a larger stretch separates the two.",
        "belt_backlash": "Small motions: backlash softens them, the sine does not.",
    },
    terms=lambda values, _: {"inverse_amplitude": 1e3 / values["amplitude_mm"], "belt_share": values["belt_share"]},
    remedy="Raise the motor current within the motors' rating, or lower accelerations.",
)


PITCH_SHARES = np.geomspace(1 / 40, 1 / 2, 12)  # of the travel, tried as pitches on an axis by itself


COGGING = _drive(
    name="cogging",
    title="Motor ripple once per cycle",
    acts_on="command",
    physics="Between full steps, the rotor's equilibrium differs from the ideal microstep position.",
    equation="u → u + a (sin θ + s₂ sin 2θ + c₂ cos 2θ),  θ = 2π u_d / p + φ",
    parameters=(
        amplitude("amplitude_mm", "a", (0, 1), (0.002, 0.05), 0.005, EACH, usual=lambda s: 1e3 * s.stretch_m),
        shape(
            "pitch_mm",
            "p: period of the ripple, usually one or four full steps",
            (0.01, 50),
            (0.1, 1),
            0.01,
            EACH,
            tried=lambda s: (1e3 * s.travel_m * PITCH_SHARES).tolist(),
        ),
        shape(
            "phase_deg",
            "φ: phase of a motor at height zero",
            (-360, 360),
            (-180, 180),
            5.0,
            EACH,
            unit="deg",
            default=0.0,
            starts=(0.0, 90.0, 180.0, -90.0),
        ),
        shape("second_sine", "s₂: of half the pitch", (-2, 2), (-0.3, 0.3), 0.02, EACH, default=0.0),
        shape("second_cosine", "c₂", (-2, 2), (-0.3, 0.3), 0.02, EACH, default=0.0),
    ),
    in_data="A spectral line at speed/p that moves with the speed; stripes on the print at a fixed pitch.",
    confounded_with={"belt_stiffness": "Moves at several speeds: a resonance stays, ripple moves with the speed."},
    of=ANY,
    terms=lambda values, _: {
        "ripple": values["amplitude_mm"] / 1e3,
        "wave": 2e3 * np.pi / values["pitch_mm"],
        "phase": np.radians(values["phase_deg"]),
        "second_sine": values["second_sine"],
        "second_cosine": values["second_cosine"],
    },
    needs="command",
    remedy=(
        "Calibrate the drivers' microsteps or the encoder, or lower the current{where}; stiffer mounts do not help."
    ),
)


COMMAND_DELAY = _drive(
    name="command_delay",
    law_of="lateness",
    title="A delay between command and motor",
    acts_on="command",
    physics="Electronics, filters and step pulses take time, so the motor executes the command late.",
    equation="u_d(t) → u_d(t − τ)",
    parameters=(
        amplitude("delay_s", "τ", (0, 0.1), (1e-4, 5e-3), 1e-4, EACH, unit="s", usual=lambda s: 1 / s.highest_hz),
    ),
    in_data="The whole response shifts in time; the phase falls in proportion to frequency.",
    confounded_with={
        "guide_damping": "Several speeds and frequencies: damping lowers the resonance, a delay does not.",
        "sensor_time_offset": "A delay of one tower only, or position sensors on the same clock as the command.",
    },
    of=ANY,
    terms=lambda values, printer: {"delay": values["delay_s"] + printer.get("delay", 0.0)},
    remedy="Nothing to repair: the firmware or drives act late{where}. Once in the file, it is compensated.",
)
