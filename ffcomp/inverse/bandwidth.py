"""How much command the accuracy costs: the bandwidth of a machine's inverse, at the knee.

Up to its bandwidth the inverse makes the nozzle follow; beyond it, it lets go. More of it buys accuracy with command
acceleration, cheaply while the machine's modes lie below, dearly when they are all followed. Both are worked out for a
square with sharp corners at seven places of the bed, line by line of frequency:

    error  e = (I − G K) x*         command acceleration  D² J⁻¹ K x* S⁻²         K = (GᴴG + ρ |D²|² I)⁻¹ Gᴴ

The knee is where error times peak^1.5 is least: from there on a percent more of peak acceleration takes less than one
and a half percent of the error away. To the error belongs a floor, what other things leave anyway: without it a step
would always pay.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ffcomp.planner.trajectory import Trajectory
from models.arrays import FloatArray
from models.machine import Machine

LOWEST_HZ, HIGHEST, STEP = 60.0, 0.46, 1.06  # Hz, of the segments' rate, from one bandwidth to the next
FLOOR_UM = 1.0  # what other things leave anyway: the path's own facets, the segments, the motors' steps
KNOTS = 512
SIDE_MM, SPEED_MM_PER_S, ACCELERATION_MM_PER_S2 = 8.0, 150.0, 3000.0  # as prints are made
REACH = 0.6  # of the print radius, for the six places around the middle


@dataclass(frozen=True, slots=True)
class EffortCurve:
    """Accuracy against effort, from the lowest bandwidth to the highest the segments can carry."""

    bandwidth_hz: FloatArray  # (k,)
    error_um: FloatArray  # (k,) rms over places
    peak_mm_per_s2: FloatArray  # (k,) of the carriages' command, over places
    plan_mm_per_s2: float  # what the plan itself asks for

    @property
    def knee(self) -> int:
        """The index of the knee."""
        return int(np.argmin(self.error_um * self.peak_mm_per_s2**1.5))

    @property
    def knee_hz(self) -> float:
        """The bandwidth at the knee, Hz."""
        return float(self.bandwidth_hz[self.knee])


def effort_weight(machine: Machine, bandwidth_hz: float, segment_s: float, rows: int = 1) -> float:
    """Return ρ for which accuracy and effort weigh alike at the bandwidth: ρ |D²(ω)|² = mean |G(ω)|² at the centre."""
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
    count = int(np.log(HIGHEST / segment_s / LOWEST_HZ) / np.log(STEP)) + 1
    bandwidths = np.geomspace(LOWEST_HZ, HIGHEST / segment_s, max(count, 2))

    def acceleration(spectrum: NDArray[np.complex128]) -> float:
        """Return the peak of the carriages' acceleration under nozzle commands (places, lines, 3)."""
        second = np.fft.irfft(bend[:, None] * spectrum, axis=1) / segment_s**2
        return float(np.abs(np.einsum("pij,ptj->pti", to_carriages, second)).max())

    errors, peaks = [], []
    for bandwidth in bandwidths.tolist():
        weight = effort_weight(machine, bandwidth, segment_s) * bend**2
        adjoint = np.conj(np.swapaxes(frfs, -1, -2))
        inverse = np.linalg.solve(adjoint @ frfs + weight[:, None, None] * np.eye(3), adjoint)
        command = np.einsum("pfij,fj->pfi", inverse, wanted)
        error = np.fft.irfft(wanted - np.einsum("pfij,pfj->pfi", frfs, command), axis=1)
        errors.append(float(np.hypot(1e3 * np.sqrt(np.mean(np.sum(error**2, axis=2))), FLOOR_UM)))
        peaks.append(acceleration(command))
    plan = acceleration(np.broadcast_to(wanted, (len(places), *wanted.shape)))
    return EffortCurve(bandwidths, np.array(errors), np.array(peaks), plan)


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
