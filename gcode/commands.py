"""The effect of each command that is not a move, on the modal state and on the motion around it.

Read it from the bottom: `EFFECTS` maps names to effects, or to functions that change the state and return the effect;
`OWN_EFFECTS` those that a firmware treats differently. The motion may continue through the command (PASS) or must rest
(STOP, DWELL). If the position is unknown after the command, the function makes the state forget it.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from itertools import chain
from math import isnan
from typing import NamedTuple

from gcode.dialect import KLIPPER, MARLIN, REPRAPFIRMWARE
from gcode.dialects import limit_unit
from gcode.errors import GcodeError, UnsupportedGcode
from gcode.program import MACHINE_LIMITS, EventKind, LimitCommand, RawMove
from gcode.state import AXES, FIRST_AXES, INCH_MM, Modal
from gcode.words import Command


class Effect(NamedTuple):
    """What one command does."""

    kind: EventKind
    dwell_s: float = 0.0
    limits: LimitCommand | None = None
    warning: str = ""
    unknown: bool = False  # a code that is not in the table; all such codes share a warning
    moves_itself: bool = False
    returns: bool = False
    raw: RawMove | None = None
    lasts_s: float = 0.0


Handler = Callable[[Modal, Command], Effect]

_TOOL_NAME = re.compile(r"T(-?\d+|\?)")
_FILAMENT_NAME = re.compile(r"T[0-3]?\d")  # Bambu's T255 and T1000 are not filaments
_M_CODE = re.compile(r"M\d+(\.\d+)?")
_STATUS_NAME = re.compile(r"_?STATUS_[A-Z_]+|_?SET_\w*LEDS?\w*")  # Voron's Stealthburner and similar
_PARK_NAME = re.compile(r"P\d+")  # Prusa XL: the next tool comes from the dock

PASS = Effect(EventKind.PASS)
STOP = Effect(EventKind.STOP)
MOVED = Effect(EventKind.STOP, moves_itself=True)
RETURNED = Effect(EventKind.STOP, returns=True)  # to the position before it, if it moves at all
UNKNOWN = Effect(EventKind.STOP, unknown=True, moves_itself=True)


def apply(modal: Modal, command: Command) -> Effect:
    """Apply one command; unknown ones stop the motion, because they may move the machine."""
    if command.name in modal.returns:
        return RETURNED
    own = OWN_EFFECTS[modal.dialect.name]
    if effect := own.get(command.name) or EFFECTS.get(command.name):
        return effect if isinstance(effect, Effect) else effect(modal, command)
    if _TOOL_NAME.fullmatch(command.name):
        return _tool(modal, command)
    if _PARK_NAME.fullmatch(command.name):
        modal.tool = command.name
        return _move_away(modal, command)
    if command.name.startswith("EXCLUDE_OBJECT"):
        return PASS
    if _STATUS_NAME.fullmatch(command.name):
        return STOP
    return _unknown(modal, command)


def _move_away(modal: Modal, command: Command) -> Effect:
    """Rest and forget the position: the machine moves by itself."""
    modal.forget()
    return MOVED


def _home(modal: Modal, command: Command) -> Effect:
    """Homing also undoes G92. On a delta it moves all axes, whichever were named."""
    modal.take_names_back()
    modal.forget_even_roughly()
    return MOVED


def _unknown(modal: Modal, command: Command) -> Effect:
    if not _M_CODE.fullmatch(command.name):
        modal.forget()
        modal.motion = ""  # the macro may continue with bare words
    return UNKNOWN


def _refuse(modal: Modal, command: Command) -> Effect:
    if not modal.dialect.refuses:
        return _unknown(modal, command)
    what = "makes numbers depend on offsets, units, turns or conditions that are not followed"
    raise UnsupportedGcode(f"{command.name} {what}; slice without it.", command.line)


def _tool(modal: Modal, command: Command) -> Effect:
    same = command.name == (modal.tool or "T0")  # firmware begins with its first tool
    modal.tool = command.name
    before, has_filament = modal.filament, _FILAMENT_NAME.fullmatch(command.name) is not None
    modal.filament = command.name if has_filament else before
    if same:
        return STOP
    changes = has_filament and before not in ("", command.name)
    return _move_away(modal, command)._replace(lasts_s=modal.filament_change_s if changes else 0.0)


def _dwell(modal: Modal, command: Command, by_s: bool = True) -> Effect:
    words = command.settings()
    seconds = words["S"] if by_s and "S" in words else words.get("P", 0.0) / 1000
    if seconds < 0:
        raise GcodeError(f"G4 waits {seconds:g} s; a wait cannot be negative.", command.line)
    return Effect(EventKind.DWELL, seconds)


def _finish_moves(modal: Modal, command: Command) -> Effect:
    """M400: Bambu's, which is a Marlin, also waits P ms or S s."""
    words = command.settings()
    seconds = max(words.get("S", 0.0) + words.get("P", 0.0) / 1000, 0.0)
    return Effect(EventKind.STOP, seconds) if seconds else STOP


