"""The limits that Marlin needs for our segments, and how to restore them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from ffcomp.firmware.marlin_planner import extruder_steps_per_mm, marlin_settings
from ffcomp.planner.segment_timing import SegmentLimits
from gcode.program import LimitCommand
from models.kinematics.delta import DeltaKinematics
from models.machine import Machine, MarlinSettings

FLICKER_STEPS, FLICKER_S = 2.0, 0.004  # filament in a segment; E's jerk must allow this jump of speed
LONGEST_DEVIATION_MM = 0.3  # that M205 J takes


@dataclass(frozen=True, slots=True)
class MarlinLimits:
    """Commands that raise and restore the limits of the axes that may be raised."""

    machine: Machine
    raised: SegmentLimits

    @property
    def settings(self) -> MarlinSettings:
        """The planner's settings."""
        return marlin_settings(self.machine)

    @property
    def _delta(self) -> bool:
        return isinstance(self.machine.kinematics, DeltaKinematics)

    def opening(self, commands: Mapping[str, LimitCommand]) -> Iterable[LimitCommand]:
        """Return what raises the limits.

        commands : the file's own in effect
        """
        o, settings = self.raised, self.settings
        acceleration, corner = o.acceleration_mm_per_s2, o.square_corner_velocity_mm_per_s
        # E's jerk, so that steps that come and go slow nothing: little enough for a retraction
        flicker = round(FLICKER_STEPS / (FLICKER_S * extruder_steps_per_mm(self.machine)), 2)
        yield from self._lines(
            self._filament(commands),
            acceleration=(acceleration,) * 4,
            speed=(o.velocity_mm_per_s,) * 4,
            printing={"P": acceleration, "T": acceleration},
            jerk=(corner, corner, corner, max(settings.jerk_mm_per_s[3], flicker)),
            deviation_mm=LONGEST_DEVIATION_MM,
            shortest_s=0.0,
        )

    def closing(self, commands: Mapping[str, LimitCommand]) -> Iterable[LimitCommand]:
        """Return what restores the limits that `opening` raises, the file's own last."""
        s = self.settings
        yield from self._lines(
            self._filament({}),
            acceleration=s.acceleration_mm_per_s2,
            speed=s.speed_mm_per_s,
            printing={"P": s.printing_acceleration_mm_per_s2, "T": s.travel_acceleration_mm_per_s2},
            jerk=s.jerk_mm_per_s,
            deviation_mm=s.junction_deviation_mm or LONGEST_DEVIATION_MM,
            shortest_s=s.shortest_segment_s,
        )
        yield from commands.values()

    def _filament(self, commands: Mapping[str, LimitCommand]) -> set[str]:
        """Return the commands whose limits of the filament are known, and so can be restored."""
        known = {code for code, command in commands.items() if "E" in command.words}
        keys = {"M201": "acceleration_mm_per_s2", "M205": "jerk_mm_per_s"}
        return known | {command for command, key in keys.items() if key in self.settings.stated}

    def _lines(
        self,
        filament: set[str],
        *,
        acceleration: tuple[float, ...],
        speed: tuple[float, ...],
        printing: Mapping[str, float],
        jerk: tuple[float, ...],
        deviation_mm: float,
        shortest_s: float,
    ) -> Iterable[LimitCommand]:
        """Return the limits of the axes that may be raised; filament : commands that also set those of E."""
        raised, settings = self.raised.raised_axes, self.settings

        def words(axes: str, values: tuple[float, ...], command: str = "") -> dict[str, float]:
            axes += "E" if command in filament else ""
            return {axis: values["XYZE".index(axis)] for axis in axes}

        corner = words(raised if self._delta else raised.replace("Z", ""), jerk, "M205")
        if "junction_deviation_mm" in settings.stated:
            corner = {"J": deviation_mm}
        if settings.slowdown and not self._delta:
            corner["B"] = 1e6 * shortest_s
        yield LimitCommand("M201", words(raised, acceleration, "M201"))
        yield LimitCommand("M203", words(raised, speed))
        yield LimitCommand("M204", printing)
        yield LimitCommand("M205", corner)
