"""Machines and their frequency responses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ffcomp.errors import extras_told
from ffcomp.identify.frf_study import Study, View, frf_json, study
from models.arrays import ComplexArray, FloatArray
from models.file import load_machine as read_machine
from models.file import load_plant as read_plant
from models.machine import Machine

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Position = tuple[float, float]


def load_machine(machine: str | Path | Machine) -> Machine:
    """Load a machine by its name or from its file.

    Parameters
    ----------
    machine : a name of the library (`ffcomp machines list`), the path of a TOML file, or a machine already

    Raises
    ------
    models.errors.MachineFileError
        If the file cannot be read, with every mistake in it as a sentence.
    """
    return machine if isinstance(machine, Machine) else read_machine(str(machine))


def load_plant(machine: str | Path | Machine) -> Machine:
    """Load a printer or one axis by itself, as `load_machine` does."""
    return read_plant(str(machine)) if isinstance(machine, str | Path) else machine


@dataclass(frozen=True, eq=False)
class FrequencyResponses:
    """Frequency responses of a machine at some positions.

    Attributes
    ----------
    machine : Machine
    frequency_hz : (k,) array
    positions_mm : (n, 2) array, columns X Y
    values : (n, k, r, c) complex array
        Row r answers column c: carriages A B C, or nozzle axes X Y Z, as was asked for.
    rows, columns : names of the outputs and of the inputs
    """

    machine: Machine
    frequency_hz: FloatArray
    positions_mm: FloatArray
    values: ComplexArray
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    study: Study

    def to_dict(self) -> list[dict[str, Any]]:
        """Return an object ffcomp-frf/1 for each position."""
        return [frf_json(self.study, station) for station in self.study.stations]

    @extras_told()
    def to_control(self) -> list[Any]:
        """Return each position's responses as a `control.FrequencyResponseData`, frequencies in rad/s."""
        import control

        omega = 2 * np.pi * self.frequency_hz
        return [control.frd(np.moveaxis(value, 0, -1), omega) for value in self.values]

    @extras_told()
    def plot(self, *, full: bool = False) -> Figure:
        """Draw a Bode figure; full : all nine responses, not only the diagonal."""
        from ffcomp.report.model import bode_figure

        return bode_figure(self.study, full)


def frf(
    machine: str | Path | Machine,
    positions_mm: Sequence[Position] = (),
    *,
    of: Literal["carriage", "nozzle", "acceleration"] | None = None,
    per: Literal["carriage", "nozzle"] | None = None,
    frequency_hz: FloatArray | None = None,
) -> FrequencyResponses:
    """Compute frequency responses of the linear model.

    Parameters
    ----------
    machine : a machine, its name or its file
    positions_mm : X, Y of each position; none: the centre of the bed
    of, per : output and input, as of `ffcomp frf`; None: what suits the machine
    frequency_hz : (k,) array; None: 0.5 to 200 Hz in steps of 0.5 Hz

    Raises
    ------
    models.errors.UnreachableError
        If a position lies outside the bed.
    """
    loaded = load_machine(machine)
    output = of or ("nozzle" if not loaded.vibration.position_dependent else "carriage")
    view = View(output, per or ("carriage" if output == "carriage" else "nozzle"))
    places = [np.array(xy, dtype=float) for xy in positions_mm or [loaded.kinematics.centre_mm]]
    loaded.kinematics.check_reach(np.array([[x, y, 0.0] for x, y in places]))
    frequencies = np.arange(0.5, 200.25, 0.5) if frequency_hz is None else np.asarray(frequency_hz, dtype=float)
    found = study(loaded, view, frequencies, places, [], [], False)
    values = np.stack([station.value for station in found.stations])
    return FrequencyResponses(
        loaded, found.frequency_hz, np.array(places), values, tuple(view.rows), tuple(view.columns), found
    )
