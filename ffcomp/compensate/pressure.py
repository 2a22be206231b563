"""What could not be done for the hot end's pressure, in a sentence."""

from __future__ import annotations

import re

from ffcomp.compensate.solve import SolvedSection
from gcode.program import Program
from models.pressure import Pressure

WHOLE = 0.95  # of the lead: less is worth a sentence
_ADVANCE = re.compile(rb"^\s*(?:SET_PRESSURE_ADVANCE\b.*?\bADVANCE=|M900\b.*?\bK|M572\b.*?\bS)([\d.]+)", re.IGNORECASE)


class PressureCheck:
    """Looks at how much of the lead was written, section by section."""

    def __init__(self, pressure: Pressure, program: Program) -> None:
        """Take the model, and the program that is written."""
        self.pressure, self.program = pressure, program
        self.short: list[tuple[float, int]] = []  # share and line

    def add(self, solved: SolvedSection) -> None:
        """Look at a section."""
        share = solved.reference.lead.share
        if share < WHOLE:
            move = int(self.program.moves.line[solved.section.first])
            self.short.append((share, self.program.first_line + move + 1))

    def warnings(self) -> tuple[str, ...]:
        """Say where the extruder cannot follow, and where the file sets the firmware's own pressure advance."""
        return (*self._short(), *self._others())

    def _short(self) -> tuple[str, ...]:
        if not self.short:
            return ()
        share, line = min(self.short)
        where = "one section" if len(self.short) == 1 else f"{len(self.short)} sections"
        jump = self.pressure.corner_velocity_mm_per_s
        return (
            f"line {line}: {100 * share:.0f} % of what the hot end's pressure asks for is written here, for the "
            f"extruder's speed may jump by {jump:g} mm/s only ({where}); let the firmware's own pressure advance do "
            "most of it (extruder.firmware_advance_s), or raise extruder.corner_velocity_mm_per_s as in the firmware.",
        )

    def _others(self) -> tuple[str, ...]:
        known = self.pressure.firmware_advance_s
        for number, line in enumerate(self.program.lines):
            found = _ADVANCE.match(line)
            if found and abs(float(found[1]) - known) > 1e-6:
                return (
                    f"line {self.program.first_line + number + 1}: the file sets the firmware's pressure advance to "
                    f"{float(found[1]):g} s, and extruder.firmware_advance_s of the machine file is {known:g}; they "
                    "must be the same.",
                )
        return ()