def _retraction_or_tool_setting(modal: Modal, command: Command) -> Effect:
    """G10 alone retracts by an amount set in the firmware; with P, S or R it sets a tool's values, with L others."""
    letters = command.letters()
    if "L" in letters:
        return _refuse(modal, command)
    if "P" in letters and letters & set("XYZ"):  # the tool's offsets, from now on
        return _move_away(modal, command)
    return PASS if letters & set("PSR") else STOP


# -- modes --


def _mode(modal: Modal, command: Command) -> Effect:
    match command.name:
        case "G20" | "G21":
            modal.unit = INCH_MM if command.name == "G20" else 1.0
        case "G90" | "G91":
            modal.absolute = command.name == "G90"
            if modal.dialect.g90_sets_e:
                modal.absolute_e = modal.absolute
        case "M82" | "M83":
            modal.set_e_mode(absolute=command.name == "M82")
        case "M120":
            modal.pushed.append((modal.absolute, modal.absolute_e, modal.feed, modal.unit))
        case "M121":
            if modal.pushed:
                modal.absolute, modal.absolute_e, modal.feed, modal.unit = modal.pushed.pop()
        case _:
            modal.plane = FIRST_AXES[{"G17": "XY", "G18": modal.dialect.g18_axes, "G19": "YZ"}[command.name]]
    return PASS


def _rename(modal: Modal, command: Command) -> Effect:
    words = command.numbers()
    modal.rename(words)
    if set(words) & set(AXES) == {"E"}:
        return PASS
    if any(isnan(number) for number in modal.base):
        rule = "moves pass through uncompensated until the machine homes"
        return Effect(EventKind.STOP, warning=f"{command.name} names a position relative to an unknown one; {rule}")
    return STOP


def _names_back(modal: Modal, command: Command) -> Effect:
    """G92.1 undoes G92 for X, Y and Z."""
    modal.take_names_back()
    return STOP


def _percent(command: Command) -> float | None:
    """Return the factor, or None if none is set (Bambu's `M221 S` and `M221 Z0` concern its endstops)."""
    share = command.settings().get("S")
    if share is not None and share <= 0:
        raise GcodeError(f"{command.name} S{share:g} is not a factor; a percentage must be above zero.", command.line)
    return None if share is None else share / 100


def _feed_factor(modal: Modal, command: Command) -> Effect:
    if (factor := _percent(command)) is not None:
        modal.set_feed_factor(factor)
    return PASS


def _feed_factor_of_marlin(modal: Modal, command: Command) -> Effect:
    """M220: R restores the factor that an earlier B saved; S is applied last."""
    letters, in_force = command.letters(), modal.feed_factor
    if "R" in letters:
        modal.set_feed_factor(modal.kept_feed_factor)
    if "B" in letters:
        modal.kept_feed_factor = in_force
    return _feed_factor(modal, command)


def _flow(modal: Modal, command: Command) -> Effect:
    if (flow := _percent(command)) is not None:  # the file's E continues without a jump
        in_file = (modal.position[3] - modal.base[3]) / modal.flow
        modal.base[3] = modal.position[3] - in_file * flow
        modal.flow = flow
    return PASS


