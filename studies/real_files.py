"""Every real print of a folder, compensated and held to independent checks: studies/reports/real_files.md.

    python -m studies.real_files FOLDER --keep WORK [--only NAME ...] [--checkout PATH] [--column before] [--write]

FOLDER holds prints of others (`*.gcode`, `.gcode.gz`, `.bgcode`, also in `real/`); they are not part of the project.
Each file is compensated twice by the command line of a checkout, in processes of their own: without a prediction and
with it. What came out is kept in WORK with what `validation/independent` finds in it, so that a run that was
interrupted goes on where it stopped. `--write` puts all that WORK holds into the column of `results/real_files.json`
and renders the page. `--kalico` plans the results with the real Kalico host too (`KALICO_PYTHON` names its Python).
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from gcode.container import read_bytes
from studies.render import RESULTS, ROOT, results_of, save
from validation.independent import reader
from validation.independent.checks import check, printer_of
from validation.independent.play import JUDGED_S, contour

MACHINES = (  # the first whose pattern fits a file's name; a list of names: the first that the checkout knows
    ("v400_*", ("flsun-v400", "flsun-qqs")),
    ("t1_*", ("flsun-t1", "flsun-qqs")),
    ("flsun_v400*", ("flsun-v400", "flsun-qqs")),
    ("helix_*", ("kossel",)),
    ("kossel_*", ("kossel",)),
    ("chest_primcube*", ("prusa-xl", "voron-300")),
    ("gkerr_*", ("bambu-p1", "voron-300")),
    ("anand_*", ("bambu-a1", "voron-300")),
    ("mk404_*", ("prusa-mk3s", "ender-3")),
    ("fast_*", ("ender-3",)),
    ("libbg_*", ("prusa-mk4", "ender-3")),
    ("ender3_*", ("ender-3",)),
    ("smoothie_*", ("ender-3",)),
    ("mk3s_*", ("prusa-mk3s", "ender-3")),
    ("gcodepreview_*", ("ender-3",)),
    ("*", ("voron-300",)),
)
SHORT = (
    "chest_benchy",
    "v400_cube",
    "v400_overhang",
    "helix_calicat",
    "mk404_vfa",
    "gkerr_motor",
    "anand_hook",
    "kage_kirimoto",
    "chest_primcube",
)
AIMS = {
    "time_median_percent": 0.7,
    "time_worst_percent": 2.5,
    "size_median": 6.0,
    "speed_s_per_s": 500.0,
    "speed_predicted_s_per_s": 300.0,
}
HOST = {"time_percent": 0.2, "late_percent": 0.5, "late_s": 0.1}
SEGMENTS_PER_SECOND = 250  # what the command line promises when nothing else is asked
ROUNDING = 1e-6
LONG_S = 600.0  # from which duration on the aims of speed count
COMMAND = "from ffcomp.cli.app import main; main()"
_HINT = re.compile(r"--offset-mm (-?[\d.]+,-?[\d.]+)")
TINY = b"G28\nG1 X%d Y%d Z1 F3000\nG1 X%d E1\nG1 Y%d E1\n"


@dataclass(frozen=True, slots=True)
class Run:
    """One command of a checkout that has ended."""

    exit_code: int
    cpu_s: float
    result: dict[str, Any]
    said: str


class Checkout:
    """The command line of some version of the project."""

    def __init__(self, root: Path, machines: Path | None = None) -> None:
        self.root, self.machines = root.resolve(), (machines or root / "models" / "library").resolve()
        self.known = {path.stem for path in self.machines.glob("*.toml")}

    def run(self, *arguments: str, seconds: float = 3600.0) -> Run:
        """Run `ffcomp` with these arguments, one thread for every library."""
        environment = os.environ | {"PYTHONPATH": str(self.root), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        with tempfile.TemporaryFile("w+b") as out, tempfile.TemporaryFile("w+b") as err:
            process = subprocess.Popen(
                [sys.executable, "-P", "-c", COMMAND, *arguments], stdout=out, stderr=err, env=environment, cwd="/"
            )
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
            out.seek(0)
            err.seek(0)
            told, said = out.read(), err.read().decode("utf-8", "replace")
        result = json.loads(told) if told.strip().startswith(b"{") else {}
        return Run(process.returncode, used.ru_utime + used.ru_stime, result, said)

    def machine_of(self, name: str) -> str:
        """Name the machine for a print, of those that there are."""
        choice = next(machines for pattern, machines in MACHINES if fnmatch(name, pattern))
        return next(machine for machine in choice if machine in self.known)

    def machine_path(self, machine: str) -> Path:
        """Return the path of a machine's file."""
        return self.machines / f"{machine}.toml"

    @cached_property
    def finds_beds(self) -> bool:
        """Whether it looks for the bed's place without being asked."""
        return bool(re.search(rb"default:\s+auto", self._printed("compensate", "--help")))

    def _printed(self, *arguments: str) -> bytes:
        command = [sys.executable, "-P", "-c", COMMAND, *arguments]
        environment = os.environ | {"PYTHONPATH": str(self.root), "COLUMNS": "200"}
        return subprocess.run(command, capture_output=True, env=environment, check=False, cwd="/").stdout


