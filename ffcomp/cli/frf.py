"""`ffcomp frf`: compute frequency responses anywhere on the bed, and compare them with measured ones."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from ffcomp.cli.command import verb
from ffcomp.cli.common import print_json, say
from ffcomp.errors import RequestError
from ffcomp.request import ADVANCED, MACHINE, OUTPUT, Option, Request

if TYPE_CHECKING:
    from ffcomp.identify.frf_study import Study, View
    from ffcomp.measurement.frf import FrequencyResponse
    from models.arrays import FloatArray
    from models.machine import Machine


Of = Literal["carriage", "nozzle", "acceleration", "carriage-alone", "effector-alone"]
Per = Literal["carriage", "nozzle"]

MOST_LINES = 100_000  # of one response: more is a slip of the finger


@dataclass(frozen=True, kw_only=True)
class FrfRequest(Request):
    """Which frequency responses `ffcomp frf` computes, compares and draws."""

    machine: Annotated[
        str,
        Option(
            "Machine: a name (see: ffcomp machines list) or the path of its file.",
            MACHINE,
            "--machine",
            "-m",
            metavar="NAME",
        ),
    ]
    at: Annotated[tuple[str, ...], Option("Position on the bed, mm. May be repeated.", MACHINE, metavar="X,Y")] = ()
    of: Annotated[
        Of | None,
        Option(
            "Output: carriage (default), nozzle, acceleration (of the nozzle), carriage-alone (sub-model 1, "
            "without the effector) or effector-alone (sub-model 2, force on the free effector).",
            MACHINE,
            metavar="OUTPUT",
        ),
    ] = None
    per: Annotated[Per | None, Option("Input: carriage or nozzle. Default: as --of.", MACHINE, metavar="INPUT")] = None
    measured: Annotated[
        tuple[Path, ...],
        Option("Measured responses (CSV, UFF) to compare with. May be repeated.", MACHINE, metavar="FILE"),
    ] = ()
    added_mass_kg: Annotated[
        tuple[float, ...],
        Option("Mass added to --of carriage-alone. May be repeated.", MACHINE, metavar="KG", low=0.0),
    ] = ()
    with_arms: Annotated[bool, Option("Add the lower halves of the arms to --of effector-alone.", MACHINE)] = False
    lowest_hz: Annotated[
        float | None, Option("Lowest frequency. Default: one step.", ADVANCED, metavar="HZ", low=0.0)
    ] = None
    highest_hz: Annotated[float, Option("Highest frequency.", ADVANCED, metavar="HZ", low=1.0)] = 200.0
    step_hz: Annotated[float, Option("Frequency step.", ADVANCED, metavar="HZ", low=0.01)] = 0.5
    figure: Annotated[Path | None, Option("Draw a figure: .png, .svg or .pdf.", OUTPUT, metavar="FILE")] = None
    full: Annotated[bool, Option("Draw all nine responses, not only the diagonal.", OUTPUT)] = False
    bed_map: Annotated[
        tuple[Path, ...],
        Option("Draw each mode over the bed: .png, .svg, .pdf; .json: its numbers.", OUTPUT, "--map", metavar="FILE"),
    ] = ()
    as_json: Annotated[bool, Option("Accepted; the output is JSON in any case.", OUTPUT, "--json")] = False

    def check(self) -> None:
        """Raise RequestError for a band that is none, or has more lines than anybody means."""
        start = self.step_hz if self.lowest_hz is None else self.lowest_hz
        if start > self.highest_hz:
            raise RequestError(f"--lowest-hz {start:g} lies above --highest-hz {self.highest_hz:g}.")
        if (self.highest_hz - start) / self.step_hz > MOST_LINES:
            raise RequestError(f"--step-hz {self.step_hz:g}: more than {MOST_LINES} frequencies; take a larger step.")

    @property
    def frequency_hz(self) -> FloatArray:
        """(k,) Hz, both ends included."""
        import numpy as np

        start = self.step_hz if self.lowest_hz is None else self.lowest_hz
        return np.arange(start, self.highest_hz + 0.5 * self.step_hz, self.step_hz)


@verb
def frf(request: FrfRequest) -> None:
    """Compute the machine's frequency responses anywhere on the bed.

    Prints one JSON object (ffcomp-frf/1) for each position, and draws figures on request.

    Example: ffcomp frf -m mp-delta-pro --at 0,0 --at -80,0 --figure bode.png --map bed.png
    """
    from ffcomp.identify.frf_study import frf_json, study
    from ffcomp.measurement.frf_files import read_frfs
    from models.file import load_machine

    machine = load_machine(request.machine)
    measured = [response for path in request.measured for response in read_frfs(path)]
    view = _view(request, measured, machine.vibration.position_dependent)
    centre = "{:g},{:g}".format(*machine.kinematics.centre_mm)
    places = [_place(text, machine) for text in request.at or (() if measured else (centre,))]
    result = study(
        machine, view, request.frequency_hz, places, measured, list(request.added_mass_kg), request.with_arms
    )
    for sentence in result.left_out:
        say(f"ffcomp: {sentence}")
    for station in result.stations:
        print_json(frf_json(result, station))
    _draw(result, request)


def _view(request: FrfRequest, measured: list[FrequencyResponse], position_dependent: bool) -> View:
    """Choose input and output: those that are stated, else those of the first measurement, else the carriages."""
    from ffcomp.identify.frf_study import View, view_of

    of: Of | None = request.of if position_dependent else request.of or "nozzle"
    if of is None and request.per is None and measured:
        view = view_of(measured[0])
    else:
        view = View(of or "carriage", request.per or ("nozzle" if of in ("nozzle", "acceleration") else "carriage"))
    if request.per is not None and not view.depends_on_place:
        raise RequestError(f"--per {request.per}: --of {view.of} is no response of the whole printer.")
    if request.added_mass_kg and view.of != "carriage-alone":
        raise RequestError(f"--added-mass-kg goes on a bare carriage: --of carriage-alone, not {view.of}.")
    if request.with_arms and view.of != "effector-alone":
        raise RequestError(f"--with-arms is for the effector by itself: --of effector-alone, not {view.of}.")
    return view


def _place(text: str, machine: Machine) -> FloatArray:
    """(2,) mm from `X,Y`, checked against the machine's reach."""
    import numpy as np

    from models.errors import UnreachableError

    try:
        x, y = (float(part) for part in text.split(","))
        machine.kinematics.check_reach(np.array([[x, y, 0.0]]))
    except UnreachableError as error:
        raise RequestError(f"--at {text}: {error}") from None
    except ValueError:
        raise RequestError(f"--at {text!r}: two numbers with a comma between them, in mm.") from None
    return np.array([x, y])


def _draw(result: Study, request: FrfRequest) -> None:
    if request.figure is not None:
        from ffcomp.report.model import draw_bode

        draw_bode(result, request.figure, request.full)
        say(f"ffcomp: {request.figure}")
    for target in request.bed_map:
        _write_map(result.machine, target)
        say(f"ffcomp: {target}")


def _write_map(machine: Machine, target: Path) -> None:
    from ffcomp.identify.frf_study import mode_map_json
    from gcode.atomic_write import replace_atomically
    from models.errors import MachineFileError
    from models.kinds import delta_vibration
    from models.vibration.mode_map import mode_map

    if not machine.vibration.position_dependent:
        rule = "Straight axes answer alike everywhere on the bed, so there is no map; --figure shows how."
        raise MachineFileError("--map", [rule])
    modes = mode_map(delta_vibration(machine))
    if target.suffix == ".json":
        replace_atomically(target, [json.dumps(mode_map_json(machine, modes)).encode()])
        return
    from ffcomp.report.model import draw_map

    draw_map(machine, modes, target)