def _gcode_offset(modal: Modal, command: Command) -> Effect:
    fields, before = command.field_numbers(), modal.homing[:]
    for axis, letter in enumerate(AXES):
        if letter in fields:
            modal.offset_axis(axis, fields[letter])
        elif f"{letter}_ADJUST" in fields:
            modal.offset_axis(axis, modal.homing[axis] + fields[f"{letter}_ADJUST"])
    if _moves(command):  # by as much as the offsets have changed
        x, y, z, _ = (p + new - old for p, new, old in zip(modal.position, modal.homing, before, strict=True))
        modal.position = [x, y, z, modal.position[3]]
    return STOP


def _moves(command: Command) -> bool:
    return command.fields().get("MOVE", "0") != "0"


def _save_state(modal: Modal, command: Command) -> Effect:
    modal.save(command.fields().get("NAME", "default"))
    return STOP


def _restore_state(modal: Modal, command: Command) -> Effect:
    name = command.fields().get("NAME", "default")
    if name not in modal.saved:
        modal.forget()
        rule = "modes and offsets are assumed unchanged, and nothing is compensated until the file names a place again"
        warning = f"RESTORE_GCODE_STATE restores {name!r}, which the file never saved; {rule}"
        return Effect(EventKind.STOP, warning=warning, moves_itself=True)
    saved = modal.saved[name]
    modal.restore(saved)
    if _moves(command):
        modal.position, modal.z_known = [*saved["position"][:3], modal.position[3]], saved["z_known"]
        return MOVED
    return STOP


# -- limits --


def _acceleration(modal: Modal, command: Command) -> Effect:
    """M204: P for printing, T for travel."""
    words = _limit_words(modal, command)
    if "S" in words:
        both = words.pop("S")
        words = {"P": both, "T": both, **words}
    return _accelerations(modal, command, words)


def _acceleration_of_klipper(modal: Modal, command: Command) -> Effect:
    """M204: S, or the smaller of P and T if both are there."""
    words = _limit_words(modal, command)
    value = words["S"] if "S" in words else min(words["P"], words["T"]) if words.keys() >= {"P", "T"} else None
    return _accelerations(modal, command, {} if value is None else {"P": value})


def _accelerations(modal: Modal, command: Command, words: dict[str, float]) -> Effect:
    named = {"P": "acceleration", "T": "travel_acceleration"}
    modal.set_limits(**{name: _positive(words[letter], command) for letter, name in named.items() if letter in words})
    return _limits(modal, command.name, words)


def _limit_words(modal: Modal, command: Command) -> dict[str, float]:
    """Return the words of a command that sets limits, mm, mm/s, mm/s²."""
    words = command.settings().items()
    return {letter: value * limit_unit(modal.dialect.name, command.name, letter, modal.unit) for letter, value in words}


def _limits(modal: Modal, code: str, words: dict[str, float] | None = None) -> Effect:
    return Effect(EventKind.PASS, limits=LimitCommand(code, words or {}, modal.limits))


def _positive(value: float, command: Command) -> float:
    if value <= 0:
        raise GcodeError(f"{command.name} sets a limit of {value:g}; limits must be above zero.", command.line)
    return value


def _smallest_xy(words: dict[str, float], command: Command) -> float | None:
    return min((_positive(words[letter], command) for letter in "XY" if letter in words), default=None)


def _axis_limits(modal: Modal, command: Command) -> Effect:
    """M201 and M203: limits of the axes."""
    words, by_speed = _limit_words(modal, command), command.name == "M203"
    if (value := _smallest_xy(words, command)) is not None:
        modal.set_caps(**{"velocity" if by_speed else "acceleration": value})
    if by_speed and "E" in words:
        modal.set_caps(filament_velocity=_positive(words["E"], command))
    return _limits(modal, command.name, words)


def _jerk(modal: Modal, command: Command) -> Effect:
    """M205, M566: at a right angle each axis jumps by the whole speed, so the axis jerk is the corner velocity."""
    words = _limit_words(modal, command)
    if (value := _smallest_xy(words, command)) is not None:
        modal.set_limits(square_corner_velocity=value)
    return _limits(modal, command.name, words)


