"""`ffcomp gap`: measure where and how much recordings and simulation disagree."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from ffcomp.cli.command import Shown, verb
from ffcomp.cli.common import print_json, say
from ffcomp.diagnosis.request import GapRequest

if TYPE_CHECKING:
    from ffcomp.diagnosis.gap import Discrepancy


@verb
def gap(request: GapRequest, shown: Shown) -> None:
    """Measure where and how much recordings and simulation disagree.

    ffcomp simulates each recording with the machine file and its effects. Repeats give the noise: files whose names
    differ in a trailing -1, -2, … only. Captures of ffcomp record plan are joined with their commands by --plan.

    Example: ffcomp gap runs/*.csv --machine my-delta.toml
    """
    from ffcomp.diagnosis.gap import gap_request

    discrepancy = gap_request(replace(request, progress=lambda text: say(f"ffcomp: {text}", shown.quiet)))
    if shown.as_json:
        print_json(discrepancy.to_dict())
    else:
        _print(discrepancy)


def _print(discrepancy: Discrepancy) -> None:
    residual = discrepancy.residual
    print(
        f"Simulation and measurement differ by {100 * residual.total.nrms:.2f} % of the signals; noise alone would "
        f"leave {100 * residual.total.noise_nrms:.2f} % (known from {discrepancy.floor.origin})."
    )
    for title, sizes in (("signal", residual.signals), ("run", residual.recordings)):
        width = max(map(len, sizes))
        for name, size in sizes.items():
            print(f"  {title} {name:{width}}  {100 * size.nrms:7.2f} %  {size.over_noise:7.1f} times the noise")
    for note in discrepancy.notes:
        print(note)
    if residual.total.over_noise < 1.1 and not discrepancy.notes:
        print("There is no gap: what differs is noise.")
        return
    loud = sorted(residual.bands, key=lambda band: -band[2])[:3]
    print("  most of it: " + ", ".join(f"{low:g}-{high:g} Hz {100 * share:.0f} %" for low, high, share in loud))
    for place, share in sorted(residual.positions.items(), key=lambda item: -item[1]):
        print(f"  {'at ' * (len(place) > 1)}{discrepancy.places[place]}: {100 * share:.0f} %")
    print(f"  while something turns back or rests: {100 * residual.near_reversals:.0f} %")
