"""How much prints gain by the better machine file: a short sample, compensated with both, on the better printer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory

from ffcomp.compensation.file import compensate_file
from ffcomp.compensation.job import Options
from ffcomp.diagnosis.result import DiagnosisResult
from ffcomp.diagnosis.words import digits
from ffcomp.errors import FfcompError
from ffcomp.inverse.model import GEOMETRY
from ffcomp.simulation.simulation import Request, read_command, simulate_command
from gcode.errors import GcodeError
from models.effects.catalogue import CATALOGUE
from models.errors import MachineFileError
from models.machine import Machine, with_values


@dataclass(frozen=True)
class PrintGain:
    """Predicted contour errors of the sample, rms in µm, on the printer as the diagnosis found it."""

    uncompensated_um: float
    before_um: float  # compensated with the file as it is
    after_um: float  # with the better file

    def to_dict(self) -> dict[str, float]:
        """Return the JSON's `print_gain`."""
        return {
            "uncompensated_um": self.uncompensated_um,
            "before_um": self.before_um,
            "after_um": self.after_um,
        }

    def sentence(self) -> str:
        """Say what prints gain."""
        return (
            f"How much prints would gain: the contour error of a small sample print (squares and lines at 100 mm/s) is "
            f"predicted to be {digits(self.before_um, 2)} µm rms if it is compensated with the file as it is, and "
            f"{digits(self.after_um, 2)} µm with the better one; uncompensated {digits(self.uncompensated_um, 2)} µm."
        )


def print_gain(machine: Machine, result: DiagnosisResult) -> PrintGain | None:
    """Predict the gain; None without a machine's effect, or where the sample cannot be printed on this machine.

    Nor where the geometry is found to be another: prints are then off by what calibration takes out.
    """
    if result.verdict != "effects" or all(CATALOGUE[name].kind == "sensor" for name in result.effects):
        return None
    if GEOMETRY in result.effects:
        return None
    retuned = with_values(machine, {key: to for key, (_, to) in result.file.retuned.items()})
    better = replace(retuned, effects={**machine.effects, **result.effects})
    with TemporaryDirectory() as folder:
        sample = Path(folder) / "sample.gcode"
        sample.write_text(sample_print(), encoding="ascii")
        try:
            plain = _contour_um(sample, better, better)
            before, after = (_contour_um(_compensated(sample, m), m, better) for m in (machine, better))
        except (FfcompError, GcodeError, MachineFileError):
            return None
    return PrintGain(plain, before, after)


def _compensated(sample: Path, machine: Machine) -> Path:
    target = sample.with_suffix(".out.gcode")
    target.unlink(missing_ok=True)
    compensate_file(sample, sample.name, machine, Options(predict=False), target)
    return target


def _contour_um(file: Path, believed: Machine, true: Machine) -> float:
    command, _ = read_command(file, believed, (0.0, 0.0), "")
    simulation = simulate_command(command, believed, true, Request(1600.0, 0.0, inf, True), path=str(file))
    return simulation.track.contour_rms_um


def sample_print() -> str:
    """Return the sample's G-code: squares of 24 and 16 mm, and eight lines of 12 mm, 1.5 mm apart, at 100 mm/s."""
    lines = ["G28", "G90", "M83", "G1 X-12 Y-12 Z0.3 F6000"]
    for half in (12.0, 8.0):
        for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)):
            lines.append(f"G1 X{x * half:g} Y{y * half:g} E{half / 15:.3f}")
    for i in range(8):
        at, side = 1.5 * i - 6.0, 6.0 * (-1) ** i
        lines += [f"G1 X{at:g} Y{-side:g} E0.05", f"G1 X{at:g} Y{side:g} E0.4"]
    return "\n".join(lines) + "\n"
