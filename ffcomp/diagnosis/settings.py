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

    # ---- is there a discrepancy ----
    exists: float = _setting(0.05, "noise power", "a smaller discrepancy is none; added where two are compared")
    known_noise: float = _setting(0.1, "noise power", "tolerance where repeats give the noise", "spread of repeats")
    guessed_noise: float = _setting(3.0, "noise power", "tolerance where the noise is guessed", "spread of guesses")
    chance_sd: float = _setting(4.0, "standard deviations", "what chance alone may show", "normal, one in 30 000")
    wrong_floor: float = _setting(-0.5, "noise power", "with a smaller discrepancy the noise floor is wrong")
    loud_noise: float = _setting(0.1, "of the signals, rms", "with more noise, `none` is not said")
    # ---- evidence ----
    significant: float = _setting(10.0, "−2 ln Z", "gain of a hypothesis that is worth more numbers", "Kass 1995")
    reshaped_share: float = _setting(0.1, "of the discrepancy", "what a freer shape of an effect removes at least")
    trace: float = _setting(1e-2, "of the discrepancy", "what an effect's formula may leave: a tenth of its amplitude")
    # ---- breadth of the search ----
    most_effects: int = _setting(2, "effects", "that are named at once")
    width: int = _setting(3, "hypotheses", "of a level that are fitted fully, and expanded")
    forms: int = _setting(2, "forms", "of an effect that are fitted in place of the present one")
    near: float = _setting(5.0, "ratio", "to the best discrepancy, up to which one is reshaped and expanded")
    # ---- ladder of fidelity ----
    visible_sd: float = _setting(3.0, "standard deviations", "score of a usual size that recordings could show")
    subset_worth: float = _setting(0.7, "of the motions", "a subset of more saves too little", "time")
    excerpt_information: float = _setting(3000.0, "χ²", "of a discrepancy in an excerpt that decides as all data do")
    coarse_error: float = _setting(1e-3, "of |r|²", "error of coarse simulations, at most")
    # ---- acceptance ----
    false_discoveries: float = _setting(0.01, "of what is named", "by chance alone, however many are looked for", "1 %")
    left: float = _setting(0.05, "of the discrepancy", "that may be left, in all and where it was left out of the fit")
    one_law: float = _setting(2e-3, "of the discrepancy", "that effects may leave of which no other law is known")
    added: float = _setting(0.6, "of the discrepancy", "what one effect more must explain")
    dominant: float = _setting(0.5, "of the discrepancy", "what an effect that leaves a rest must explain")
    ahead: float = _setting(1.5, "ratio", "by which any other family leaves more there")
    varies: float = _setting(0.1, "of what looks like an effect", "that one size of it need not explain: a third of it")


SETTINGS = SearchSettings()
