"""What every effect of the catalogue does, drawn, and the page that tells of them all: docs/EFFECTS.md.

    python -m scripts.pages.effects --write     some 20 seconds; needs matplotlib

Everything is computed: the library's printer is simulated with the effect and without it. What an effect is shown by
stands in `SHOWN`; one that is not there is shown by hard moves and by a response.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.effects.catalogue import CATALOGUE, effective_machine, effects_of, measured, with_effect
from models.effects.effect import Effect, EffectParameter
from models.file import load_machine
from models.kinds import delta_vibration, with_parts
from models.machine import Machine
from models.printer.printer import simulate_printer

FloatArray = NDArray[np.float64]
RealArray = NDArray[np.floating[Any]]

DOCS = Path(__file__).parents[2] / "docs"
PAGE = DOCS / "EFFECTS.md"
MACHINE = "mp-delta-pro"
ROW_S = 1 / 3200
HEIGHT_MM = 30.0
WITHOUT, WITH, APART = "#8a8f98", "#0072b2", "#d55e00"
SIZE_INCH, DPI = (7.2, 2.5), 100


@dataclass(frozen=True)
class Curve:
    x: RealArray  # (n,)
    y: RealArray  # (n,)


@dataclass(frozen=True)
class Panel:
    """One of the two views of an effect: a curve without it, one with it, and in time their difference."""

    title: str
    axes: tuple[str, str]
    draw: Callable[[Machine], Curve]
    apart: bool = False
    logarithmic: bool = False
    least: float | None = None  # of y that is drawn


@dataclass(frozen=True)
class Shown:
    """An effect of a usual size and where it is characteristic."""

    values: Mapping[str, Any]
    look: str  # what to look for in the figure
    panels: tuple[Panel, Panel]
    base: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # effects of both curves
    paper: bool = False  # the base shares the load as Eqs. 22-27 do
    machine: str = ""  # of the library, if not MACHINE


# ---- motions -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sine:
    """The nozzle to and fro along an axis from the centre, faded in over the first period."""

    axis: str
    reach_mm: float
    frequency_hz: float
    periods: int = 6

    def path(self) -> FloatArray:
        """(n, 3) mm"""
        t = np.arange(0.0, self.periods / self.frequency_hz, ROW_S)
        s = np.clip(t * self.frequency_hz, 0.0, 1.0)
        fade = s**3 * (10 - 15 * s + 6 * s**2)
        return np.outer(fade * np.sin(2 * np.pi * self.frequency_hz * t) * self.reach_mm, _unit(self.axis))


@dataclass(frozen=True)
class Line:
    """The nozzle along an axis at an even speed, after a soft start."""

    axis: str
    speed_mm_per_s: float
    seconds: float
    start_s: float = 0.1

    def path(self) -> FloatArray:
        """(n, 3) mm"""
        t = np.arange(0.0, self.seconds, ROW_S)
        s = np.clip(t / self.start_s, 0.0, 1.0)
        moved = np.cumsum(s**3 * (10 - 15 * s + 6 * s**2)) * ROW_S * self.speed_mm_per_s
        return np.outer(moved, _unit(self.axis))


@dataclass(frozen=True)
class Step:
    """One hard move along an axis, and rest."""

    axis: str
    length_mm: float = 12.0
    acceleration: float = 5000.0  # mm/s²
    seconds: float = 0.4
    begin_s: float = 0.05

    def path(self) -> FloatArray:
        """(n, 3) mm"""
        t = np.arange(0.0, self.seconds, ROW_S) - self.begin_s
        half = np.sqrt(self.length_mm / self.acceleration)
        first, second = np.clip(t, 0.0, half), np.clip(t - half, 0.0, half)
        moved = self.acceleration * (0.5 * first**2 + half * second - 0.5 * second**2)
        return np.outer(moved, _unit(self.axis))


Motion = Sine | Line | Step


def _unit(axis: str) -> FloatArray:
    return np.eye(3)["xyz".index(axis)]


@cache
def shaking(axis: str) -> FloatArray:
    """(n, 3) mm: two periods of 2 s with every line of 3 to 150 Hz, even in acceleration, up to 3 m/s²."""
    t = np.arange(0.0, 4.0, ROW_S)
    f = np.arange(3.0, 150.0, 0.5)
    phase = np.random.default_rng(5).uniform(0, 2 * np.pi, len(f))
    moved = np.sin(2 * np.pi * np.outer(t, f) + phase) @ (1 / (2 * np.pi * f) ** 2)
    peak = np.abs(np.sin(2 * np.pi * np.outer(t, f) + phase).sum(axis=1)).max()
    return np.outer((moved - moved[0]) * 3000.0 / peak, _unit(axis))


# ---- panels --------------------------------------------------------------------------------------


def signal_of(
    machine: Machine, path: FloatArray, signal: str, height_mm: float = HEIGHT_MM, aside_mm: float = 0.0
) -> FloatArray:
    """(n,) m/s² that the sensor records while the nozzle is sent along (n, 3) mm from the centre, or aside of it."""
    x, y = machine.kinematics.centre_mm
    nozzle = path + np.array([x + aside_mm, y, height_mm])
    motion = simulate_printer(machine, machine.kinematics.inverse(nozzle), ROW_S)
    felt = measured(machine, motion.signals)
    axis = signal[-1]
    return felt.carriage[:, "ABC".index(axis)] if axis in "ABC" else felt.nozzle[:, "xyz".index(axis)]


def trace(motion: Motion, signal: str, from_s: float, to_s: float, title: str = "") -> Panel:
    """The signal over a part of the time."""

    def draw(machine: Machine) -> Curve:
        y = signal_of(machine, motion.path(), signal)
        t = ROW_S * np.arange(len(y))
        part = (t >= from_s) & (t <= to_s)
        return Curve(1e3 * t[part], y[part])

    return Panel(title, ("time, ms", f"{signal}, m/s²"), draw, apart=True)


def spectrum(motion: Motion, signal: str, from_s: float, to_hz: float, title: str = "") -> Panel:
    """The amplitude of the signal's lines, after a while."""

    def draw(machine: Machine) -> Curve:
        y = signal_of(machine, motion.path(), signal)[round(from_s / ROW_S) :]
        window = np.hanning(len(y))
        lines = 2 * np.abs(np.fft.rfft(window * (y - y.mean()))) / window.sum()
        f = np.fft.rfftfreq(len(y), ROW_S)
        return Curve(f[f <= to_hz], lines[f <= to_hz])

    return Panel(title, ("frequency, Hz", f"{signal}, m/s²"), draw, logarithmic=True, least=1e-3)


