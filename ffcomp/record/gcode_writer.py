"""The G-code of a plan, and the commands around its experiments in each firmware's words.

A capture starts and ends around each experiment; corrections (shaper, mesh, skew) are off in between and back on at the
end. Klipper and Kalico ignore a command that their configuration does not have, with a message; so does Marlin.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.record.plan import SETTLE_S, Experiment, Motion, Plan, capture_name, run_name
from gcode.dialect import KLIPPER, MARLIN, REPRAPFIRMWARE
from gcode.dialects import close_limits, open_limits, shaper_off
from gcode.emit import MoveWriter
from gcode.program import ModalState, MotionLimits
from models.machine import Machine

TRAVEL_SHARE = 0.2  # of the machine's velocity, between experiments

FASTEST_HZ, SLOWEST_HZ = 1600.0, 1300.0  # of the chips that RepRapFirmware knows, at the usual settings
RESTORE = "FFCOMP_RESTORE"

MACRO = f"""\
[gcode_macro {RESTORE}]
description: Put back what a recording of ffcomp changes. Call it in CANCEL_PRINT as well.
gcode:
    {{% set own = printer.configfile.settings %}}
    SET_VELOCITY_LIMIT VELOCITY={{own.printer.max_velocity}} ACCEL={{own.printer.max_accel}}
    SET_VELOCITY_LIMIT SQUARE_CORNER_VELOCITY={{own.printer.square_corner_velocity}}
    SET_VELOCITY_LIMIT MINIMUM_CRUISE_RATIO={{own.printer.minimum_cruise_ratio}}
    {{% if own.input_shaper is defined %}}
    SET_INPUT_SHAPER SHAPER_FREQ_X={{own.input_shaper.shaper_freq_x}} SHAPER_FREQ_Y={{own.input_shaper.shaper_freq_y}}
    {{% endif %}}
    {{% if printer.bed_mesh is defined and 'default' in printer.bed_mesh.profiles %}}
    BED_MESH_PROFILE LOAD=default
    {{% endif %}}
"""


@dataclass(frozen=True)
class Firmware:
    """How a firmware records, and how its corrections are switched."""

    flavor: str
    chips: Sequence[str]  # Klipper's names; RepRapFirmware's addresses; ignored by Marlin
    shaper: Sequence[str] | None = None  # lines that switch its own on again; none: it has none; None: not known
    switches_shaper: bool = True  # off before the experiments

    @property
    def records(self) -> bool:
        """Whether the firmware itself records."""
        return self.flavor in (KLIPPER, REPRAPFIRMWARE)

    def start(self, name: str, lasting_s: float) -> list[str]:
        """Return the lines that begin the capture of one execution, which lasts so long, rests included."""
        if self.flavor == KLIPPER:
            return [f"ACCELEROMETER_MEASURE CHIP={chip} NAME={name}" for chip in self.chips]
        if self.flavor == REPRAPFIRMWARE:
            return [f'M956 P{chip} S{math.ceil(lasting_s * FASTEST_HZ)} A0 F"{name}.csv"' for chip in self.chips]
        return []

    def stop(self, name: str, lasting_s: float) -> list[str]:
        """Return the lines that end it."""
        if self.flavor == KLIPPER:
            return self.start(name, lasting_s)
        if self.flavor == REPRAPFIRMWARE:  # it ends when it has all samples, later the slower the chip
            return [f"G4 P{math.ceil(1e3 * lasting_s * (FASTEST_HZ / SLOWEST_HZ - 1.0)) + 200}"]
        return []

    def shaper_off(self) -> list[str]:
        """Return the lines that switch the firmware's input shaper off."""
        if not self.switches_shaper or self.shaper == ():
            return []
        kept = _KEEP_SHAPER if self.flavor == REPRAPFIRMWARE else ()
        on = (line.encode() for line in self.shaper or ())
        return [*kept, *(line.decode().rstrip() for line in shaper_off(self.flavor, on))]

    def shaper_on(self) -> list[str]:
        """Return the lines that switch it on again, if its settings are known."""
        on = _BACK if self.flavor == REPRAPFIRMWARE else self.shaper or ()
        return [*(on if self.shaper_off() else ()), *([RESTORE] if self.flavor == KLIPPER else [])]

    def explained(self) -> list[str]:
        """Return the comments at the head of a file: how everything is put back, with the macro that does it."""
        return [*self.restores(), *(["", *MACRO.splitlines()] if self.flavor == KLIPPER else [])]

    def restores(self) -> list[str]:
        """Say in sentences how everything is put back, also after a cancelled run."""
        shaper_returns = self.shaper is not None or self.flavor == REPRAPFIRMWARE or not self.switches_shaper
        return [_RESTORES[self.flavor], *([] if shaper_returns else [_STAYS_OFF])]


