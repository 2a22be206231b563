"""`ffcomp machines effort`: what accuracy costs in command acceleration, and where the knee is."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from ffcomp.cli.options import AsJson, Figure

if TYPE_CHECKING:
    from ffcomp.inverse.settings import EffortCurve

Name = Annotated[str, typer.Argument(metavar="MACHINE", help="A machine's name or the path of its file.")]

RATES = (250.0, 500.0)  # segments a second


def effort(machine: Name, figure: Figure = None, as_json: AsJson = False) -> None:
    """Show the inverse's accuracy against the carriage acceleration that it needs.

    ffcomp compensate uses the bandwidth at the knee of this curve.

    Example: ffcomp machines effort mp-delta-pro --figure effort.png
    """
    from ffcomp.cli.common import exit_codes, print_json, say

    with exit_codes():
        from ffcomp.inverse.settings import effort_curve
        from models.effects.catalogue import design_machine
        from models.file import load_machine

        loaded = load_machine(machine)
        curves = {rate: effort_curve(design_machine(loaded)[0], 1 / rate) for rate in RATES}
        if figure is not None:
            from ffcomp.report.model import draw_effort

            draw_effort(curves, loaded, figure)
            say(f"ffcomp: drawn into {figure}.")
        if as_json:
            rates = [_as_json(rate, curve) for rate, curve in curves.items()]
            print_json({"schema": "ffcomp-effort/1", "machine": loaded.name, "sha256": loaded.sha256, "rates": rates})
        else:
            for rate, curve in curves.items():
                _print(rate, curve)


def _as_json(rate: float, curve: EffortCurve) -> dict[str, object]:
    return {
        "segments_per_second": rate,
        "bandwidth_hz": curve.bandwidth_hz.tolist(),
        "tracking_rms_um": curve.error_um.tolist(),
        "peak_command_acceleration_mm_per_s2": curve.peak_mm_per_s2.tolist(),
        "knee_hz": curve.knee_hz,
    }


def _print(rate: float, curve: EffortCurve) -> None:
    print(f"{rate:g} segments/s, a square of 8 mm (the plan itself: {curve.plan_mm_per_s2 / 1e3:.1f} m/s²)")
    print("  bandwidth   tracking rms   peak command")
    for k in range(len(curve.bandwidth_hz)):
        mark = "   <- the knee" if k == curve.knee else ""
        peak = curve.peak_mm_per_s2[k] / 1e3
        print(f"  {curve.bandwidth_hz[k]:6.1f} Hz   {curve.error_um[k]:9.1f} µm   {peak:7.1f} m/s²{mark}")
