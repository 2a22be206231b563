"""Load measured files of any kind as frequency responses, or at least resonances; content decides, not the name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.identify.axis_spectra import Spectrum, spectrum_of
from ffcomp.identify.captures import STRAIGHT, frfs_from_captures
from ffcomp.identify.experiment import Plan
from ffcomp.identify.from_resonances import Resonance
from ffcomp.identify.predict import AXES
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.measurement.frf_files import read_frfs
from ffcomp.measurement.modes import ModeFit, modes_of
from ffcomp.measurement.plain_capture import columns_of
from ffcomp.measurement.recording import Recording, read_recording
from ffcomp.measurement.recording_frfs import frfs_from_recordings
from ffcomp.measurement.shake_and_tune import is_stdata
from ffcomp.measurement.table import read_text
from ffcomp.measurement.uff import is_universal
from models.machine import Machine

Kind = Literal["frf", "recording", "vibration"]
_OURS = "ffcomp-"  # in the names that our plans give to captures
_NEEDS_PLAN = (
    "By its name it is a capture of a plan of ffcomp's, and holds no resonance test. Captures of `identify plan` need "
    "the .json file beside its G-code (--plan); those of `record plan` belong to `ffcomp diagnose --plan`."
)
POSITION_PITCH_MM = 5.0  # recordings whose middles are nearer than this were made at one position
LARGEST_MOTION_MM = 25.0  # of the nozzle about its middle: beyond it one linear response does not describe a recording


@dataclass
class Gathered:
    """Everything the files held."""

    responses: list[FrequencyResponse] = field(default_factory=list)
    spectra: list[ModeFit] = field(default_factory=list)  # of files that show resonances only
    shaken: list[Spectrum] = field(default_factory=list)  # the same of a machine of modal axes
    skipped: list[str] = field(default_factory=list)  # sentences


def gather(
    paths: Sequence[Path],
    machine: Machine,
    *,
    band_hz: tuple[float, float],
    plan: Plan | None = None,
    axes: Sequence[str] = STRAIGHT,
    shaken_axis: str | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Gathered:
    """Read every file.

    Parameters
    ----------
    axes : the printer's axes in the sensor's own, of captures of a plan.
    shaken_axis : the excited axis of resonance tests whose names do not say it.

    Raises
    ------
    MeasurementError
        For the first file that cannot be used, with all that is wrong with it.
    """
    found, recordings = Gathered(), []
    for path in paths:
        progress(f"reading {path.name}")
        kind = kind_of(path)
        if kind == "frf":
            found.responses += [r.between(*band_hz) for r in read_frfs(path)]
        elif kind == "recording":
            recordings.append(read_recording(path))
        elif plan is not None:
            found.responses += [r.between(*band_hz) for r in frfs_from_captures(plan, [path], machine, axes)]
        elif _OURS in path.stem:
            raise MeasurementError(str(path), [_NEEDS_PLAN])
        elif machine.vibration.position_dependent:
            found.spectra.append(modes_of(path))
        else:
            _take(spectrum_of(path, shaken_axis, band_hz), found)
    if not machine.vibration.position_dependent:
        found.responses += [r for recording in recordings for r in frfs_from_recordings([recording], *band_hz)]
        recordings = []
    for position, members in _by_position(recordings, machine, found.skipped).items():
        found.responses += frfs_from_recordings(members, *band_hz, position_mm=position)
    found.responses = [r for r in found.responses if len(r.frequency_hz)]
    return found


def _take(spectrum: Spectrum | str, found: Gathered) -> None:
    if isinstance(spectrum, str):
        found.skipped.append(spectrum)
    else:
        found.shaken.append(spectrum)


def kind_of(path: Path) -> Kind:
    """Tell the kind of a file by its first line that is no comment of ours.

    Raises
    ------
    MeasurementError
        If it cannot be read, or is of no known kind.
    """
    if not path.is_file():
        raise MeasurementError(str(path), ["There is no such file."])
    if is_stdata(path):
        return "vibration"
    if is_universal(path):
        return "frf"
    lines = [line.strip().lower() for line in read_text(path).splitlines() if line.strip()]
    if not lines:
        raise MeasurementError(str(path), ["The file is empty."])
    header = next((line for line in lines if not line.startswith("# ") and ":" not in line.split(",")[0]), lines[0])
    if header.startswith("frequency_hz"):
        return "frf"
    if columns_of(header) is not None and "cmd_" not in header:
        return "vibration"
    if "t_s" in [name.strip() for name in header.split(",")] or "cmd_" in header:
        return "recording"
    return "vibration"


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


def resonances_of(spectra: Sequence[ModeFit], place: tuple[float, float] = (0.0, 0.0)) -> list[Resonance]:
    """Select the main clear mode of each spectrum whose axis is known."""
    found = []
    for spectrum in spectra:
        clear = [m for m in spectrum.modes if m.clear]
        axis = spectrum.signal.removeprefix("psd_").removeprefix("acc_")
        if clear and axis in AXES:
            found.append(Resonance(axis, place, max(clear, key=lambda m: m.power)))
    return found