DEFAULT_CHIPS: Mapping[str, Sequence[str]] = {KLIPPER: ("adxl345",), REPRAPFIRMWARE: ("0",), MARLIN: ()}

_KEEP_SHAPER = (
    "var ffcompShaper = move.shaping.type",
    "var ffcompFrequency = move.shaping.frequency",
    "var ffcompDamping = move.shaping.damping",
)
_BACK = ("M593 P{var.ffcompShaper} F{var.ffcompFrequency} S{var.ffcompDamping}",)
_CORRECTIONS_OFF: Mapping[str, Sequence[str]] = {
    KLIPPER: ("BED_MESH_CLEAR", "SET_SKEW CLEAR=1"),
    REPRAPFIRMWARE: ("G29 S2",),
    MARLIN: ("M420 S0",),
}
_MESH_ON: Mapping[str, Sequence[str]] = {REPRAPFIRMWARE: ("G29 S1",), MARLIN: ("M420 S1",)}  # Klipper: the macro
_STAYS_OFF = (
    "The input shaper stays off until then or until the firmware restarts: the machine file has no input_shaper in "
    "[firmware] with which to switch it on again."
)
_RESTORES: Mapping[str, str] = {
    KLIPPER: f"The file puts back its limits after every experiment, and calls {RESTORE} at the end. That macro, "
    "printed at the head of the file, belongs into printer.cfg: it puts back limits, shaper and bed mesh as "
    "printer.cfg states them, and does so for a cancelled run too where CANCEL_PRINT calls it. Without it: RESTART.",
    REPRAPFIRMWARE: "The file puts back limits, shaper and mesh at the end. When the run is cancelled, cancel.g must: "
    'M98 P"config.g" and G29 S1 in it, or a reset.',
    MARLIN: "The file puts back limits and mesh at the end. When the run is cancelled: M501, or a reset.",
}


# The file


def gcode_lines(plan: Plan, machine: Machine, firmware: Firmware) -> Iterator[bytes]:
    """Yield the G-code file line by line; the machine's limits are put back after every experiment."""
    yield from comments(_instructions(plan, machine, firmware))
    yield from lines(["G28", "G21", "G90", "M220 S100", *firmware.shaper_off(), *_CORRECTIONS_OFF[firmware.flavor]])
    travel, rising = travel_feeds(machine)
    # up first: homing may leave the nozzle low
    yield b"G1 Z%.10g F%.10g\n" % (plan.experiments[0].position_mm[2], rising)
    for experiment, repeat in plan.runs():
        name = run_name(experiment.name, repeat)
        of_repeats = f", {repeat} of {plan.repeats}" if plan.repeats > 1 else ""
        yield from comments(["", f"{name}: {_kind(experiment)}, {experiment.duration_s:.1f} s{of_repeats}"])
        yield from _recorded(experiment, name, plan, machine, firmware, travel)
    where = "from the temporary folder of the printer's host" if firmware.flavor == KLIPPER else "from the printer"
    bring = f"Bring back, {where}:" if firmware.records else "Captures:"
    yield from comments(["", "Done.", bring, *(capture_name(each.name, repeat) for each, repeat in plan.runs())])
    yield from lines([*_MESH_ON.get(firmware.flavor, ()), *firmware.shaper_on()])


def _recorded(
    experiment: Experiment, name: str, plan: Plan, machine: Machine, firmware: Firmware, travel: float
) -> Iterator[bytes]:
    """Yield one experiment from rest to rest, between the start and the end of its capture.

    Klipper counts a capture from where its queue of moves ends. After M400 the queue is empty, and restarts a
    quarter of a second after whatever the host is doing: the first rest gives the host time in hand, so that the
    capture begins exactly `rest_before_s` before the first move.
    """
    axes = machine.kinematics.raisable_axes
    if experiment.excitation is not None and experiment.excitation.direction == "z" and "Z" not in axes:
        axes += "Z"  # the very axis that is excited
    duration = plan.capture_s(experiment)
    there = b"G1 X%.10g Y%.10g Z%.10g F%.10g\n" % (*experiment.motion.start_mm[:3].tolist(), travel)
    yield there
    yield from lines(["M400", f"M117 {name}"])
    before = [rest(SETTLE_S), *firmware.start(name, duration), rest(plan.rest_before_s)]
    # the place repeated: a reader of the file then knows the position after a command it does not know
    lead = [*lines(before), there]
    tail = lines([rest(plan.rest_after_s), *firmware.stop(name, duration)])
    yield from moves_within_limits(experiment.motion, machine, firmware.flavor, axes, lead, tail)
    yield b"M400\n"


