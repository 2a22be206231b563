"""Eight measured systems whose answer is published, diagnosed from their own recordings: studies/reports/measured.md.

    python -m studies.measured [NAME ...] [--keep FOLDER]     some 3 min of CPU

Needs `measured` in `../shared/data`, or in $FFCOMP_DATA: recordings of robot joints, a servo, a motor and a flexible
link, with licences and origins in their READMEs. Here each gets a machine file in its own words (what turns turns, and
is driven by a current, a voltage or a servo's law), without the effect. `fit-*` are diagnosed by the command line,
`test-*` only compared with the file that comes out; FOLDER then holds both machine files of each and the answers. An
answer that FOLDER holds already is taken as it is.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ffcomp.diagnosis.problems import plant_of, problem_of, recordings_of
from ffcomp.diagnosis.verb import gap_of
from models.file import load_plant
from studies.render import DATA, REPORTS, results_of, save

FIGURE = REPORTS / "measured.png"


@dataclass(frozen=True)
class System:
    """One measured system."""

    name: str
    what: str
    axis: str  # of its machine file: tables from [axis] on; "": its file is beside the recordings
    published: str
    expected: tuple[str, ...]  # effects any of which is the dominant one
    column: str = "torque_n_m"  # that `force_n` of its recordings is


SYSTEMS = (
    System(
        "kuka_axis1",
        "joint of a 300 kg robot",
        """
input = "force"
inertia_kg_m2 = 1000
stiffness_n_m_per_rad = 0.0
damping_n_m_s_per_rad = 2500

[uncertainty]
"axis.inertia_kg_m2" = 0.5
"axis.damping_n_m_s_per_rad" = 1.0
""",
        "dry friction 355 N m",
        ("coulomb_friction", "stribeck_friction", "bristle_friction"),
    ),
    System(
        "quanser_link1",
        "flexible link, hub to tip",
        """
input = "position"
inertia_kg_m2 = 0.17043
stiffness_n_m_per_rad = 40.0
damping_n_m_s_per_rad = 0.5

[uncertainty]
"axis.inertia_kg_m2" = 0.02
"axis.stiffness_n_m_per_rad" = 0.5
"axis.damping_n_m_s_per_rad" = 1.0
""",
        "stiffness 27.0 N m/rad, damped across the strip",
        ("belt_damping", "belt_stiffness"),
    ),
    System(
        "odrive_cogging",
        "outrunner motor turned slowly",
        """
input = "current"
inertia_a_s2_per_rad = 0.0035
stiffness_a_per_rad = 0.0
damping_a_s_per_rad = 0.003

[uncertainty]
"axis.inertia_a_s2_per_rad" = 0.3
"axis.damping_a_s_per_rad" = 1.0
""",
        "cogging of 7, 28, 14, 36, 12 and 84 lines a turn, 0.86 A and less",
        ("cogging_force",),
        "current_a",
    ),
    System(
        "xl330_position",
        "hobby servo with a pendulum, goal in",
        """
input = "position"
inertia_kg_m2 = 0.006
damping_n_m_s_per_rad = 0.011

[axis.drive]
torque_constant_n_m_per_a = 0.3
resistance_ohm = 3.75
supply_v = 7.4
gain_v_per_rad = 8.4

[uncertainty]
"axis.inertia_kg_m2" = 0.5
"axis.damping_n_m_s_per_rad" = 1.0
"axis.drive.torque_constant_n_m_per_a" = 0.5
""",
        "gravity 0.4805 N m, then friction of 0.28 of the motor's torque",
        ("pendulum_gravity", "friction_by_load"),
    ),
    System(
        "xl330_volts",
        "the same servo, motor voltage in",
        """
input = "voltage"
inertia_v_s2_per_rad = 0.08
stiffness_v_per_rad = 0.0
damping_v_s_per_rad = 0.4

[effects.pendulum_gravity]
voltage_v = 5.8

[uncertainty]
"axis.inertia_v_s2_per_rad" = 0.5
"axis.damping_v_s_per_rad" = 1.0
""",
        "friction that grows with load (0.28 of the motor's torque), dry 0.33 to 0.47 V",
        ("friction_by_load", "coulomb_friction", "stribeck_friction"),
        "voltage_v",
    ),
    System(
        "xl330_swing",
        "the same pendulum swings out, motor off",
        """
input = "force"
inertia_kg_m2 = 0.0065
stiffness_n_m_per_rad = 0.0
damping_n_m_s_per_rad = 0.012

[effects.pendulum_gravity]
torque_n_m = 0.4805

[uncertainty]
"axis.inertia_kg_m2" = 0.2
"axis.damping_n_m_s_per_rad" = 1.0
""",
        "dry friction 0.0070 N m; least squares 0.0081",
        ("coulomb_friction", "stribeck_friction", "bristle_friction"),
    ),
    System(
        "pendulum_torque",
        "pendulum that its drive swings up",
        "",
        "gravity 3.31 N m; least squares 3.80",
        ("pendulum_gravity",),
    ),
    System(
        "pendulum_wide",
        "pendulum that swings out from 1.6 rad",
        "",
        "viscous friction alone; least squares: drag 7.3e-6 N m s²/rad² and viscous 0.000127 of 0.000224 N m s/rad",
        ("quadratic_drag",),
    ),
)


def main() -> None:
    """Diagnose what is asked for; the others stay as they were measured."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--keep", type=Path)
    given = parser.parse_intermixed_args()
    if unknown := set(given.names) - {system.name for system in SYSTEMS}:
        parser.error(f"{min(unknown)} is none of {', '.join(system.name for system in SYSTEMS)}")
    with tempfile.TemporaryDirectory() as scratch:
        folder = given.keep or Path(scratch)
        rows = {
            system.name: measured(system, given.data / "measured" / system.name, folder / system.name)
            for system in SYSTEMS
            if not given.names or system.name in given.names
        }
    if given.names:
        known = {row["name"]: row for row in results_of("measured")["rows"]}
        rows = known | rows
    ordered = [rows[system.name] for system in SYSTEMS]
    draw(ordered)
    save("measured", {"rows": ordered, "named": sum(row["right"] for row in ordered), "systems": len(SYSTEMS)})