def prints_of(folder: Path) -> Iterator[Path]:
    """All prints of a folder and its `real`."""
    for place in (folder, folder / "real"):
        yield from sorted(p for p in place.glob("*") if p.name.endswith((".gcode", ".gcode.gz", ".bgcode")))


def name_of(path: Path) -> str:
    """Name a print in the table: as its file, without the ending, but for the binary ones."""
    return path.name.removesuffix(".gz").removesuffix(".gcode")


def measured(
    checkout: Checkout, path: Path, work: Path, started_s: dict[str, float], predicted_below_s: float
) -> dict[str, Any]:
    """Compensate a print, and tell all that is said and used.

    predicted_below_s : CPU seconds; a print that took longer is not compensated again with its prediction
    """
    name = name_of(path)
    machine = checkout.machine_of(name)
    source = work / (path.name if path.suffix == ".bgcode" else f"{name}.gcode")
    data = path.read_bytes()
    source.write_bytes(gzip.decompress(data) if path.suffix == ".gz" else data)
    out = work / f"{name}.out{source.suffix}"
    again = work / f"{name}.again{source.suffix}"
    machine_path = str(checkout.machine_path(machine))
    common = ["compensate", str(source), "-m", machine_path, "--json", "-q"]
    tried, place, run = [], list[str](), None
    places = [[], ["--offset-mm", "0,0"]] if checkout.finds_beds else [["--offset-mm", "auto"], []]
    while places:
        place = places.pop(0)
        run = checkout.run(*common, *place, "--no-predict", "-o", str(out))
        told = (run.said.strip().splitlines() or [""])[-1]
        tried.append({"offset": place[-1] if place else "default", "exit": run.exit_code, "said": _short(told, source)})
        if run.exit_code == 0:
            break
        if (hint := _HINT.search(run.said)) and not places and hint[1] not in [each["offset"] for each in tried]:
            places.append(["--offset-mm", hint[1]])
    assert run is not None
    row: dict[str, Any] = {"name": name, "machine": machine, "exit": run.exit_code, "tried": tried}
    row["first_exit"] = tried[0]["exit"]
    if run.exit_code:
        row["said"] = tried[-1]["said"]
        return row
    predicted = checkout.run(*common, *place, "-o", str(again)) if run.cpu_s < predicted_below_s else None
    row |= _told(run, predicted, started_s[machine])
    if predicted:
        row["same_twice"] = out.read_bytes() == again.read_bytes()
    row["size"] = out.stat().st_size / source.stat().st_size
    row["bytes"] = out.stat().st_size
    back = work / f"{name}.back{source.suffix}"
    restored = checkout.run("restore", str(out), "-o", str(back), "-q")
    if restored.exit_code == 2:
        restored = checkout.run("restore", str(out), "-o", str(back))
    row["restored"] = restored.exit_code == 0 and _text(back) == _text(source)
    for left in (again, back):
        left.unlink(missing_ok=True)
    return row