def moves_within_limits(
    motion: Motion,
    machine: Machine,
    flavor: str,
    axes: str,
    lead: Iterable[bytes] = (),
    tail: Iterable[bytes] = (),
) -> Iterator[bytes]:
    """Yield the moves of an experiment, around them lines before and after, around these its limits and the machine's.

    axes : axes with raised limits
    """
    limits, usual = motion.limits, machine.limits
    velocity, acceleration = limits.velocity_mm_per_s, limits.acceleration_mm_per_s2
    yield from open_limits(flavor, velocity, acceleration, limits.square_corner_velocity_mm_per_s, axes)
    yield from lead
    moves = MoveWriter()
    moves.reset(ModalState(), motion.start_mm[:3].tolist(), 0.0)
    yield from moves.moves(np.ascontiguousarray(motion.ends_mm), motion.speed)
    yield from tail
    restored = MotionLimits(
        usual.velocity_mm_per_s, usual.acceleration_mm_per_s2, usual.square_corner_velocity_mm_per_s, 0.5
    )
    yield from close_limits(flavor, restored, axes)


def travel_feeds(machine: Machine) -> tuple[float, float]:
    """Return F between experiments, and F where the nozzle rises, mm/min."""
    limits = machine.limits
    travel = 60 * TRAVEL_SHARE * limits.velocity_mm_per_s
    return travel, min(travel, 60 * (limits.z_velocity_mm_per_s or limits.velocity_mm_per_s))


def rest(seconds: float) -> str:
    """Return the line of a dwell."""
    return f"G4 P{1e3 * seconds:.0f}"


def lines(texts: Iterable[str]) -> Iterator[bytes]:
    """Encode lines."""
    return (text.encode() + b"\n" for text in texts)


def comments(sentences: Iterable[str]) -> Iterator[bytes]:
    """Encode comments."""
    return (f"; {sentence}".rstrip().encode() + b"\n" for sentence in sentences)


def _kind(experiment: Experiment) -> str:
    if experiment.excitation is None:
        return experiment.kind
    direction, (x, y, z) = experiment.excitation.direction, experiment.position_mm
    moved = f"the nozzle along {direction}" if direction in "xyz" else f"carriage {direction} alone"
    return f"{experiment.kind}, {moved} at X{x:g} Y{y:g} Z{z:g}"


def _instructions(plan: Plan, machine: Machine, firmware: Firmware) -> list[str]:
    """Say what must be so before the file runs, and how everything is put back."""
    runs, identifies = plan.repeats * len(plan.experiments), plan.experiments[0].excitation is not None
    purpose = "identification" if identifies else "diagnosis"
    by_hand = [
        "- Record each experiment in a file of its own, from a second before it moves,",
        "  named NAME-REPEAT.csv as below.",
    ]
    return [
        f"Recording for the {purpose} of {plan.machine} (machine file sha256 {plan.machine_sha256[:8]}).",
        f"{len(plan.experiments)} experiments, {plan.repeats} times each: {runs} captures, "
        f"{plan.duration_s / 60:.1f} min and homing; {firmware.flavor}.",
        "",
        "Before it runs:",
        "- Warm up the guides: let the printer move for some minutes. Heaters may be off; nothing on the bed.",
        "- The accelerometer is screwed to the nozzle holder, rigidly; its cable does not pull.",
        *machine.kinematics.setup_notes,
        *_z_limits(plan, machine),
        "- Speed override is 100 %. Print the file from the printer's own storage.",
        *([] if firmware.records else by_hand),
        "",
        *firmware.explained(),
        "",
    ]


def _z_limits(plan: Plan, machine: Machine) -> list[str]:
    """State which limits in Z the firmware must allow, if a periodic excitation moves anything there."""
    rising = [each for each in plan.experiments if each.excitation and np.ptp(each.motion.vertices_mm[:, 2])]
    if not rising:
        return []
    return [
        f"- The firmware lets Z move at {machine.limits.velocity_mm_per_s:g} mm/s and "
        f"{rising[0].motion.limits.z_acceleration_mm_per_s2:g} mm/s² (Klipper: max_z_velocity, max_z_accel)."
    ]
