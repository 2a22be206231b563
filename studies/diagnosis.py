"""The full blind test of `ffcomp diagnose`.

    python -m studies.diagnosis --cases 240 --jobs 2 --resume DIR       reports/diagnosis.md and its figure
    python -m studies.diagnosis --cases 240 --scheduler tcp://HOST:8786 --resume DIR      by a Dask cluster
    python -m studies.diagnosis --cases 240 --resume DIR --render       the page of what is done so far
    python -m studies.diagnosis --cases 48 --seed 9130 --resume DIR2 --earlier      another bank, told on the same page

The bank is `validation/blind`. Everything is kept in DIR (see `validation/blind/bank.py`; of a cluster, on a disk that
all workers see), so that it can be stopped at any time and continued: a verdict that is there is not asked for again.
The cases come in an order of which every beginning is balanced. Each is sealed, asked for in a process of its own
(`--case`), and only the labels of answered cases are opened, at the end.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import joblib
import numpy as np

from ffcomp.api.measurements import diagnose
from ffcomp.errors import FfcompError
from studies.diagnosis_tables import results
from studies.render import REPORTS, ROOT, results_of, save
from validation.blind import score
from validation.blind.bank import (
    FULL,
    full_bank,
    label_path,
    make_case,
    open_labels,
    refusal_path,
    same_bank,
    verdict_path,
)
from validation.blind.kinds import MACHINES

FIGURE = REPORTS / "diagnosis_confusion.png"
LONGEST_S = 600  # of CPU, of an answer


def main() -> None:
    """Make, ask, open, and write the page."""
    if sys.argv[1:2] == ["--case"]:
        return case(*map(Path, sys.argv[2:]))
    options = _options()
    bank = Path(options.resume)
    cases = full_bank(options.cases, options.seed, options.machines)
    same_bank(bank, options.seconds)
    if not options.render:
        over(options, lambda name: one(bank, name, *cases[name], options.seconds), cases)
    done = [name for name in cases if answered(bank, name)]
    labels = open_labels(bank, done)
    judged = [score.Judged(name, label, _read(verdict_path(bank, name))) for name, label in labels.items()]
    if options.earlier:
        save("diagnosis", {"earlier": with_earlier(results(judged, options))})
        return
    without_runs = sum(refusal_path(bank, name).exists() and name not in done for name in cases)
    save("diagnosis", {**results(judged, options), "without_runs": without_runs})
    draw_confusion(judged, FIGURE)


def with_earlier(found: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the earlier banks of the page, the five newest, with this one first; older ones are small."""
    kept = ("cases", "seed", "seconds", "done", "commits", "rates")
    others = [bank for bank in results_of("diagnosis")["earlier"] if bank["seed"] != found["seed"]]
    return [{key: found[key] for key in kept}, *others[:4]]


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=FULL)
    parser.add_argument("--jobs", type=int, default=1, help="cases at a time")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster, in place of --jobs")
    parser.add_argument("--resume", required=True, metavar="DIR", help="where cases, verdicts and labels are kept")
    parser.add_argument("--seconds", type=float, default=2.0, help="of each run")
    parser.add_argument("--seed", type=int, default=1, help="another number, another bank")
    parser.add_argument("--machines", nargs="*", default=list(MACHINES), help="of these kinds")
    parser.add_argument("--earlier", action="store_true", help="a bank asked before: a column of the same page")
    parser.add_argument("--render", action="store_true", help="ask for nothing more, write the page")
    return parser.parse_args()


def over(options: argparse.Namespace, work: Callable[[str], None], names: Iterable[str]) -> None:
    """Do the work for every case, in this order: here, or spread over a cluster."""
    if options.scheduler:
        from distributed import Client

        with Client(options.scheduler) as client:
            client.gather(client.map(work, list(names), pure=False))
        return
    joblib.Parallel(options.jobs, prefer="threads", batch_size=1)(joblib.delayed(work)(name) for name in names)


def tell(text: str) -> None:
    """Say what happens, with the time."""
    print(datetime.now(UTC).strftime("%H:%M:%S"), text, file=sys.stderr, flush=True)


# ---- asking --------------------------------------------------------------------------------------


