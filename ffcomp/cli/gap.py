"""`ffcomp gap`: do simulation and measurement disagree, where, and how much against the noise."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ffcomp.cli.options import AsJson, MachineName, Runs

if TYPE_CHECKING:
    from ffcomp.diagnose.residuals import Gap, Size

NO_GAP = 1.1  # times the noise


def gap(runs: Runs, machine: MachineName, as_json: AsJson = False) -> None:
    """Measure where and how much recordings and simulation disagree.

    ffcomp simulates each recording with the machine file and its effects. Repeats give the noise: files whose names
    differ in a trailing -1, -2, … only.

    Example: ffcomp gap runs/*.csv --machine my-delta.toml
    """
    from ffcomp.cli.common import exit_codes, print_json

    with exit_codes():
        from ffcomp.diagnose.engine import noise_floor
        from ffcomp.diagnose.noise import whitener
        from ffcomp.diagnose.printer_problem import Delta
        from ffcomp.diagnose.residuals import find_gap
        from ffcomp.diagnose.validation import check_alike
        from ffcomp.measurement.recording import read_recording
        from models.file import load_machine

        loaded, measured = load_machine(machine), [read_recording(path) for path in runs]
        plant = Delta(loaded, measured, ())
        check_alike(measured)
        simulated = plant.simulate({})
        floor = noise_floor(plant, simulated)
        found = find_gap(whitener(plant.observations, floor, plant.band_hz), floor, simulated)
        result = _result(found, floor.from_repeats)
        if as_json:
            print_json(result)
        else:
            _print(found, floor.from_repeats)


def _result(found: Gap, from_repeats: bool) -> dict[str, Any]:
    return {
        "schema": "ffcomp-gap/1",
        **_size(found.whole),
        "noise_from_repeats": from_repeats,
        "signals": {name: _size(size) for name, size in found.signals.items()},
        "where": {
            "frequency_hz": [{"from": low, "to": high, "share": share} for low, high, share in found.bands],
            "signal": {name: _over(size) for name, size in found.signals.items()},
            "region": [{"place_mm": list(place), "share": share} for place, share in found.places.items()],
            "near_reversals": found.near_reversals,
            "runs": {name: _size(size) for name, size in found.recordings.items()},
        },
    }


def _size(size: Size) -> dict[str, float]:
    return {"nrms": size.nrms, "noise_nrms": size.noise_nrms}


def _over(size: Size) -> float:
    """How many times the noise."""
    return size.nrms / size.noise_nrms


def _print(found: Gap, from_repeats: bool) -> None:
    origin = (
        "repeats" if from_repeats else "the spectrum above the model's band, which is weaker: measure something twice"
    )
    print(
        f"Simulation and measurement differ by {100 * found.whole.nrms:.2f} % of the signals; noise alone would leave "
        f"{100 * found.whole.noise_nrms:.2f} % (known from {origin})."
    )
    for title, sizes in (("signal", found.signals), ("run", found.recordings)):
        width = max(map(len, sizes))
        for name, size in sizes.items():
            print(f"  {title} {name:{width}}  {100 * size.nrms:7.2f} %  {_over(size):7.1f} times the noise")
    if _over(found.whole) < NO_GAP:
        print("There is no gap: what differs is noise.")
        return
    loud = sorted(found.bands, key=lambda band: -band[2])[:3]
    print("  most of it: " + ", ".join(f"{low:g}-{high:g} Hz {100 * share:.0f} %" for low, high, share in loud))
    for place, share in sorted(found.places.items(), key=lambda item: -item[1]):
        print(f"  at ({', '.join(f'{x:g}' for x in place)}) mm: {100 * share:.0f} %")
    print(f"  while something turns back or rests: {100 * found.near_reversals:.0f} %")
