"""`ffcomp record`: moves for the printer's own sensor, captures joined with their command, and a check of seconds."""

from __future__ import annotations

from ffcomp.cli.command import group, verb
from ffcomp.cli.common import report
from ffcomp.errors import RequestError
from ffcomp.record.request import CheckRequest, JoinRequest, PlanRequest
from ffcomp.result import Result


@verb
def plan(request: PlanRequest) -> Result:
    """Write the G-code of moves that are worth recording.

    For diagnose, at most 12 experiments and 5 minutes: hard zigzags, slow reversals, loops and multisines at several
    places, each made twice. For identify, a periodic excitation of each carriage or axis by itself. For check, half a
    minute in the middle of the bed. The G-code contains the capture commands. For scan, no sensor is needed: the
    printer draws a page, and ffcomp identify scan reads a picture of it. With --print, a print is recorded while it
    prints; nothing is repeated then, and ffcomp diagnose needs --without-repeats.

    Example: ffcomp record plan -m mp-delta-pro -o moves.gcode
    """
    from ffcomp.record.planning import plan_recording

    return plan_recording(request)


@verb
def join(request: JoinRequest) -> Result:
    """Join captures with their commands: one measured run for each experiment and repeat.

    Klipper's and Kalico's captures share the clock of the motion. Others are aligned with the motion below 20 Hz.
    Captures that cannot be joined are listed with the reason; if none can, the exit code is 5. The plan may be a print,
    compensated or not, that contains the capture commands: from ffcomp record plan --print, or from your slicer between
    layers (ACCELEROMETER_MEASURE, or M956; each capture begins and ends with a rest of 0.2 s or more).

    Example: ffcomp record join captures/*.csv --plan moves.json -m my-delta.toml --output-dir runs/
    """
    from ffcomp.record.axes import turn_of
    from ffcomp.record.join import join_captures
    from ffcomp.record.prints import plan_of
    from ffcomp.record.result import JoinedRuns, recording_lines
    from gcode.atomic_write import replace_atomically
    from models.file import load_machine

    if request.output_dir.resolve() in {path.resolve().parent for path in request.captures}:
        raise RequestError(f"{request.output_dir}: the captures are there; give another --output-dir.")
    machine = load_machine(request.machine)
    plan = plan_of(request.plan, machine)
    turn = turn_of(request.axes_map)
    result = join_captures(request.captures, plan, machine, turn, report)
    targets = [request.output_dir / f"{each.name}.csv" for each in result.joined]
    if taken := [path for path in targets if path.exists() and not request.force]:
        raise RequestError(f"{taken[0]} exists already; give another --output-dir, or --force.")
    if targets:
        request.output_dir.mkdir(parents=True, exist_ok=True)
    for each, path in zip(result.joined, targets, strict=True):
        replace_atomically(path, recording_lines(each.recording))
    return JoinedRuns(result, plan, machine, request.machine, request.output_dir, targets)


@verb
def check(request: CheckRequest) -> Result:
    """Check in half a minute whether the printer moves as last time, and if not, what changed.

    First write the G-code with ffcomp record plan --for check, and run it whenever you want to know. Then give its
    captures: they are compared with the machine file and with the earlier checks.

    Example: ffcomp record check captures/*.csv --plan check.json -m my-delta.toml
    """
    from dataclasses import replace
    from datetime import datetime

    from ffcomp.check.compare import check_result
    from ffcomp.check.history import read_history, write_history
    from ffcomp.record.axes import turn_of
    from ffcomp.record.join import join_captures
    from ffcomp.record.plan import load_plan
    from models.file import load_machine

    plan, machine = load_plan(request.plan), load_machine(request.machine)
    earlier = read_history(request.history_file)
    turn = turn_of(request.axes_map)
    joined = join_captures(request.captures, plan, machine, turn, report)
    joined.check()
    left_out = [f"Left out {each.file}: {each.why}" for each in joined.refused]
    result = check_result(joined, plan, machine, earlier, datetime.now().isoformat(timespec="minutes"))
    checks = earlier if result.known else [*earlier, result.check]
    if not result.known:
        write_history(request.history_file, checks)
    return replace(
        result,
        notes=(*left_out, *joined.notes(plan, machine), *result.notes),
        machine=machine.name,
        history=request.history_file,
        checks=tuple(checks),
        diagnose=f"ffcomp diagnose CAPTURES --plan {request.plan} -m {request.machine}",
    )


record = group(
    "record",
    """Record the printer's vibrations with its own accelerometer.

    Write the G-code with ffcomp record plan and run it. Then give the captures to ffcomp diagnose with --plan, or turn
    them into measured runs with ffcomp record join.
    """,
    plan,
    join,
    check,
)
