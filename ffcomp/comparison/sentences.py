"""Say a comparison in plain sentences, the bad news as plainly as the good."""

from __future__ import annotations

from collections.abc import Iterator

from ffcomp.comparison.result import Comparison, EqualQuality, Method
from ffcomp.numerics.digits import um
from ffcomp.result import Answer, Fact, clock
from ffcomp.simulation.expectation import condition_of

WORTH_RATIO, TIE_RATIO = 2.0, 1.05  # times less error than the best shaper: below the first, a shaper is enough


def answer_of(comparison: Comparison) -> Answer:
    """Return what people are shown of a comparison, wherever they look."""
    step = comparison.expected.next_step if comparison.expected else ""
    facts = [*_method_facts(comparison), *findings(comparison)]
    return Answer(worth(comparison), facts, cautions(comparison), [step] if step else [])


def worth(comparison: Comparison) -> str:
    """Weigh the compensated print against the best fixed shaper, which owners have for nothing."""
    ours = comparison.ours
    stated = comparison.acceleration_mm_per_s2
    at = "" if stated is None else f"at your {acceleration(stated)} "
    if not ours.peaks.within_limits:
        return f"Worth it? No: {at}ffcomp asks the carriages for more than the machine file allows."
    left, theirs, before, shaper, where = _weighed(comparison)
    if left > TIE_RATIO * before:
        return f"Worth it? No: {at}ffcomp makes this print worse{where}: {um(left)} µm, without it {um(before)}."
    if left >= theirs / TIE_RATIO:
        as_good = "as good" if left <= TIE_RATIO * theirs else "better"
        sentence = f"Worth it? No: {at}the best input shaper ({shaper}) is {as_good} on this print{where}"
        return f"{sentence}: {um(theirs)} µm against {um(left)}."
    gain = (
        f"{at}ffcomp leaves {um(left)} µm, the best input shaper ({shaper}) {um(theirs)} and none {um(before)}{where}."
    )
    gain += _speeds(comparison, ours)
    if theirs < WORTH_RATIO * left:
        return f"Worth it? Hardly: {gain} The difference is small: a shaper is enough."
    return f"Worth it? Yes: {gain}"


def _weighed(comparison: Comparison) -> tuple[float, float, float, str, str]:
    """Return the contour error, µm, of ffcomp, of the best shaper and of none, which shaper that is, and on what.

    Those to expect by the machine file's `[uncertainty]`, or else those of the virtual printer.
    """
    expected = comparison.expected
    if expected is not None:
        condition = condition_of(expected.uncertainty, expected.assumed)
        left, theirs, before = expected.compensated_um, expected.shaper_um, expected.uncompensated_um
        return left, theirs, before, expected.shaper_name, f" (expected {condition})"
    left, theirs, before = map(comparison.rms_um, (comparison.ours, comparison.best, comparison.none))
    return left, theirs, before, nick(comparison.best), f", {comparison.where}"


def _speeds(comparison: Comparison, ours: Method) -> str:
    quality, rival = ours.equal_quality, comparison.fastest_shaper
    if quality is None or not quality.reached:
        return ""
    quality_text = f" It keeps 99 % within {comparison.quality_bound_um:g} µm up to {_highest(quality)}"
    if rival is None or rival.equal_quality is None:
        return f"{quality_text}."
    if not rival.equal_quality.reached:
        return f"{quality_text}, which no shaper manages."
    return f"{quality_text}, the fastest shaper ({nick(rival)}) up to {_highest(rival.equal_quality)}."


def _highest(quality: EqualQuality) -> str:
    return f"{acceleration(quality.acceleration_mm_per_s2)}{' and more' if quality.capped else ''}"


def findings(comparison: Comparison) -> list[Fact]:
    """Return what stands below the methods: how it was found, and what limits it."""
    named = (
        ("Inverse", _written(comparison)),
        ("Limits", _limits(comparison)),
        ("Evaluated", comparison.sampling),
        ("Marlin", comparison.settings.get("Marlin", "")),
        ("Simulated", _plant(comparison)),
        ("Predicted", _predicted(comparison)),
    )
    return [(name, sentence) for name, sentence in named if sentence]


def cautions(comparison: Comparison) -> list[str]:
    """Return the caveats: whether another file is compared, assumed modes, and warnings about the print."""
    assumed = [party.assumed for party in (comparison.machine, comparison.plant) if party.assumed]
    return list(dict.fromkeys([*comparison.notes, *assumed, *comparison.ours.warnings]))


