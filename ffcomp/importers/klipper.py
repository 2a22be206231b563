"""Values of a Klipper or Kalico configuration."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from ffcomp.importers.delta import TOWER_ANGLES_DEG, arm_lengths, print_radius
from ffcomp.importers.klipper_file import KlipperConfig
from ffcomp.importers.values import (
    AXES,
    ConfigValues,
    PrinterConfigError,
    Value,
    changed,
    converted,
    known,
    least,
    listed,
    plain_number,
    shaped_axis,
    together,
)
from models.kinematics.delta import DeltaKinematics

KINDS = {
    "delta": "delta",
    "cartesian": "cartesian",
    "limited_cartesian": "cartesian",
    "corexy": "corexy",
    "limited_corexy": "corexy",
}
TOWERS = "abc"
HOMES_ELSEWHERE = ("safe_z_home", "homing_override", "gcode_macro g28")
FULL_STEPS_PER_ROTATION = 200.0
SQUARE_CORNER_VELOCITY_MM_PER_S = 5.0
CRUISE_RATIO = 0.5  # ffcomp plans with the firmware's default
DAMPING_RATIO = 0.1


def from_klipper(config: KlipperConfig) -> ConfigValues:
    """Collect all values of a configuration that a machine file can hold.

    Raises
    ------
    PrinterConfigError
        If it is no configuration of a printer, or of one with unsupported kinematics.
    """
    kind, origin = _kinematics(config)
    of_kind = _delta(config) if kind == "delta" else _straight(config)
    homed = None if _homes_elsewhere(config) else (_homed_delta if kind == "delta" else _homed)(config)
    homing = {"homing.position_mm": homed}
    values = known({**of_kind, **_limits(config), **_steps(config, TOWERS if kind == "delta" else AXES), **homing})
    shaper_hz = _shaper_hz(config) if kind == "delta" else ()
    return ConfigValues("Klipper", kind, origin, values, tuple(_notes(config)), shaper_hz)


def _kinematics(config: KlipperConfig) -> tuple[str, str]:
    option = config.text("printer", "kinematics")
    if option is None:
        remarks = "".join(f" {sentence}" for sentence in config.remarks)
        raise PrinterConfigError(f"{config.name}: the configuration gives no kinematics in [printer].{remarks}")
    if option.text not in KINDS:
        raise PrinterConfigError(
            f"{option.place}: [printer] kinematics = {option.text!r}: ffcomp has delta, cartesian and corexy machines."
        )
    return KINDS[option.text], f"{option.place} [printer] kinematics"


def _default(number: float, option: str) -> Value:
    return Value(number, "default", f"{option} is not given: the firmware's default")


# --- Deltas


def _delta(config: KlipperConfig) -> dict[str, Value | None]:
    radius = config.number("printer", "delta_radius", above=0)
    arms = _of_towers(config, "arm_length")
    return {
        **arm_lengths(arms),
        "kinematics.delta_radius_mm": radius,
        "kinematics.tower_angles_deg": listed(_towers(config)),
        "kinematics.print_radius_mm": print_radius(_asked_radius(config, radius), radius, least(arms)),
        "kinematics.print_height_mm": _print_height(config),
    }


def _towers(config: KlipperConfig) -> list[Value]:
    """Read the towers' angles."""
    return [
        config.number(f"stepper_{tower}", "angle") or _default(angle, f"[stepper_{tower}] angle")
        for tower, angle in zip(TOWERS, TOWER_ANGLES_DEG, strict=True)
    ]


def _print_height(config: KlipperConfig) -> Value | None:
    """Return the lowest endstop; homing may end a little above it, where the endstops differ."""
    lowest, homed = least(_of_towers(config, "position_endstop")), _homed_delta(config)
    if lowest is None or homed is None or isinstance(homed.value, float) or homed.value[2] <= lowest.number:
        return lowest
    return converted(homed.value[2], "where homing ends", lowest)


