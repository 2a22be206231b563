"""What it is worth to compensate effects that are not linear: every effect, hidden in the independent printer.

    python -m studies.effects_compensated [--keep FILE] [--seconds S] [NAME ...]     some ten minutes for all of them

A part of the ringing tower is compensated with a machine file that does not know the effect, and with one that does;
both print on the independent printer of `validation/blind`, which has it. Beside them: the printer without it. What
FILE holds already is not made again. The same on our own virtual printer tells how much of what is left comes of the
effect's other shape. A table goes to standard output; `performance.py` writes the same into its page.
"""

from __future__ import annotations

import os

from models.kinds import delta_vibration, with_parts

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # one core: said before numpy and scipy start their threads

import argparse
import json
import sys
import time
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from ffcomp.comparison.evaluation import Execution, contour
from ffcomp.comparison.methods import COMPENSATED, inversion, none
from ffcomp.comparison.sampling import Print, PrintSlice
from ffcomp.compensation.solve import solutions
from ffcomp.inverse import nonlinear
from ffcomp.inverse.model import GEOMETRY, InverseModel
from ffcomp.inverse.settings import settings_for
from ffcomp.simulation.playback import simulate_nozzles
from models.effects.catalogue import CATALOGUE, effects_of_printers, with_effect
from models.file import load_machine
from models.machine import Machine
from tests.support.hidden_delta import LAYERS, PRINT, Printer, on_the_real
from validation import judge
from validation.blind.delta import EFFECTS
from validation.blind.real import Real

SECONDS = 15.0
SEEDS = {"belt_stiffness": 1, "coulomb_friction": 4, "guide_damping": 4, "effector_mass": 5}  # of the last proof
SEED = 2
UNMEASURED = {"arm_inertia"}  # which the page says: the independent printer hides it only since a while
PAPER = {"center_of_mass"}  # felt only where the loads go by Eqs. 22-27
OTHER_SHAPE = {
    "coulomb_friction": "a bristle, or a tanh of its own width, for the file's creep",
    "stribeck_friction": "a bristle or a tanh; the surplus falls as exp(-\\|v\\|/v_s), not as a bell",
    "joint_friction": "bristles that slide after some 15 to 50 µm",
    "guide_damping": "shears thinner with speed",
    "belt_hardening": "a fifth power besides",
    "belt_position_stiffness": "the compliance grows evenly, not the stiffness",
    "belt_backlash": "soft flanks and a damped landing",
    "torque_angle": "a tenth of the compliance is the belt's, in series",
    "command_delay": "wanders by up to four percent",
    "cogging": "a second harmonic besides",
}


@dataclass(frozen=True, slots=True)
class Row:
    """One effect: contour rms on the independent printer, µm, and what the command took."""

    name: str
    kind: str
    table: dict[str, Any]
    none_um: float  # not compensated, with the effect
    ignorant_um: float
    knowing_um: float
    own_um: float  # the knowing command on our own virtual printer, whose effect has the file's shape
    without_um: float  # the printer without the effect, compensated with the right file
    rounds: float  # of the whole printer, on average of the stretches; 0: the linear model holds the effect
    cpu_s_per_print_s: float
    ignorant_share: float  # of its limit that a carriage is asked for at the worst
    knowing_share: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="of effects; default: all that machines have")
    parser.add_argument("--keep", type=Path, metavar="FILE", help="where answers are kept, and looked for")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of the print")
    options = parser.parse_args()
    print("\n".join(as_table(effects(options.seconds, options.keep, options.names))))


def machines_effects() -> list[str]:
    """Those that the bank's printer can hide, not of sensors; geometry is calibrated, not compensated."""
    hidden = [name for name in effects_of_printers() if name in EFFECTS and name not in UNMEASURED]
    return [name for name in hidden if CATALOGUE[name].kind != "sensor" and name != GEOMETRY]


def effects(seconds: float, keep: Path | None = None, names: Collection[str] = ()) -> dict[str, Any]:
    """Every effect's row, by name."""
    kept = dict(json.loads(keep.read_text(encoding="utf-8"))) if keep and keep.exists() else {}
    for name in names or machines_effects():
        if name not in kept:
            kept[name] = asdict(row(name, seconds))
            if keep:
                keep.write_text(json.dumps(kept, indent=1), encoding="utf-8")
            print(name, file=sys.stderr, flush=True)
    return kept


