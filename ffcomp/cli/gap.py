"""`ffcomp gap`: measure where and how much recordings and simulation disagree."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ffcomp.cli.options import AsJson, CaptureAxes, MachineName, MovesPlanFile, Runs

if TYPE_CHECKING:
    from ffcomp.diagnose.gap import Discrepancy

NO_GAP = 1.1  # times the noise


def gap(
    runs: Runs,
    machine: MachineName,
    plan: MovesPlanFile = None,
    axes_map: CaptureAxes = None,
    as_json: AsJson = False,
) -> None:
    """Measure where and how much recordings and simulation disagree.

    ffcomp simulates each recording with the machine file and its effects. Repeats give the noise: files whose names
    differ in a trailing -1, -2, … only. Captures of ffcomp record plan are joined with their commands by --plan.

    Example: ffcomp gap runs/*.csv --machine my-delta.toml
    """
    from ffcomp.cli.common import exit_codes, print_json, say

    with exit_codes():
        from ffcomp.diagnose.gap import measure_gap
        from ffcomp.diagnose.problems import recordings_of
        from ffcomp.record.axes import turn_of
        from models.file import load_plant

        loaded = load_plant(machine)
        measured = recordings_of(loaded, runs, plan, turn_of(axes_map), lambda text: say(f"ffcomp: {text}", False))
        found = measure_gap(loaded, measured)
        if as_json:
            print_json(found.to_dict())
        else:
            _print(found)


def _print(discrepancy: Discrepancy) -> None:
    from ffcomp.diagnose.gap import over_noise

    found = discrepancy.found
    origin = (
        "repeats"
        if discrepancy.from_repeats
        else "the spectrum above the model's band, which is weaker: measure something twice"
    )
    print(
        f"Simulation and measurement differ by {100 * found.total.nrms:.2f} % of the signals; noise alone would leave "
        f"{100 * found.total.noise_nrms:.2f} % (known from {origin})."
    )
    for title, sizes in (("signal", found.signals), ("run", found.recordings)):
        width = max(map(len, sizes))
        for name, size in sizes.items():
            print(f"  {title} {name:{width}}  {100 * size.nrms:7.2f} %  {over_noise(size):7.1f} times the noise")
    for note in discrepancy.notes:
        print(note)
    if over_noise(found.total) < NO_GAP and not discrepancy.notes:
        print("There is no gap: what differs is noise.")
        return
    loud = sorted(found.bands, key=lambda band: -band[2])[:3]
    print("  most of it: " + ", ".join(f"{low:g}-{high:g} Hz {100 * share:.0f} %" for low, high, share in loud))
    for place, share in sorted(found.positions.items(), key=lambda item: -item[1]):
        print(f"  at ({', '.join(f'{x:g}' for x in place)}) mm: {100 * share:.0f} %")
    print(f"  while something turns back or rests: {100 * found.near_reversals:.0f} %")
