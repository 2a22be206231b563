"""The full blind test of `ffcomp diagnose`: makes the bank, asks the command line, opens the labels, writes the page.

    python -m studies.diagnosis --cases 120 --jobs 2 --resume DIR --write      → docs/DIAGNOSIS.md and its figure

The bank is `validation/blind`. Everything is kept in DIR (see `validation/blind/seal.py`), so that it can be
interrupted and
continued, also with more cases; a verdict that is there is not asked for again. Without `--write` the page goes to
standard output.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from validation.blind import score
from validation.blind.bank import case
from validation.blind.seal import open_labels, verdict_path, write_case
from validation.blind.strata import full_bank

ROOT = Path(__file__).parents[1]
LONGEST_S = 3600.0
PAGE, FIGURE = ROOT / "docs" / "DIAGNOSIS.md", ROOT / "docs" / "diagnosis_confusion.png"
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
    text = "\n".join(page(judged, options)) + "\n"
    if options.write:
        PAGE.write_text(text, encoding="utf-8")
        draw_confusion(judged, FIGURE)
    else:
        print(text)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=120)
    parser.add_argument("--jobs", type=int, default=2, help="diagnoses at a time")
    parser.add_argument("--resume", required=True, metavar="DIR", help="where cases, verdicts and labels are kept")
    parser.add_argument("--seconds", type=float, default=3.0, help="of each run")
    parser.add_argument("--seed", type=int, default=1, help="another number, another bank")
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.relative_to(ROOT)} and its figure")
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


# ---- the page ------------------------------------------------------------------------------------


def page(judged: Sequence[score.Judged], options: argparse.Namespace) -> Iterable[str]:
    yield from introduction(judged, options)
    yield from aims(judged)
    yield from what_is_seen(judged)
    yield from answers(judged)
    yield from failures(judged)


def introduction(judged: Sequence[score.Judged], options: argparse.Namespace) -> Iterable[str]:
    fast = np.nanmedian([j.verdict.get("seconds", np.nan) for j in judged])
    yield "# Diagnosis: the blind test\n"
    yield (
        f"Made by `python -m studies.diagnosis --cases {options.cases} --resume DIR --write` (seed {options.seed}, "
        f"runs of {options.seconds:g} s at 1600 Hz, Python {platform.python_version()}; in the median a verdict takes "
        f"{fast:.0f} s).\n"
    )
    yield (
        "`validation/blind` draws a delta printer, hides something in it, measures it, and writes a machine file that "
        "is off by some percent. Its equations share no line with the tool's: Lagrange's in the nozzle's position, "
        "with the frame as bodies of their own, integrated at 12.8 kHz. Its effects have other shapes than the "
        "catalogue's: friction is a bristle or a tanh, stiction fades as exp(-|v|/v_s), play has soft flanks and a "
        "damped landing, a hardening belt has a fifth power, cogging a second harmonic, a stepper's sine acts in "
        "series with its belt, a delay wanders, grease thins with speed, a frame has two modes a few percent apart. "
        "The sensors have coloured noise, channels of differing levels, and counts. Every label is hashed before the "
        "first verdict and opened after the last.\n"
    )
    yield (
        "An effect is *visible* (decided before any verdict) if the runs with and without it differ by a tenth of the "
        "noise (rms, 1 to 200 Hz) and if what no retuning within the file's uncertainties explains is worth a "
        "−2 ln likelihood of 30. Machine files are off by 2 % (`rough-file` 5 %, `exact-file` 0, `nothing` any of "
        "these). `few` has one repeated motion, the others two. *Wrong name alone*: something was named and the truth "
        "is not in it, visible or not. The fresh runs are at a place and with motions that the diagnosis never saw.\n"
    )


def aims(judged: Sequence[score.Judged]) -> Iterable[str]:
    yield "## Against the aims\n"
    yield "| | found | 95 % interval (Wilson) | aim | |"
    yield "|---|---|---|---|---|"
    for rate in score.rates(judged):
        low, high = rate.interval
        found = f"{100 * rate.share:.1f} % ({rate.hits} of {rate.total})" if rate.total else "no case"
        yield f"| {rate.title} | {found} | {100 * low:.0f}-{100 * high:.0f} % | {rate.aim} | {rate.verdict} |"
    left = score.shrink(judged)
    if left:
        middle = float(np.median(left))
        quarters = "-".join(f"{x:.2f}" for x in np.percentile(left, [25, 75]))
        verdict = "reached" if middle <= 0.1 else "missed"
        yield (
            f"| gap above noise on fresh runs, after/before, median of {len(left)} | {middle:.3f} "
            f"| quartiles {quarters} | ≤ 0.10 | {verdict} |"
        )
    yield ""


def what_is_seen(judged: Sequence[score.Judged]) -> Iterable[str]:
    yield "## Power against what retuning leaves\n"
    yield "rms of the effect's trace after the best retuning, in standard deviations of the noise; single effects.\n"
    yield "| left | right | of |"
    yield "|---|---|---|"
    for low, high, rate in score.power(judged, EDGES):
        yield f"| {low:g} to {high:g} | {rate.hits} | {rate.total} |"
    yield ""


def answers(judged: Sequence[score.Judged]) -> Iterable[str]:
    yield "## What was hidden, what was said\n"
    yield f"![confusion matrix]({FIGURE.name})\n"
    yield "| hidden | said |"
    yield "|---|---|"
    for row, counts in sorted(score.confusion(judged).items()):
        yield f"| {row} | {', '.join(f'{answer} {n}' for answer, n in counts.most_common())} |"
    yield ""


def failures(judged: Sequence[score.Judged]) -> Iterable[str]:
    """Every visible case that ended otherwise than it should, with what the tool said about it."""
    yield "## Every miss\n"
    yield "| case | stratum | hidden | left by retuning | said | because |"
    yield "|---|---|---|---|---|---|"
    for j in judged:
        if _as_wanted(j):
            continue
        left = ", ".join(f"{np.sqrt(max(v.left, 0) / v.rows):.2f}" for v in j.label.visibility.values())
        seen = left if j.label.visible else f"{left} (invisible)"
        yield f"| {j.name} | {j.label.stratum} | {j.question} | {seen} | {j.answer} | {_because(j)} |"
    yield ""


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
