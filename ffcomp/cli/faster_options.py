"""The options of a print that is to be quicker, and the bound that they ask for."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from ffcomp.request import FASTER

if TYPE_CHECKING:
    from ffcomp.faster.bound import Bound

MaxError = Annotated[
    list[str] | None,
    typer.Option(
        "--max-error-um",
        metavar="UM",
        rich_help_panel=FASTER,
        help="Print as quickly as a contour error below this allows. 'Feature=UM': another bound for one kind of line, "
        "named as in the file.",
    ),
]
MaxFlow = Annotated[
    float | None,
    typer.Option(
        metavar="V",
        rich_help_panel=FASTER,
        min=0.1,
        help="What the nozzle can melt, mm³/s. Without it: the slicer's setting, or else the largest flow as sliced.",
    ),
]
MaxSpeed = Annotated[
    float | None,
    typer.Option(metavar="V", rich_help_panel=FASTER, min=1.0, help="Highest speed of the nozzle, mm/s."),
]
MinLayerTime = Annotated[
    float | None,
    typer.Option(
        metavar="S",
        rich_help_panel=FASTER,
        min=0.0,
        help="No layer becomes shorter than this. Without it: the slicer's setting, or else 5 s.",
    ),
]
KeepSpeed = Annotated[
    list[str] | None,
    typer.Option(
        metavar="FEATURE",
        rich_help_panel=FASTER,
        help="Keep the slicer's speed of one kind of line, e.g. 'External perimeter'.",
    ),
]
ChangeSpeed = Annotated[
    list[str] | None,
    typer.Option(
        metavar="FEATURE",
        rich_help_panel=FASTER,
        help="Change the speed of one kind of line that keeps the slicer's otherwise: 'Bridge infill', 'first layer'.",
    ),
]
Safety = Annotated[
    float,
    typer.Option(
        metavar="SHARE",
        rich_help_panel=FASTER,
        min=0.001,
        max=0.5,
        help="Share of the printers, as uncertain as the machine file says, that may exceed the bound.",
    ),
]
IfKnown = Annotated[
    str,
    typer.Option(
        metavar="SHARES",
        rich_help_panel=FASTER,
        help="Also measure, on slices, what the print would take if the machine were known better: 2%,1%.",
    ),
]


def shares_known(text: str, bound: Bound | None) -> list[float]:
    """Return the relative standard deviations that `--if-known` asks for."""
    if not text:
        return []
    if bound is None:
        raise typer.BadParameter("--if-known is about a quicker print: --max-error-um UM.")
    try:
        found = [float(each.strip().removesuffix("%")) / 100 for each in text.split(",")]
    except ValueError:
        found = [-1.0]
    if not all(0.0 <= each <= 1.0 for each in found):
        raise typer.BadParameter(f"--if-known {text!r}: shares in %, with commas between them, e.g. 2%,1%.")
    return found


def bound_of(
    errors: list[str] | None,
    flow: float | None,
    speed: float | None,
    layer_time_s: float | None,
    keep_speed: list[str] | None,
    change_speed: list[str] | None,
    safety: float,
    s_curve: bool,
) -> Bound | None:
    """Return the bound that the options ask for; None: none."""
    if not errors:
        if flow is not None or speed is not None or layer_time_s is not None or keep_speed or change_speed:
            raise typer.BadParameter("A quicker print needs the error that it may have: --max-error-um UM.")
        return None
    if s_curve:
        raise typer.BadParameter("--s-curve plans for the slicer's speeds; leave it out with --max-error-um.")
    from ffcomp.faster.bound import Bound

    own: dict[str, float] = {}
    for text in errors:
        name, _, number = text.rpartition("=")
        own[name.strip()] = _micrometres(number, text)
    if "" not in own:
        raise typer.BadParameter("One --max-error-um without a feature says what holds for all others.")
    of_all = own.pop("")
    return Bound(
        of_all,
        tuple(own.items()),
        tuple(keep_speed or ()),
        flow,
        speed,
        layer_time_s,
        tuple(change_speed or ()),
        safety,
    )


def _micrometres(number: str, text: str) -> float:
    try:
        value = float(number)
    except ValueError:
        value = 0.0
    if not 0.1 <= value <= 10_000.0:
        raise typer.BadParameter(f"--max-error-um {text}: it is a number of µm from 0.1 to 10000, or Feature=number.")
    return value
