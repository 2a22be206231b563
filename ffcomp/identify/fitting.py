"""`identify fit` of whatever a machine file describes: from files to a fitted machine file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ffcomp.errors import RequestError
from ffcomp.identify.axis_fit import fit_axis
from ffcomp.identify.load import gather
from ffcomp.identify.machine_fit import MachineFit, Method, fit_measurements
from ffcomp.record.axes import STRAIGHT
from models.kinds import is_one_axis
from models.machine import Machine


@dataclass(frozen=True)
class FitRequest:
    """What is asked of a fit; see `fit_measurements` and `ffcomp.identify.load.gather`."""

    name: str
    plan: str | Path | None = None
    known: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    method: Method = "direct"
    band_hz: tuple[float, float] = (2.0, 400.0)
    axes: Sequence[str] = STRAIGHT
    shaken_axis: Sequence[str] = ()
    column: str | None = None
    rough: bool = False
    write_start: bool = True


def fit_files(
    start: Machine,
    data: Sequence[Path],
    asked: FitRequest,
    progress: Callable[[str], None] = lambda _: None,
) -> MachineFit:
    """Fit a machine file's numbers to files.

    Raises
    ------
    MeasurementError, MachineFileError, RequestError
    """
    if is_one_axis(start):
        if asked.plan is not None or asked.method != "direct":
            raise RequestError("--plan and --method are for printers; an axis by itself is fitted to its runs.")
        return fit_axis(start, data, asked.known, asked.name, progress)
    gathered = gather(
        data,
        start,
        band_hz=asked.band_hz,
        plan=asked.plan,
        axes=asked.axes,
        shaken_axis=asked.shaken_axis,
        column=asked.column,
        progress=progress,
    )
    for sentence in [] if gathered.nothing else gathered.skipped:
        progress(sentence)
    return fit_measurements(
        start,
        gathered,
        data,
        asked.known,
        asked.name,
        method=asked.method,
        write_start=asked.write_start,
        rough=asked.rough,
        progress=progress,
    )