def _text(path: Path) -> bytes:
    """Read a print's G-code; of a container, the project's own reader does."""
    return read_bytes(path) if path.suffix == ".bgcode" else path.read_bytes()


def _short(said: str, source: Path) -> str:
    return said.replace(str(source), source.name).removeprefix("ffcomp: ")[:300]


def _told(run: Run, predicted: Run | None, started_s: float) -> dict[str, Any]:
    """What the command says of itself, and the CPU seconds of its process."""
    result, slowed = run.result, dict[str, list[float]]()
    for place in result.get("slowed", ()):
        slowed.setdefault(_cause(place), []).append(float(place["seconds"]))
    time_s, was_s = float(result["print_time_s"]), float(result["original_print_time_s"])
    share = result.get("compensated_share") or {}
    tracks = predicted.result.get("predicted", {}) if predicted else {}
    contour_um = {key: track.get("contour_rms_um") for key, track in tracks.items()}
    own = {"cpu_s": run.cpu_s, "cpu_predicted_s": predicted.cpu_s if predicted else None}
    return {
        "flavor": result.get("flavor"),
        "time_s": time_s,
        "original_time_s": was_s,
        "longer_percent": 100.0 * (time_s / was_s - 1.0) if was_s else None,
        "share_told_path": share.get("path"),
        "share_told_filament": share.get("filament"),
        "segments_told": result.get("segments"),
        "slowed": {cause: {"places": len(each), "seconds": sum(each)} for cause, each in sorted(slowed.items())},
        "warnings": len(result.get("warnings", ())),
        "contour_um": contour_um.get("uncompensated"),
        "contour_compensated_um": contour_um.get("compensated"),
        **own,
        "start_s": started_s,
        "speed": time_s / max(run.cpu_s - started_s, 1e-3),
        "speed_predicted": time_s / max(predicted.cpu_s - started_s, 1e-3) if predicted else None,
    }


def _cause(place: dict[str, Any]) -> str:
    """What a place was slowed down for, in words."""
    if place.get("limit"):
        return f"{place['limit']} of {place.get('carriage') or 'the nozzle'}"
    return str(place.get("cause") or "firmware's own limits")


def checked(checkout: Checkout, path: Path, row: dict[str, Any], work: Path, judge: bool) -> dict[str, Any]:
    """Hold a compensated print against its original, with no code of the compensator."""
    ending = path.suffix if path.suffix == ".bgcode" else ".gcode"
    out = work / f"{row['name']}.out{ending}"
    if row["exit"] or not out.exists():
        return {}
    machine = tomllib.loads(checkout.machine_path(row["machine"]).read_text(encoding="utf-8"))
    before, after = read_bytes(path), _text(out)
    printer = printer_of(machine, row["flavor"])
    report = check(before, after, printer, row["flavor"], embedded=reader.MOVE.search(after) is not None)
    found = {**report.numbers, "wrong": report.wrong, "relative_e": reader.relative_without_saying(before)}
    clock_s = report.numbers["own_clock_s"] or 0.0
    found["clock_off_percent"] = 100.0 * (clock_s / row["time_s"] - 1.0)
    if judge and row["flavor"] == "klipper":  # the clock goes by Klipper's rules
        found |= contour(before, after, machine, printer, row["flavor"])
    return found