def _asked_radius(config: KlipperConfig, radius: Value | None) -> Value | None:
    given = config.number("printer", "print_radius", above=0)
    return given or changed(radius, float, "print_radius is not given, so it is the delta_radius")


def _of_towers(config: KlipperConfig, option: str) -> list[Value | None]:
    """Read an option of each tower; towers B and C default to A."""
    first = config.number("stepper_a", option, above=0)
    return [config.number(f"stepper_{tower}", option, above=0) or first for tower in TOWERS]


# --- Cartesian and CoreXY machines


def _straight(config: KlipperConfig) -> dict[str, Value | None]:
    ranges = {f"kinematics.{axis}_range_mm": _range(config, f"stepper_{axis}") for axis in AXES}
    shaped = [_shaped_axis(config, axis) for axis in AXES]
    return {**ranges, **{key: value for axis in shaped for key, value in axis.items()}}


def _range(config: KlipperConfig, section: str) -> Value | None:
    highest = config.number(section, "position_max")
    lowest = config.number(section, "position_min") or _default(0.0, "position_min")
    return None if highest is None else listed([lowest, highest])


def _shaper_hz(config: KlipperConfig) -> tuple[float, ...]:
    found = (_shaper_frequency(config, axis) for axis in AXES)
    return tuple(each.number for each in found if each is not None)


def _shaper_frequency(config: KlipperConfig, axis: str) -> Value | None:
    """Read the shaper's frequency; Kalico calls some shapers smoothers; zero switches either off."""
    found = (config.number("input_shaper", f"{name}_{axis}") for name in ("shaper_freq", "smoother_freq"))
    return next((each for each in found if each is not None and each.number > 0), None)


def _shaped_axis(config: KlipperConfig, axis: str) -> dict[str, Value]:
    frequency = _shaper_frequency(config, axis)
    if frequency is None:
        return {}
    damping = config.number("input_shaper", f"damping_ratio_{axis}", above=0)
    return shaped_axis(axis, frequency, damping or _default(DAMPING_RATIO, f"damping_ratio_{axis}"))


# --- Where homing all axes ends


def _homes_elsewhere(config: KlipperConfig) -> str | None:
    """Return the section by which homing ends elsewhere than at the endstops; None if there is none."""
    return next((section for section, _ in config.options if section.lower() in HOMES_ELSEWHERE), None)


def _homed(config: KlipperConfig) -> Value | None:
    """Return the endstops' position, if every axis has one; a probe that homes Z gives none."""
    found = [config.number(f"stepper_{axis}", "position_endstop") for axis in AXES]
    given = [each for each in found if each is not None]
    return listed(given) if len(given) == len(found) else None


def _homed_delta(config: KlipperConfig) -> Value | None:
    """Return the nozzle's position with each carriage at its endstop."""
    radius, towers = config.number("printer", "delta_radius", above=0), _towers(config)
    arms, endstops = (_of_towers(config, option) for option in ("arm_length", "position_endstop"))
    sources = [each for each in (radius, *arms, *endstops) if each is not None]
    if radius is None or len(sources) < 7:
        return None
    lengths, heights = (np.array([each.number for each in several if each]) for several in (arms, endstops))
    radii = np.full(3, radius.number)
    angles = np.array([each.number for each in towers])
    delta = DeltaKinematics(lengths, radii, angles, effector_height_mm=0.0, print_radius_mm=1.0, print_height_mm=1.0)
    nozzle = delta.forward((heights + np.sqrt(lengths**2 - radii**2))[None])[0]
    return converted([round(float(each), 4) + 0.0 for each in nozzle], "the carriages at their endstops", *sources)


# --- Limits and steps


def _limits(config: KlipperConfig) -> dict[str, Value | None]:
    corner = config.number("printer", "square_corner_velocity")
    return {
        "limits.velocity_mm_per_s": config.number("printer", "max_velocity", above=0),
        "limits.acceleration_mm_per_s2": config.number("printer", "max_accel", above=0),
        "limits.square_corner_velocity_mm_per_s": corner
        or _default(SQUARE_CORNER_VELOCITY_MM_PER_S, "square_corner_velocity"),
        "limits.z_velocity_mm_per_s": config.number("printer", "max_z_velocity", above=0),
        "limits.z_acceleration_mm_per_s2": config.number("printer", "max_z_accel", above=0),
    }


