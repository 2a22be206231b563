"""One printer, as each firmware's configuration would state it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ffcomp.importers.builder import MachineDraft, build_draft, machine_text, read_printer_config
from models.file import load_machine
from models.machine import Machine

SAVED = "\n#*# <---------------------- SAVE_CONFIG ---------------------->\n#*# DO NOT EDIT"
SAVED += " THIS BLOCK OR BELOW. The contents are auto-generated.\n#*#\n"
STEPS = "[steps]\nsteps_per_mm = [80.0, 80.0, 400.0]\nfull_steps_per_mm = [5.0, 5.0, 25.0]\n"  # of a machine file


@dataclass(frozen=True)
class Delta:
    """mm, degrees, mm/s, mm/s²."""

    arms: tuple[float, float, float] = (280.5, 280.75, 280.25)
    radius: float = 131.25
    trims: tuple[float, float, float] = (0.25, -0.5, 0.125)
    print_radius: float = 120.0
    height: float = 300.5
    velocity: float = 300.0
    acceleration: float = 3000.0
    corner: float = 5.0
    microsteps: int = 16

    def klipper(self) -> str:
        towers = zip("abc", self.arms, (210, 330, 90), self.trims, strict=True)
        steppers = "".join(
            f"[stepper_{tower}]\nmicrosteps: {self.microsteps}\nrotation_distance: 40\narm_length: {arm!r}\n"
            f"angle: {angle + trim!r}\nposition_endstop: {self.height!r}\n"
            for tower, arm, angle, trim in towers
        )
        return steppers + (
            f"[printer]\nkinematics: delta\nmax_velocity: {self.velocity!r}\nmax_accel: {self.acceleration!r}\n"
            f"square_corner_velocity: {self.corner!r}\nmax_z_velocity: {self.velocity!r}\n"
            f"max_z_accel: {self.acceleration!r}\ndelta_radius: {self.radius!r}\nprint_radius: {self.print_radius!r}\n"
        )

    def reprapfirmware(self) -> str:
        arms, (x, y, z) = ":".join(map(repr, self.arms)), self.trims
        return (
            f'M550 P"Delta" ; the name\nM665 L{arms} R{self.radius!r} H{self.height!r} B{self.print_radius!r} '
            f"X{x!r} Y{y!r} Z{z!r}\nM350 {_axes(self.microsteps)} I1\nM92 {_axes(5 * self.microsteps)}\n"
            f"M203 {_axes(60 * self.velocity)}\nM201 {_axes(self.acceleration)}\nM566 {_axes(60 * self.corner)} P1\n"
        )

    def marlin(self) -> str:
        (a, b, c), (x, y, z) = (arm - self.arms[0] for arm in self.arms), self.trims
        return (
            f"echo:; Steps per unit:\necho:  M92 {_axes(5 * self.microsteps)} E96.00\necho:  M203 "
            f"{_axes(self.velocity)}\necho:  M201 {_axes(self.acceleration)}\necho:  M204 P{self.acceleration!r} "
            f"R9000 T9000\necho:  M205 B20000 S0 T0 {_axes(self.corner)} E5\necho:  M350 {_axes(self.microsteps)}\n"
            f"echo:  M665 L{self.arms[0]!r} R{self.radius!r} H{self.height!r} S200 X{x!r} Y{y!r} Z{z!r} A{a!r} B{b!r} "
            f"C{c!r}\n"
        )


def _axes(value: float) -> str:
    return f"X{value!r} Y{value!r} Z{value!r}"


COREXY = """
[printer]
kinematics: corexy
max_velocity: 400
max_accel: 8000
max_z_velocity: 15
max_z_accel: 350
[stepper_x]
rotation_distance: 40
microsteps: 32
full_steps_per_rotation: 400
position_min: -5
position_max: 300
[stepper_y]
rotation_distance: 40
microsteps: 32
full_steps_per_rotation: 400
position_max: 302.5
[stepper_z]
rotation_distance: 40
gear_ratio: 80:16
microsteps: 16
position_min: -2
position_max: 290
"""
SHAPER = "[input_shaper]\nshaper_type: mzv\nshaper_freq_x: 61.2\nshaper_freq_y: 43.4\ndamping_ratio_y: 0.07\n"


def written(folder: Path, text: str | bytes, name: str = "x") -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def drafted(path: Path, like: Path | None = None, kinematics: str | None = None) -> MachineDraft:
    return build_draft(read_printer_config(path, kinematics), path.stem, like)


def imported(path: Path, **options: str) -> Machine:
    """The machine that an import gives."""
    made = drafted(path, **options)  # type: ignore[arg-type]
    file = path.with_suffix(".toml")
    file.write_text(machine_text(made, path), encoding="utf-8")
    return load_machine(file)