def measured(system: System, data: Path, folder: Path) -> dict[str, Any]:
    """Diagnose the recordings of one system, and compare the new file with those that were held out."""
    folder.mkdir(parents=True, exist_ok=True)
    before, after = folder / "machine.toml", folder / "better.toml"
    head = f'format = "ffcomp-machine/1"\nname = "{system.name}"\n\n[kinematics]\ntype = "axis"\n\n[axis]\nunit = "rad"'
    text = head + system.axis if system.axis else (data / "machine.toml").read_text(encoding="utf-8")
    before.write_text(text, encoding="utf-8")
    load_plant(before)
    fit, test = (recordings(data, kind, folder, system.column) for kind in ("fit", "test"))
    words = ["diagnose", *map(str, fit), "-m", str(before), "--without-repeats", "-o", str(after), "--json"]
    print(f"{system.name}: ffcomp {' '.join(words)}", flush=True)
    kept = folder / "answer.json"
    if not kept.exists():
        after.unlink(missing_ok=True)
        before_s = cpu_s()
        told = json.loads(run(words))
        kept.write_text(json.dumps(told | {"cpu_s": cpu_s() - before_s}), encoding="utf-8")
    answer = json.loads(kept.read_text(encoding="utf-8"))
    effects = [*answer["effects"], *([answer["dominant"]] if answer["dominant"] else [])]
    named = {each["name"]: each["parameters"] for each in effects}
    files = {"before": before} | ({"after": after} if after.exists() else {})
    return {
        "name": system.name,
        "what": system.what,
        "published": system.published,
        "verdict": answer["verdict"],
        "finding": answer["finding"],
        "said": answer["said"][0],
        "rest": bool(answer["dominant"]),
        "effects": [{"name": name, "numbers": numbers(values)} for name, values in named.items()],
        "retuned": [f"{key} {each['from']:.4g} to {each['to']:.4g}" for key, each in answer["retuned"].items()],
        "right": bool(set(named) & set(system.expected)),
        "wrong": sorted(set(named) - set(system.expected)),
        "compared": answer["compared"],
        "fit": {key: gap(path, fit) for key, path in files.items()},
        "test": {key: gap(path, test) for key, path in files.items()},
        "others": answer["other_motions"],
        "seconds": answer["cpu_s"],
    }


def recordings(data: Path, kind: str, folder: Path, column: str) -> list[Path]:
    """Copy recordings with the columns of what turns: mrad become rad."""
    written = []
    for path in sorted(data.glob(f"{kind}-*.csv")):
        head, *rows = path.read_text(encoding="utf-8").splitlines()
        table = np.loadtxt(rows, delimiter=",")
        names = []
        for k, name in enumerate(head.split(",")):
            table[:, k] *= 1e-3 if name.endswith("_mm") else 1.0
            names.append(column if name == "force_n" else name.replace("_mm", "_rad"))
        written.append(folder / path.name)
        np.savetxt(written[-1], table, delimiter=",", header=",".join(names), comments="", fmt="%.9g")
    return written


def run(words: list[str]) -> str:
    """Run ffcomp; its standard output."""
    command = [sys.executable, "-m", "ffcomp", *words]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True).stdout


def cpu_s() -> float:
    """Return the CPU time of all processes that ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def gap(machine: Path, files: list[Path]) -> float:
    """Return the gap of a machine file on recordings, as a share of what the answer compared."""
    plant = plant_of(machine)
    return gap_of(problem_of(plant, recordings_of(plant, files), ()).compared()).residual.total.nrms


def numbers(parameters: dict[str, Any]) -> str:
    """Return an effect's numbers with their intervals, in a line."""
    each = {key: [_number(e[what]) for what in ("value", "low", "high")] for key, e in parameters.items()}
    return "; ".join(f"{key} {value} ({low} to {high})" for key, (value, low, high) in each.items())


def _number(value: Any) -> str:
    return f"[{', '.join(_number(x) for x in value)}]" if isinstance(value, list) else f"{value:.3g}"


def draw(rows: list[dict[str, Any]]) -> None:
    """Draw the gap of each system before and after, on what was fitted and on what was held out."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 3.6), layout="constrained")
    bars = (
        ("fit", "before", "#c9c9c9"),
        ("test", "before", "#8c8c8c"),
        ("fit", "after", "#9ecae1"),
        ("test", "after", "#2471a3"),
    )
    for k, (kind, when, colour) in enumerate(bars):
        label = (
            f"{'fitted to' if kind == 'fit' else 'held out'}, {'the file' if when == 'before' else 'with the answer'}"
        )
        heights = [100 * row[kind].get(when, np.nan) for row in rows]
        axes.bar(np.arange(len(rows)) + 0.2 * (k - 1.5), heights, 0.18, color=colour, label=label)
    axes.set(yscale="log", ylabel="gap, % of what is compared", xticks=range(len(rows)))
    axes.set_xticklabels([row["name"].replace("_", "\n", 1) for row in rows])
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(ncols=2, frameon=False, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    figure.savefig(FIGURE, dpi=120, metadata={"Software": None})
    plt.close(figure)


if __name__ == "__main__":
    main()
