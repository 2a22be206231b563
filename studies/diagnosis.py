"""The full blind test of `ffcomp diagnose`: makes the bank, asks the command line, opens the labels, writes the page.

    python -m studies.diagnosis --cases 120 --jobs 2 --resume DIR      docs/DIAGNOSIS.md and its figure

The bank is `validation/blind`. Everything is kept in DIR (see `validation/blind/seal.py`), so that it can be
interrupted and
continued, also with more cases; a verdict that is there is not asked for again. Without `--write` the page goes to
standard output.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from studies.render import save
from validation.blind import score
from validation.blind.bank import case
from validation.blind.seal import open_labels, verdict_path, write_case
from validation.blind.strata import full_bank

ROOT = Path(__file__).parents[1]
LONGEST_S = 3600.0
FIGURE = ROOT / "docs" / "diagnosis_confusion.png"
EDGES = (0.0, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, np.inf)


def main() -> None:
    options = _options()
    bank = Path(options.resume)
    cases = full_bank(options.cases, options.seed)
    same_bank(bank, options.seconds)
    for name, (seed, stratum) in cases.items():
        if not (bank / "sealed" / name / "label.json").exists():
            write_case(bank, name, case(seed, stratum, options.seconds))
            tell(f"{name}: made")
    with ThreadPoolExecutor(options.jobs) as pool:
        list(pool.map(lambda name: ask(bank, name), cases))
    labels = open_labels(bank, list(cases))
    judged = [
        score.Judged(name, label, _read(verdict_path(bank, name)), _read(_proof_path(bank, name)))
        for name, label in labels.items()
    ]
    save("diagnosis", results(judged, options))
    draw_confusion(judged, FIGURE)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=120)
    parser.add_argument("--jobs", type=int, default=2, help="diagnoses at a time")
    parser.add_argument("--resume", required=True, metavar="DIR", help="where cases, verdicts and labels are kept")
    parser.add_argument("--seconds", type=float, default=3.0, help="of each run")
    parser.add_argument("--seed", type=int, default=1, help="another number, another bank")
    return parser.parse_args()


def tell(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def same_bank(bank: Path, seconds: float) -> None:
    """Cases of another length do not belong into the same folder."""
    made_with = bank / "bank.json"
    if not made_with.exists():
        bank.mkdir(parents=True, exist_ok=True)
        _write(made_with, {"seconds": seconds})
    if (before := _read(made_with)["seconds"]) != seconds:
        raise SystemExit(f"{bank} holds runs of {before:g} s; continue it with --seconds {before:g}, or take another.")


# ---- asking --------------------------------------------------------------------------------------


def ask(bank: Path, name: str) -> None:
    """The verdict of one case, then the gap on its fresh runs before and after; both are written once and kept."""
    verdict, folder = verdict_path(bank, name), bank / "cases" / name
    better = verdict.with_suffix(".toml")
    verdict.parent.mkdir(parents=True, exist_ok=True)
    if not verdict.exists():
        began = time.monotonic()
        runs = sorted((folder / "runs").glob("*.csv"))
        machine = ("--machine", folder / "machine.toml")
        found = ffcomp("diagnose", *runs, *machine, "--json", "--quiet", "--force", "--output", better)
        _write(verdict, {**found, "wall_seconds": time.monotonic() - began})
        tell(f"{name}: {found['verdict']} after {time.monotonic() - began:.0f} s")
    if not _proof_path(bank, name).exists():
        _write(_proof_path(bank, name), _proof(bank, name, better) if better.exists() else {})


def _proof(bank: Path, name: str, better: Path) -> dict[str, float]:
    """nrms on runs that the diagnosis never saw."""
    fresh = sorted((bank / "sealed" / name / "fresh").glob("*.csv"))
    before = ffcomp("gap", *fresh, "--machine", bank / "cases" / name / "machine.toml", "--json")
    after = ffcomp("gap", *fresh, "--machine", better, "--json")
    if score.FAILED in (before.get("verdict"), after.get("verdict")):
        return {}
    return {"before": before["nrms"], "after": after["nrms"], "noise": before["noise_nrms"]}


def _proof_path(bank: Path, name: str) -> Path:
    return bank / "verdicts" / f"{name}-proof.json"


def ffcomp(*arguments: str | Path) -> dict[str, Any]:
    """The answer of the command line as JSON; its last words if it failed."""
    command = [sys.executable, "-c", "from ffcomp.cli.app import main; main()", *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    try:
        answer = subprocess.run(
            command, capture_output=True, text=True, cwd=ROOT, env=environment, timeout=LONGEST_S, check=False
        )
    except subprocess.TimeoutExpired:
        return {"verdict": score.FAILED, "why": f"no answer within {LONGEST_S:.0f} s"}
    if answer.returncode != 0:
        return {"verdict": score.FAILED, "why": f"exit {answer.returncode}: {answer.stderr[-800:]}"}
    return dict(json.loads(answer.stdout))


def _read(path: Path) -> dict[str, Any]:
    return dict(json.loads(path.read_text(encoding="utf-8")))


def _write(path: Path, content: dict[str, Any]) -> None:
    """All or nothing: an interrupted run leaves no half a verdict."""
    beside = path.with_suffix(".part")
    beside.write_text(json.dumps(content, indent=1), encoding="utf-8")
    beside.replace(path)


# ---- the results ---------------------------------------------------------------------------------


def results(judged: Sequence[score.Judged], options: argparse.Namespace) -> dict[str, Any]:
    """Return what the page says of all cases."""
    return {
        "cases": options.cases,
        "seed": options.seed,
        "seconds": options.seconds,
        "verdict_s": np.nanmedian([j.verdict.get("seconds", np.nan) for j in judged]),
        "rates": [rate_of(rate) for rate in score.rates(judged)],
        "shrink": shrink_of(score.shrink(judged)),
        "power": [
            {"low": low, "high": high, "right": rate.hits, "of": rate.total}
            for low, high, rate in score.power(judged, EDGES)
        ],
        "confusion": [
            {"hidden": row, "said": [{"answer": answer, "count": n} for answer, n in counts.most_common()]}
            for row, counts in sorted(score.confusion(judged).items())
        ],
        "misses": [miss(j) for j in judged if not _as_wanted(j)],
    }


def rate_of(rate: score.Rate) -> dict[str, Any]:
    low, high = rate.interval
    return {
        "title": rate.title,
        "hits": rate.hits,
        "total": rate.total,
        "low": low,
        "high": high,
        "aim": rate.aim,
        "verdict": rate.verdict,
    }


def shrink_of(left: Sequence[float]) -> dict[str, Any] | None:
    """Return what is left of the gap on fresh runs, or None if nothing was measured."""
    if not left:
        return None
    median = float(np.median(left))
    return {
        "count": len(left),
        "median": median,
        "quartiles": np.percentile(left, [25, 75]),
        "verdict": "reached" if median <= 0.1 else "missed",
    }


def miss(j: score.Judged) -> dict[str, Any]:
    """Describe a visible case that ended otherwise than it should, with what the tool said about it."""
    return {
        "case": j.name,
        "stratum": j.label.stratum,
        "hidden": j.question,
        "left": [np.sqrt(max(v.left, 0) / v.rows) for v in j.label.visibility.values()],
        "visible": j.label.visible,
        "said": j.answer,
        "because": _because(j),
    }


def _as_wanted(j: score.Judged) -> bool:
    if j.label.outside:
        return j.says == "unknown"
    if j.label.stratum == "nothing":
        return j.says == "none"
    return j.right or (not j.label.visible and j.says in ("none", "unknown"))


def _because(j: score.Judged) -> str:
    refused = j.verdict.get("refused") or {}
    rivals = ", ".join(rival["name"] for rival in j.verdict.get("confusable_with", []))
    parts = [j.verdict.get("why", "").replace("\n", " ").replace("|", "/")]
    if refused:
        parts.append(f"nearest {'+'.join(refused['effects'])}; {'; '.join(refused['because'])}")
    if rivals:
        parts.append(f"looks alike: {rivals}")
    return "; ".join(filter(None, parts))


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