def _steps(config: KlipperConfig, motors: str) -> dict[str, Value | None]:
    found = [_motor(config, f"stepper_{motor}") for motor in motors]
    return {
        "steps.steps_per_mm": together([steps for steps, _ in found]),
        "steps.full_steps_per_mm": together([full_steps for _, full_steps in found]),
        "steps.extruder_steps_per_mm": _motor(config, "extruder")[0],
    }


def _motor(config: KlipperConfig, section: str) -> tuple[Value | None, Value | None]:
    """Compute microsteps and full steps for each mm."""
    microsteps = config.number(section, "microsteps", above=0)
    distance = config.number(section, "rotation_distance", above=0)
    if microsteps is None or distance is None:
        return _motor_of_old_file(config, section, microsteps)
    per_turn = config.number(section, "full_steps_per_rotation", above=0)
    full_steps = (per_turn.number if per_turn else FULL_STEPS_PER_ROTATION) * _gear_ratio(config, section)
    sources = [each for each in (distance, per_turn, microsteps) if each is not None]
    rule = f"{full_steps:g} full steps for {distance.number:g} mm"
    full_steps_per_mm = converted(full_steps / distance.number, rule, *sources[:-1])
    steps_per_mm = full_steps / distance.number * microsteps.number
    return converted(steps_per_mm, f"{rule}, {microsteps.number:g} microsteps each", *sources), full_steps_per_mm


def _motor_of_old_file(
    config: KlipperConfig, section: str, microsteps: Value | None
) -> tuple[Value | None, Value | None]:
    """Convert step_distance, which a motor had until 2021."""
    distance = config.number(section, "step_distance", above=0)
    if distance is None:
        return None, None
    steps_per_mm = converted(1 / distance.number, "one step for each", distance)
    if microsteps is None:
        return steps_per_mm, None
    rule = f"{microsteps.number:g} steps of {distance.number:g} mm for each full step"
    return steps_per_mm, converted(1 / distance.number / microsteps.number, rule, distance, microsteps)


def _gear_ratio(config: KlipperConfig, section: str) -> float:
    """Parse `80:16, 3:1`: motor turns for each turn of the pulley."""
    option = config.text(section, "gear_ratio")
    if option is None or not option.text:
        return 1.0
    place = f"{option.place}: [{section}] gear_ratio"
    pairs = [pair.split(":") for pair in option.text.split(",") if pair.strip()]
    if any(len(pair) != 2 for pair in pairs):
        raise PrinterConfigError(f"{place} = {option.text!r} must be pairs like 80:16 with commas between them.")
    return math.prod(plain_number(up, place, above=0) / plain_number(down, place, above=0) for up, down in pairs)


# --- Settings that a machine file cannot hold


def _notes(config: KlipperConfig) -> Iterator[str]:
    yield from config.remarks
    if elsewhere := _homes_elsewhere(config):
        yield (
            f"Homing ends where [{elsewhere}] leaves the nozzle: if that is always one place, give it as position_mm "
            "in [homing], and the first travel is compensated too."
        )
    ratio = config.number("printer", "minimum_cruise_ratio")
    if ratio is not None and ratio.number != CRUISE_RATIO:
        yield (
            f"{ratio.origin} = {ratio.number:g}: ffcomp plans with {CRUISE_RATIO:g}; say "
            f"SET_VELOCITY_LIMIT MINIMUM_CRUISE_RATIO={ratio.number:g} in the start G-code."
        )
    if (limited := config.text("printer", "kinematics")) and limited.text.startswith("limited_"):
        yield f"{limited.place}: the limits of single axes of {limited.text!r} have no place in a machine file."
