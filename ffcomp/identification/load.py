"""Load measured files of any kind as frequency responses, or at least resonances; content decides, not the name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

import numpy as np
from scipy.interpolate import CubicSpline

from ffcomp.errors import MeasurementError
from ffcomp.identification.axis_spectra import Spectrum
from ffcomp.identification.request import IdentifyRequest
from ffcomp.identification.resonance_tests import BeltTest, TestFile, no_test, read_test
from ffcomp.measurement.capture import Capture
from ffcomp.measurement.faults import fault
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.measurement.frf_files import read_frfs
from ffcomp.measurement.recording import Recording, read_recording
from ffcomp.measurement.recording_frfs import frfs_from_recordings
from ffcomp.measurement.vibration import Resonances, kind_of, read_vibrations
from ffcomp.numerics.stages import Stage
from ffcomp.record.axes import STRAIGHT, turn_of
from ffcomp.record.join import join_captures
from ffcomp.record.plan import Excitation, Experiment, Plan
from ffcomp.record.planning import TOWERS, excited_coordinate
from ffcomp.record.prints import plan_of
from ffcomp.record.result import Joined
from models.machine import Machine

_OURS = "ffcomp-"  # in the names that our plans give to captures
_NEEDS_PLAN = (
    "By its name it is a capture of a plan of ffcomp's, and holds no resonance test. Captures of `record plan` need "
    "the .json file next to its G-code (--plan)."
)
POSITION_PITCH_MM = 5.0  # recordings whose middles are nearer than this were made at one position
LARGEST_MOTION_MM = 25.0  # of the nozzle about its middle: beyond it one linear response does not describe a recording


@dataclass
class Gathered:
    """Everything the files held."""

    responses: list[FrequencyResponse] = field(default_factory=list)
    shaken: list[Spectrum] = field(default_factory=list)  # of files that show resonances of an axis
    belts: list[BeltTest] = field(default_factory=list)  # of tests along a belt or a tower
    skipped: list[str] = field(default_factory=list)  # sentences


def gather(machine: Machine, request: IdentifyRequest, progress: Callable[[str], None] = lambda _: None) -> Gathered:
    """Read every file of a request.

    Axes x, y, z of captures of a plan that is no periodic excitation mean that they are found.

    Raises MeasurementError for the first file that cannot be used, with all that is wrong with it.
    """
    plan, band_hz = request.plan, (request.lowest_hz, request.highest_hz)
    gathered, recordings = Gathered(), list[Recording]()
    tests: list[TestFile] = []
    captures: list[Path] = []
    for path in cast("tuple[Path, ...]", request.data):
        progress(Stage(1, f"reading {path.name}"))
        kind = kind_of(path)
        if kind == "frf":
            gathered.responses += [r.between(*band_hz) for r in read_frfs(path)]
        elif kind == "recording":
            recordings.append(read_recording(path))
        elif plan is not None:
            captures.append(path)
        elif _OURS in path.stem:
            raise MeasurementError(str(path), [_NEEDS_PLAN])
        else:
            tests += read_vibrations(path)
    gathered.skipped += [
        f"{Path(each.source).name}: {fault('lost samples', overflows=each.overflows)}"
        for each in tests
        if isinstance(each, Capture) and each.overflows
    ]
    for test, axis in _with_axes(tests, request.axis, gathered.skipped):
        read = read_test(test, axis, band_hz, request.column or _named_column(test, request.axis))
        if isinstance(read, str):
            gathered.skipped.append(read)
        elif isinstance(read, BeltTest):
            gathered.belts.append(read)
        else:
            gathered.shaken.append(read)
    if not machine.vibration.position_dependent:
        gathered.responses += [r for recording in recordings for r in frfs_from_recordings([recording], *band_hz)]
        recordings = []
    for position, members in _by_position(recordings, machine, gathered.skipped).items():
        gathered.responses += frfs_from_recordings(members, *band_hz, position_mm=position)
    if plan is not None and captures:
        moves = plan_of(plan, machine)
        periodic = any(each.excitation is not None for each in moves.experiments)  # which does not show the axes' signs
        turn = turn_of(request.axes_map) if periodic or request.axes_map != ",".join(STRAIGHT) else None
        joined = join_captures(captures, moves, machine, turn, progress)
        joined.check()
        gathered.skipped += [f"{Path(each.file).name} is left out: {each.why}" for each in joined.refused]
        for sentence in joined.notes(moves, machine):
            progress(sentence)
        gathered.responses += responses_of(joined.joined, moves, machine, band_hz)
    gathered.responses = [r for r in gathered.responses if len(r.frequency_hz)]
    return gathered


def _with_axes(
    tests: Sequence[TestFile], stated: Sequence[str], skipped: list[str]
) -> list[tuple[TestFile, str | None]]:
    """Pair each resonance test with its excited axis; other files are skipped."""
    problems = [no_test(test) for test in tests]
    skipped += filter(None, problems)
    usable = [test for test, problem in zip(tests, problems, strict=True) if not problem]
    silent = [test for test in usable if test.axis is None]
    if len(stated) > 1 and len(stated) != len(silent):
        rule = f"--axis is given {len(stated)} times, for {len(silent)} tests whose names do not state their axis"
        raise MeasurementError("--axis", [f"{rule}: give it once for all of them, or once for each."])
    axes = iter(stated if len(stated) > 1 else [*stated] * len(silent))
    return [(test, test.axis if test.axis is not None else next(axes, None)) for test in usable]


def _named_column(test: TestFile, stated: Sequence[str]) -> str | None:
    """Return the axis that the user said, where the file has a column of that name and its header does not say more."""
    if not isinstance(test, Resonances) or test.by_axis or len(stated) != 1:
        return None
    return stated[0] if stated[0] in test.psd else None


def _by_position(
    recordings: Sequence[Recording], machine: Machine, skipped: list[str]
) -> dict[tuple[float, float, float], list[Recording]]:
    positions: dict[tuple[float, float, float], list[Recording]] = {}
    for recording in recordings:
        middle, extent = _extent(recording, machine)
        if extent > LARGEST_MOTION_MM:
            skipped.append(
                f"{recording.source}: its nozzle moves {extent:.0f} mm from the middle; a frequency response belongs "
                f"to one place (at most {LARGEST_MOTION_MM:g} mm), so this recording is left out."
            )
            continue
        x, y, z = (float(POSITION_PITCH_MM * round(c / POSITION_PITCH_MM)) for c in middle)
        positions.setdefault((x, y, z), []).append(recording)
    return positions


def _extent(recording: Recording, machine: Machine) -> tuple[list[float], float]:
    """Return the middle of the nozzle's commanded path, and its distance from there, mm."""
    nozzle = recording.command if recording.command_space == "nozzle" else machine.kinematics.forward(recording.command)
    low, high = nozzle.min(axis=0), nozzle.max(axis=0)
    machine.kinematics.inverse(nozzle[:1])  # raises where the arms cannot reach
    return ((low + high) / 2).tolist(), float(np.linalg.norm(high - low) / 2)


