"""State the comparison in plain sentences, the bad news as plainly as the good."""

from __future__ import annotations

from ffcomp.compare.result import Comparison, EqualQuality, Method
from ffcomp.report.compare.words import (
    acceleration,
    contour_p99_um,
    contour_rms_um,
    duration,
    extrudes,
    fastest_shaper,
    nick,
    shapers,
    times,
    um,
    where_seen,
)

ALIKE = 1.05  # two errors closer than this are called the same


def verdict(found: Comparison) -> list[str]:
    """Return the sentences, the most important first."""
    own_method, none, best = (found.methods[name] for name in (found.compensated, "none", found.best_fixed))
    return [
        _against_none(found, none, own_method),
        _against_best(found, best, own_method),
        *_against_all(found, own_method),
        *_written(found),
        *_mismatch(found, best, own_method),
        *_equal_quality(found, none, own_method),
        *_limits(found, own_method),
        *_warnings(own_method),
        found.sampling,
        *_assumed(found),
        _plant(found),
        *_predicted(found),
    ]


def _against_none(found: Comparison, none: Method, own_method: Method) -> str:
    before, after = contour_rms_um(found, none), contour_rms_um(found, own_method)
    where = (
        "Where plastic flows, the" if extrudes(found) else "No plastic flows in the evaluated part; over all moves, the"
    )
    numbers = (
        f"{where} nozzle is {um(before)} µm (rms) off the reference path without compensation and {um(after)} µm with "
        "ffcomp"
    )
    tails = (
        f"99 % of the time it stays within {um(contour_p99_um(found, own_method))} µm, without compensation within "
        f"{um(contour_p99_um(found, none))} µm"
    )
    if after > ALIKE * before:
        return f"{numbers}: ffcomp makes this print worse, do not use it here; {tails}."
    if before <= ALIKE * after:
        return f"{numbers}: no difference worth the trouble; {tails}."
    return f"{numbers}: {times(before / after)} less; {tails}."


def _against_best(found: Comparison, best: Method, own_method: Method) -> str:
    theirs, own = contour_rms_um(found, best), contour_rms_um(found, own_method)
    usual = _calibrated(found)
    said = f"The best fixed input shaper ({nick(best)}, {_short(best.tuning)}) leaves {um(theirs)} µm"
    if own > ALIKE * theirs:
        return f"{said}: {times(own / theirs)} less than ffcomp. Use the shaper.{usual}"
    if theirs <= ALIKE * own:
        return f"{said}, the same as ffcomp.{usual}"
    return f"{said}: {times(theirs / own)} as much as ffcomp.{usual}"


def _calibrated(found: Comparison) -> str:
    """State what owners have: the best shaper that a firmware's own calibration sets."""
    usual = [method for method in found.methods.values() if method.family == "calibrated"]
    if not usual:
        return ""
    first = min(usual, key=lambda method: contour_rms_um(found, method))
    least = um(contour_rms_um(found, first))
    return f" Set by the firmware's own resonance test, shapers leave {least} µm ({nick(first)})."


def _short(tuning: str) -> str:
    """Return the choice without its explanation."""
    return tuning.split(": ")[0].rstrip(".")


def _against_all(found: Comparison, own_method: Method) -> list[str]:
    """Name a method beside those above that is better."""
    first = min(found.methods.values(), key=lambda method: contour_rms_um(found, method))
    own, least = contour_rms_um(found, own_method), contour_rms_um(found, first)
    told = (found.compensated, found.best_fixed, "none", *(["fbs-lpv"] if found.robust.robust else []))
    if first.name in told or own <= ALIKE * least:
        return []
    return [f"The least error of all has {first.label}: {um(least)} µm."]


def _written(found: Comparison) -> list[str]:
    """Tell how `compensate` inverts with this machine file, where that is not plain, and what plain leaves."""
    plain = found.methods.get("fbs-lpv")
    if not found.robust.robust or plain is None:
        return []
    exact = ", where the printer is exactly as the file says" if found.plant.sha256 == found.machine.sha256 else ""
    return [
        f"“ffcomp” is what `ffcomp compensate` writes with this machine file. {found.robust.reason} That leaves "
        f"{um(contour_rms_um(found, plain))} µm (“{plain.label}”) here{exact}."
    ]


