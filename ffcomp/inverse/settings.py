"""How the inversion is discretised and how much command it may spend."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ffcomp.inverse.bandwidth import effort_curve
from ffcomp.inverse.solver_names import Backend
from ffcomp.planner.limits import planner_limits
from ffcomp.planner.segment_merging import MergeLimits
from ffcomp.planner.segment_timing import SegmentLimits
from models.effects.catalogue import design_machine
from models.machine import Machine
from models.pressure import Pressure

SEGMENTS_PER_SECOND = 250.0
LIFT_LAG_MM = 0.02  # of the nozzle in a lift, that is left as it is
CUT = 256  # knots: no segment is joined across a knot whose number is a multiple of it


@dataclass(frozen=True, slots=True)
class Settings:
    """How the inverse is discretised, solved and limited."""

    segment_s: float = 0.004  # S, one G1
    rows_per_segment: int = 2  # where the error is weighed
    substeps: int = 4  # of the simulation, per segment
    commit: int = 64  # segments kept of each window of the exact inverse
    preview: int = 24  # segments looked ahead there, thrown away
    bandwidth_hz: float = 100.0  # where accuracy is given up for a gentler command
    lead_s: float = 0.008  # how long before the path's start the command may begin, at most
    tail_s: float = 0.004  # how long after the path's end the command comes to rest, at most
    compliance_s2: tuple[float, float, float] = (1.0, 1.0, 1.0)  # nozzle's lag per acceleration along X Y Z: mm s²/mm
    corrections: int = 1  # of the exact inverse, by the segments as they are executed
    inverse: Literal["fast", "exact"] = "fast"
    robust: bool = False  # the robust reference instead of the path,
    robust_quickly: bool = False  # with less work, for a search
    memory: int = 60  # segments after which the plant has forgotten (1 % is left after 240 ms)
    time_scaling: bool = True  # where limits do not let the nozzle follow, the plan becomes slower
    tolerance_um: float = 25.0  # by which an active limit may take the nozzle off its path before that
    strict: bool = False  # an error instead
    s_curve: bool = False  # the plan's ramps with limited jerk
    solver: Backend = "osqp"  # of the quadratic programmes where a limit binds
    one_model: bool = False  # that of the bed's middle everywhere
    merge_um: float = 1.0  # segments are joined while they miss the command by less than this across its direction,
    merge_along_um: float = 3.0  # than this along it: the nozzle is early or late, not beside its path,
    merge_filament_um: float = 0.2  # and than this in filament;
    longest_merged_s: float = 0.25  # and no longer than this
    shortest_um: float = 10.6  # no segment is shorter than this, as rounded numbers may take 1 µm of it,
    shortest_s: float = 1e-3  # or than this
    embed: bool = True  # the file holds its original, as comments
    pressure: Pressure | None = None  # of the hot end, which the filament allows for; None: it follows the plan
    output: SegmentLimits = field(default_factory=SegmentLimits)

    @property
    def joins_lifts(self) -> bool:
        """Whether the nozzle follows a lift so well that it is written as it was planned, in one segment."""
        return self.compliance_s2[2] * self.output.z_acceleration_mm_per_s2 <= LIFT_LAG_MM

    @property
    def merging(self) -> MergeLimits:
        """What a segment may be."""
        return MergeLimits(
            1e-3 * self.merge_um,
            1e-3 * self.merge_along_um,
            1e-3 * self.merge_filament_um,
            self.longest_merged_s / self.segment_s,
            self.shortest_knots,
            1e-3 * self.shortest_um,
        )

    @property
    def shortest_knots(self) -> float:
        """The shortest segment that a line of the file may ask for, in knots; never more than one."""
        return min(self.shortest_s / self.segment_s, 1.0)


def settings_for(machine: Machine, segments_per_second: float = SEGMENTS_PER_SECOND) -> Settings:
    """Choose a machine's settings: its bandwidth at the knee, and from its own limits what no G-code file can raise."""
    limits = planner_limits(machine)
    output = SegmentLimits(
        z_acceleration_mm_per_s2=limits.z_acceleration_mm_per_s2 or limits.acceleration_mm_per_s2,
        raised_axes=machine.kinematics.raisable_axes,
        instantaneous_corner_velocity_mm_per_s=limits.instantaneous_corner_velocity_mm_per_s,
        retract_acceleration_mm_per_s2=limits.acceleration_mm_per_s2 * limits.extrusion_ratio,
    )
    segment_s = 1.0 / segments_per_second
    design = design_machine(machine)[0]
    bandwidth = effort_curve(design, segment_s).knee_hz
    return Settings(
        output=output,
        segment_s=segment_s,
        bandwidth_hz=bandwidth,
        compliance_s2=_nozzle_compliance(design),
        pressure=machine.pressure,
    )


def _nozzle_compliance(machine: Machine) -> tuple[float, float, float]:
    """Return by how much the nozzle lags at most per acceleration along X, Y and Z, s²."""
    positions = np.stack(list(machine.kinematics.sample_positions.values()))
    jacobian = machine.vibration.jacobian(positions)
    lag = jacobian @ machine.vibration.low_frequency(positions)[1] @ np.linalg.inv(jacobian)
    x, y, z = np.linalg.norm(lag, axis=1).max(axis=0).tolist()
    return x, y, z
