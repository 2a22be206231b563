"""How the inversion is discretised, and how much command it may spend: the bandwidth at the knee.

Up to its bandwidth the inverse makes the nozzle follow; beyond it, it lets go. More of it buys accuracy with command
acceleration, cheaply while the machine's modes lie below, dearly when they are all followed. Both are worked out for a
square with sharp corners at seven places of the bed, line by line of frequency:

    error  e = (I − G K) x*         command acceleration  D² J⁻¹ K x* S⁻²         K = (GᴴG + ρ |D²|² I)⁻¹ Gᴴ

The knee is where error times peak^1.5 is least: from there on a percent more of peak acceleration takes less than one
and a half percent of the error away. To the error belongs a floor, what other things leave anyway: without it a step
would always pay. On straight axes, whose model is the same everywhere, little else is left, but of a robust inverse
the unknown part: following them as far would need up to three times the acceleration for the same error.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ffcomp.planner.limits import EXTRUSION_RATIO, planner_limits
from ffcomp.planner.segment_merging import MergeLimits
from ffcomp.planner.segment_timing import SegmentLimits
from ffcomp.planner.trajectory import Trajectory
from models.arrays import FloatArray
from models.effects.catalogue import design_machine
from models.machine import Machine

LOWEST_HZ, HIGHEST, STEP = 60.0, 0.46, 1.06  # Hz, of the segments' rate, from one bandwidth to the next
FLOOR_UM = 1.0  # what other things leave anyway: the path's own facets, the segments, the motors' steps,
STRAIGHT_FLOOR_UM = 0.3  # and on straight axes
KNOTS = 512
SIDE_MM, SPEED_MM_PER_S, ACCELERATION_MM_PER_S2 = 8.0, 150.0, 3000.0  # as prints are made
REACH = 0.6  # of the print radius: the six places around the middle


@dataclass(frozen=True, slots=True)
class EffortCurve:
    """Accuracy against effort, from the lowest bandwidth to the highest the segments can carry."""

    bandwidth_hz: FloatArray  # (k,)
    error_um: FloatArray  # (k,) rms over places
    peak_mm_per_s2: FloatArray  # (k,) of the carriages' command, over places

    def knee_hz(self, floor_um: float = 0.0) -> float:
        """Return the bandwidth at the knee, Hz, where so much more is left anyway."""
        return float(self.bandwidth_hz[np.argmin(np.hypot(self.error_um, floor_um) * self.peak_mm_per_s2**1.5)])


def control_weight_at(machine: Machine, bandwidth_hz: float, segment_s: float, rows: int = 1) -> float:
    """Return the ρ that balances accuracy and effort at the bandwidth: ρ |D²(ω)|² = mean |G(ω)|² at the centre."""
    g = machine.vibration.frequency_response(np.zeros(2), np.array([bandwidth_hz]), "nozzle", "nozzle")[0]
    hat = np.sinc(bandwidth_hz * segment_s) ** 2  # the hats' own spectrum
    second_difference = (2 * np.sin(np.pi * bandwidth_hz * segment_s)) ** 2
    gain2 = float(np.trace((g.conj().T @ g).real)) / 3 * hat**2
    return gain2 * rows / second_difference**2


def effort_curve(machine: Machine, segment_s: float) -> EffortCurve:
    """Compute the curve of one machine, for segments of `segment_s` seconds."""
    f: FloatArray = np.fft.rfftfreq(KNOTS, segment_s).astype(np.float64)
    wanted = np.fft.rfft(_square(machine, segment_s), axis=0)
    bend = -((2 * np.sin(np.pi * f * segment_s)) ** 2)
    around = REACH * machine.kinematics.model_reach_mm * np.exp(1j * np.pi / 3 * np.arange(6))
    places = np.array([[0.0, 0.0], *zip(around.real.tolist(), around.imag.tolist(), strict=True)])
    frfs = (
        np.array([machine.vibration.frequency_response(xy, f, "nozzle", "nozzle") for xy in places])
        * (np.sinc(f * segment_s) ** 2)[:, None, None]
    )
    to_carriages = np.linalg.inv(machine.kinematics.jacobian(places))
    floor_um = FLOOR_UM if machine.kinematics.model_reach_mm > 0.0 else STRAIGHT_FLOOR_UM
    count = int(np.log(HIGHEST / segment_s / LOWEST_HZ) / np.log(STEP)) + 1
    bandwidths = np.geomspace(LOWEST_HZ, HIGHEST / segment_s, max(count, 2))

    errors, peaks = [], []
    for bandwidth in bandwidths.tolist():
        weight = control_weight_at(machine, bandwidth, segment_s) * bend**2
        adjoint = np.conj(np.swapaxes(frfs, -1, -2))
        inverse = np.linalg.solve(adjoint @ frfs + weight[:, None, None] * np.eye(3), adjoint)
        command = np.einsum("pfij,fj->pfi", inverse, wanted)
        error = np.fft.irfft(wanted - np.einsum("pfij,pfj->pfi", frfs, command), axis=1)
        errors.append(float(np.hypot(1e3 * np.sqrt(np.mean(np.sum(error**2, axis=2))), floor_um)))
        acceleration = np.fft.irfft(bend[:, None] * command, axis=1) / segment_s**2
        peaks.append(float(np.abs(np.einsum("pij,ptj->pti", to_carriages, acceleration)).max()))
    return EffortCurve(bandwidths, np.array(errors), np.array(peaks))


def _square(machine: Machine, segment_s: float) -> FloatArray:
    """Return the nozzle's path round a square at the firmware's corner speed, (KNOTS, 3) mm at the knots."""
    a = min(machine.limits.acceleration_mm_per_s2, ACCELERATION_MM_PER_S2)
    corner = machine.limits.square_corner_velocity_mm_per_s
    speed = min(SPEED_MM_PER_S, machine.limits.velocity_mm_per_s, float(np.sqrt(corner**2 + 0.8 * a * SIDE_MM)))
    ramp = (speed - corner) / a
    cruise = (SIDE_MM - (corner + speed) * ramp) / speed
    side = 2 * ramp + cruise
    corners = SIDE_MM * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    origin, direction = np.zeros((4, 4)), np.zeros((4, 4))
    origin[:, :2], direction[:, :2] = corners, np.diff(corners, axis=0, append=corners[:1]) / SIDE_MM
    begin_t = 0.1 + side * np.arange(4, dtype=np.float64)
    ramps, cruises, corner_v, cruise_v, acceleration = (np.full(4, each) for each in (ramp, cruise, corner, speed, a))
    plan = Trajectory(begin_t, ramps, cruises, ramps, corner_v, cruise_v, corner_v, acceleration, origin, direction)
    return plan.position(segment_s * np.arange(KNOTS, dtype=np.float64))[:, :3]


SEGMENTS_PER_SECOND = 250.0
LIFT_LAG_MM = 0.02  # of the nozzle in a lift, not compensated
CUT = 256  # knots: no segment is joined across a knot whose number is a multiple of it


@dataclass(frozen=True, slots=True)
class SlowingSettings:
    """What happens where limits do not let the nozzle follow."""

    slow: bool = True  # the plan becomes slower
    tolerance_um: float = 25.0  # path error that an active limit may cause before that
    strict: bool = False  # an error instead


@dataclass(frozen=True, slots=True)
class WriterSettings:
    """Segments of the written file."""

    merge_um: float = 1.0  # segments are joined while they miss the command by less than this across its direction,
    merge_along_um: float = 3.0  # than this along it: the nozzle is early or late, not off its path,
    merge_filament_um: float = 0.2  # and than this in filament;
    longest_s: float = 0.25  # and no longer than this
    embed: bool = True  # the file holds its original, as comments


@dataclass(frozen=True, slots=True)
class Settings:
    """How the inverse is discretised and solved."""

    segment_s: float = 0.004  # S, one G1
    rows_per_segment: int = 2  # where the error is weighed
    substeps: int = 4  # of the simulation, per segment
    bandwidth_hz: float = 100.0  # where accuracy is given up for a gentler command,
    robust_share: float = 1.0  # and the share of it that robust inversion takes
    lead_s: float = 0.008  # how long before the path's start the command may begin, at most
    tail_s: float = 0.004  # how long after the path's end the command comes to rest, at most
    compliance_s2: tuple[float, float, float] = (1.0, 1.0, 1.0)  # nozzle's lag per acceleration along X Y Z: mm s²/mm
    robust: bool = False  # the robust reference instead of the path
    memory: int = 60  # segments after which the plant has forgotten (1 % is left after 240 ms)
    one_model: bool = False  # that of the bed's middle everywhere
    slowing: SlowingSettings = SlowingSettings()
    writer: WriterSettings = WriterSettings()
    output: SegmentLimits = field(default_factory=SegmentLimits)

    @property
    def inverse_hz(self) -> float:
        """The bandwidth of the inverse, plain or robust."""
        return self.robust_share * self.bandwidth_hz if self.robust else self.bandwidth_hz

    @property
    def joins_lifts(self) -> bool:
        """Whether the nozzle follows a lift well enough to write it as planned, in one segment."""
        return self.compliance_s2[2] * self.output.z_acceleration_mm_per_s2 <= LIFT_LAG_MM

    @property
    def merging(self) -> MergeLimits:
        """The limits of a written segment."""
        writer = self.writer
        return MergeLimits(
            1e-3 * writer.merge_um,
            1e-3 * writer.merge_along_um,
            1e-3 * writer.merge_filament_um,
            writer.longest_s / self.segment_s,
        )


def settings_for(machine: Machine, segments_per_second: float = SEGMENTS_PER_SECOND) -> Settings:
    """Choose a machine's settings: its bandwidth at the knee, and from its own limits what no G-code file can raise."""
    limits = planner_limits(machine)
    output = SegmentLimits(
        z_acceleration_mm_per_s2=limits.z_acceleration_mm_per_s2 or limits.acceleration_mm_per_s2,
        raised_axes=machine.kinematics.raisable_axes,
        retract_acceleration_mm_per_s2=limits.acceleration_mm_per_s2 * EXTRUSION_RATIO,
    )
    segment_s = 1.0 / segments_per_second
    design = design_machine(machine)[0]
    curve = effort_curve(design, segment_s)
    coupled = design.kinematics.model_reach_mm > 0.0
    return Settings(
        output=output,
        segment_s=segment_s,
        bandwidth_hz=curve.knee_hz(),
        robust_share=1.0 if coupled else curve.knee_hz(FLOOR_UM) / curve.knee_hz(),
        compliance_s2=nozzle_compliance(design),
    )


def nozzle_compliance(machine: Machine) -> tuple[float, float, float]:
    """Return by how much the nozzle lags at most per acceleration along X, Y and Z, s²."""
    positions = np.stack(list(machine.kinematics.sample_positions.values()))
    jacobian = machine.vibration.jacobian(positions)
    lag = jacobian @ machine.vibration.low_frequency(positions)[1] @ np.linalg.inv(jacobian)
    x, y, z = np.linalg.norm(lag, axis=1).max(axis=0).tolist()
    return x, y, z
