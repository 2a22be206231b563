"""`ffcomp show`: look at a compensated print."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from ffcomp.cli.command import verb
from ffcomp.numerics.serialise import ALL_OF, keys
from ffcomp.options import PLATE, STAMPED_MACHINE, parse_figure
from ffcomp.request import OUTPUT, Argument, Option, Request
from ffcomp.result import Fact, Result

if TYPE_CHECKING:
    from ffcomp.simulation.forecast import Forecast
    from models.machine import Machine


COMPUTED = "The file contains no prediction for this machine; these errors were computed now."


@dataclass(frozen=True)
class ShowRequest(Request):
    """A compensated print to draw."""

    file: Annotated[Path, Argument("Compensated print.", metavar="FILE")]
    output: Annotated[
        Path | None,
        Option(
            "Picture: .png, .svg or .pdf. Default: FILE.png.",
            OUTPUT,
            "--output -o",
            metavar="FILE",
            parse=parse_figure,
            writes="file",
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
            writes="file",
        ),
    ] = None
    preview_of: Annotated[
        Literal["compensated", "original"],
        Option("Whose error --gcode-preview shows: compensated or original.", OUTPUT, metavar="WHICH"),
    ] = "compensated"


@dataclass(frozen=True, eq=False, repr=False)
class ShowResult(Result):
    """The picture of a print and its errors."""

    title = "Before and after"
    schema = "ffcomp-show/1"
    json_keys: ClassVar = keys("input", "machine", "picture", "gcode_preview", "source") | keys(**{ALL_OF: "forecast"})

    input: Path
    machine: Machine
    picture: Path
    gcode_preview: Path | None
    forecast: Forecast
    kept: bool  # in the file; False: computed
    figure: Any

    def figures(self) -> Sequence[str]:
        """Return the name of its picture."""
        return ("paths",)

    def plot(self, name: str = "", **options: Any) -> Any:
        """Return the picture."""
        return self.figure

    @property
    def source(self) -> str:
        """Where the errors are from: the prediction in the file, or computed now."""
        return "file" if self.kept else "computed"

    @property
    def headline(self) -> str:
        """The expected contour error, in the words of `compensate`."""
        expected = self.forecast.expected
        return self.forecast.verdict if expected is None else expected.headline

    @property
    def facts(self) -> list[Fact]:
        """The errors on the machine as its file says, and the files that were drawn."""
        exact = [("If the machine file is exact", self.forecast.exact)] if self.forecast.tracks else []
        preview = [("G-code for viewers", str(self.gcode_preview))] if self.gcode_preview else []
        return [*exact, ("Picture", str(self.picture)), *preview]

    @property
    def warnings(self) -> list[str]:
        """Whether the machine's modes are assumed, and the errors computed now."""
        return list(filter(None, [self.machine.assumed, "" if self.kept else COMPUTED]))

    @property
    def next_steps(self) -> Sequence[str]:
        """A measurement, where the machine file is not known well enough."""
        expected = self.forecast.expected
        return [expected.next_step] if expected is not None and expected.next_step else []


@verb
def show(request: ShowRequest) -> Result:
    """Draw a compensated print: reference, uncompensated and compensated path.

    ffcomp simulates both prints with the design model. The errors are the prediction that `ffcomp compensate` stored in
    the file or, without one, those of the simulation.

    Example: ffcomp show out.gcode
    """
    from ffcomp.api.machines import machine_of
    from ffcomp.errors import NothingToDo
    from ffcomp.report.show import show_figure
    from ffcomp.simulation.forecast import forecast_in
    from ffcomp.simulation.preview import gcode_preview, preview
    from ffcomp.version import __version__
    from gcode.atomic_write import replace_atomically
    from gcode.container import read_bytes
    from gcode.embedded import STAMP_REACH, already_processed, find_offset
    from models.file import load_machine

    file, target = request.file, request.gcode_preview
    data = read_bytes(file, request.plate)
    stamp = already_processed(data)
    if stamp is None:
        raise NothingToDo(f"{file}: not compensated by ffcomp; first: ffcomp compensate {file} --machine NAME.")
    machine = load_machine(request.machine) if request.machine else machine_of(stamp, file)
    seen = preview(data, str(file), machine)
    footer = (
        f"design model of {machine.name}, machine file sha256 {machine.sha256[:8]}; planned as the firmware does; "
        f"ffcomp v{__version__}"
    )
    if target is not None:
        curve = seen.before if request.preview_of == "original" else seen.after
        replace_atomically(target, gcode_preview(seen.original, curve, find_offset(data[:STAMP_REACH])))
    picture = request.output or file.with_name(file.name + ".png")
    predicted, kept = forecast_in(data[-STAMP_REACH:], stamp, machine, lambda: seen.forecast(machine))
    figure = show_figure(seen, predicted, f"{file.name} on {machine.name}", footer, request.z_mm)
    result = ShowResult(file, machine, picture, target, predicted, kept, figure)
    result.write_figure(picture)
    return result