def response(
    axis: str,
    signal: str,
    title: str = "",
    height_mm: float = HEIGHT_MM,
    angle: bool = False,
    aside_mm: float = 0.0,
) -> Panel:
    """Acceleration felt for what is commanded along an axis; its angle in degrees instead of its size."""

    def draw(machine: Machine) -> Curve:
        y = signal_of(machine, shaking(axis), signal, height_mm, aside_mm)
        half = len(y) // 2
        f = np.fft.rfftfreq(half, ROW_S)
        lines = (f >= 5.0) & (f <= 120.0)
        commanded = np.fft.rfft(shaking(axis)[half:, "xyz".index(axis)])[lines] * -((2 * np.pi * f[lines]) ** 2) * 1e-3
        found = np.fft.rfft(y[half:])[lines] / commanded
        return Curve(f[lines], np.degrees(np.unwrap(np.angle(found))) if angle else np.abs(found))

    what = "angle, degrees" if angle else f"{signal} / commanded {axis}"
    return Panel(title, ("frequency, Hz", what), draw, logarithmic=not angle)


def misplacement(axis: str, title: str) -> Panel:
    """Where the nozzle rests, against where it should, along x."""

    def draw(machine: Machine) -> Curve:
        x = np.linspace(-110.0, 110.0, 45)
        wanted = np.column_stack([x, np.zeros_like(x), np.full_like(x, HEIGHT_MM)])
        true = effective_machine(machine).kinematics.forward(machine.kinematics.inverse(wanted))
        i = "xyz".index(axis)
        off = true[:, i] - wanted[:, i]
        return Curve(x, off - off[len(x) // 2])  # homing and calibration make it right in the middle

    return Panel(title, ("commanded x, mm", f"{axis}: true less wanted, mm"), draw)


# ---- what each effect is shown by ----------------------------------------------------------------

TURNS = Sine("x", 4.0, 4.0, 4)
HARD = Step("x")
LOUD = Sine("z", 1.0, 14.0, 28)
BOTH = (response("x", "acc_x", "nozzle"), response("x", "acc_A", "carriage A"))

SHOWN: dict[str, Shown] = {
    "arm_geometry": Shown(
        {"arm_length_mm": 1.0},
        "A bowed first layer and another scale of the print, both right in the middle; accelerations hardly change.",
        (misplacement("z", "bowed"), misplacement("x", "and of another scale")),
    ),
    "arm_inertia": Shown(
        {"share_along": 1.0},
        "Sideways the slow resonances rise a little; up and down at the centre nothing changes. Shown for uniform "
        "rods, the most there can be, of arms of 32 g a pair.",
        (response("x", "acc_x", "along x"), response("z", "acc_z", "up and down")),
    ),
    "belt_backlash": Shown(
        {"width_mm": 0.06},
        "Where the motion pulls harder than gravity the carriage lets go and falls back with a knock; gentler motions "
        "do not show it at all.",
        (
            trace(Sine("z", 2.5, 12.0, 6), "acc_A", 0.25, 0.45, "up and down with 1.4 g"),
            trace(Sine("z", 1.0, 12.0, 6), "acc_A", 0.25, 0.45, "with 0.6 g"),
        ),
    ),
    "belt_damping": Shown(
        {"share": [0.6, 0.6, 0.0]},
        "The size of the answer hardly changes; its phase lags less, most of all around the resonance. Shown on "
        "`ender-3`.",
        (response("x", "acc_x", "size"), response("x", "acc_x", "angle", angle=True)),
        machine="ender-3",
    ),
    "belt_hardening": Shown(
        {"cubic_n_per_m3": 2e12},
        "A sine of 14 Hz answers with harmonics as well: the stronger, the louder it is.",
        (
            spectrum(Sine("z", 0.3, 14.0, 28), "acc_A", 1.0, 100.0, "a gentle sine"),
            spectrum(LOUD, "acc_A", 1.0, 100.0, "a loud sine"),
        ),
    ),
    "belt_position_stiffness": Shown(
        {"slope_per_m": 0.8, "q_centre_mm": 330.0},
        "The resonance shifts with the height over the bed, and stays where the carriages are at q_c.",
        (
            response("x", "acc_A", "low over the bed", 10.0),
            response("x", "acc_A", "high over the bed", 250.0),
        ),
    ),
    "belt_stiffness": Shown({"relative_change": 0.2}, "All resonances shift together.", BOTH),
    "center_of_mass": Shown(
        {"offset_mm": [10.0, 0.0, 0.0]},
        'Shaken up and down, carriage A carries more than before, B less. Shown for a file with `force_map = "paper"`; '
        "by virtual work both curves are one.",
        (response("z", "acc_A", "carriage A"), response("z", "acc_B", "carriage B")),
        paper=True,
    ),
    "cogging": Shown(
        {"amplitude_mm": 0.01, "pitch_mm": 0.8},
        "A line at speed / pitch, which moves with the speed: a resonance would stay.",
        (
            spectrum(Line("z", 16.0, 1.6), "acc_A", 0.3, 100.0, "at 16 mm/s: 20 Hz"),
            spectrum(Line("z", 32.0, 1.6), "acc_A", 0.3, 100.0, "at 32 mm/s: 40 Hz"),
        ),
    ),
    "command_delay": Shown(
        {"delay_s": 3e-3},
        "The same answer, later; the angle falls in proportion to the frequency.",
        (
            trace(HARD, "acc_x", 0.03, 0.2, "a hard move"),
            response("x", "acc_x", "angle of the response", angle=True),
        ),
    ),
    "coulomb_friction": Shown(
        {"force_n": 3.0},
        "A jump wherever the carriage turns back, which then rings; of much the same size at every speed.",
        (
            trace(TURNS, "acc_A", 0.45, 0.95, "to and fro, 100 mm/s at most"),
            trace(Sine("x", 1.5, 4.0, 4), "acc_A", 0.45, 0.95, "the same at 38 mm/s"),
        ),
    ),
    "effector_mass": Shown({"added_kg": 0.15}, "Lower resonances; all towers alike.", BOTH),
    "extruder_mount": Shown(
        {"relative_stiffness_change": [-0.5, 0.0, 0.0], "relative_damping_change": [-0.5, 0.0, 0.0]},
        "The nozzle's answer changes along one axis, above the mount's own frequency; along the other it does not.",
        (response("x", "acc_x", "along x, whose mount is loose"), response("y", "acc_y", "along y")),
    ),
    "force_map": Shown(
        {},
        "The lowest modes are off by a factor of about 1.5.",
        BOTH,
    ),
    "frame_mode": Shown(
        {"mass_kg": 15.0, "frequency_hz": 18.0, "damping_ratio": 0.03, "direction": "x"},
        "A pair of peak and dip at the frame's frequency, only along the direction of its sway.",
        (response("x", "acc_x", "along x, where it sways"), response("y", "acc_y", "along y")),
    ),
    "gantry_racking": Shown(
        {"radius_mm": 150.0, "frequency_hz": 45.0, "damping_ratio": 0.04, "x_centre_mm": 125.0},
        "In the middle nothing; aside of it y has a second resonance. Shown on `voron-250`.",
        (
            response("y", "acc_y", "in the middle"),
            response("y", "acc_y", "90 mm to the right", aside_mm=90.0),
        ),
        machine="voron-250",
    ),
    "growing_bed": Shown(
        {"growth_per_m": [0.0, 3.0, 0.0]},
        "The resonance of the bed falls as the print grows; at the first layer it is that of the file. Shown on "
        "`ender-3`, whose bed moves along y.",
        (
            response("y", "acc_y", "first layer", 0.0),
            response("y", "acc_y", "150 mm high", 150.0),
        ),
        machine="ender-3",
    ),
    "guide_damping": Shown({"added_n_s_per_m": 25.0}, "Lower and broader resonances, at the same frequencies.", BOTH),
    "joint_friction": Shown(
        {"force_n": 3.0},
        "The nozzle's acceleration jumps where the nozzle turns back, and all carriages feel it together.",
        (trace(TURNS, "acc_x", 0.45, 0.95, "nozzle"), trace(TURNS, "acc_A", 0.45, 0.95, "carriage A")),
    ),
    "sensor_clock_drift": Shown(
        {"relative_drift": 0.01},
        "In step at the beginning of the record, out of step at its end.",
        (
            trace(Sine("x", 1.0, 12.0, 36), "acc_x", 0.1, 0.35, "early in the record"),
            trace(Sine("x", 1.0, 12.0, 36), "acc_x", 2.65, 2.9, "late in the record"),
        ),
    ),
    "sensor_gain": Shown(
        {"carriage_relative_change": [0.1, 0.0, 0.0]},
        "One channel is too large by one factor, at all times and frequencies; the others are right.",
        (trace(HARD, "acc_A", 0.03, 0.2, "the sensor of A"), trace(HARD, "acc_B", 0.03, 0.2, "the sensor of B")),
    ),
    "sensor_misalignment": Shown(
        {"angles_deg": [0.0, 0.0, 6.0]},
        "A motion along x shows in y as well, as a small copy of x.",
        (trace(HARD, "acc_x", 0.03, 0.2, "the move along x"), trace(HARD, "acc_y", 0.03, 0.2, "response in y")),
    ),
    "sensor_time_offset": Shown(
        {"offset_s": 5e-3},
        "Every channel late by the same time, those of the carriages as well.",
        (trace(HARD, "acc_x", 0.03, 0.2, "nozzle"), trace(HARD, "acc_A", 0.03, 0.2, "carriage A")),
    ),
    "stribeck_friction": Shown(
        {"force_n": 2.0, "extra_force_n": 1.5, "velocity_mm_per_s": 20.0},
        "Against dry friction of the same force: after each turn it rings for longer, for friction that falls with "
        "speed feeds the swing; slow motion goes in jerks.",
        (
            trace(Sine("x", 6.0, 4.0, 4), "acc_A", 0.56, 0.82, "150 mm/s at most"),
            trace(Sine("x", 0.5, 4.0, 4), "acc_A", 0.56, 0.82, "13 mm/s at most"),
        ),
        base={"coulomb_friction": {"force_n": 2.0}},
    ),
    "toolhead_mode": Shown(
        {"slope_per_m": [0.0, 0.0, 0.0], "curve_per_m2": [0.0, 20.0, 0.0], "x_centre_mm": 125.0},
        "The resonance of y stays in the middle and shifts at the sides. Shown on `voron-250`.",
        (
            response("y", "acc_y", "in the middle"),
            response("y", "acc_y", "100 mm to the right", aside_mm=100.0),
        ),
        machine="voron-250",
    ),
    "torque_angle": Shown(
        {"amplitude_mm": 0.12},
        "A gentle motion hardly shows it; a loud sine of 14 Hz answers with a row of harmonics.",
        (
            spectrum(Sine("z", 0.3, 14.0, 28), "acc_A", 1.0, 100.0, "a gentle sine"),
            spectrum(LOUD, "acc_A", 1.0, 100.0, "a loud sine"),
        ),
    ),
}


def shown(effect: Effect) -> Shown:
    """What is declared here; an effect that is not, at its largest usual size by a hard move and a response."""
    if effect.name in SHOWN:
        return SHOWN[effect.name]
    values = {p.name: _usual(p) for p in effect.parameters if p.default is None}
    return Shown(values, effect.in_data, (trace(HARD, "acc_A", 0.03, 0.3, "a hard move"), response("x", "acc_x")))


def _usual(p: EffectParameter) -> Any:
    if p.size == "direction":
        return "both"
    value = sum(p.typical) / 2 if p.role == "shape" else p.typical[p.power > 0]
    return [value] * 3 if p.size == "vector3" else value


def machines(effect: Effect, seen: Shown) -> tuple[Machine, Machine]:
    """Without the effect, and with it."""
    base = load_machine(seen.machine or MACHINE)
    if seen.paper:
        base = with_parts(base, effector=replace(delta_vibration(base).effector, force_map="paper"))
    for name, table in seen.base.items():
        base = with_effect(base, name, **table)
    alone = replace(base, effects={}) if seen.base else base  # the effect takes the place of what it is compared with
    return base, with_effect(alone, effect.name, **seen.values)


# ---- figures -------------------------------------------------------------------------------------


def draw(effect: Effect, path: Path) -> None:
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    seen = shown(effect)
    pair = machines(effect, seen)
    with rc_context({"font.size": 8, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=SIZE_INCH, dpi=DPI, layout="constrained")
        for axes, panel in zip(figure.subplots(1, 2), seen.panels, strict=True):
            _panel(axes, panel, *(panel.draw(machine) for machine in pair))
        handles, labels = axes.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
        figure.savefig(path, pil_kwargs={"optimize": True}, metadata={"Software": None})
    _fewer_colours(path)


def _panel(axes: Any, panel: Panel, without: Curve, with_it: Curve) -> None:
    axes.plot(without.x, without.y, color=WITHOUT, lw=2.2, label="without")
    axes.plot(with_it.x, with_it.y, color=WITH, lw=1.1, label="with")
    if panel.apart:
        axes.plot(without.x, with_it.y - without.y, color=APART, lw=0.9, label="difference")
    if panel.logarithmic:
        axes.set_yscale("log")
        axes.set_ylim(bottom=panel.least)
    axes.set_title(panel.title, fontsize=8, loc="left")
    axes.set_xlabel(panel.axes[0])
    axes.set_ylabel(panel.axes[1])
    axes.margins(x=0)
    axes.grid(alpha=0.25, lw=0.5)


def _fewer_colours(path: Path) -> None:
    """64 colours are enough for lines, and a third of the bytes."""
    from PIL import Image

    with Image.open(path) as image:
        image.convert("RGB").quantize(64).save(path, optimize=True)


# ---- the page ------------------------------------------------------------------------------------

HEAD = """# The effects

Deviations of a printer from the basic model: {count} effects, each with its physics, parameters, signature in data and
the effects that it is easily confused with. `ffcomp diagnose` finds them, the virtual printer simulates them, and a
machine file contains them as `[effects.name]`. Each is declared once, in the file of its family in `models/effects/`
([how to add one](where_do_I_change.md#a-new-effect)).

Figures: the library's `{machine}` at the centre, {height:g} mm above the bed, without the effect (grey) and with it
(blue); in time also their difference (orange). Accelerations are those of a sensor; frequency responses are measured
per commanded acceleration.

Cartesian and CoreXY machines have all effects except those marked for deltas only. Lists of three are then in the
order x, y, z; for motors and belts of a CoreXY they are belt A, belt B, z. If no axis has a `mass_kg`, forces, dampings
and masses are per kilogram of moved mass, with keys that end in `_per_kg`. The stretch s is the motor's lead over the
driven point (`models/vibration/modal.py`); a `frame_mode` sways under all moving axes. Three effects depend on the
nozzle's position on such a machine: `gantry_racking`, `growing_bed` and `toolhead_mode`. `ffcomp diagnose` looks for
them if the recordings lie 40 mm apart along x, or 20 mm along z.

`python -m scripts.pages.effects --write` writes this page and its figures.
"""
KINDS = {
    "parameter": "changes the machine's numbers",
    "force": "a force the machine file has no number for",
    "command": "changes what the motors do",
    "frame": "gives the machine something more that moves",
    "sensor": "changes the recording, not the motion: corrected, never compensated",
}
ONLY = {("carriages", "axes"): "", ("carriages",): "; of deltas only", ("axes",): "; of straight axes only"}
SIZES = {"scalar": "one", "per_tower": "one, or one a tower", "vector3": "three, x y z", "direction": "a direction"}


def printers(effect: Effect) -> tuple[str, ...]:
    """Return the kinds of printers that may have it; the page tells nothing of an axis by itself."""
    return tuple(moves for moves in effect.of if moves != "axis")


def page() -> str:
    """The text of docs/EFFECTS.md."""
    effects = [CATALOGUE[name] for name in effects_of()]
    head = HEAD.format(count=len(effects), machine=MACHINE, height=HEIGHT_MM)
    listed = [f"- [`{e.name}`](#{e.name}): {_small(e.title)}" for e in effects]
    return "\n".join([head, *listed, "", *(_section(e) for e in effects)])


def _small(title: str) -> str:
    return title[0].lower() + title[1:]


def _section(effect: Effect) -> str:
    seen = shown(effect)
    parts = [
        f"## {effect.name}\n\n**{effect.title}** ({KINDS[effect.kind]}{ONLY[printers(effect)]})",
        effect.physics,
        f"    {effect.equation}",
        _table(effect),
        f"In data: {effect.in_data}",
        f"![{effect.title}: without and with it](effects/{effect.name}.png)",
        f"*Shown: {_values(seen.values)}. {seen.look}*",
        _rivals(effect),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _table(effect: Effect) -> str:
    if not effect.parameters:
        return "It has no parameters: it is there or it is not."
    rows = ["| parameter | unit | meaning | may be | usual | how many |", "|---|---|---|---|---|---|"]
    rows += [_row(p) for p in (*effect.parameters, *effect.of_printers)]
    return "\n".join(rows)


def _row(p: EffectParameter) -> str:
    optional = "" if p.default is None else f" (if left out: {p.default:g})"
    spans = ["a unit vector"] * 2 if p.size == "direction" else [_span(p.bounds), _span(p.typical)]
    return f"| `{p.name}` | {p.unit or '-'} | {p.meaning}{optional} | {' | '.join(spans)} | {SIZES[p.size]} |"


def _span(ends: Sequence[float]) -> str:
    return f"{ends[0]:g} to {ends[1]:g}"


def _values(values: Mapping[str, Any]) -> str:
    return ", ".join(f"`{name} = {value!r}`".replace("'", '"') for name, value in values.items()) or "the effect"


def _rivals(effect: Effect) -> str:
    rivals = {n: how for n, how in effect.confounded_with.items() if n in effects_of() or n not in CATALOGUE}
    if not rivals:
        return ""
    return "\n".join(["Easily confused with:\n", *(f"- {_linked(n)}: {how}" for n, how in rivals.items())])


def _linked(name: str) -> str:
    return f"[`{name}`](#{name})" if name in CATALOGUE else f"`{name}` of the machine file"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--write", action="store_true", help="write docs/EFFECTS.md and docs/effects/*.png")
    parser.add_argument("names", nargs="*", help="draw these effects only")
    given = parser.parse_args()
    if not given.write:
        print(page())
        return
    (DOCS / "effects").mkdir(exist_ok=True)
    for name in given.names or effects_of():
        draw(CATALOGUE[name], DOCS / "effects" / f"{name}.png")
    PAGE.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
