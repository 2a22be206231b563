"""Say a comparison in plain sentences, the bad news as plainly as the good, and define the terms."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from ffcomp.comparison.result import Comparison, EqualQuality, Method
from ffcomp.comparison.words import (
    acceleration,
    contour_p99_um,
    contour_rms_um,
    duration,
    extrudes,
    fastest_shaper,
    nick,
    seen,
    shapers,
    times,
    where_seen,
)
from ffcomp.numerics.digits import um
from ffcomp.result import Answer, Fact
from ffcomp.simulation.expectation import condition_of

WORTH_RATIO, TIE_RATIO = 2.0, 1.05  # times less error than the best shaper: below the first, a shaper is enough


@dataclass(frozen=True, slots=True)
class Worth:
    """Whether it is worth it, in one word, and why."""

    word: str  # Yes, Hardly, No
    why: str

    def __str__(self) -> str:
        return f"Worth it? {self.word}: {self.why}"


def answer_of(comparison: Comparison) -> Answer:
    """Return what people are shown of a comparison, wherever they look."""
    step = comparison.expected.next_step if comparison.expected else ""
    facts = [*findings(comparison), *method_facts(comparison)]
    return Answer(str(worth(comparison)), facts, cautions(comparison), [step] if step else [])


def worth(comparison: Comparison) -> Worth:
    """Weigh the compensated print against the best fixed shaper, which owners have for nothing."""
    ours = comparison.methods[comparison.compensated]
    if not ours.peaks.within_limits:
        return Worth("No", f"{_at(comparison)}ffcomp asks the carriages for more than the machine file allows.")
    left, theirs, before, shaper, where = _weighed(comparison, ours)
    if left >= theirs / TIE_RATIO:
        as_good = "as good" if left <= TIE_RATIO * theirs else "better"
        sentence = f"{_at(comparison)}the best input shaper ({shaper}) is {as_good} on this print{where}"
        return Worth("No", f"{sentence}: {um(theirs)} µm against {um(left)}.")
    gain = f"{_at(comparison)}ffcomp leaves {um(left)} µm, the best input shaper ({shaper}) {um(theirs)} and none "
    gain += f"{um(before)}{where}.{_faster(comparison, ours)}"
    if theirs < WORTH_RATIO * left:
        return Worth("Hardly", f"{gain} The difference is small: a shaper is enough.")
    return Worth("Yes", gain)


def _weighed(comparison: Comparison, ours: Method) -> tuple[float, float, float, str, str]:
    """Return the contour error, µm, of ffcomp, of the best shaper and of none, which shaper that is, and on what.

    Those of the Monte-Carlo plants, or else those to expect by the machine file's `[uncertainty]`, or else those of the
    virtual printer.
    """
    none, best, expected = comparison.methods["none"], comparison.methods[comparison.best_fixed], comparison.expected
    if ours.spread is not None and none.spread is not None:
        spreads = [(each.spread.mean_um, nick(each)) for each in shapers(comparison) if each.spread is not None]
        theirs, shaper = min(spreads)
        return ours.spread.mean_um, theirs, none.spread.mean_um, shaper, " (mean of printers that are off)"
    if expected is not None:
        condition = condition_of(expected.uncertainty, expected.assumed)
        left, theirs, before = expected.compensated_um, expected.shaper_um, expected.uncompensated_um
        return left, theirs, before, expected.shaper_name, f" (expected {condition})"
    left, theirs, before = (contour_rms_um(comparison, method) for method in (ours, best, none))
    return left, theirs, before, nick(best), f", {where_seen(comparison)}"


def _at(comparison: Comparison) -> str:
    if comparison.acceleration_mm_per_s2 is None:
        return ""
    return f"at your {acceleration(comparison.acceleration_mm_per_s2)} "


def _faster(comparison: Comparison, ours: Method) -> str:
    quality, rival = ours.equal_quality, fastest_shaper(comparison)
    theirs = None if rival is None else rival.equal_quality
    if quality is None or not quality.reached:
        return ""
    quality_text = f" It keeps 99 % within {comparison.quality_bound_um:g} µm up to {_highest(quality)}"
    if theirs is None or rival is None:
        return f"{quality_text}."
    if not theirs.reached:
        return f"{quality_text}, which no shaper manages."
    return f"{quality_text}, the fastest shaper ({nick(rival)}) up to {_highest(theirs)}."


def _highest(quality: EqualQuality) -> str:
    return f"{acceleration(quality.acceleration_mm_per_s2)}{' and more' if quality.capped else ''}"


def findings(comparison: Comparison) -> list[Fact]:
    """Return the named findings, the most important first."""
    ours, none, best = (comparison.methods[name] for name in (comparison.compensated, "none", comparison.best_fixed))
    return [
        ("Against no compensation", _against_none(comparison, none, ours)),
        ("Against shapers", _against_best(comparison, best, ours)),
        *(("Best of all", each) for each in _against_all(comparison, ours)),
        *(("Inverse", each) for each in _written(comparison)),
        *(("If the printer is off", each) for each in _mismatch(comparison, best, ours)),
        *(("At equal quality", each) for each in _equal_quality(comparison, none, ours)),
        *(("Limits", each) for each in _limits(comparison, ours)),
        ("Evaluated", comparison.sampling),
        *(("Marlin", each) for each in filter(None, [comparison.settings.get("Marlin")])),
        ("Simulated", _plant(comparison)),
        *(("Predicted", each) for each in _predicted(comparison)),
    ]


def cautions(comparison: Comparison) -> list[str]:
    """Return the caveats: assumed modes, and warnings about the print."""
    return [*_assumed(comparison), *dict.fromkeys(comparison.methods[comparison.compensated].warnings)]


def method_facts(comparison: Comparison) -> list[Fact]:
    """Return each method's contour error and, where they were sought, its spread and its speed at equal quality."""
    return [(method.label, ", ".join(_numbers(comparison, method))) for method in comparison.methods.values()]


