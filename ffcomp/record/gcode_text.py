"""The G-code of a recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ffcomp.record.firmware import Firmware
from ffcomp.record.plan import SETTLE_S, TRAVEL_SHARE, Experiment, MovesPlan
from ffcomp.record.plan_files import capture_name, run_name
from gcode.dialects import KLIPPER, close_limits, open_limits
from gcode.emit import MoveWriter
from gcode.limits import MotionLimits
from gcode.program import ModalState
from models.machine import Machine

_BY_HAND = (
    "- Record each experiment in a file of its own, from a second before it moves to half a second after,",
    "  named NAME-REPEAT.csv as below.",
)


def gcode_lines(plan: MovesPlan, machine: Machine, firmware: Firmware) -> Iterator[bytes]:
    """Yield the G-code file line by line.

    Parameters
    ----------
    machine : whose limits are put back after every experiment
    """
    yield from _comments(_instructions(plan, machine, firmware))
    yield from _lines(["G28", "G21", "G90", "M220 S100", *firmware.corrections_off()])
    travel = 60 * TRAVEL_SHARE * machine.limits.velocity_mm_per_s
    height = plan.experiments[0].position_mm[2]
    # up first: homing may leave the nozzle low
    yield b"G1 Z%.10g F%.10g\n" % (height, min(travel, 60 * _z_velocity(machine)))
    for experiment, repeat in plan.runs():
        name = run_name(experiment.name, repeat)
        words = f"{name}: {experiment.kind}, {experiment.duration_s:.1f} s, {repeat} of {plan.repeats}"
        yield from _comments(["", words])
        yield from _recorded(experiment, name, plan, machine, firmware, travel)
    yield from _comments(["", *_closing(plan, firmware)])
    yield from _lines(firmware.corrections_on())


def _z_velocity(machine: Machine) -> float:
    return machine.limits.z_velocity_mm_per_s or machine.limits.velocity_mm_per_s


def _recorded(
    experiment: Experiment, name: str, plan: MovesPlan, machine: Machine, firmware: Firmware, travel: float
) -> Iterator[bytes]:
    """Yield one experiment from rest to rest, between the start and the end of its capture.

    Klipper counts a capture from where its queue of moves ends. After M400 the queue is empty, and begins anew a
    quarter of a second after whatever the host is doing: the first rest gives the host time in hand, so that the
    capture begins exactly `rest_before_s` before the first move.
    """
    motion, axes = experiment.motion, machine.kinematics.raisable_axes
    lasting = plan.rest_before_s + experiment.duration_s + plan.rest_after_s
    limits = motion.limits
    there = b"G1 X%.10g Y%.10g Z%.10g F%.10g\n" % (*motion.start_mm[:3].tolist(), travel)
    yield there
    yield from _lines(["M400", f"M117 {name}"])
    yield from open_limits(
        firmware.flavor,
        limits.velocity_mm_per_s,
        limits.acceleration_mm_per_s2,
        limits.square_corner_velocity_mm_per_s,
        axes,
    )
    yield from _lines([_rest(SETTLE_S), *firmware.start(name, lasting), _rest(plan.rest_before_s)])
    yield there  # repeated: a reader of the file then knows the position after a command it does not know
    moves = MoveWriter()
    moves.reset(ModalState(), motion.start_mm[:3].tolist(), 0.0)
    yield from moves.moves(np.ascontiguousarray(motion.ends_mm), motion.speed)
    yield from _lines([_rest(plan.rest_after_s), *firmware.stop(name, lasting)])
    yield from close_limits(firmware.flavor, _own_limits(machine), axes)
    yield b"M400\n"


def _rest(seconds: float) -> str:
    return f"G4 P{1e3 * seconds:.0f}"


def _own_limits(machine: Machine) -> MotionLimits:
    own = machine.limits
    return MotionLimits(own.velocity_mm_per_s, own.acceleration_mm_per_s2, own.square_corner_velocity_mm_per_s, 0.5)


def _lines(texts: Sequence[str]) -> Iterator[bytes]:
    for text in texts:
        yield text.encode() + b"\n"


def _comments(sentences: Sequence[str]) -> Iterator[bytes]:
    for sentence in sentences:
        yield f"; {sentence}".rstrip().encode() + b"\n"


def _instructions(plan: MovesPlan, machine: Machine, firmware: Firmware) -> list[str]:
    """Say what must be so before the file runs, and how everything is put back."""
    runs = plan.repeats * len(plan.experiments)
    return [
        f"Recording for the diagnosis of {plan.machine} (machine file sha256 {plan.machine_sha256[:8]}).",
        f"{len(plan.experiments)} experiments, {plan.repeats} times each: {runs} captures, "
        f"{plan.duration_s / 60:.1f} min and homing; {firmware.flavor}.",
        "",
        "Before it runs:",
        "- Warm up the guides: let the printer move for some minutes. Heaters may be off; nothing on the bed.",
        "- The accelerometer is screwed to the nozzle holder, rigidly; its cable does not pull.",
        *machine.kinematics.setup_notes,
        "- Speed override is 100 %. Print the file from the printer's own storage.",
        *(
            []
            if firmware.records
            else ["- Record each experiment in a file of its own, from a second before it moves,"]
        ),
        *([] if firmware.records else ["  named NAME-REPEAT.csv as below."]),
        "",
        *firmware.explained(),
        "",
    ]


def _closing(plan: MovesPlan, firmware: Firmware) -> list[str]:
    where = "from the temporary folder of the printer's host" if firmware.flavor == KLIPPER else "from the printer"
    wanted = [f"Bring back, {where}:"] if firmware.records else ["Captures:"]
    return ["Done.", *wanted, *(capture_name(each.name, repeat) for each, repeat in plan.runs())]