def _jerk_as_m566(modal: Modal, command: Command) -> Effect:
    """RepRapFirmware also obeys M205, in mm/s."""
    words = _limit_words(modal, command)
    _jerk(modal, command)
    return _limits(modal, "M566", {axis: words[axis] for axis in AXES if axis in words})


def _velocity_limit(modal: Modal, command: Command) -> Effect:
    fields = command.field_numbers()
    for key in fields.keys() & _LIMIT_FIELDS.keys():
        _positive(fields[key], command)
    modal.set_limits(**{name: fields[key] for key, name in _LIMIT_FIELDS.items() if key in fields})
    if (ratio := fields.get("MINIMUM_CRUISE_RATIO")) is not None:
        if not 0.0 <= ratio < 1.0:
            rule = "Klipper stops unless it is at least 0 and below 1"
            raise GcodeError(f"{command.name} has MINIMUM_CRUISE_RATIO={ratio:g}; {rule}.", command.line)
        modal.set_limits(minimum_cruise_ratio=ratio)
    return _limits(modal, command.name)._replace(warning=_accel_to_decel_warning(modal, fields))


def _accel_to_decel_warning(modal: Modal, fields: dict[str, float]) -> str:
    """Warn where older Klippers would use another cruise ratio; slicers also write ACCEL_TO_DECEL for the default."""
    value, acceleration = fields.get("ACCEL_TO_DECEL"), modal.limits.acceleration
    if value is None or "MINIMUM_CRUISE_RATIO" in fields or isnan(acceleration):
        return ""
    usual = 0.5 if isnan(modal.limits.minimum_cruise_ratio) else modal.limits.minimum_cruise_ratio
    ratio = 1.0 - min(value / acceleration, 1.0)
    if abs(ratio - usual) < 0.01:
        return ""
    rule = f"only Klipper before 2024 obeys it (a cruise ratio of {ratio:.3g}); ffcomp plans with {usual:g}"
    return f"ACCEL_TO_DECEL={value:g} is not followed: {rule}; set MINIMUM_CRUISE_RATIO instead"


_LIMIT_FIELDS = {
    "VELOCITY": "velocity",
    "ACCEL": "acceleration",
    "SQUARE_CORNER_VELOCITY": "square_corner_velocity",
    "ACCEL_TO_DECEL": "accel_to_decel",
}


def _reset_limits(modal: Modal, command: Command) -> Effect:
    modal.requested = MACHINE_LIMITS
    modal.set_limits()
    return _limits(modal, command.name)


def _motors_off(modal: Modal, command: Command) -> Effect:
    """M18 and M84: E alone switches off the extruder only, and S only sets the idle timeout."""
    letters = command.letters()
    if letters == {"S"}:
        return PASS
    if letters == {"E"}:
        return STOP
    modal.forget_even_roughly()
    return STOP


def _begin_condition(modal: Modal, command: Command) -> Effect:
    """Bambu's M622: the printer may skip the lines up to its M623."""
    modal.conditions.append(modal.whereabouts())
    return STOP


def _end_condition(modal: Modal, command: Command) -> Effect:
    """M623: the position is known only if nothing moved since M622."""
    if not modal.conditions or modal.conditions.pop() != modal.whereabouts():
        return _move_away(modal, command)
    return STOP


def _volumetric(modal: Modal, command: Command) -> Effect:
    """M200 D0 keeps E in mm; any other diameter makes it mm³."""
    return _refuse(modal, command) if command.settings().get("D") else PASS


