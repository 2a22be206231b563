"""Effects that the data cannot tell from the named ones: competing hypotheses and confounded candidates."""

from __future__ import annotations

from collections.abc import Sequence

from ffcomp.diagnose.hypotheses import TRACE, Hypothesis, misfit
from ffcomp.diagnose.score_test import Screened, similarity

COMPETING = 20.0  # −2 ln Z
CONFOUNDED = 0.8  # cos² from which one effect can be taken for another


def competing_with(
    best: Hypothesis, tried: Sequence[Hypothesis], share: float = 1.0, gap: float = 0.0
) -> list[Hypothesis]:
    """Find hypotheses of other effects, as many, that are nearly as likely, or that explain all but a trace too.

    Parameters
    ----------
    share : of the data, on which all were fitted: all of it would set them apart that much further.
    gap : the discrepancy without any effect, of the noise. Where it is large, even a small error of an effect's shape
        is significant, and no effect has exactly our shape: what leaves a thousandth of it cannot be ruled out.
    """
    scale = misfit(best.fit) * share
    others = [h for h in tried if h.names != best.names and len(h.effects) == len(best.effects)]
    return [
        h for h in others if (h.fit.evidence - best.fit.evidence) / scale < COMPETING or h.discrepancy < TRACE * gap
    ]


def confounded_with(
    best: Hypothesis, screened: Sequence[Screened], limit: float = CONFOUNDED
) -> list[tuple[str, float]]:
    """Find candidates whose signature is like that of a named effect: name and cos², the most similar first."""
    ours = [s for s in screened if s.candidate.name in best.names]
    others = [s for s in screened if s.candidate.name not in best.names and s.visible]
    similar = {o.candidate.name: max((similarity(o, s) for s in ours), default=0.0) for o in others}
    return sorted(((name, c) for name, c in similar.items() if c > limit), key=lambda pair: -pair[1])
