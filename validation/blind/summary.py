"""The score of a bank as plain data: rates against aims, strata, the confusion matrix, and every miss."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from validation.blind import score
from validation.blind.cases import CONDITIONS, HIDES
from validation.blind.kinds import KINDS


def summary(judged: Sequence[score.Judged]) -> dict[str, Any]:
    """Return the JSON object ffcomp-bank-score/1."""
    return {
        "schema": "ffcomp-bank-score/1",
        "cases": len(judged),
        "rates": [rate_of(rate) for rate in score.rates(judged)],
        "strata": [
            *(stratum(name, [j for j in judged if j.label.machine == name]) for name in KINDS),
            *(stratum(name, [j for j in judged if j.label.hides == name]) for name in HIDES),
            *(stratum(name, [j for j in judged if j.label.condition == name]) for name in CONDITIONS),
        ],
        "confusion": confusion(judged),
        "misses": [miss(j) for j in judged if not score.as_wanted(j)],
    }


def rate_of(rate: score.Rate) -> dict[str, Any]:
    """Return one rate with its Wilson interval and its aim."""
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


def stratum(name: str, judged: Sequence[score.Judged]) -> dict[str, Any]:
    """Count the cases of a stratum that ended as they should."""
    hits = sum(score.as_wanted(j) for j in judged)
    low, high = score.wilson(hits, len(judged))
    return {"name": name, "hits": hits, "total": len(judged), "low": low, "high": high}


def confusion(judged: Sequence[score.Judged]) -> list[dict[str, Any]]:
    """Return what was said, for everything that was hidden."""
    return [
        {"hidden": row, "said": [{"answer": answer, "count": n} for answer, n in counts.most_common()]}
        for row, counts in sorted(score.confusion(judged).items())
    ]


def miss(j: score.Judged) -> dict[str, Any]:
    """Describe a case that ended otherwise than it should, with what was said about it."""
    return {
        "case": j.name,
        "stratum": j.label.stratum,
        "hidden": j.question,
        "left": [math.sqrt(max(v.left, 0.0) / v.rows) for v in j.label.visibility.values()],
        "visible": j.label.visible,
        "said": j.answer,
        "because": _because(j),
    }


def _because(j: score.Judged) -> str:
    refused = j.verdict.get("refused") or {}
    rivals = ", ".join(rival["name"] for rival in j.verdict.get("confusable_with", []))
    parts = [j.verdict.get("why", "").replace("\n", " ").replace("|", "/")]
    if refused:
        parts.append(f"nearest {'+'.join(refused['effects'])}; {'; '.join(refused['because'])}")
    if rivals:
        parts.append(f"looks alike: {rivals}")
    return "; ".join(filter(None, parts))