def _method_facts(comparison: Comparison) -> list[Fact]:
    """Return each method's contour error and, where it was sought, its speed at equal quality."""
    return [(method.label, ", ".join(_numbers(comparison, method))) for method in comparison.methods.values()]


def _numbers(comparison: Comparison, method: Method) -> Iterator[str]:
    errors = comparison.seen(method)
    yield f"{um(errors.contour_rms_um)} µm rms"
    yield f"99 % within {um(errors.contour_p99_um)}"
    yield f"largest {um(errors.contour_max_um)}"
    if method.equal_quality is not None:
        yield _speed(method.equal_quality)
    if not method.peaks.within_limits:
        yield "beyond the carriages' limits"


def _written(comparison: Comparison) -> str:
    """State which inverse `compensate` uses with this machine file, if not the plain one, and the plain one's error."""
    plain = comparison.methods.get("fbs-lpv")
    if not comparison.robust.robust or plain is None:
        return ""
    exact = comparison.plant.sha256 == comparison.machine.sha256
    return (
        f"The row “ffcomp” is the file that `ffcomp compensate` writes. {comparison.robust.reason} The plain inverse "
        f"(“{plain.label}”) leaves {um(comparison.rms_um(plain))} µm here"
        f"{', where the printer is exactly as the file says' if exact else ''}."
    )


def _speed(quality: EqualQuality) -> str:
    highest, whole = acceleration(quality.acceleration_mm_per_s2), clock(quality.print_time_s)
    if not quality.reached:
        return f"misses it even at {highest}"
    if quality.capped:
        return f"keeps it even at {highest}, the highest that was tried (whole print {whole})"
    return f"keeps it up to {highest} (whole print {whole})"


def _limits(comparison: Comparison) -> str:
    ours, beyond = comparison.ours, [m for m in comparison.methods.values() if not m.peaks.within_limits]
    velocity = comparison.limits.get("carriage_velocity_mm_per_s")
    most = comparison.limits.get("carriage_acceleration_mm_per_s2")
    allowed = "" if velocity is None or most is None else f" ({velocity:.0f} mm/s, {acceleration(most)})"
    if ours in beyond:
        return (
            f"ffcomp asks the carriages for {ours.peaks.velocity_mm_per_s:.0f} mm/s and "
            f"{acceleration(ours.peaks.acceleration_mm_per_s2)}, more than the machine file allows{allowed}: "
            "the real printer cannot reach this accuracy; lower the print's speed or acceleration."
        )
    if beyond:
        names = f"{allowed}: {', '.join(method.label for method in beyond)}"
        return f"Beyond the limits of the carriages{names}. A real printer cannot reach their accuracy."
    return ""


def _predicted(comparison: Comparison) -> str:
    if not comparison.predicted:
        return ""
    before, after = (um(comparison.predicted[name].contour_rms_um) for name in ("uncompensated", "compensated"))
    part = "" if comparison.whole else ", of the part that was evaluated"
    return (
        f"`ffcomp compensate` and `ffcomp show` predict {before} → {after} µm rms for this print, with the linear "
        "model that ffcomp plans with and over all moves, travel included. The errors above come from the "
        f"nonlinear virtual printer, {comparison.where}{part}."
    )


def _plant(comparison: Comparison) -> str:
    effects = f", with {', '.join(comparison.plant.effects)}" if comparison.plant.effects else ""
    if comparison.plant.sha256 == comparison.machine.sha256:
        return (
            "All of this is simulated, and the virtual printer has exactly the parameters of the machine "
            f"file{effects}. A real printer differs from its file, so expect larger errors."
        )
    return (
        f"All of this is simulated: every method uses the model of {comparison.machine.name}, and the virtual printer "
        f"that evaluates them is {comparison.plant.name}{effects}."
    )


def nick(method: Method) -> str:
    """Return the label without its family, where that is known: `MZV`, `MZV, z too`, `ffcomp`."""
    return method.label.removesuffix(f", {method.family}")


def acceleration(mm_per_s2: float) -> str:
    """Format an acceleration in the firmware's unit and in metres: `12,400 mm/s² (12.4 m/s²)`."""
    return f"{float(f'{mm_per_s2:.3g}'):,.0f} mm/s² ({mm_per_s2 / 1e3:.3g} m/s²)"