# ---- captures of a plan --------------------------------------------------------------------------
#
# A capture's start is known to a fraction of a millisecond. The rest is a delay that is fitted with the parameters
# (`FrequencyResponse.clock`): resonances separate a drive's own delay from a capture's, not alignment.


RATE_HZ = 3200.0
BAND_HZ = (5.0, 150.0)  # that moves excite
HALF_WIDTH_HZ = 2.0  # zigzags and loops have a few lines in a hertz only
VARIANCE_FACTOR = 4.0  # polynomials of such wide windows err by twice the noise, measured on simulated captures
MOST_NOISE = 0.15  # of a response's values: beyond it, as across the axes at the centre, it is not used
COMMANDS = ("cmd_x", "cmd_y")  # z moves too little


def responses_of(
    joined: Sequence[Joined], plan: Plan, machine: Machine, band_hz: tuple[float, float]
) -> list[FrequencyResponse]:
    """Estimate the responses of each periodic experiment, and to x and y from all moves at a place together."""
    experiments = {each.name: each for each in plan.experiments}
    excitations = {each.name: each.excitation for each in plan.experiments if each.excitation is not None}
    periodic, places = dict[str, list[Recording]](), dict[int, list[Recording]]()
    for each in joined:
        experiment = experiments[each.experiment]
        if each.experiment in excitations:
            cut = _whole_periods(each, experiment, excitations[each.experiment], machine)
            periodic.setdefault(each.experiment, []).append(cut)
        else:
            places.setdefault(experiment.place, []).append(each.recording)
    responses = []
    for name, members in periodic.items():
        found = frfs_from_recordings(members, *band_hz, position_mm=experiments[name].position_mm)
        band = excitations[name].band
        responses += [replace(r.between(band.lowest_hz, band.highest_hz), clock=name) for r in found]
    for place, members in sorted(places.items()):
        at = next(each.position_mm for each in plan.experiments if each.place == place)
        responses += _of_moves(members, place, at, (max(BAND_HZ[0], band_hz[0]), min(BAND_HZ[1], band_hz[1])))
    return responses


