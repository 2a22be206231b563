"""Tables of any printer, whatever its kinematics: limits, steps, extruder, firmware, macros."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Annotated, Literal, TypeVar

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from models.machine import MarlinSettings, MotionLimits, RepRapFirmwareSettings, Steps
from models.schema.table import FOUR, THREE, TWO, Place, Table, refuse

DEFAULT_LIMITS = MotionLimits(velocity_mm_per_s=0, acceleration_mm_per_s2=0)  # these two have no default


class LimitsTable(Table):
    """`[limits]`."""

    velocity_mm_per_s: float = Field(ge=1, le=1e4)
    acceleration_mm_per_s2: float = Field(ge=10, le=1e6)
    square_corner_velocity_mm_per_s: float = Field(DEFAULT_LIMITS.square_corner_velocity_mm_per_s, ge=0, le=1000)
    carriage_velocity_mm_per_s: float = Field(DEFAULT_LIMITS.carriage_velocity_mm_per_s, ge=1, le=1e4)
    carriage_acceleration_mm_per_s2: float = Field(DEFAULT_LIMITS.carriage_acceleration_mm_per_s2, ge=10, le=1e7)
    z_velocity_mm_per_s: float | None = Field(None, ge=0.1, le=1e4)
    z_acceleration_mm_per_s2: float | None = Field(None, ge=1, le=1e6)
    carriage_travel_mm: Annotated[list[Place], TWO] | None = None
    step_rate_hz: float | None = Field(None, ge=100, le=1e8)

    @model_validator(mode="after")
    def _possible(self) -> LimitsTable:
        travel = self.carriage_travel_mm
        if travel is not None and not travel[0] < travel[1]:
            refuse([f"limits.carriage_travel_mm = {travel} must be the lower place first, then the higher one (mm)."])
        return self

    def limits(self) -> MotionLimits:
        """Return the limits."""
        return MotionLimits(**self.record())


Microsteps = Annotated[float, Field(ge=1, le=1e5)]
FullSteps = Annotated[float, Field(ge=0.1, le=1000)]


class StepsTable(Table):
    """`[steps]`."""

    steps_per_mm: Microsteps | Annotated[list[Microsteps], THREE] = 80.0
    full_steps_per_mm: FullSteps | Annotated[list[FullSteps], THREE] = 5.0
    extruder_steps_per_mm: float | None = Field(None, ge=1, le=1e5)

    @model_validator(mode="after")
    def _microsteps(self) -> StepsTable:
        whole, micro = self.full_steps_per_mm, self.steps_per_mm
        if (np.atleast_1d(whole) > np.atleast_1d(micro)).any():
            rule = f"must not exceed steps_per_mm = {_shown(micro)}: a full step holds at least one microstep."
            refuse([f"steps.full_steps_per_mm = {_shown(whole)} {rule}"])
        return self

    def steps(self) -> Steps:
        """Return the steps."""
        return Steps(**self.record(), stated=tuple(sorted(self.model_fields_set)))


Speeds = Annotated[list[Annotated[float, Field(ge=0.01, le=5000)]], FOUR]
Accelerations = Annotated[list[Annotated[float, Field(ge=1, le=1e6)]], FOUR]


_Settings = TypeVar("_Settings", MarlinSettings, RepRapFirmwareSettings)


def _stated(table: Table, settings: _Settings) -> _Settings:
    stated = table.record(exclude_none=True)
    return replace(settings, **stated, stated=tuple(stated))


class MarlinTable(Table):
    """`[firmware.marlin]`: the planner's settings from M503, and build options."""

    speed_mm_per_s: Speeds | None = None
    acceleration_mm_per_s2: Accelerations | None = None
    printing_acceleration_mm_per_s2: float | None = Field(None, ge=1, le=1e6)
    retract_acceleration_mm_per_s2: float | None = Field(None, ge=1, le=1e6)
    travel_acceleration_mm_per_s2: float | None = Field(None, ge=1, le=1e6)
    junction_deviation_mm: float | None = Field(None, ge=0.001, le=0.3)
    jerk_mm_per_s: Speeds | None = None
    lowest_speed_mm_per_s: float | None = Field(None, ge=0, le=1000)
    lowest_travel_speed_mm_per_s: float | None = Field(None, ge=0, le=1000)
    shortest_segment_s: float | None = Field(None, ge=0, le=1)
    minimum_steps_per_segment: int | None = Field(None, ge=1, le=100)
    slowdown: bool | None = None
    segments_per_second: float | None = Field(None, ge=1, le=1000)

    def settings(self, limits: MotionLimits, towers: bool) -> MarlinSettings:
        """Return the settings; speeds, accelerations and jerk missing from the file come from its `[limits]`.

        towers : of a delta
        """
        return _stated(self, MarlinSettings.within(limits, towers))


class RepRapFirmwareTable(Table):
    """`[firmware.reprapfirmware]`: the planner's settings from config.g."""

    speed_mm_per_s: Speeds | None = None
    acceleration_mm_per_s2: Accelerations | None = None
    jerk_mm_per_s: Speeds | None = None
    printing_acceleration_mm_per_s2: float | None = Field(None, ge=1, le=1e6)
    travel_acceleration_mm_per_s2: float | None = Field(None, ge=1, le=1e6)
    jerk_policy: int | None = Field(None, ge=0, le=1)
    queue_moves: int | None = Field(None, ge=2, le=1000)

    def settings(self, limits: MotionLimits, delta: bool) -> RepRapFirmwareSettings:
        """Return the settings; missing ones come from its `[limits]`."""
        return _stated(self, RepRapFirmwareSettings.within(limits, delta))


_SHAPER = re.compile(r'SET_INPUT_SHAPER(?: +\w+=[\w.-]+)+|M593(?: *[A-Z](?:"[\w+]*"|[\w.:-]*))+', re.IGNORECASE)


def _shaper_command(text: str) -> str:
    if not _SHAPER.fullmatch(text):
        raise ValueError(
            f"firmware.input_shaper: {text!r} must be a command that switches an input shaper on, such as "
            "SET_INPUT_SHAPER SHAPER_FREQ_X=55 or M593 X F40."
        )
    return text


class FirmwareTable(Table):
    """`[firmware]`: the printer's firmware and its own input shaper."""

    flavor: Literal["klipper", "marlin", "reprapfirmware"] | None = None
    version: Annotated[str, Field(pattern=r"^v?\d+(\.\d+)*$")] | None = None
    input_shaper: list[Annotated[str, AfterValidator(_shaper_command)]] | None = None
    marlin: MarlinTable | None = None
    reprapfirmware: RepRapFirmwareTable | None = None


MacroName = Annotated[str, Field(pattern=r"^@?[A-Za-z_]\w*$")]


class MacrosTable(Table):
    """`[macros]`: the printer's own macros."""

    returns: list[MacroName] | None = None


def _shown(value: float | list[float]) -> str:
    return ", ".join(f"{number:g}" for number in np.atleast_1d(value))
