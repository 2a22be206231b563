"""A diagnosis in sentences for the printer's owner, the most important first; and what stands out in each split."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.diagnosis.diagnosis import Diagnosis
from ffcomp.diagnosis.next_experiment import Separation
from ffcomp.diagnosis.result import DiagnosisResult
from ffcomp.diagnosis.sentences import summary_sentences
from ffcomp.diagnosis.words import evidence, joined, most_of, percent, times, times_noise, title
from ffcomp.report.diagnose.summary import DiagnosisSummary, Split
from ffcomp.report.diagnose.tables import in_words


@dataclass(frozen=True)
class Origin:
    """Origin of a diagnosis; files by name and hash, not by folder."""

    machine: str  # its name
    machine_file: str  # `my-delta.toml sha256:…`
    runs: Sequence[str]  # `a-1.csv sha256:…`
    date: str
    version: str
    seconds: float  # of computing
    written: str = ""  # the better machine file, if there is one


@dataclass(frozen=True, eq=False)
class ReportInput:
    """Everything that the report shows."""

    result: DiagnosisResult
    search: Diagnosis
    summary: DiagnosisSummary
    proposals: Sequence[Separation]
    origin: Origin
    gain: str = ""  # how much prints would gain, in a sentence


def verdict(report: ReportInput) -> list[str]:
    """Return the finding in the words of the verb, with sizes first; then where it shows, and how sure it is."""
    result, finding = report.result, report.result.finding
    sentences = summary_sentences(result)
    if finding == "effects":
        named = joined([in_words(result, effect) for effect in result.effects])
        sentences = [f"Missing from the machine file: {named}.", *sentences, *_where(report)]
        sentences += [f"{_sure(result)} {_confounded(result)}", _file(report)]
    elif finding == "nothing":
        sentences += _nearest_promise(report)
        sentences.append("Other motions, speeds and positions may still show something that these could not.")
    elif finding in ("unproven", "unexplained"):
        sentences += _where(report)
    return [*sentences, *_invisible(result), *_noise(report)]


def _where(report: ReportInput) -> list[str]:
    """State what the excess depends on most."""
    sentences = [
        stands_out(split) for split in report.summary.splits if split.title in ("frequency", "place", "motion")
    ]
    telling = [sentence for sentence in sentences if " of the excess lies " in sentence]
    return [f"Where it shows: {' '.join(telling)}"] if telling else []


def _sure(result: DiagnosisResult) -> str:
    least = min(result.confidence.values(), default=0.0)
    return f"{_odds(least)} (−2 ln Z: {evidence(result.evidence)} better than retuning alone)."


def _odds(confidence: float) -> str:
    if confidence > 0.9999:
        return "Among the effects that ffcomp knows it is practically certain"
    return f"Among the effects that ffcomp knows it is {percent(confidence)} likely"


def _confounded(result: DiagnosisResult) -> str:
    if not result.confounded_with:
        return "No other effect that these runs could show looks like it."
    names = joined([f"{name} ({title(name, result.names.catalogue)})" for name, _ in result.confounded_with], "or")
    return f"It may be taken for {names}; what tells them apart stands below."


def _file(report: ReportInput) -> str:
    if report.origin.written:
        return (
            f"The better machine file is {report.origin.written}. Compare it with new runs before you trust it: "
            f"ffcomp gap NEW-RUNS -m {report.origin.written}."
        )
    return "Give -o better.toml to have the machine file with this in it, then compare it with new runs (ffcomp gap)."


def _nearest_promise(report: ReportInput) -> list[str]:
    seen = [s for s in report.search.screened if s.visible]
    if not seen:
        return []
    first = min(seen, key=lambda s: s.evidence)
    name, gain = first.candidate.name, -first.evidence
    named = title(name, report.result.names.catalogue)
    if gain < 0:
        return [f"No effect would have been worth its cost; {name} ({named}) came nearest."]
    return [f"{name} ({named}) came nearest: it promised {evidence(gain)} in −2 ln Z, too little to call it an effect."]


def _invisible(result: DiagnosisResult) -> list[str]:
    if not result.invisible:
        return []
    return [f"These runs could not have shown: {joined(list(result.invisible))}. Nothing is said about them."]


def _noise(report: ReportInput) -> list[str]:
    if not report.result.gap.noise_guessed:
        return []
    return ["Nothing was measured twice, so the noise is a guess from above the model's band: weaker evidence."]


# ---- what stands out where the excess is split ----------------------------------------------------

NO_EXCESS = 0.1  # excess, of the noise, on the mean: there is nothing to split
HIGH_RATIO = 1.5  # times the mean excess
TELLING_SHARE = 0.25  # of the excess
LOW_RATIO = 0.1  # times the mean excess
MOST_NAMED = 4  # labels in one sentence

WHERE = {
    "frequency": "at {}",
    "signal": "in {}",
    "place": "at {}",
    "window of time": "in the window {}",
    "run": "in {}",
    "share of the run's time": "at {} of the runs' time",
    "motion": "while what is measured is {}",
    "size of motion": "among the samples between {} of the signal's range",
    "motor's step cycle": "at {} of the cycle",
}
MOTIONS = {"backward": "moving backward", "forward": "moving forward"}
SPREAD = {
    "frequency": "no band holds more than its part",
    "signal": "all signals have their part",
    "place": "all positions contribute",
    "window of time": "all windows of time have their part",
    "run": "all runs have their part",
    "share of the run's time": "early and late alike",
    "motion": "forward, backward and turning back alike",
    "size of motion": "small and large motion alike",
    "motor's step cycle": "no phase of the cycle holds much more than its part",
}


def stands_out(split: Split) -> str:
    """Return `81 % of the excess lies at 60-80 Hz (10 % of what was compared).`."""
    excess, weight = np.maximum(split.before, 0.0), np.array(split.weight)
    mean = float(excess @ weight)
    if mean < NO_EXCESS:
        return "No excess here: the error is as large as the noise."
    if len(excess) == 1:
        return f"There is only one: {split.labels[0]}, where the error is {times(times_noise(mean))} the noise."
    hot = _hot(excess, mean, bool(split.spans))
    share = float(excess[hot] @ weight[hot]) / mean
    if not hot or share < TELLING_SHARE:
        return _spread(split, excess, mean)
    where = WHERE[split.title].format(_named(split, hot))
    most, compared = most_of(share), percent(float(weight[hot].sum()))
    return f"{most[0].upper()}{most[1:]} of the excess lies {where} ({compared} of what was compared)."


def _spread(split: Split, excess: np.ndarray, mean: float) -> str:
    """State that the excess is everywhere, or nearly."""
    spared = [] if split.spans else [int(i) for i in np.argsort(excess) if excess[i] < LOW_RATIO * mean]
    if not spared:
        return f"Nothing stands out: {SPREAD[split.title]}."
    return f"It is everywhere but {WHERE[split.title].format(_named(split, spared))}."


def _hot(excess: np.ndarray, mean: float, in_a_row: bool) -> list[int]:
    """Labels whose excess is high; of labels in a row those around the highest."""
    high = excess > HIGH_RATIO * mean
    if not in_a_row:
        return [int(i) for i in np.argsort(-excess) if high[i]]
    first = last = int(excess.argmax())
    while first > 0 and high[first - 1]:
        first -= 1
    while last < len(excess) - 1 and high[last + 1]:
        last += 1
    return list(range(first, last + 1)) if high[first] else []


def _named(split: Split, hot: Sequence[int]) -> str:
    if split.spans:
        return f"{split.spans[hot[0]][0]:.0f}-{split.spans[hot[-1]][1]:.0f} {split.unit}"
    names = [MOTIONS.get(split.labels[i], split.labels[i]) for i in hot[:MOST_NAMED]]
    more = len(hot) - MOST_NAMED
    return joined([*names, f"{more} more"] if more > 0 else names)