def _whole_periods(joined: Joined, experiment: Experiment, excited: Excitation, machine: Machine) -> Recording:
    """Cut out the whole periods, and one before them, which the estimator leaves out; only one coordinate moves."""
    recording, carriage = joined.recording, excited.direction in TOWERS
    if recording.gaps.any():
        raise MeasurementError(joined.source, ["Rows are missing in its motion. Record it again."])
    samples = round(excited.band.period_s * RATE_HZ)
    since = np.arange(-samples, samples * excited.periods) / RATE_HZ
    when = experiment.measured_from_s + since
    at = np.clip(when - joined.begin_s, 0.0, recording.time_s[-1])
    command = np.zeros((len(when), 3))
    column = (TOWERS if carriage else STRAIGHT).index(excited.direction)
    command[:, column] = excited_coordinate(machine.kinematics, excited.direction, experiment.motion, when)
    return replace(
        recording,
        source=joined.source,
        time_s=since - since[0],
        command=command,
        command_space="carriage" if carriage else "nozzle",
        acceleration={name: CubicSpline(recording.time_s, x)(at) for name, x in recording.acceleration.items()},
        comments={"period_s": str(excited.band.period_s)},
    )


def _of_moves(
    members: Sequence[Recording], place: int, position: tuple[float, float, float], band_hz: tuple[float, float]
) -> list[FrequencyResponse]:
    """Estimate the responses at one place; a capture's start is known to a fraction of a millisecond: one clock."""
    longest = max(len(recording.time_s) for recording in members)
    alike = [_resting(recording, longest) for recording in members]
    responses = frfs_from_recordings(alike, *band_hz, half_width_hz=HALF_WIDTH_HZ, position_mm=position)
    name = f"place {place}, {len(members)} captures"
    commanded = [r for r in responses if r.input in COMMANDS]
    known = [r for r in commanded if np.sqrt(r.variance.sum() / np.sum(np.abs(r.value) ** 2)) < MOST_NOISE]
    return [replace(r, variance=r.variance * VARIANCE_FACTOR, source=name, clock=f"place-{place}") for r in known]


def _resting(recording: Recording, count: int) -> Recording:
    """Lengthen a recording, which ends at rest, to so many rows."""
    more = count - len(recording.time_s)
    return replace(
        recording,
        time_s=np.arange(count) / recording.sample_rate_hz,
        command=np.concatenate([recording.command, np.repeat(recording.command[-1:], more, axis=0)]),
        acceleration={name: np.pad(values, (0, more)) for name, values in recording.acceleration.items()},
        position={},
    )
