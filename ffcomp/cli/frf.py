"""`ffcomp frf`: compute frequency responses anywhere on the bed, and compare them with measured ones."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ffcomp.cli.options import Figure, MachineName
from ffcomp.request import ADVANCED, MACHINE, OUTPUT

if TYPE_CHECKING:
    from ffcomp.identify.frf_study import Study, View
    from ffcomp.measurement.frf import FrequencyResponse
    from models.arrays import FloatArray
    from models.machine import Machine


class Of(StrEnum):
    """Outputs."""

    carriage = "carriage"
    nozzle = "nozzle"
    acceleration = "acceleration"
    carriage_alone = "carriage-alone"
    effector_alone = "effector-alone"


class Per(StrEnum):
    """Inputs."""

    carriage = "carriage"
    nozzle = "nozzle"


MOST_LINES = 100_000  # of one response: more is a slip of the finger


At = Annotated[
    list[str] | None,
    typer.Option(metavar="X,Y", rich_help_panel=MACHINE, help="Position on the bed, mm. May be repeated."),
]
Output = Annotated[
    Of | None,
    typer.Option(
        metavar="OUTPUT",
        rich_help_panel=MACHINE,
        help="Output: carriage (default), nozzle, acceleration (of the nozzle), carriage-alone (sub-model 1, "
        "without the effector) or effector-alone (sub-model 2, force on the free effector).",
    ),
]
Input = Annotated[
    Per | None,
    typer.Option(metavar="INPUT", rich_help_panel=MACHINE, help="Input: carriage or nozzle. Default: as --of."),
]
Measured = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="FILE",
        rich_help_panel=MACHINE,
        help="Measured responses (CSV, UFF) to compare with. May be repeated.",
    ),
]
AddedMass = Annotated[
    list[float] | None,
    typer.Option(
        metavar="KG", rich_help_panel=MACHINE, min=0.0, help="Mass added to --of carriage-alone. May be repeated."
    ),
]
WithArms = Annotated[
    bool,
    typer.Option(
        "--with-arms", rich_help_panel=MACHINE, help="Add the lower halves of the arms to --of effector-alone."
    ),
]
Lowest = Annotated[
    float | None,
    typer.Option(metavar="HZ", rich_help_panel=ADVANCED, min=0.0, help="Lowest frequency. Default: one step."),
]
Highest = Annotated[float, typer.Option(metavar="HZ", rich_help_panel=ADVANCED, min=1.0, help="Highest frequency.")]
Step = Annotated[float, typer.Option(metavar="HZ", rich_help_panel=ADVANCED, min=0.01, help="Frequency step.")]
Full = Annotated[
    bool, typer.Option("--full", rich_help_panel=OUTPUT, help="Draw all nine responses, not only the diagonal.")
]
BedMap = Annotated[
    list[Path] | None,
    typer.Option(
        "--map",
        metavar="FILE",
        rich_help_panel=OUTPUT,
        help="Draw each mode over the bed: .png, .svg, .pdf; .json: its numbers.",
    ),
]
AcceptedJson = Annotated[
    bool, typer.Option("--json", rich_help_panel=OUTPUT, help="Accepted; the output is JSON in any case.")
]


def frf(
    machine: MachineName,
    at: At = None,
    of: Output = None,
    per: Input = None,
    measured: Measured = None,
    added_mass_kg: AddedMass = None,
    with_arms: WithArms = False,
    lowest_hz: Lowest = None,
    highest_hz: Highest = 200.0,
    step_hz: Step = 0.5,
    figure: Figure = None,
    full: Full = False,
    bed_map: BedMap = None,
    as_json: AcceptedJson = False,
) -> None:
    """Compute the machine's frequency responses anywhere on the bed.

    Prints one JSON object (ffcomp-frf/1) for each position, and draws figures on request.

    Example: ffcomp frf -m mp-delta-pro --at 0,0 --at -80,0 --figure bode.png --map bed.png
    """
    from ffcomp.cli.common import exit_codes, print_json, say

    with exit_codes():
        from ffcomp.identify.frf_json import frf_json
        from ffcomp.identify.frf_study import study
        from ffcomp.measurement.frf_files import read_frfs
        from models.file import load_machine

        loaded = load_machine(machine)
        responses = [response for path in measured or [] for response in read_frfs(path)]
        if not loaded.vibration.position_dependent:
            of = of or Of.nozzle
        view = _view(of, per, responses, added_mass_kg or [], with_arms)
        centre = "{:g},{:g}".format(*loaded.kinematics.centre_mm)
        places = [_place(text, loaded) for text in at or ([] if responses else [centre])]
        frequencies = _frequencies(lowest_hz, highest_hz, step_hz)
        found = study(loaded, view, frequencies, places, responses, added_mass_kg or [], with_arms)
        for sentence in found.left_out:
            say(f"ffcomp: {sentence}")
        for station in found.stations:
            print_json(frf_json(found, station))
        _draw(found, figure, full, bed_map or [])


def _view(of: Of | None, per: Per | None, measured: list[FrequencyResponse], masses: list[float], arms: bool) -> View:
    """Choose input and output: those asked for, else those of the first measurement, else the carriages."""
    from ffcomp.identify.frf_study import View, view_of

    if of is None and per is None and measured:
        view = view_of(measured[0])
    else:
        answers = of or Of.carriage
        commanded = per or (Per.nozzle if answers in (Of.nozzle, Of.acceleration) else Per.carriage)
        view = View(answers.value, commanded.value)
    if per is not None and not view.depends_on_place:
        raise typer.BadParameter(f"--per {per.value}: --of {view.of} is no response of the whole printer.")
    if masses and view.of != "carriage-alone":
        raise typer.BadParameter(f"--added-mass-kg goes on a bare carriage: --of carriage-alone, not {view.of}.")
    if arms and view.of != "effector-alone":
        raise typer.BadParameter(f"--with-arms is for the effector by itself: --of effector-alone, not {view.of}.")
    return view


def _frequencies(lowest: float | None, highest: float, step: float) -> FloatArray:
    """(k,) Hz, both ends included."""
    import numpy as np

    start = step if lowest is None else lowest
    if start > highest:
        raise typer.BadParameter(f"--lowest-hz {start:g} lies above --highest-hz {highest:g}.")
    if (highest - start) / step > MOST_LINES:
        raise typer.BadParameter(f"--step-hz {step:g}: more than {MOST_LINES} frequencies; take a larger step.")
    return np.arange(start, highest + 0.5 * step, step)


def _place(text: str, machine: Machine) -> FloatArray:
    """(2,) mm from `X,Y`, checked against the machine's reach."""
    import numpy as np

    from models.errors import UnreachableError

    try:
        x, y = (float(part) for part in text.split(","))
        machine.kinematics.check_reach(np.array([[x, y, 0.0]]))
    except UnreachableError as error:
        raise typer.BadParameter(f"--at {text}: {error}") from None
    except ValueError:
        raise typer.BadParameter(f"--at {text!r}: two numbers with a comma between them, in mm.") from None
    return np.array([x, y])


def _draw(found: Study, figure: Path | None, full: bool, maps: list[Path]) -> None:
    from ffcomp.cli.common import say

    if figure is not None:
        from ffcomp.report.model import draw_bode

        draw_bode(found, figure, full)
        say(f"ffcomp: {figure}")
    for target in maps:
        _write_map(found.machine, target)
        say(f"ffcomp: {target}")


def _write_map(machine: Machine, target: Path) -> None:
    from ffcomp.identify.frf_json import mode_map_json
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