def start_seconds(checkout: Checkout, machine: str, work: Path) -> float:
    """CPU seconds of compensating three short moves: the start of the process, with its caches warm."""
    tiny, out = work / "tiny.gcode", work / "tiny.out.gcode"
    kinematics = tomllib.loads(checkout.machine_path(machine).read_text(encoding="utf-8"))["kinematics"]
    middle = [0.0, 0.0]
    if kinematics["type"] != "delta":
        middle = [sum(kinematics[f"{axis}_range_mm"]) / 2.0 for axis in "xy"]
    x, y = (round(v) for v in middle)
    tiny.write_bytes(TINY % (x, y, x + 3, y + 3))
    arguments = ["compensate", str(tiny), "-m", str(checkout.machine_path(machine)), "--json", "-q", "-o", str(out)]
    runs = [checkout.run(*arguments, "--offset-mm", "0,0") for _ in range(3)]
    if any(run.exit_code for run in runs):
        raise SystemExit(f"{machine}: {runs[0].said}")
    return min(run.cpu_s for run in runs[1:])


def known_start_seconds(checkout: Checkout, machine: str, work: Path) -> float:
    """Measure a machine's start once for all runs that keep their results in `work`."""
    kept = work / "starts.txt"
    known = dict(line.split() for line in kept.read_text().splitlines()) if kept.exists() else {}
    if machine not in known:
        known[machine] = f"{start_seconds(checkout, machine, work):.3f}"
        kept.write_text("".join(f"{name} {value}\n" for name, value in known.items()))
    return float(known[machine])


