"""`ffcomp show`: look at a compensated print."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from ffcomp.cli.command import Json, verb
from ffcomp.cli.common import opened, print_json, say, say_assumed
from ffcomp.errors import RequestError
from ffcomp.options import PLATE, STAMPED_MACHINE, parse_figure
from ffcomp.request import OUTPUT, Argument, Option, Request

if TYPE_CHECKING:
    from ffcomp.simulation.forecast import Forecast


COMPUTED = "The file keeps no prediction for this machine: these errors were computed now."


@dataclass(frozen=True)
class ShowRequest(Request):
    """A compensated print to be looked at."""

    file: Annotated[Path, Argument("Compensated print.", metavar="FILE")]
    output: Annotated[
        Path | None,
        Option(
            "Picture: .png, .svg or .pdf. Default: FILE.png.",
            OUTPUT,
            "--output",
            "-o",
            metavar="FILE",
            parse=parse_figure,
        ),
    ] = None
    machine: Annotated[str, STAMPED_MACHINE] = ""
    z_mm: Annotated[
        float | None, Option("Height of the layer. Default: where outer walls vibrate most.", OUTPUT, metavar="MM")
    ] = None
    plate: Annotated[int | None, PLATE] = None
    gcode_preview: Annotated[
        Path | None,
        Option(
            "Also write a small G-code for the viewers of slicers and hosts: lines are coloured, as features, by "
            "their contour error. Not for printing.",
            OUTPUT,
            metavar="FILE",
        ),
    ] = None
    preview_of: Annotated[
        Literal["compensated", "original"],
        Option("Whose error --gcode-preview shows: compensated or original.", OUTPUT, metavar="WHICH"),
    ] = "compensated"
    open_it: Annotated[bool, Option("Open the picture when it is made.", OUTPUT, "--open")] = False

    def check(self) -> None:
        """Check that the preview does not go where the print is."""
        if self.gcode_preview is not None and self.gcode_preview.resolve() == self.file.resolve():
            raise RequestError(f"{self.gcode_preview}: --gcode-preview names another file than the print.")


@verb
def show(request: ShowRequest, shown: Json) -> None:
    """Draw a compensated print: reference, uncompensated and compensated path.

    ffcomp simulates both prints with the design model. The errors are those that `ffcomp compensate` predicted and kept
    in the file, or if it holds none, those of the simulation.

    Example: ffcomp show out.gcode
    """
    result = _show(request)
    if shown.as_json:
        print_json(result.to_dict())
    else:
        expected = result.forecast.expected
        said = [] if expected is None else [expected.headline, expected.next_step]
        source = "" if result.kept else COMPUTED
        print(*filter(None, [*said, result.forecast.verdict, source, result.picture, result.gcode_preview]), sep="\n")
    if request.open_it:
        open_picture(str(result.picture))


def open_picture(picture: str) -> None:
    """Open the picture with the program that the desktop has for it; without one the picture is there all the same."""
    if not opened(picture):
        say(f"ffcomp: no program here opens pictures; look at {picture} yourself.")


@dataclass(frozen=True)
class ShowResult:
    """What was drawn of a print."""

    input: Path
    machine: dict[str, str | None]  # as of `identity`
    picture: Path
    gcode_preview: Path | None
    forecast: Forecast
    kept: bool  # in the file; False: computed

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object ffcomp-show/1."""
        return {
            "schema": "ffcomp-show/1",
            "input": self.input,
            "machine": self.machine,  # MACHINE
            "picture": self.picture,  # the file that was drawn
            **(
                {}
                if self.gcode_preview is None
                else {
                    "gcode_preview": self.gcode_preview  # with `--gcode-preview`: the G-code for viewers
                }
            ),
            **self.forecast.to_dict(),
            # text: whether the file keeps them, as `compensate` has predicted: "file"; "computed": it keeps none for
            # this machine
            "source": "file" if self.kept else "computed",
        }


def _show(request: ShowRequest) -> ShowResult:
    from ffcomp.cli.machine_files import machine_of
    from ffcomp.errors import NothingToDo
    from ffcomp.report.show import draw
    from ffcomp.simulation.forecast import forecast_in
    from ffcomp.simulation.gcode_preview import gcode_preview
    from ffcomp.simulation.preview import preview
    from ffcomp.version import __version__
    from gcode.atomic_write import replace_atomically
    from gcode.container import read_bytes
    from gcode.embedded import STAMP_REACH, already_processed, find_offset
    from models.file import load_machine
    from models.machine import identity

    file, target = request.file, request.gcode_preview
    data = read_bytes(file, request.plate)
    stamp = already_processed(data)
    if stamp is None:
        raise NothingToDo(f"{file}: not compensated by ffcomp; first: ffcomp compensate {file} --machine NAME.")
    machine = load_machine(request.machine) if request.machine else machine_of(stamp, file)
    say_assumed([machine])
    offset = find_offset(data[:STAMP_REACH])
    seen = preview(data, str(file), machine, offset, stamp.flavor)
    footer = (
        f"design model of {machine.name}, machine file sha256 {machine.sha256[:8]}; planned as the firmware does; "
        f"ffcomp v{__version__}"
    )
    if target is not None and (original := seen.original) is not None:
        of_original = request.preview_of == "original"
        curve = (seen.before, original.before_due) if of_original else (seen.after, original.after_due)
        replace_atomically(target, gcode_preview(original, *curve, offset))
    picture = request.output or file.with_name(file.name + ".png")
    predicted, kept = forecast_in(data[-STAMP_REACH:], stamp, machine, lambda: seen.forecast(machine))
    draw(seen, predicted, f"{file.name} on {machine.name}", footer, picture, request.z_mm)
    return ShowResult(file, identity(machine), picture, target, predicted, kept)