_PASSING = str.split("""
    G15 G40 G49 G50 G54 G69 G80 G91.1 G94 M20 M21 M27 M31 M42 M73 M75 M76 M77 M78 M85 M92 M104 M105 M106 M107 M108
    M110 M111 M112 M113 M114 M115 M117 M118 M119 M140 M141 M150 M155 M163 M207 M208 M209 M211 M218
    M300 M301 M302 M304 M413 M503 M550 M555 M562 M568 M572 M603 M851 M862.1 M862.2 M862.3
    M862.4 M862.5 M862.6 M900 M907 M16 M73.2 M74 M122 M142 M201.2 M204.2 M217 M220.2 M355 M404 M405 M406 M412 M591
    M592
    ACTION_NOTIFICATION DISPLAY_STATUS RESPOND SAVE_VARIABLE
    SET_DISPLAY_GROUP SET_DISPLAY_TEXT SET_FAN_SPEED SET_FILAMENT_SENSOR SET_GCODE_VARIABLE
    SET_HEATER_TEMPERATURE SET_IDLE_TIMEOUT SET_LED SET_LED_TEMPLATE SET_PIN SET_PRESSURE_ADVANCE
    SET_PRINT_STATS_INFO SET_RETRACTION SET_TEMPERATURE_FAN_TARGET TURN_OFF_HEATERS
    UPDATE_DELAYED_GCODE ECHO VAR GLOBAL SET
""")
_RESTING = str.split("""
    G11 G29.1 G29.2 G392 M3 M4 M5 M17 M80 M101 M103 M109 M116 M190 M191 M280 M303 M420 M500 M501 M502
    M504 M569 M575 M593 M620.1 M620.3 M622.1 M630 M906 M911 M912 M913 M914 M915 M919 M960 M971 M973
    M975 M981 M982.2 M991 M1002 M1003 M1007 M9833.2
    MANUAL_STEPPER SET_INPUT_SHAPER SYNC_EXTRUDER_MOTION TEMPERATURE_WAIT
""")
# Macros that return to where they started. The last four groups move nothing unless the owner configured it: timelapse
# of Moonraker, Mainsail, Creality, Qidi, whose parking is off by default; fans, lamps, states and layer hooks of Voron,
# Klippain, RatOS, Creality.
RETURNING_MACROS = {
    "pauses, filament changes": str.split("M0 M1 M25 M226 M600 M601 M602 PAUSE RESUME"),
    "wiping": str.split("""
        CLEAN_NOZZLE NOZZLE_CLEAN CLEANNOZZLE WIPE_NOZZLE NOZZLE_WIPE NOZZLE_CLEANING NOZZLE_SCRUB SCRUB_NOZZLE
        BRUSH_NOZZLE NOZZLE_BRUSH WIPE BRUSH
    """),
    "photographs": str.split("""
        M240 TIMELAPSE_TAKE_FRAME HYPERLAPSE TIMELAPSE_RENDER _TIMELAPSE_NEW_FRAME TAKE_FRAME TIMELAPSE TAKE_TIMELAPSE
        TAKE_PHOTO TAKE_SNAPSHOT SNAPSHOT
    """),
    "fans and filters": str.split("""
        PART_FAN PART_FANS PART_FAN_ON PART_FAN_OFF SET_PART_FAN COOLING_FAN AUX_FAN AUX_FAN_ON AUX_FAN_OFF SET_AUX_FAN
        CHAMBER_FAN EXHAUST_FAN EXHAUST_FAN_ON EXHAUST_FAN_OFF SIDE_FAN NEVERMORE_ON NEVERMORE_OFF START_FILTER
        STOP_FILTER FILTER_ON FILTER_OFF AIR_FILTER FAN_ON FAN_OFF SET_EXHAUST_FAN
    """),
    "lamps and sounds": str.split("""
        LIGHT LIGHT_ON LIGHT_OFF LIGHTS LIGHTS_ON LIGHTS_OFF LED LED_ON LED_OFF LEDS_ON LEDS_OFF CASELIGHT_ON
        CASELIGHT_OFF CASE_LIGHT_ON CASE_LIGHT_OFF STOP_LED_EFFECTS BEEP BEEPER
    """),
    "layers and states": str.split("""
        SET_PAUSE_NEXT_LAYER SET_PAUSE_AT_LAYER LAYER_CHANGE _LAYER_CHANGE ON_LAYER_CHANGE _ON_LAYER_CHANGE
        AFTER_LAYER_CHANGE BEFORE_LAYER_CHANGE _AFTER_LAYER_CHANGE _BEFORE_LAYER_CHANGE BEFORE_LAYER AFTER_LAYER
        _ON_LAYER _PRINT_STATUS PRINT_STATUS UPDATE_PRINT_STATS SET_PRINT_STATE SET_PRINT_PROGRESS PRINT_PROGRESS
        CLEAR_DISPLAY DISPLAY_MESSAGE
    """),
}
# Firmware skips the moves of an object that is excluded while printing. The next move then begins elsewhere, at rest.
# It starts from the stated position and runs at travel speed within the file's own limits.
_OBJECTS = str.split("EXCLUDE_OBJECT_START EXCLUDE_OBJECT_END M486")
_STILL = str.split("""
    SET_TMC_CURRENT SET_TMC_FIELD SET_SMOOTH_TIME SET_EXTRUDER_ROTATION_DISTANCE SET_SERVO SET_DIGIPOT
    QUERY_FILAMENT_SENSOR QUERY_ENDSTOPS GET_POSITION HELP CLEAR_PAUSE
    ENABLE_FILAMENT_SENSOR DISABLE_FILAMENT_SENSOR SET_SKEW SKEW_PROFILE
""")
_MOVING_AWAY = str.split("""
    G12 G27 G29 G30 G31 G32 G33 G34 G38.2 G38.3 G38.4 G38.5 G53 M2 M30 M48 M81 M98 M125 M206
    M401 M402 M428 M524 M605 M620 M621 M665 M666 M701 M702 M970 M970.3 M972
    M974 M976 M977 M982 M983 M983.1 M983.3 M983.4 M984 M1006 ACTIVATE_EXTRUDER SET_KINEMATIC_POSITION
    BED_MESH_CALIBRATE BED_MESH_CLEAR BED_MESH_OFFSET BED_MESH_PROFILE CANCEL_PRINT
    DELTA_CALIBRATE END_PRINT PRINT_END PRINT_START PROBE QUAD_GANTRY_LEVEL START_PRINT
    Z_TILT_ADJUST
""")
_REFUSED = str.split("""
    G16 G41 G42 G43 G43.1 G43.2 G51 G52 G55 G56 G57 G58 G59 G59.1 G59.2 G59.3 G68 G90.1
    G92.2 G92.3 G93 G95 IF ELIF ELSE WHILE BREAK CONTINUE ABORT
""")