def _mismatch(found: Comparison, best: Method, own_method: Method) -> list[str]:
    """Compare with the most tolerant shaper, and with the best one tuned again."""
    own = own_method.spread
    if own is None:
        return []
    evaluated = [(method.spread, f"{method.label}, as tuned") for method in shapers(found) if method.spread is not None]
    against = sorted(evaluated, key=lambda each: each[0].median_um)[:1]
    if best.retuned is not None:
        against.append((best.retuned, f"{nick(best)} tuned again on each"))
    said = (
        f"On {len(own.contour_rms_um)} printers that are not as the machine file says, over all moves: "
        f"{um(own.median_um)} µm in the median and {um(own.worst_um)} µm at worst with ffcomp"
    )
    said += "".join(f"; {um(spread.median_um)} and {um(spread.worst_um)} µm with {name}" for spread, name in against)
    if any(own.median_um > ALIKE * spread.median_um for spread, _ in against):
        return [f"{said}. With such an uncertainty the shaper is better: measure the machine first."]
    if any(own.worst_um > ALIKE * spread.worst_um for spread, _ in against):
        return [f"{said}. In the median ffcomp is ahead or level, at worst the shaper is better."]
    return [f"{said}."]


def _equal_quality(found: Comparison, none: Method, own_method: Method) -> list[str]:
    own, rival = own_method.equal_quality, fastest_shaper(found)
    if own is None:
        return []
    parts, saved = [f"ffcomp {_speed(own)}"], ""
    if rival is not None and rival.equal_quality is not None:
        parts.append(f"the fastest shaper ({rival.label}) {_speed(rival.equal_quality)}")
        saved = _saved(rival.equal_quality, own)
    if none.equal_quality is not None:
        parts.append(f"no compensation {_speed(none.equal_quality)}")
    bound = f"If 99 % of the contour error must stay below {found.quality_bound_um:g} µm"
    return [f"{bound}: {'; '.join(parts)}.{saved}"]


def _speed(quality: EqualQuality) -> str:
    highest, whole = acceleration(quality.acceleration_mm_per_s2), duration(quality.print_time_s)
    if not quality.reached:
        return f"misses it even at {highest}"
    if quality.capped:
        return f"keeps it even at {highest}, the highest that was tried (whole print {whole})"
    return f"keeps it up to {highest} (whole print {whole})"


def _saved(theirs: EqualQuality, own: EqualQuality) -> str:
    """State the time saved against the shaper, where both keep the bound."""
    if not (own.reached and theirs.reached):
        return ""
    share = 1 - own.print_time_s / theirs.print_time_s
    if abs(share) < 0.005:
        return " That saves no time on this print."
    word = "less" if share > 0 else "more"
    return f" With ffcomp that is {100 * abs(share):.0f} % {word} print time than with the shaper."


def _limits(found: Comparison, own_method: Method) -> list[str]:
    beyond = [method for method in found.methods.values() if not method.peaks.within_limits]
    if own_method in beyond:
        return [
            f"ffcomp asks the carriages for {own_method.peaks.velocity_mm_per_s:.0f} mm/s and "
            f"{acceleration(own_method.peaks.acceleration_mm_per_s2)}, "
            f"more than the machine file allows{_allowed(found)}: "
            "its accuracy here is not to be had; lower the print's speed or acceleration."
        ]
    if beyond:
        names = ", ".join(method.label for method in beyond)
        return [f"Beyond the limits of the carriages{_allowed(found)}: {names}. Their accuracy is not to be had."]
    return []


def _allowed(found: Comparison) -> str:
    velocity = found.limits.get("carriage_velocity_mm_per_s")
    most = found.limits.get("carriage_acceleration_mm_per_s2")
    if velocity is None or most is None:
        return ""
    return f" ({velocity:.0f} mm/s, {acceleration(most)})"


def _warnings(own_method: Method) -> list[str]:
    return [f"Warning: {sentence}" for sentence in dict.fromkeys(own_method.warnings)]


def _assumed(found: Comparison) -> list[str]:
    """Say whose modes are assumed, of the machine and the plant; each once."""
    return list(dict.fromkeys(party.assumed for party in (found.machine, found.plant) if party.assumed))


def _predicted(found: Comparison) -> list[str]:
    """State the number of `compensate` and `show`, which is another quantity."""
    if not found.predicted:
        return []
    before, after = (um(found.predicted[name].contour_rms_um) for name in ("uncompensated", "compensated"))
    part = "" if found.whole else ", of the part that was evaluated"
    return [
        f"`ffcomp compensate` and `ffcomp show` say {before} → {after} µm rms for this print: that is predicted by the "
        "linear model that ffcomp plans with, over all moves of the whole print, travel too. The errors above are "
        f"the virtual printer's, which is not linear, {where_seen(found)}{part}."
    ]


def _plant(found: Comparison) -> str:
    effects = f", with {', '.join(found.plant.effects)}" if found.plant.effects else ""
    if found.plant.sha256 == found.machine.sha256:
        hint = "" if found.mismatch else "; --mismatch 10% shows by how much"
        return (
            "All of this is simulated, and the virtual printer has the very numbers of the machine file that ffcomp "
            f"plans with{effects}. A real printer differs from its file, so in reality it will be less good{hint}."
        )
    return (
        f"All of this is simulated: every method uses the model of {found.machine.name}, and the virtual printer that "
        f"evaluates them is {found.plant.name}{effects}."
    )
