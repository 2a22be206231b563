"""The numbers that steer the search of `diagnose`: one frozen table, with units, meanings and origins.

A *discrepancy* is the mean square of the whitened residual and of what retuning costs, less one: in units of the
noise's power, 0 is noise alone. *Evidence* is −2 ln Z. The origin "bank" means: set by hand, by verdicts on cases of
the blind bank (validation/blind) while the search was made.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

BANK = "bank"


def _setting(default: Any, unit: str, meaning: str, origin: str = BANK) -> Any:
    return field(default=default, metadata={"unit": unit, "meaning": meaning, "origin": origin})


@dataclass(frozen=True)
class SearchSettings:
    """What the search tries, prunes, accepts and refuses by."""

    # ---- candidates ----
    reach_sd: float = _setting(5.0, "standard deviations", "by which the file's numbers may be retuned")
    probe: float = _setting(0.1, "of a usual size", "with which the signature of an axis' effect is taken")
    force_offset: float = _setting(0.1, "of the force", "by which the zero of an axis' measured force may be off")
    most_lines: int = _setting(6, "lines", "of a force that repeats along an axis")
    most_pitches: int = _setting(4, "pitches", "at which a search for a ripple of an axis begins")
    places_apart_mm: float = _setting(20.0, "mm", "from which two places count as two")
    # ---- is there a discrepancy ----
    shaped: float = _setting(3.0, "noise power", "discrepancy from which an input shaper is looked for")
    one_signal: float = _setting(0.85, "of the discrepancy", "in one signal of three or more: its sensor is at fault")
    simulation_error: float = _setting(3e-3, "of the signals", "no simulation is nearer, however quiet sensors are")
    exists: float = _setting(0.05, "noise power", "a smaller discrepancy is none; added where two are compared")
    known_noise: float = _setting(0.1, "noise power", "tolerance where repeats tell the noise", "spread of repeats")
    guessed_noise: float = _setting(3.0, "noise power", "tolerance where the noise is guessed", "spread of guesses")
    chance_sd: float = _setting(4.0, "standard deviations", "what chance alone may show", "normal, one in 30 000")
    large: float = _setting(1.0, "noise power", "discrepancy from which effects may be too strong to be linear")
    wrong_floor: float = _setting(-0.5, "noise power", "with a smaller discrepancy the noise floor is wrong")
    loud_noise: float = _setting(0.1, "of the signals, rms", "with more noise, `none` is not said")
    # ---- evidence ----
    significant: float = _setting(10.0, "−2 ln Z", "gain of a hypothesis that is worth more numbers", "Kass 1995")
    competing: float = _setting(20.0, "−2 ln Z", "a rival no further behind may be it as well", "twice Kass 1995")
    promising: float = _setting(30.0, "−2 ln Z", "score that begins a search without a discrepancy", "three times Kass")
    added_share: float = _setting(0.4, "of the discrepancy", "what an added effect removes at least")
    added_share_of_trace: float = _setting(0.8, "of the discrepancy", "the same where no more than a trace is left")
    reshaped_share: float = _setting(0.1, "of the discrepancy", "what a freer shape of an effect removes at least")
    implausible: float = _setting(
        3.0, "variance", "mean square of the file's numbers beyond which they are implausible"
    )
    trace: float = _setting(3e-3, "of the discrepancy", "what an effect's formula may leave: no shape is more exact")
    little: float = _setting(0.02, "of the discrepancy", "an effect that leaves less is begun at the right place")
    # ---- breadth of the search ----
    most_effects: int = _setting(3, "effects", "that are named at once")
    by_score: int = _setting(6, "candidates", "fitted by the score test's prediction, and pursued a little further")
    by_simulation: int = _setting(3, "candidates", "fitted by what they do in simulation; added; fitted fully")
    swaps: int = _setting(2, "candidates", "tried in place of each effect; shapes of each that are scored in full")
    paired: int = _setting(5, "candidates", "whose pairs are tried where one effect explains poorly")
    poor: float = _setting(0.15, "of the discrepancy", "one effect that leaves more explains poorly")
    alike: float = _setting(0.5, "cos²", "of two signatures from which one effect may stand in for the other")
    # ---- pruning: times the best discrepancy beyond which a hypothesis is not taken further ----
    keep_initial: float = _setting(30.0, "ratio", "after initial fits, in coarse simulations")
    keep_added: float = _setting(10.0, "ratio", "after an effect was added, in coarse simulations")
    keep_fitted: float = _setting(5.0, "ratio", "after full fits")
    keep_straight: float = _setting(2.0, "ratio", "beside one that needs implausible numbers")
    # ---- ladder of fidelity ----
    visible_sd: float = _setting(3.0, "standard deviations", "score of a usual size that recordings could show")
    subset_share: float = _setting(0.5, "of |r|²", "that the motions of a low-fidelity subset hold")
    subset_worth: float = _setting(0.7, "of the motions", "a subset of more saves too little", "time")
    excerpt_information: float = _setting(3000.0, "χ²", "of a discrepancy in an excerpt that decides as all data do")
    excerpt_s: float = _setting(1.2, "s", "of each motion in an excerpt")
    excerpt_lead_s: float = _setting(0.4, "s", "simulated before, from a gentle start: vibrations decay", "belts")
    many_motions: int = _setting(8, "motions", "from which an excerpt holds only some, each recorded once", "time")
    excerpt_motions: int = _setting(6, "motions", "that it then holds", "time")
    coarse_error: float = _setting(1e-3, "of |r|²", "by which coarse simulations may be off")
    quick_gain: float = _setting(
        1e-2, "of the cost", "that another step must promise while hypotheses are ranked", "time"
    )
    renewed: int = _setting(4, "parameters", "up to which all derivatives are renewed at every step", "time")
    horizon_s: float = _setting(0.25, "s", "of each motion that a warm start fits first", "Ribeiro 2020; bank")
    horizon_growth: float = _setting(1.4, "ratio", "by which that horizon grows from fit to fit", "Ribeiro 2020; bank")
    horizon_shown: float = _setting(0.15, "of |r|² a row", "of the whole motions, that a first horizon must show")
    horizon_left: float = _setting(0.1, "of the discrepancy", "that a warm start may leave to be followed")
    # ---- acceptance ----
    left: float = _setting(0.15, "of the discrepancy", "that may be left, in all and where it was left out of the fit")
    left_near_noise: float = _setting(
        0.3, "of the discrepancy", "the same where the error is within 1.2 times the noise"
    )
    near_noise: float = _setting(0.44, "noise power", "of an error of 1.2 times the noise")
    minor_place: float = _setting(
        0.05, "of all that is unexplained", "a place with less proves nothing against an effect"
    )
    worse_place: float = _setting(1.5, "ratio", "by which no place left out may become worse")
    dominant: float = _setting(0.6, "of the discrepancy", "what one effect explains elsewhere, to be named with a rest")
    ahead: float = _setting(1.5, "ratio", "by which any other family, and retuning alone, leave more there")
    signature: float = _setting(0.5, "of what is left there", "that still looks like the effect")
    mostly: float = _setting(0.9, "of the discrepancy", "an explanation that failed a test is worth reporting")
    differs: float = _setting(0.8, "of what is left in a motion", "that a size refitted to it leaves at most", "EMPS")
    differs_from: float = _setting(0.02, "of the size", "from which it is told that it differs there", "EMPS")
    differs_by: float = _setting(0.1, "of the size", "by which it may differ there, as the same effect", "EMPS")
    confounded: float = _setting(0.8, "cos²", "of projected signatures from which effects are confounded")
    block_hz: float = _setting(5.0, "Hz", "over which the residual of a wrong shape keeps its sign, for intervals")
    few_motions: int = _setting(3, "motions", "that do not tell how far a value scatters", "Student's t")
    separates_rms: float = _setting(0.3, "of the noise, rms", "between predictions, that tells them apart", "1000 rows")
    loosened: float = _setting(5.0, "ratio", "of uncertainties, in the fit of the file's numbers that may all be wrong")
    as_loose: float = _setting(1.5, "ratio", "of what the effects leave: such a fit explains as much")
    # ---- work ----
    budget_steps: float = _setting(
        2.4e8, "integration steps", "after which nothing more is tried, of a printer", "90 s of CPU, 2026"
    )
    restart_steps: float = _setting(4e7, "integration steps", "that a warm start may take beyond", "15 s of CPU, 2026")


SETTINGS = SearchSettings()
