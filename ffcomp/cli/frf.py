"""`ffcomp frf`: how the machine answers, anywhere on its bed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from models.machine import FloatArray, Machine


def frf(
    machine: Annotated[str, typer.Option("--machine", "-m", help="A machine's name or the path of its file.")],
    at: Annotated[
        list[str] | None, typer.Option(metavar="X,Y", help="A place on the bed, mm; may be given several times.")
    ] = None,
    highest_hz: Annotated[float, typer.Option(min=1.0, help="The frequencies end here.")] = 200.0,
    step_hz: Annotated[float, typer.Option(min=0.01, help="Distance of the frequencies.")] = 0.5,
    figure: Annotated[Path | None, typer.Option(help="Draw Bode figures of the carriages: .png, .svg, .pdf.")] = None,
    bed_map: Annotated[
        Path | None, typer.Option("--map", help="Draw each mode's frequency and damping over the bed.")
    ] = None,
) -> None:
    """Frequency responses of the model: commanded to real carriage position, 3 × 3, by receptance coupling.

    Prints one JSON object a place (ffcomp-frf/1). Pictures on request.

    Example: ffcomp frf -m mp-delta-pro --at 0,0 --at -80,0 --figure bode.png --map bed.png
    """
    from ffcomp.cli.common import exit_codes, print_json, say

    with exit_codes():
        import numpy as np

        from models.machine_file import load_machine

        loaded = load_machine(machine)
        places = [_place(text, loaded) for text in at or ["0,0"]]
        frequencies = np.arange(step_hz, highest_hz + 0.5 * step_hz, step_hz)
        for place in places:
            print_json(_answer(loaded, place, frequencies))
        if figure is not None or bed_map is not None:
            from ffcomp.report.frf import draw_bode, draw_map

            if figure is not None:
                draw_bode(loaded, places, frequencies, figure)
                say(f"ffcomp: {figure}")
            if bed_map is not None:
                draw_map(loaded, bed_map)
                say(f"ffcomp: {bed_map}")


def _place(text: str, machine: Machine) -> FloatArray:
    """(2,) mm from `X,Y`, checked against the machine's reach."""
    import numpy as np

    from models.errors import UnreachableError
    from models.kinematics.delta import check_reach

    try:
        x, y = (float(part) for part in text.split(","))
        check_reach(machine.kinematics, np.array([[x, y, 0.0]]))
    except UnreachableError as error:
        raise typer.BadParameter(f"--at {text}: {error}") from None
    except ValueError:
        raise typer.BadParameter(f"--at {text!r}: two numbers with a comma between them, in mm.") from None
    return np.array([x, y])


def _answer(machine: Machine, place: FloatArray, frequencies: FloatArray) -> dict[str, Any]:
    import numpy as np

    from models.receptance import carriage_frf

    g = carriage_frf(machine, place, frequencies)
    phase = np.degrees(np.unwrap(np.angle(g), axis=0))
    rows = range(3)
    return {
        "schema": "ffcomp-frf/1",
        "machine": {"name": machine.name, "sha256": machine.sha256},
        "position_mm": [*place.tolist(), 0.0],
        "frequency_hz": frequencies.tolist(),
        "carriage": [
            [{"magnitude": np.abs(g[:, i, j]).tolist(), "phase_deg": phase[:, i, j].tolist()} for j in rows]
            for i in rows
        ],
    }
