"""How fast commands are found, how that grows, where the time goes: benchmarks/PERFORMANCE.md and its figures.

    python -m benchmarks.performance --keep DIR --write            some 30 minutes on one core and a half
    python -m benchmarks.performance --keep DIR --only SECTION     makes one section's numbers anew
    python -m benchmarks.performance --keep DIR --quick            everything small, in some minutes

Every section's numbers are kept in DIR/SECTION.json; what is there is not made again, unless `--only` names it. Without
`--write` the page goes to standard output. What is compared is measured in turns in one process, in CPU time: other
work on the machine shares its caches, but is not counted.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # one core: said before numpy and scipy start their threads
os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["FFCOMP_CACHE"] = "off"  # what is worked out for a machine is worked out anew, but where it says "again"

import argparse
import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks import performance_prints as prints
from benchmarks import performance_ways as ways
from benchmarks import performance_where as where
from benchmarks import steps
from benchmarks.performance_figures import draw
from benchmarks.performance_page import page
from studies import effects_compensated
from studies.prose import filled

FOLDER = Path(__file__).parent
PAGE = FOLDER / "PERFORMANCE.md"
RADII_MM = (0.0, 20.0, 40.0, 60.0, 80.0, 100.0, 120.0)

Section = Callable[[Path], Any]  # where it may keep parts of an answer → its numbers, as JSON has them

SECTIONS: Mapping[str, Section] = {
    "ways": lambda keep: ways.side_by_side(rounds=25, seconds=ways.TOGETHER_S),
    "prints": lambda keep: prints.as_they_are(rounds=3),
    "lengths": lambda keep: prints.by_length(prints.LENGTHS_S, rounds_s=3600.0),
    "two": lambda keep: prints.two_processes(prints.SIDE_BY_SIDE_S),
    "place": lambda keep: ways.over_the_bed(RADII_MM, rounds=50, seconds=40.0),
    "where": lambda keep: where.where(rounds=5),
    "steps": lambda keep: {path.stem: [asdict(row) for row in steps.measured(path)] for path in steps.PRINTS},
    "first": lambda keep: prints.first_runs(prints.SMALL_S),
    "effects": lambda keep: effects_compensated.effects(effects_compensated.SECONDS, keep / "effects-parts.json"),
}
QUICK: Mapping[str, Section] = {
    "ways": lambda keep: ways.side_by_side(rounds=1, seconds=6.0, names=ways.PRINTS[:1]),
    "prints": lambda keep: prints.as_they_are(rounds=1, limit=3),
    "lengths": lambda keep: prints.by_length((60.0, 180.0, 600.0), rounds_s=600.0),
    "two": lambda keep: prints.two_processes(120.0),
    "place": lambda keep: ways.over_the_bed(RADII_MM[::3], rounds=2, seconds=8.0),
    "where": lambda keep: where.where(rounds=1),
    "first": lambda keep: prints.first_runs(20.0),
    "steps": lambda keep: {steps.PRINTS[1].stem: [asdict(row) for row in steps.measured(steps.PRINTS[1], rounds=1)]},
    "effects": lambda keep: effects_compensated.effects(4.0, None, ("belt_stiffness", "coulomb_friction")),
}


def main() -> None:
    options = _options()
    keep = Path(options.keep)
    keep.mkdir(parents=True, exist_ok=True)
    makers = QUICK if options.quick else SECTIONS
    for name in options.only:
        (keep / f"{name}.json").unlink(missing_ok=True)
    wanted = options.only or list(makers)
    found = {name: kept(name, makers[name], keep) for name in makers if name in wanted or _has(keep, name)}
    text = filled(page(found))
    if options.write:
        PAGE.write_text(text, encoding="utf-8")
        draw(found, FOLDER)
    else:
        print(text)


def kept(name: str, make: Section, keep: Path) -> Any:
    """A section's numbers, made once."""
    path = keep / f"{name}.json"
    if not path.exists():
        path.write_text(json.dumps(make(keep), indent=1), encoding="utf-8")
        print(path, file=sys.stderr, flush=True)
    return json.loads(path.read_text(encoding="utf-8"))


def _has(keep: Path, name: str) -> bool:
    return (keep / f"{name}.json").exists()


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", required=True, metavar="DIR", help="where every section's numbers are kept")
    parser.add_argument("--only", nargs="+", default=[], choices=SECTIONS, metavar="SECTION", help=", ".join(SECTIONS))
    parser.add_argument("--quick", action="store_true", help="small sizes: to see that everything works")
    parser.add_argument("--write", action="store_true", help="write benchmarks/PERFORMANCE.md and its figures")
    return parser.parse_args()


if __name__ == "__main__":
    main()
