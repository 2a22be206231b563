"""Tables and percentages in pages that are otherwise written by hand: machines, modes, accuracy, thresholds."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from ffcomp.diagnosis.settings import SETTINGS
from ffcomp.inverse.settings import effort_curve
from models.file import load_machine
from models.finding import LIBRARY
from models.kinds import delta_vibration
from models.kinematics.cartesian import COREXY, CartesianKinematics
from models.kinematics.delta import DeltaKinematics
from models.machine import Machine, assumed_modes
from models.vibration.mode_map import numbers

DOCS = Path(__file__).parents[2] / "docs"
PLACES = ("0, 0", "-100, 0", "100, 0")
# a sentence of a page, and the number in it
NUMBERS: Mapping[str, Mapping[str, float]] = {
    "DIAGNOSE.md": {"at least # % at places": 100 * SETTINGS.dominant},
    "explanation/measuring_and_diagnosis.md": {
        "explain # % of what is left": 100 * SETTINGS.added,
        "at most # % of the discrepancy": 100 * SETTINGS.left,
        "explains # % where it was left": 100 * SETTINGS.dominant,
        "leave # times as much": SETTINGS.ahead,
    },
}


def pages() -> dict[Path, str]:
    """Return the pages with their tables and numbers filled in."""
    tables: dict[str, dict[str, Iterable[list[str]]]] = {
        "reference/library.md": dict(_library()),
        "explanation/the_model.md": {"What changes over the bed": _modes()},
        "explanation/the_inverse.md": {"What accuracy costs": _accuracy()},
    }
    found = {}
    for name in (*tables, *NUMBERS):
        text = (DOCS / name).read_text(encoding="utf-8")
        for section, rows in tables.get(name, {}).items():
            table = rf"(^##+ {section}\n(?:(?!^##|^\|).*\n)*\|.*\n\|.*\n)(?:\|.*\n)+"
            lines = "".join(f"| {' | '.join(row)} |\n" for row in rows)
            text = _once(table, lambda match, lines=lines: match[1] + lines, text)
        for sentence, value in NUMBERS.get(name, {}).items():
            pattern = re.escape(sentence).replace(r"\#", r"[\d.]+")
            text = _once(pattern, lambda _, s=sentence, x=value: s.replace("#", f"{x:g}"), text)
        found[DOCS / name] = text
    return found


def _once(pattern: str, new: object, text: str) -> str:
    text, count = re.subn(pattern, new, text, flags=re.MULTILINE)  # type: ignore[call-overload]
    if count != 1:
        raise ValueError(f"{pattern!r} stands {count} times in its page, not once.")
    return str(text)


def _library() -> Iterator[tuple[str, Iterable[list[str]]]]:
    """Return the machines by the sections of their page."""
    machines = [load_machine(path) for path in sorted(LIBRARY.glob("*.toml"), key=lambda path: path.stem)]
    of = {"Deltas": list[list[str]](), "CoreXY": list[list[str]](), "Cartesian": list[list[str]]()}
    for machine in machines:
        kinematics, kind = machine.kinematics, "Deltas"
        if isinstance(kinematics, CartesianKinematics):
            kind = "CoreXY" if np.array_equal(kinematics.motor_matrix, COREXY) else "Cartesian"
        of[kind].append(_row(machine))
    yield from of.items()


def _row(machine: Machine) -> list[str]:
    kinematics, name = machine.kinematics, machine.name.removesuffix(" (assumed dynamics)")
    modes = machine.vibration.modes_at(np.array(kinematics.centre_mm)).frequencies_hz
    slowest = ", ".join(f"{f:.0f}" for f in sorted(modes)[:2])
    reach = ""
    if isinstance(kinematics, CartesianKinematics):
        reach = ", ".join(f"{low:g} to {high:g}" for low, high in kinematics.range_mm)
    elif isinstance(kinematics, DeltaKinematics):
        reach = f"radius {kinematics.print_radius_mm:g}, height {kinematics.print_height_mm:g}"
    assumed = "assumed" if assumed_modes(machine) else "measured"
    return [f"`{Path(machine.path).stem}`", name, reach, f"{slowest}, {assumed}", machine.flavor]


def _modes() -> Iterable[list[str]]:
    model = delta_vibration(load_machine("mp-delta-pro"))
    for place in PLACES:
        xy = np.array([float(x) for x in place.split(",")])
        found, order = model.modes_at(xy), np.argsort(numbers(model, xy))
        pairs = zip(found.frequencies_hz[order], found.damping_ratios[order], strict=True)
        yield [place, *(f"{frequency:.1f} ({damping:.2f})" for frequency, damping in pairs)]


def _accuracy() -> Iterable[list[str]]:
    curve = effort_curve(load_machine("mp-delta-pro"), 0.004)
    is_knee = np.isclose(curve.bandwidth_hz, curve.knee_hz())
    every_other = slice(int(np.argmax(is_knee)) % 2, None, 2)
    columns = (curve.bandwidth_hz, curve.error_um, 1e-3 * curve.peak_mm_per_s2, is_knee)
    for f, error, peak, knee in zip(*(column[every_other] for column in columns), strict=True):
        yield [f"**{f:.1f}, the knee**" if knee else f"{f:.1f}", f"{error:.1f}", f"{peak:.1f}"]
