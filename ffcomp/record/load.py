"""Read measured runs and captures alike, as a diagnosis needs them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from ffcomp.identify.captures import STRAIGHT, turning
from ffcomp.identify.experiment_files import load_plan
from ffcomp.identify.load import Gathered, gather, kind_of
from ffcomp.measurement.recording import Recording, read_recording
from ffcomp.record.join import join_captures
from ffcomp.record.plan_files import is_moves, load_moves
from ffcomp.record.responses import responses_of
from models.arrays import FloatArray
from models.machine import Machine


def load_recordings(
    paths: Sequence[str | Path],
    machine: Machine,
    plan: str | Path | None = None,
    turn: FloatArray | None = None,
    progress: Callable[[str], None] = lambda sentence: None,
) -> list[Recording]:
    """Read measured runs, and join captures with the commands of their plan.

    Parameters
    ----------
    plan : the file that `ffcomp record plan` wrote beside its G-code; None: there are no captures
    turn : (3, 3) from the accelerometer's axes to the printer's; None: found in the captures
    progress : told what is read, joined, and refused

    Raises
    ------
    MeasurementError
        For a run that cannot be used, for captures without a plan, and if no capture can be joined.
    """
    if plan is None:
        return [read_recording(path) for path in paths]  # which says what to do with a capture
    captures = [path for path in paths if kind_of(Path(path)) == "vibration"]
    runs = [read_recording(path) for path in paths if path not in captures]
    if not captures:
        return runs
    moves = load_moves(plan)
    found = join_captures(captures, moves, machine, turn, progress)
    found.check()
    for each in found.refused:
        progress(f"left out {each.file}: {each.why}")
    for sentence in found.notes(moves, machine):
        progress(sentence)
    return [*runs, *found.recordings]


def gather_measurements(
    paths: Sequence[Path],
    machine: Machine,
    plan: str | Path | None,
    *,
    band_hz: tuple[float, float],
    axes: Sequence[str] = STRAIGHT,
    shaken_axis: Sequence[str] = (),
    column: str | None = None,
    progress: Callable[[str], None] = lambda sentence: None,
) -> Gathered:
    """Read what `identify fit` takes, captures of either kind of plan included; see `ffcomp.identify.load.gather`.

    Parameters
    ----------
    plan : the file that `identify plan` or `record plan` wrote beside its G-code; None: there are no captures of it
    axes : the printer's axes in the sensor's own; of `record plan`'s captures x, y, z means that they are found
    """
    moves = plan is not None and is_moves(plan)
    captures = [path for path in paths if moves and kind_of(path) == "vibration"]
    found = gather(
        [path for path in paths if path not in captures],
        machine,
        band_hz=band_hz,
        plan=None if plan is None or moves else load_plan(Path(plan)),
        axes=axes,
        shaken_axis=shaken_axis,
        column=column,
        progress=progress,
    )
    if plan is not None and captures:
        turn = None if tuple(axes) == STRAIGHT else turning(axes)
        recordings = load_recordings(captures, machine, plan, turn, progress)
        found.responses += responses_of(recordings, load_moves(plan), band_hz)
    return found
