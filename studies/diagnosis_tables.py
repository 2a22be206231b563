"""What the page of `studies.diagnosis` says, as plain data."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from validation.blind import score
from validation.blind.kinds import KINDS
from validation.blind.score import Judged, Rate, miss

EDGES = (0.0, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, np.inf)


def results(judged: Sequence[Judged], options: argparse.Namespace) -> dict[str, Any]:
    """Return what the page says of all cases."""
    when = sorted(j.verdict["when"] for j in judged)
    return {
        "cases": options.cases,
        "done": len(judged),
        "kinds": dict(Counter(j.label.hides for j in judged)),
        "seed": options.seed,
        "seconds": options.seconds,
        "when": {"first": when[0], "last": when[-1]},
        "commits": dict(Counter(j.verdict["commit"] for j in judged)),
        "verdict_s": {
            m: _median([j.verdict.get("cpu_seconds") for j in judged if j.label.machine == m]) for m in KINDS
        },
        "cpu": cpu_of([j.verdict["cpu_seconds"] for j in judged if "cpu_seconds" in j.verdict]),
        "rates": [rate_of(rate) for rate in score.rates(judged)],
        "damping": by_damping(judged),
        "late": late_of(judged),
        "rests": rests_of([j for j in judged if j.label.rest and j.label.visible]),
        "sets": asdict(sets(judged)),
        "strata": [stratum(judged, *each) for each in [("all", lambda _: True), *_strata(judged)]],
        "power": [
            {"low": low, "high": high, "right": rate.hits, "of": rate.total} for low, high, rate in power(judged, EDGES)
        ],
        "confusion": confusion_rows(judged),
        "misses": [miss(j) for j in judged if not score.as_wanted(j)],
    }


def _median(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None


def cpu_of(seconds: Sequence[float]) -> dict[str, float]:
    """Return how long verdicts take, s of CPU."""
    return {"median": float(np.median(seconds)), "worst": max(seconds)}


def by_damping(judged: Sequence[Judged]) -> list[dict[str, Any]]:
    """Return the counts of cases whose damping is anywhere, beside the others of the same machines."""
    machines = {j.label.machine for j in judged if j.label.condition == "free-damping"}
    same = [j for j in judged if j.label.machine in machines and j.label.condition != "rest"]
    free, known = ([j for j in same if (j.label.condition == "free-damping") == is_free] for is_free in (True, False))
    both = zip(score.rates(free), score.rates(known), strict=True)
    return [{"title": a.title, "free": rate_of(a), "known": rate_of(b)} for a, b in both]


def late_of(judged: Sequence[Judged]) -> dict[str, dict[str, int]]:
    """Count the cases, of those whose damping is anywhere and of others, that name a delay or an offset by mistake."""
    found = {}
    for which, is_free in (("free", True), ("known", False)):
        cases = [j for j in judged if (j.label.condition == "free-damping") == is_free]
        wrong = [bool({"sensor_time_offset", "command_delay"} & (j.named - score.acceptable(j))) for j in cases]
        found[which] = {"hits": sum(wrong), "total": len(wrong)}
    return found


def rests_of(judged: Sequence[Judged]) -> dict[str, int]:
    """Count how effects with a rest beside them were named."""
    return {
        "total": len(judged),
        "alone": sum(j.right for j in judged),
        "with_rest": sum(j.right_with_rest and not j.right for j in judged),
        "beside": sum(j.truth < j.named for j in judged),
        "unknown": sum(j.says == "unknown" and not j.dominant for j in judged),
    }


def _strata(judged: Sequence[Judged]) -> list[tuple[str, Callable[[Judged], bool]]]:
    """Return the machines, and then the conditions, that have cases."""
    machines = [m for m in KINDS if any(j.label.machine == m for j in judged)]
    conditions = sorted({j.label.condition for j in judged})
    return [
        *((m, lambda j, m=m: j.label.machine == m) for m in machines),
        *((c, lambda j, c=c: j.label.condition == c) for c in conditions),
    ]


def stratum(judged: Sequence[Judged], name: str, belongs: Callable[[Judged], bool]) -> dict[str, Any]:
    """Count the cases of a stratum that ended as they should."""
    own = [score.as_wanted(j) for j in judged if belongs(j)]
    return {"name": name, "total": len(own), "hits": sum(own), "interval": score.wilson(sum(own), len(own))}


@dataclass(frozen=True)
class Sets:
    """Verdicts of visible effects that name more than one explanation."""

    total: int
    in_set: int  # the truth is one of them
    recording: int  # of these, a recording that separates them is named
    settled: int  # of these, the given runs separate them already, by the answer
    twins: int  # of these, no move separates them, by the answer


def sets(judged: Sequence[Judged]) -> Sets:
    """Count the verdicts that name a set, and their answers on how to separate its members."""
    several = [j for j in judged if j.named and j.label.visible and j.verdict.get("confusable_with")]
    right = [j for j in several if j.in_set]
    separations = [j.verdict.get("separate", []) for j in right]
    recording = [any(each["separates"] and each["record"] for each in own) for own in separations]
    twins = [any(not each["separates"] for each in own) for own in separations]
    settled = [
        bool(own) and not asked and not twin for own, asked, twin in zip(separations, recording, twins, strict=True)
    ]
    return Sets(len(several), len(right), sum(recording), sum(settled), sum(twins))


def power(judged: Sequence[Judged], edges: Sequence[float]) -> list[tuple[float, float, Rate]]:
    """Top-1 of single effects against what retuning leaves of them, as an rms in noises."""
    single = [(j, _left(j)) for j in judged if j.label.hides == "single"]
    found = []
    for low, high in pairwise(edges):
        inside = [j for j, left in single if low <= left < high]
        found.append((low, high, Rate("top-1", sum(j.right for j in inside), len(inside), "", lambda _: True)))
    return found


def _left(j: Judged) -> float:
    return float(np.sqrt(min(max(v.left, 0.0) / v.rows for v in j.label.visibility.values())))


def rate_of(rate: Rate) -> dict[str, Any]:
    """Return one rate with its Wilson interval and its aim."""
    low, high = rate.interval
    return {key: getattr(rate, key) for key in ("title", "hits", "total", "aim", "verdict")} | {
        "low": low,
        "high": high,
    }


def confusion_rows(judged: Sequence[Judged]) -> list[dict[str, Any]]:
    """Return the answers, for everything that was hidden."""
    return [
        {"hidden": row, "said": [{"answer": answer, "count": n} for answer, n in counts.most_common()]}
        for row, counts in sorted(score.confusion(judged).items())
    ]
