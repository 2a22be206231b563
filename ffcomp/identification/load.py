"""Load measured files of any kind as frequency responses, or at least resonances; content decides, not the name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.identification.axis_spectra import Spectrum
from ffcomp.identification.captures import frfs_from_captures, responses_of
from ffcomp.identification.from_resonances import Resonance
from ffcomp.identification.predict import AXES
from ffcomp.identification.resonance_tests import BeltTest, TestFile, no_test, read_test
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.measurement.frf_files import read_frfs
from ffcomp.measurement.kinds import kind_of
from ffcomp.measurement.klipper import Resonances
from ffcomp.measurement.modes import ModeFit, modes_in
from ffcomp.measurement.recording import Recording, read_recording
from ffcomp.measurement.recording_frfs import frfs_from_recordings
from ffcomp.measurement.vibration import read_vibrations
from ffcomp.numerics.stages import Stage
from ffcomp.record.axes import STRAIGHT, turning
from ffcomp.record.join import load_recordings
from ffcomp.record.plan import load_plan
from models.machine import Machine

_OURS = "ffcomp-"  # in the names that our plans give to captures
_NEEDS_PLAN = (
    "By its name it is a capture of a plan of ffcomp's, and holds no resonance test. Captures of `record plan` need "
    "the .json file beside its G-code (--plan)."
)
POSITION_PITCH_MM = 5.0  # recordings whose middles are nearer than this were made at one position
LARGEST_MOTION_MM = 25.0  # of the nozzle about its middle: beyond it one linear response does not describe a recording


@dataclass
class Gathered:
    """Everything the files held."""

    responses: list[FrequencyResponse] = field(default_factory=list)
    spectra: list[ModeFit] = field(default_factory=list)  # of files that show resonances only
    shaken: list[Spectrum] = field(default_factory=list)  # the same of a machine of modal axes
    belts: list[BeltTest] = field(default_factory=list)  # of tests along a belt or a tower
    skipped: list[str] = field(default_factory=list)  # sentences

    @property
    def nothing(self) -> bool:
        """Whether the files held nothing that can be fitted."""
        return not (self.responses or self.spectra or self.shaken or self.belts)


def gather(
    paths: Sequence[Path],
    machine: Machine,
    *,
    band_hz: tuple[float, float],
    plan: str | Path | None = None,
    axes: Sequence[str] = STRAIGHT,
    shaken_axis: Sequence[str] = (),
    column: str | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Gathered:
    """Read every file.

    Parameters
    ----------
    plan : the file that `record plan` wrote beside its G-code; None: there are no captures of it.
    axes : the printer's axes in the sensor's own, of captures of a plan. Where the plan is no periodic excitation,
        x, y, z means that they are found.
    shaken_axis : the excited axis of resonance tests whose names do not say it: x, y, z or a direction such as
        "1,-1"; one for all of them, or one each in their order.
    column : the spectrum to be taken of files with several.

    Raises
    ------
    MeasurementError
        For the first file that cannot be used, with all that is wrong with it.
    """
    gathered, recordings = Gathered(), list[Recording]()
    tests: list[TestFile] = []
    captures: list[Path] = []
    for path in paths:
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
    for test, axis in _with_axes(tests, list(shaken_axis), gathered.skipped):
        _take(test, axis, machine, column or _named_column(test, shaken_axis), band_hz, gathered)
    if not machine.vibration.position_dependent:
        gathered.responses += [r for recording in recordings for r in frfs_from_recordings([recording], *band_hz)]
        recordings = []
    for position, members in _by_position(recordings, machine, gathered.skipped).items():
        gathered.responses += frfs_from_recordings(members, *band_hz, position_mm=position)
    gathered.responses = [r for r in gathered.responses if len(r.frequency_hz)]
    if plan is not None and captures:
        gathered.responses += _of_plan(captures, plan, machine, band_hz, axes, progress)
    return gathered


def _of_plan(
    captures: Sequence[Path],
    plan_file: str | Path,
    machine: Machine,
    band_hz: tuple[float, float],
    axes: Sequence[str],
    progress: Callable[[str], None],
) -> list[FrequencyResponse]:
    """Estimate the responses that captures of a plan show."""
    plan = load_plan(plan_file)
    if all(each.excitation is not None for each in plan.experiments):
        responses = [r.between(*band_hz) for r in frfs_from_captures(plan, captures, machine, axes)]
        return [r for r in responses if len(r.frequency_hz)]
    turn = None if tuple(axes) == STRAIGHT else turning(axes)
    return responses_of(load_recordings(captures, machine, plan_file, turn, progress), plan, band_hz)


def _with_axes(tests: Sequence[TestFile], stated: list[str], skipped: list[str]) -> list[tuple[TestFile, str | None]]:
    """Pair each resonance test with its excited axis; what is no test is skipped."""
    usable = []
    for test in tests:
        sentence = no_test(test)
        if sentence:
            skipped.append(sentence)
        else:
            usable.append(test)
    silent = [test for test in usable if test.axis is None]
    if len(stated) > 1 and len(stated) != len(silent):
        rule = f"--axis is given {len(stated)} times, for {len(silent)} tests whose names do not state their axis"
        raise MeasurementError("--axis", [f"{rule}: give it once for all of them, or once for each."])
    axes = iter(stated if len(stated) > 1 else stated * len(silent))
    return [(test, test.axis if test.axis is not None else next(axes, None)) for test in usable]


def _named_column(test: TestFile, stated: Sequence[str]) -> str | None:
    """Return the axis that the user said, where the file has a column of that name and its header does not say more."""
    if not isinstance(test, Resonances) or test.by_axis or len(stated) != 1:
        return None
    return stated[0] if stated[0] in test.psd else None


def _take(
    test: TestFile,
    axis: str | None,
    machine: Machine,
    column: str | None,
    band_hz: tuple[float, float],
    gathered: Gathered,
) -> None:
    """Add a resonance test to what the files hold."""
    if machine.vibration.position_dependent and (axis is None or axis in AXES):
        gathered.spectra.append(modes_in(test, column, axis))
        return
    read = read_test(test, axis, band_hz, column)
    if isinstance(read, str):
        gathered.skipped.append(read)
    elif isinstance(read, BeltTest):
        gathered.belts.append(read)
    else:
        gathered.shaken.append(read)


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


def resonances_of(
    spectra: Sequence[ModeFit], place: tuple[float, float] = (0.0, 0.0)
) -> tuple[list[Resonance], list[str]]:
    """Select the strongest mode of each spectrum whose axis is known and whose mode is clear; say what is left out."""
    resonances, left_out = [], []
    for spectrum in spectra:
        modes = [m for m in spectrum.modes if not m.tone]
        main = max(modes, key=lambda m: m.power, default=None)
        name = Path(spectrum.source).name
        if spectrum.axis not in AXES:
            left_out.append(f"{name}: the excited axis is not stated, so it is not used. Say --axis x or y.")
        elif main is None:
            left_out.append(f"{name}: {spectrum.verdict}")
        elif not main.clear:
            left_out.append(
                f"{name}: it is not used, for its strongest mode is known to {main.frequency_hz:.1f} ± "
                f"{main.frequency_sd_hz:.1f} Hz only. Test it again, excited harder, with the sensor fastened."
            )
        else:
            resonances.append(Resonance(spectrum.axis, place, main))
    return resonances, left_out