def _numbers(comparison: Comparison, method: Method) -> Iterator[str]:
    errors = seen(comparison, method)
    yield f"{um(errors.contour_rms_um)} µm rms"
    yield f"99 % within {um(errors.contour_p99_um)}"
    yield f"largest {um(errors.contour_max_um)}"
    if method.spread is not None:
        yield f"on printers that are off {um(method.spread.median_um)} (median), {um(method.spread.worst_um)} at worst"
    if method.equal_quality is not None:
        yield _speed(method.equal_quality)
    if not method.peaks.within_limits:
        yield "beyond the carriages' limits"


def _against_none(comparison: Comparison, none: Method, ours: Method) -> str:
    before, after = contour_rms_um(comparison, none), contour_rms_um(comparison, ours)
    where = (
        "Where plastic flows, the"
        if extrudes(comparison)
        else "No plastic flows in the evaluated part; over all moves, the"
    )
    numbers = (
        f"{where} nozzle is {um(before)} µm (rms) off the reference path without compensation and {um(after)} µm with "
        "ffcomp"
    )
    tails = (
        f"99 % of the time it stays within {um(contour_p99_um(comparison, ours))} µm, without compensation within "
        f"{um(contour_p99_um(comparison, none))} µm"
    )
    if after > TIE_RATIO * before:
        return f"{numbers}: ffcomp makes this print worse, do not use it here; {tails}."
    if before <= TIE_RATIO * after:
        return f"{numbers}: no difference worth the trouble; {tails}."
    return f"{numbers}: {times(before / after)} less; {tails}."


