"""The G-code of a plan, and the commands around its experiments in each firmware's words.

A capture starts and ends around each experiment; corrections (shaper, mesh, skew) are off in between and back on at the
end. Klipper and Kalico ignore a command that their configuration does not have, with a message; so does Marlin.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.firmware.base import FileLimits, Firmware
from ffcomp.firmware.table import FIRMWARES
from ffcomp.planner.segment_timing import SegmentLimits
from ffcomp.record.plan import SETTLE_S, Experiment, Motion, Plan, capture_name, run_name
from gcode.dialects import shaper_off
from gcode.emit import MoveWriter
from gcode.program import ModalState
from models.machine import Machine

TRAVEL_SHARE = 0.2  # of the machine's velocity, between experiments

_STAYS_OFF = (
    "The input shaper stays off until then or until the firmware restarts: the machine file has no input_shaper in "
    "[firmware], so ffcomp cannot switch it on again."
)


@dataclass(frozen=True)
class Recorder:
    """How a firmware records with its accelerometers, and how its corrections are switched."""

    flavor: str
    chips: Sequence[str] | None = None  # Klipper's names; RepRapFirmware's addresses; None: the usual one
    shaper: Sequence[str] | None = None  # lines that switch its own on again; none: it has none; None: not known

    @property
    def firmware(self) -> Firmware:
        """The firmware."""
        return FIRMWARES[self.flavor]

    @property
    def records(self) -> bool:
        """Whether the firmware itself records."""
        return bool(self.firmware.usual_chips)

    def capture(self, name: str, lasting_s: float) -> tuple[list[str], list[str]]:
        """Return the lines that begin and end the capture of one execution, which lasts so long, rests included."""
        chips = self.firmware.usual_chips if self.chips is None else self.chips
        return self.firmware.capture(chips, name, lasting_s)

    def shaper_off(self) -> list[str]:
        """Return the lines that switch the firmware's input shaper off."""
        if self.shaper == ():
            return []
        on = (line.encode() for line in self.shaper or ())
        return [*self.firmware.shaper_kept, *(line.decode().rstrip() for line in shaper_off(self.flavor, on))]

    def shaper_on(self) -> list[str]:
        """Return the lines that switch it on again, if its settings are known."""
        on = self.firmware.shaper_back or self.shaper or ()
        return [*(on if self.shaper_off() else ()), *self.firmware.restore_call]

    def explained(self) -> list[str]:
        """Return the comments at the head of a file: how everything is restored, with the macro that does it."""
        return [*self.restores(), *self.firmware.restore_macro]

    def restores(self) -> list[str]:
        """Say in sentences how everything is restored, also after a cancelled run."""
        shaper_returns = self.shaper is not None or bool(self.firmware.shaper_back)
        return [self.firmware.restores, *([] if shaper_returns else [_STAYS_OFF])]


# The file


def gcode_lines(plan: Plan, machine: Machine, recorder: Recorder) -> Iterator[bytes]:
    """Yield the G-code file line by line; the machine's limits are put back after every experiment."""
    yield from comments(_instructions(plan, machine, recorder))
    yield from lines(["G28", "G21", "G90", "M220 S100", *recorder.shaper_off(), *recorder.firmware.corrections_off])
    travel, rising = travel_feeds(machine)
    # up first: homing may leave the nozzle low
    yield b"G1 Z%.10g F%.10g\n" % (plan.experiments[0].position_mm[2], rising)
    for experiment, repeat in plan.runs():
        name = run_name(experiment.name, repeat)
        of_repeats = f", {repeat} of {plan.repeats}" if plan.repeats > 1 else ""
        yield from comments(["", f"{name}: {_kind(experiment)}, {experiment.duration_s:.1f} s{of_repeats}"])
        yield from _recorded(experiment, name, plan, machine, recorder, travel)
    bring = f"Bring back, {recorder.firmware.captures_at}:" if recorder.records else "Captures:"
    yield from comments(["", "Done.", bring, *(capture_name(each.name, repeat) for each, repeat in plan.runs())])
    yield from lines([*recorder.firmware.corrections_on, *recorder.shaper_on()])


def _recorded(
    experiment: Experiment, name: str, plan: Plan, machine: Machine, recorder: Recorder, travel: float
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
    start, stop = recorder.capture(name, duration)
    before = [rest(SETTLE_S), *start, rest(plan.rest_before_s)]
    # the place repeated: a reader of the file then knows the position after a command it does not know
    lead = [*lines(before), there]
    tail = lines([rest(plan.rest_after_s), *stop])
    yield from moves_within_limits(experiment.motion, machine, recorder.firmware, axes, lead, tail)
    yield b"M400\n"


def moves_within_limits(
    motion: Motion,
    machine: Machine,
    firmware: Firmware,
    axes: str,
    lead: Iterable[bytes] = (),
    tail: Iterable[bytes] = (),
) -> Iterator[bytes]:
    """Yield the moves of an experiment, around them lines before and after, around these its limits and the machine's.

    axes : axes with raised limits
    """
    limits = motion.limits
    corner = limits.square_corner_velocity_mm_per_s
    raised = SegmentLimits(limits.velocity_mm_per_s, limits.acceleration_mm_per_s2, corner, raised_axes=axes)
    yield from _ended(firmware.opening(machine, raised, FileLimits()))
    yield from lead
    moves = MoveWriter()
    moves.reset(ModalState(), motion.start_mm[:3].tolist(), 0.0)
    yield from moves.moves(np.ascontiguousarray(motion.ends_mm), motion.speed)
    yield from tail
    yield from _ended(firmware.closing(machine, raised, FileLimits()))


def _ended(limits: Iterable[bytes]) -> Iterator[bytes]:
    return (line.rstrip() + b"\n" for line in limits)


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


def _instructions(plan: Plan, machine: Machine, recorder: Recorder) -> list[str]:
    """State the conditions before the file runs, and how everything is restored."""
    runs, identifies = plan.repeats * len(plan.experiments), plan.experiments[0].excitation is not None
    purpose = "identification" if identifies else "diagnosis"
    by_hand = [
        "- Record each experiment in a file of its own, from a second before it moves,",
        "  named NAME-REPEAT.csv as below.",
    ]
    return [
        f"Recording for the {purpose} of {plan.machine} (machine file sha256 {plan.machine_sha256[:8]}).",
        f"{len(plan.experiments)} experiments, {plan.repeats} times each: {runs} captures, "
        f"{plan.duration_s / 60:.1f} min and homing; {recorder.flavor}.",
        "",
        "Before it runs:",
        "- Warm up the guides: let the printer move for some minutes. Heaters may be off; nothing on the bed.",
        "- The accelerometer is screwed to the nozzle holder, rigidly; its cable does not pull.",
        *machine.kinematics.setup_notes,
        *_z_limits(plan, machine),
        "- Speed override is 100 %. Print the file from the printer's own storage.",
        *([] if recorder.records else by_hand),
        "",
        *recorder.explained(),
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