EFFECTS: dict[str, Handler | Effect] = {
    **dict.fromkeys(_PASSING, PASS),
    **dict.fromkeys([*_RESTING, *_STILL], STOP),
    **dict.fromkeys(chain(*RETURNING_MACROS.values(), _OBJECTS), RETURNED),
    **dict.fromkeys(_MOVING_AWAY, _move_away),
    **dict.fromkeys(_REFUSED, _refuse),
    **dict.fromkeys(("G17", "G18", "G19", "G20", "G21", "G90", "G91", "M82", "M83"), _mode),
    **dict.fromkeys(("M18", "M84"), _motors_off),
    **dict.fromkeys(("M120", "M121"), PASS),  # endstops on and off
    "G4": _dwell,
    "M400": STOP,
    "G10": _retraction_or_tool_setting,
    "G28": _home,
    "G92": _rename,
    "G92.1": _names_back,
    "M200": _volumetric,
    **dict.fromkeys(("M201", "M203"), _axis_limits),
    "M204": _acceleration,
    "M205": _jerk,
    "M220": _feed_factor,
    "M221": _flow,
    "M566": _jerk,
    "M622": _begin_condition,
    "M623": _end_condition,
    "RESET_VELOCITY_LIMIT": _reset_limits,
    "RESTORE_GCODE_STATE": _restore_state,
    "SAVE_GCODE_STATE": _save_state,
    "SET_GCODE_OFFSET": _gcode_offset,
    "SET_VELOCITY_LIMIT": _velocity_limit,
}
# Commands that a firmware treats differently, by the name of its dialect (`gcode.dialect`).
OWN_EFFECTS: dict[str, dict[str, Handler | Effect]] = {
    KLIPPER: {
        **dict.fromkeys(("G92.1", "M120", "M121"), UNKNOWN),
        **dict.fromkeys(("M201", "M203", "M205", "M566"), PASS),
        "G4": partial(_dwell, by_s=False),  # it ignores S
        "M204": _acceleration_of_klipper,
    },
    MARLIN: {"M220": _feed_factor_of_marlin, "M400": _finish_moves, "M566": PASS},
    REPRAPFIRMWARE: {"M120": _mode, "M121": _mode, "M205": _jerk_as_m566},
}