def _against_best(comparison: Comparison, best: Method, ours: Method) -> str:
    best_um, ours_um = contour_rms_um(comparison, best), contour_rms_um(comparison, ours)
    usual = _calibrated(comparison)
    sentence = f"The best fixed input shaper ({nick(best)}, {_short(best.tuning)}) leaves {um(best_um)} µm"
    if ours_um > TIE_RATIO * best_um:
        asked, by_ours = best.peaks.acceleration_mm_per_s2, ours.peaks.acceleration_mm_per_s2
        harder = ""
        if asked > TIE_RATIO * by_ours:
            harder = f" if the carriages can do {acceleration(asked)}, where ffcomp needs {acceleration(by_ours)}"
        return f"{sentence}: {times(ours_um / best_um)} less than ffcomp. Use the shaper{harder}.{usual}"
    if best_um <= TIE_RATIO * ours_um:
        return f"{sentence}, the same as ffcomp.{usual}"
    return f"{sentence}: {times(best_um / ours_um)} as much as ffcomp.{usual}"


def _calibrated(comparison: Comparison) -> str:
    """State what owners have: the best shaper that a firmware's own calibration sets."""
    usual = [method for method in comparison.methods.values() if method.family == "calibrated"]
    if not usual:
        return ""
    first = min(usual, key=lambda method: contour_rms_um(comparison, method))
    least = um(contour_rms_um(comparison, first))
    return f" Set by the firmware's own resonance test, shapers leave {least} µm ({nick(first)})."


def _short(tuning: str) -> str:
    return tuning.split(": ")[0].rstrip(".")


def _against_all(comparison: Comparison, ours: Method) -> list[str]:
    first = min(comparison.methods.values(), key=lambda method: contour_rms_um(comparison, method))
    ours_um, least = contour_rms_um(comparison, ours), contour_rms_um(comparison, first)
    named = (comparison.compensated, comparison.best_fixed, "none", *(["fbs-lpv"] if comparison.robust.robust else []))
    if first.name in named or ours_um <= TIE_RATIO * least:
        return []
    return [f"{first.label} has the lowest error: {um(least)} µm."]


def _written(comparison: Comparison) -> list[str]:
    """State which inverse `compensate` uses with this machine file, if not the plain one, and the plain one's error."""
    plain = comparison.methods.get("fbs-lpv")
    if not comparison.robust.robust or plain is None:
        return []
    exact = (
        ", where the printer is exactly as the file says"
        if comparison.plant.sha256 == comparison.machine.sha256
        else ""
    )
    return [
        f"The row “ffcomp” is the file that `ffcomp compensate` writes. {comparison.robust.reason} The plain inverse "
        f"(“{plain.label}”) leaves {um(contour_rms_um(comparison, plain))} µm here{exact}."
    ]


def _mismatch(comparison: Comparison, best: Method, ours: Method) -> list[str]:
    our_spread = ours.spread
    if our_spread is None:
        return []
    evaluated = [
        (method.spread, f"{method.label}, as tuned") for method in shapers(comparison) if method.spread is not None
    ]
    against = sorted(evaluated, key=lambda each: each[0].mean_um)[:1]
    if best.retuned is not None:
        against.append((best.retuned, f"{nick(best)} tuned again on each"))
    sentence = (
        f"On {len(our_spread.contour_rms_um)} printers that differ from the machine file, over all moves: "
        f"{um(our_spread.mean_um)} µm on average and {um(our_spread.worst_um)} µm at worst with ffcomp"
    )
    sentence += "".join(f"; {um(spread.mean_um)} and {um(spread.worst_um)} µm with {name}" for spread, name in against)
    if any(our_spread.mean_um > TIE_RATIO * spread.mean_um for spread, _ in against):
        return [f"{sentence}. With such an uncertainty the shaper is better: measure the machine first."]
    if any(our_spread.worst_um > TIE_RATIO * spread.worst_um for spread, _ in against):
        return [f"{sentence}. On average ffcomp is ahead or level, at worst the shaper is better."]
    return [f"{sentence}."]