def version_of(checkout: Checkout) -> str:
    """Return the commit of a checkout."""
    told = subprocess.run(
        ["git", "-C", str(checkout.root), "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False
    )
    return told.stdout.strip()


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians and worst cases of what the aims are about."""
    done = [row for row in rows if row["exit"] == 0]
    long = [row for row in done if row["time_s"] > LONG_S]

    def of(key: str, among: list[dict[str, Any]], worst: Any) -> dict[str, Any]:
        values = [(row[key], row["name"]) for row in among if row.get(key) is not None]
        if not values:
            return {"median": None, "worst": None, "name": None, "count": 0}
        return {
            "median": statistics.median(v for v, _ in values),
            "worst": worst(values)[0],
            "name": worst(values)[1],
            "count": len(values),
        }

    return {
        "files": len(rows),
        "done": len(done),
        "at_once": sum(row["first_exit"] == 0 for row in rows),
        "longer_percent": of("longer_percent", done, max),
        "size": of("size", done, max),
        "speed": of("speed", long, min),
        "speed_predicted": of("speed_predicted", long, min),
        "share_path": of("share_path", done, min),
        "worst_second": of("segments_worst_second", done, max),
        "shortest_um": of("shortest_um", done, min),
        "shortest_ms": of("shortest_ms", done, min),
        "wrong": sum(len(row.get("wrong", ())) for row in done),
    }


def derived(found: dict[str, Any]) -> dict[str, Any]:
    """Work out what the page says of both columns."""
    found |= {"aims": AIMS, "long_s": LONG_S, "judged_s": JUDGED_S}
    after = found.get("after") or found["before"]
    found.setdefault("after", after)
    found.setdefault("before", after)
    rows, ends = after["rows"], after["summary"]
    by_name = {row["name"]: row for row in found["before"]["rows"]}
    found["pairs"] = [{"name": row["name"], "before": by_name.get(row["name"]), "after": row} for row in rows]
    starts = [row["start_s"] for row in rows if row["exit"] == 0]
    found["start"] = {"low": min(starts), "high": max(starts)} if starts else {"low": None, "high": None}
    found["verdicts"] = verdicts(ends)
    found["sentence"] = sentence(ends, rows)
    found["kalico"] = [each for column in ("before", "after") for each in _hosts(found[column]["rows"], column)]
    found["kalico_sentence"] = kalico_sentence([each for each in found["kalico"] if each["column"] == "after"])
    return found


def verdicts(ends: dict[str, Any]) -> dict[str, str]:
    """Say of each aim whether it is met."""

    def word(*met: bool) -> str:
        return "met" if all(met) else "missed"

    def least(key: str, most: float) -> str:
        return word(ends[key]["worst"] >= most) if ends[key]["count"] else "not measured"

    time, size = ends["longer_percent"], ends["size"]
    return {
        "longer": f"median {word(time['median'] <= AIMS['time_median_percent'])}, "
        f"worst {word(time['worst'] <= AIMS['time_worst_percent'])}",
        "size": word(size["median"] <= AIMS["size_median"]),
        "speed": least("speed", AIMS["speed_s_per_s"]),
        "speed_predicted": least("speed_predicted", AIMS["speed_predicted_s_per_s"]),
        "worst_second": word((ends["worst_second"]["worst"] or 0) <= SEGMENTS_PER_SECOND),
        "shortest_um": least("shortest_um", 10.0 - ROUNDING),
        "shortest_ms": least("shortest_ms", 1.0 - ROUNDING),
    }


def sentence(ends: dict[str, Any], rows: list[dict[str, Any]]) -> str:
    """Say plainly which aims are missed, and by which files."""
    told = []
    for what, key, missed in (
        ("longer than 2.5 %", "longer_percent", lambda row: row["longer_percent"] > AIMS["time_worst_percent"]),
        ("slower than 500 print-seconds per CPU second", "speed", lambda row: _slow(row, "speed", "speed_s_per_s")),
        (
            "slower than 300 with the prediction",
            "speed_predicted",
            lambda row: _slow(row, "speed_predicted", "speed_predicted_s_per_s"),
        ),
        ("compensated by less than 95 %", "share_path", lambda row: row.get("share_path", 1.0) < 0.95),
    ):
        names = [f"{row['name']} ({row[key]:.3g})" for row in rows if row["exit"] == 0 and missed(row)]
        if names:
            told.append(f"{what}: {', '.join(names)}")
    median = ends["longer_percent"]["median"], ends["size"]["median"]
    begun = f"Missed or worth a look: the median file is {median[0]:+.2f} % longer and ×{median[1]:.1f} as large. "
    refused = [row["name"] for row in rows if row["exit"]]
    if refused:
        told.append(f"refused: {', '.join(refused)}")
    return begun + (". ".join(each[0].upper() + each[1:] for each in told) + "." if told else "No file misses an aim.")


def _slow(row: dict[str, Any], key: str, aim: str) -> bool:
    return bool(row["time_s"] > LONG_S and row[key] is not None and row[key] < AIMS[aim])


def _hosts(rows: list[dict[str, Any]], column: str) -> list[dict[str, Any]]:
    """Say of each file that went through the real host what came of it."""
    return [
        {
            "name": row["name"],
            "column": column,
            "told_s": row["time_s"],
            "off_percent": 100.0 * (row["kalico"]["total_s"] / row["time_s"] - 1.0),
            **row["kalico"],
        }
        for row in rows
        if row.get("kalico")
    ]


def kalico_sentence(hosts: list[dict[str, Any]]) -> str:
    """Say plainly which aims the real host misses."""
    if not hosts:
        return "The host has not been asked about the result of this version."
    told = []
    for what, missed in (
        ("the told time is off by more than 0.2 %", lambda k: abs(k["off_percent"]) > HOST["time_percent"]),
        ("0.5 % of the segments or more are late", lambda k: (k["late_percent"] or 0.0) >= HOST["late_percent"]),
        ("late segments take 0.1 s or more in all", lambda k: (k["late_s"] or 0.0) >= HOST["late_s"]),
        ("the host stops where nothing asks for it", lambda k: (k["stops"] or 0) > 0),
    ):
        names = [each["name"] for each in hosts if missed(each)]
        told.append(f"{what} in {len(names)} of {len(hosts)}{': ' + ', '.join(names) if names else ''}")
    return "Of these aims: " + "; ".join(told) + "."


def digest(path: Path) -> str:
    """Return the first digits of a file's hash: which file it was."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:8]


def main() -> None:
    """Measure, check, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--keep", type=Path, required=True, metavar="WORK")
    parser.add_argument("--checkout", type=Path, default=ROOT)
    parser.add_argument("--machines", type=Path, help="folder of machine files; default: the checkout's library")
    parser.add_argument("--only", nargs="*", metavar="NAME", help="parts of names; short: a representative few")
    parser.add_argument("--column", choices=("before", "after"), default="after")
    parser.add_argument("--again", action="store_true", help="compensate again what WORK holds")
    parser.add_argument("--kept", action="store_true", help="measure nothing: only what WORK holds")
    parser.add_argument("--check-again", action="store_true", help="repeat the checks of what WORK holds")
    parser.add_argument("--no-judge", action="store_true", help="do not play the results on independent plants")
    parser.add_argument("--predicted-below", type=float, default=np.inf, metavar="S", help="of CPU time, without it")
    parser.add_argument("--kalico", action="store_true", help="plan the results with the real Kalico host")
    parser.add_argument("--write", action="store_true", help="write the column and render the page")
    asked = parser.parse_args()
    work = asked.keep.resolve()
    work.mkdir(parents=True, exist_ok=True)
    checkout, rows, started_s = Checkout(asked.checkout, asked.machines), list[dict[str, Any]](), dict[str, float]()
    wanted = SHORT if asked.only == ["short"] else asked.only
    for path in prints_of(asked.folder):
        name = name_of(path)
        if wanted and not any(each in name for each in wanted):
            continue
        kept = work / f"{name}.json"
        row = json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else {}
        if not row and asked.kept:
            continue
        if not row or asked.again:
            machine = checkout.machine_of(name)
            if machine not in started_s:
                started_s[machine] = known_start_seconds(checkout, machine, work)
            row = measured(checkout, path, work, started_s, asked.predicted_below) | {"sha256": digest(path)}
        if "wrong" not in row or asked.check_again:
            row |= checked(checkout, path, row, work, not asked.no_judge)
        if asked.kalico and row["exit"] == 0 and row["flavor"] == "klipper" and "kalico" not in row:
            row["kalico"] = through_kalico(checkout, row, work)
        kept.write_text(json.dumps(row, indent=1), encoding="utf-8")
        rows.append(row)
        print(_line(row), *row.get("wrong", ()), sep="\n    ", flush=True)
    print(json.dumps(summary(rows), indent=1))
    if asked.write:
        known = results_of("real_files") if (RESULTS / "real_files.json").exists() else {}
        column = {"version": version_of(checkout), "rows": rows, "summary": summary(rows)}
        save("real_files", derived(known | {asked.column: column}))


def through_kalico(checkout: Checkout, row: dict[str, Any], work: Path) -> dict[str, Any]:
    """Plan a compensated print with the real host, on a printer of its own kind."""
    from validation.independent.kalico import judged

    machine = tomllib.loads(checkout.machine_path(row["machine"]).read_text(encoding="utf-8"))
    text = _text(next(work.glob(f"{row['name']}.out.*")))
    relative = bool(row.get("relative_e"))
    return {"kinematics": machine["kinematics"]["type"], **judged(text, machine, relative)}


def _line(row: dict[str, Any]) -> str:
    if row["exit"]:
        return f"{row['name']}: exit {row['exit']}: {row['said']}"
    keys: tuple[str, ...] = ("longer_percent", "size", "speed", "speed_predicted", "share_path", "clock_off_percent")
    keys += ("segments_worst_second", "shortest_um", "shortest_ms", "contour_um", "contour_compensated_um")
    told = " ".join(f"{key}={row[key]:.4g}" for key in keys if row.get(key) is not None)
    return f"{row['name']} [{row['machine']}, {row['flavor']}] {row['time_s']:.0f} s: {told}"


if __name__ == "__main__":
    main()