def one(bank: Path, name: str, seed: int, stratum: str, seconds: float) -> None:
    """Make a case and seal its label; then ask for the verdict. What is there is kept."""
    if not label_path(bank, name).exists() and (refusal := make_case(bank, name, seed, stratum, seconds)):
        tell(f"{name}: {refusal}")
        return
    if answered(bank, name):
        return
    verdict_path(bank, name).parent.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    asked(bank, name)
    found = _read(verdict_path(bank, name))
    _write(verdict_path(bank, name), {**found, "commit": commit(), "when": datetime.now(UTC).isoformat("T", "minutes")})
    tell(f"{name}: {found['verdict']} after {time.monotonic() - began:.0f} s")


def answered(bank: Path, name: str) -> bool:
    """Tell whether a case has its verdict: one that is not dated was stopped in the middle."""
    path = verdict_path(bank, name)
    return path.exists() and "when" in _read(path)


def asked(bank: Path, name: str) -> None:
    """Let a process of its own answer, and write that it did not."""
    folder, out = bank / "cases" / name, bank / "verdicts" / name
    command = [sys.executable, "-m", "studies.diagnosis", "--case", str(folder), str(out)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    answer = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment, check=False)
    why = f"exit {answer.returncode}: {answer.stderr[-800:]}"
    if answer.returncode == -signal.SIGXCPU:
        why = f"no answer within {LONGEST_S:.0f} s of CPU"
    if not verdict_path(bank, name).exists():
        _write(verdict_path(bank, name), {"verdict": score.FAILED, "why": why})


def commit() -> str:
    """Return the checkout's commit."""
    answer = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, cwd=ROOT, check=True
    )
    return answer.stdout.strip()


def _read(path: Path) -> dict[str, Any]:
    return dict(json.loads(path.read_text(encoding="utf-8")))


def _write(path: Path, content: dict[str, Any]) -> None:
    """All or nothing: an interrupted run leaves no half a verdict."""
    beside = path.with_suffix(".part")
    beside.write_text(json.dumps(content, indent=1), encoding="utf-8")
    beside.replace(path)


# ---- one case, in a process of its own -----------------------------------------------------------


def case(folder: Path, out: Path) -> None:
    """Ask for the verdict of one sealed case; nothing here reads a label.

    folder : with machine.toml and runs/
    out : OUT.json gets the verdict, OUT.toml the better machine file
    """
    resource.setrlimit(resource.RLIMIT_CPU, (LONGEST_S, LONGEST_S + 10))
    runs, better = sorted((folder / "runs").glob("*.csv")), out.with_suffix(".toml")
    began = time.process_time()
    try:
        found = diagnose(runs, folder / "machine.toml", better)
    except FfcompError as error:
        _write(out.with_suffix(".json"), {"verdict": "failed", "why": str(error).replace(f"{folder}/", "")})
        return
    took = time.process_time() - began
    tried = [{"effects": list(h.names), "evidence": h.fit.evidence, "left": h.discrepancy} for h in found.search.tried]
    _write(
        out.with_suffix(".json"),
        {**found.to_dict(), "cpu_seconds": took, "tried": tried[:8]},
    )


def draw_confusion(judged: Sequence[score.Judged], path: Path) -> None:
    """Truth down, answer across, counts in the cells."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    table = dict(sorted(score.confusion(judged).items()))
    columns = sorted({answer for counts in table.values() for answer in counts})
    shares = np.array([[counts[c] / counts.total() for c in columns] for counts in table.values()])
    figure, axes = pyplot.subplots(figsize=(3.5 + 0.34 * len(columns), 3.0 + 0.27 * len(table)), layout="constrained")
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for i, counts in enumerate(table.values()):
        for k, column in enumerate(columns):
            if counts[column]:
                axes.text(
                    k, i, str(counts[column]), ha="center", va="center", color="white" if shares[i, k] > 0.5 else "k"
                )
    axes.set_xticks(range(len(columns)), columns, rotation=60, ha="right")
    axes.set_yticks(range(len(table)), list(table))
    axes.set_xlabel("said")
    axes.set_ylabel("hidden")
    axes.set_title(f"Blind test, {len(judged)} cases")
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


if __name__ == "__main__":
    main()