def _equal_quality(comparison: Comparison, none: Method, ours: Method) -> list[str]:
    quality, rival = ours.equal_quality, fastest_shaper(comparison)
    if quality is None:
        return []
    parts, saved = [f"ffcomp {_speed(quality)}"], ""
    if rival is not None and rival.equal_quality is not None:
        parts.append(f"the fastest shaper ({rival.label}) {_speed(rival.equal_quality)}")
        saved = _saved(rival.equal_quality, quality)
    if none.equal_quality is not None:
        parts.append(f"no compensation {_speed(none.equal_quality)}")
    bound = f"If 99 % of the contour error must stay below {comparison.quality_bound_um:g} µm"
    return [f"{bound}: {'; '.join(parts)}.{saved}"]


def _speed(quality: EqualQuality) -> str:
    highest, whole = acceleration(quality.acceleration_mm_per_s2), duration(quality.print_time_s)
    if not quality.reached:
        return f"misses it even at {highest}"
    if quality.capped:
        return f"keeps it even at {highest}, the highest that was tried (whole print {whole})"
    return f"keeps it up to {highest} (whole print {whole})"


def _saved(theirs: EqualQuality, quality: EqualQuality) -> str:
    """State the time saved against the shaper, where both keep the bound."""
    if not (quality.reached and theirs.reached):
        return ""
    share = 1 - quality.print_time_s / theirs.print_time_s
    if abs(share) < 0.005:
        return " That saves no time on this print."
    word = "less" if share > 0 else "more"
    return f" With ffcomp that is {100 * abs(share):.0f} % {word} print time than with the shaper."


def _limits(comparison: Comparison, ours: Method) -> list[str]:
    beyond = [method for method in comparison.methods.values() if not method.peaks.within_limits]
    if ours in beyond:
        return [
            f"ffcomp asks the carriages for {ours.peaks.velocity_mm_per_s:.0f} mm/s and "
            f"{acceleration(ours.peaks.acceleration_mm_per_s2)}, "
            f"more than the machine file allows{_allowed(comparison)}: "
            "the real printer cannot reach this accuracy; lower the print's speed or acceleration."
        ]
    if beyond:
        names = f"{_allowed(comparison)}: {', '.join(method.label for method in beyond)}"
        return [f"Beyond the limits of the carriages{names}. A real printer cannot reach their accuracy."]
    return []


def _allowed(comparison: Comparison) -> str:
    velocity = comparison.limits.get("carriage_velocity_mm_per_s")
    most = comparison.limits.get("carriage_acceleration_mm_per_s2")
    if velocity is None or most is None:
        return ""
    return f" ({velocity:.0f} mm/s, {acceleration(most)})"


def _assumed(comparison: Comparison) -> list[str]:
    """Say whose modes are assumed, of the machine and the plant; each once."""
    return list(dict.fromkeys(party.assumed for party in (comparison.machine, comparison.plant) if party.assumed))


def _predicted(comparison: Comparison) -> list[str]:
    if not comparison.predicted:
        return []
    before, after = (um(comparison.predicted[name].contour_rms_um) for name in ("uncompensated", "compensated"))
    part = "" if comparison.whole else ", of the part that was evaluated"
    return [
        f"`ffcomp compensate` and `ffcomp show` predict {before} → {after} µm rms for this print, with the linear "
        "model that ffcomp plans with and over all moves, travel included. The errors above come from the "
        f"nonlinear virtual printer, {where_seen(comparison)}{part}."
    ]


def _plant(comparison: Comparison) -> str:
    effects = f", with {', '.join(comparison.plant.effects)}" if comparison.plant.effects else ""
    if comparison.plant.sha256 == comparison.machine.sha256:
        hint = "" if comparison.mismatch else "; --mismatch 10% shows by how much"
        return (
            "All of this is simulated, and the virtual printer has exactly the parameters of the machine "
            f"file{effects}. A real printer differs from its file, so expect larger errors{hint}."
        )
    return (
        f"All of this is simulated: every method uses the model of {comparison.machine.name}, and the virtual printer "
        f"that evaluates them is {comparison.plant.name}{effects}."
    )