def row(name: str, seconds: float) -> Row:
    """Hide, compensate, print."""
    ignorant = load_machine(judge.MACHINE_FILE)
    tables = tomllib.loads(judge.MACHINE_FILE.read_text(encoding="utf-8"))
    if name in PAPER:
        ignorant = with_parts(ignorant, effector=replace(delta_vibration(ignorant).effector, force_map="paper"))
        tables["effector"]["force_map"] = "paper"
    plain = Real(tables)
    table, real = EFFECTS[name](np.random.default_rng(SEEDS.get(name, SEED)), 1.0, plain)
    knowing = with_effect(ignorant, name, **table)
    has, has_not = Printer(real, knowing), Printer(plain, ignorant)
    rounds, cpu_s, share = cost(knowing, seconds)
    return Row(
        name,
        CATALOGUE[name].kind,
        table,
        printed(has, ignorant, seconds, compensate=False),
        printed(has, ignorant, seconds),
        printed(has, knowing, seconds),
        on_our_own(knowing, seconds),
        printed(has_not, ignorant, seconds),
        rounds,
        cpu_s,
        cost(ignorant, seconds)[2],
        share,
    )


def stretches(machine: Machine, seconds: float) -> list[PrintSlice]:
    return Print(PRINT.read_bytes(), PRINT.name, machine).slices(LAYERS, at_most_s=seconds)[0]


def printed(printer: Printer, machine: Machine, seconds: float, compensate: bool = True) -> float:
    """Contour rms of a command by that file, µm."""
    way = inversion(machine, settings_for(machine), COMPENSATED) if compensate else none()
    played = [on_the_real(printer, each, way.motion(each)[0]) for each in stretches(machine, seconds)]
    return 1e3 * float(np.sqrt(np.mean(contour(played) ** 2)))


def on_our_own(machine: Machine, seconds: float) -> float:
    """Contour rms on the virtual printer that the file describes, µm."""
    way, played = inversion(machine, settings_for(machine), COMPENSATED), []
    for each in stretches(machine, seconds):
        motion, _ = way.motion(each)
        t, (nozzle,) = simulate_nozzles([machine], motion, machine)
        played.append(Execution(each, motion, t, nozzle))
    return 1e3 * float(np.sqrt(np.mean(contour(played) ** 2)))


def cost(machine: Machine, seconds: float) -> tuple[float, float, float]:
    """Rounds of the whole printer, CPU time for each print-second, s, of the second time, and share of a limit."""
    inverter, parts = InverseModel(machine, settings_for(machine)), stretches(machine, seconds)
    with patch.object(nonlinear, "_played", side_effect=nonlinear._played) as rounds:
        solve(inverter, parts)
    began = time.process_time()
    share = solve(inverter, parts)
    took = time.process_time() - began
    return rounds.call_count / len(parts), took / sum(each.trajectory.end_t for each in parts), share


def solve(inverter: InverseModel, parts: list[PrintSlice]) -> float:
    """The largest share of its limit that a carriage is asked for."""
    return max(solved.solution.utilisation for part in parts for solved in solutions(part.planned, inverter))


def as_table(found: Mapping[str, Any]) -> Iterator[str]:
    yield (
        "| effect | hidden | not compensated | ignorant | knowing | without the effect | knowing, our own printer "
        "| rounds | CPU s a print-second | share of a limit, ignorant and knowing "
        "| in the independent printer, unlike the file |"
    )
    yield "|---" * 11 + "|"
    order: Callable[[str], Any] = lambda name: (found[name]["rounds"] > 0, name)  # noqa: E731
    for name in sorted(found, key=order):
        r = found[name]
        yield (
            f"| `{name}` | {told(r['table'])} | {r['none_um']:.1f} | {r['ignorant_um']:.2f} | {r['knowing_um']:.2f} "
            f"| {r['without_um']:.2f} | {r['own_um']:.2f} | {r['rounds']:.0f} | {r['cpu_s_per_print_s']:.3f} "
            f"| {r['ignorant_share']:.2f}, {r['knowing_share']:.2f} "
            f"| {OTHER_SHAPE.get(name, '')} |"
        )


def told(table: Mapping[str, Any]) -> str:
    def number(value: Any) -> str:
        if isinstance(value, list):
            return " / ".join(number(each) for each in value)
        return value if isinstance(value, str) else f"{value:.3g}"

    return ", ".join(f"{key} {number(value)}" for key, value in table.items()) or "the other map"


if __name__ == "__main__":
    main()
