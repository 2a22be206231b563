"""Choose the firmware that a print is read and written for, and say why."""

from __future__ import annotations

from dataclasses import dataclass

from gcode.dialects import FLAVORS, FlavorSign
from gcode.errors import UnsupportedGcode

REMEDY = "--flavor NAME, or flavor in [firmware] of the machine file, says it"


@dataclass(frozen=True, slots=True)
class FlavorChoice:
    """A firmware, and why it was chosen."""

    flavor: str
    reason: str  # a sentence for people
    warning: str = ""  # where the print itself speaks of another


def choose_flavor(asked: str, stated: str, sign: FlavorSign, path: str = "") -> FlavorChoice:
    """Choose a firmware: the caller's word goes before the machine file's, and that before what the print shows.

    Parameters
    ----------
    asked : str
        What the caller asks for; empty: nothing.
    stated : str
        What the machine file states; empty: nothing.
    sign : FlavorSign
        What the print shows.
    path : str
        The print's name, for errors.

    Raises
    ------
    UnsupportedGcode
        If what is asked for is no flavor.
    """
    flavor = asked or stated
    if not flavor:
        return FlavorChoice(sign.flavor, _shown(sign))
    if flavor not in FLAVORS:
        raise UnsupportedGcode(f"The flavor {flavor!r} is none of {', '.join(sorted(FLAVORS))}.", path=path)
    by = "it was asked for" if asked else "the machine file says"
    reason = f"Firmware: {flavor}, as {by}."
    if not sign.text or sign.flavor == flavor:
        return FlavorChoice(flavor, reason)
    rule = f"The print is made for {sign.flavor} ({sign.text}), but compensated for {flavor}, as {by}"
    remedy = f"If the printer runs {sign.flavor}, many segments will come late: --flavor {sign.flavor}"
    return FlavorChoice(flavor, reason, f"{rule}. {remedy}.")


def _shown(sign: FlavorSign) -> str:
    because = f"the print holds {sign.text}" if sign.text else "nothing in the print names another"
    doubt = "" if sign.certain else f" If that is wrong: {REMEDY}."
    return f"Firmware: {sign.flavor}, because {because}.{doubt}"
