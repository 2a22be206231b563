"""One machine's inverse: the tables over its bed, made once, and every run through them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ffcomp.inverse import constrained as limited
from ffcomp.inverse import lq_preview as fast
from ffcomp.inverse import windowed_qr as exact
from ffcomp.inverse.bandwidth import effort_weight
from ffcomp.inverse.command_limits import CommandLimits, excess
from ffcomp.inverse.iterate import Playing
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.riccati import Preview
from ffcomp.inverse.robust import MARGIN, Softening
from ffcomp.inverse.settings import Settings
from ffcomp.inverse.windowed_qr import Held
from ffcomp.numerics import disk_cache as kept
from models.arrays import FloatArray
from models.effects.catalogue import design_machine, without_effects
from models.machine import Drive, Machine
from models.vibration.modal import low_frequency
from models.vibration.scheduled import Schedule, interpolate, models_along, rest_state
from models.vibration.state_space import TABLE_ARRAYS, DiscretePlant, PlantTable, plant_table

GEOMETRY = "arm_geometry"  # a delta is calibrated, not compensated: at rest the nozzle must be where it is said to be


@dataclass(frozen=True, slots=True)
class RunResult:
    vertices: FloatArray  # (n + 1, 3) mm: the nozzle command at the knots
    state: FloatArray  # (18,): of the plant at the last knot
    response: FloatArray  # (n·substeps, 3) mm: where the nozzle will be by the design model; empty if not asked for
    windows: int
    limited: int  # windows in which a limit had to be enforced
    excess: float  # how many times its limit a carriage is asked for at the worst; up to 1 is allowed
    held: tuple[Held, ...] = ()  # those windows


class Inverter:
    """Inverts one machine."""

    def __init__(self, machine: Machine, settings: Settings) -> None:
        given = machine
        machine, beyond = design_machine(given)
        self.machine, self.settings = machine, settings
        self.not_modelled = tuple(name for name in beyond if name == GEOMETRY)
        # the whole printer, where the linear model cannot hold its effects; what the firmware believes of it stays
        own = without_effects(given, GEOMETRY)
        self.printer = own if len(beyond) > len(self.not_modelled) else None
        self.delta = machine.kinematics.compiled()
        s = settings
        self._kept = kept.name_of(machine, s.segment_s, s.substeps, s.rows_per_segment, s.bandwidth_hz, s.one_model)
        self._known = kept.load(self._kept)
        self.fine = Schedule(machine, self._table("fine", s.substeps))
        self.coarse = self._table("coarse", s.rows_per_segment)
        self.effort = effort_weight(machine, settings.bandwidth_hz, settings.segment_s, settings.rows_per_segment)
        self.delay_s = steady_delay(machine)
        self.limits = CommandLimits.of(machine, settings.segment_s)

    @cached_property
    def preview(self) -> Preview:
        """The gains of the fast inverse."""
        reach = self.machine.kinematics.model_reach_mm
        preview = Preview(self._plant_at, reach, self.settings.rows_per_segment, self.effort)
        if self._known:
            preview.take_up(self._known)
        return preview

    def _table(self, name: str, steps: int) -> PlantTable:
        """The plant over the bed, for that many steps a segment."""
        if self._known:
            return PlantTable.of_arrays({each: self._known[f"{name} {each}"] for each in TABLE_ARRAYS})
        table = plant_table(self.machine, self.settings.segment_s / steps)
        return table.frozen() if self.settings.one_model else table

    def keep(self) -> None:
        """Leave what was worked out for the next time."""
        worked_out = self.settings.inverse == "fast" and len(self.preview)
        if not worked_out or (self._known and worked_out == len(self._known["node"])):
            return
        if meanwhile := kept.load(self._kept):  # another process may have been elsewhere on the bed
            self.preview.take_up(meanwhile)
        tables = {"fine": self.fine.table, "coarse": self.coarse}
        arrays = {f"{name} {each}": array for name, table in tables.items() for each, array in table.arrays().items()}
        self._known = {**arrays, **self.preview.known()}
        kept.save(self._kept, self._known)

    def _plant_at(self, xy: FloatArray) -> tuple[DiscretePlant, FloatArray]:
        """The plant for half a segment at places (g, 2) mm, and the nozzle's Jacobian there."""
        step_s = self.settings.segment_s / self.settings.rows_per_segment
        return DiscretePlant(step_s, *models_along(self.coarse, xy)), self.machine.kinematics.jacobian(xy)

    def compliance_at(self, xy: FloatArray) -> FloatArray:
        """C of G⁻¹(s) ≈ I + τ s + C s² for the carriages at places (n, 2) mm: (n, 3, 3) s²."""
        table = self.coarse
        return interpolate(self._compliance, table.x0_mm, table.pitch_mm, table.nodes, np.ascontiguousarray(xy))

    @cached_property
    def _compliance(self) -> FloatArray:
        """It at the table's nodes: Eq. 29 and Eq. 34 turned over and expanded at s = 0."""
        carriage, effector, j = self.machine.carriage, self.machine.effector, self.coarse.jacobian
        if self.machine.has_straight_axes:
            return np.tile(np.diag(low_frequency(self.machine)[1]), (len(j), 1, 1))
        if self.settings.one_model:
            j = np.broadcast_to(j[len(j) // 2], j.shape)
        k, c, b = (
            np.broadcast_to(number, 3)
            for number in (
                carriage.belt_stiffness_n_per_m,
                carriage.belt_damping_n_s_per_m,
                carriage.guide_damping_n_s_per_m,
            )
        )
        load = (self.machine.nozzle_side_mass_kg + effector.extruder_mass_kg) * np.swapaxes(j, 1, 2) @ j
        moving = (carriage.moving_mass_kg * np.eye(3) + load) / k[:, None]
        first, second = drive_lag(carriage.drive)
        return np.asarray(moving + np.diag(second + b / k * first - b * c / k**2))

    @cached_property
    def softening(self) -> Softening:
        """What is wanted of a machine that is not exactly known."""
        s = self.settings
        return Softening(self.machine, s.segment_s / s.rows_per_segment, s.bandwidth_hz, self.effort)

    def softened(self, reference: Reference) -> FloatArray:
        """What is wanted beyond the path, (rows, 3) mm, at the rows of the run's segments; or nothing."""
        if not (self.settings.robust and any(self.machine.uncertainty.values())):
            return np.empty((0, 3))
        s = self.settings
        rows = np.arange(1 - MARGIN, reference.knots * s.rows_per_segment + 1 + MARGIN, dtype=np.float64)
        t = reference.t0 + rows * s.segment_s / s.rows_per_segment
        return self.softening.of(reference.nozzle(t), reference.moving(t))

    def hold(self, state: FloatArray, nozzle: FloatArray, duration_s: float) -> FloatArray:
        """The state after the command has rested at (3,) mm for a while: what still rings, rings on."""
        s = self.settings
        intervals = round(duration_s / s.segment_s)
        if intervals > 2 * s.memory:
            return rest_state(self.machine, nozzle)
        if intervals <= 0:
            return state
        still = np.repeat(nozzle[None], intervals * s.substeps + 1, axis=0)
        return self.fine.respond(still, np.zeros_like(still), state, s.substeps)[1]

    def run(self, reference: Reference, state: FloatArray, keep_response: bool = False, hold: bool = True) -> RunResult:
        """Solve one run, from the plant's state (18,) at its first knot.

        hold : False leaves the fast inverse's answer as it is where it exceeds a limit
        """
        run, begin, held = Playing(self, reference), state, list[Held]()
        if self.settings.inverse == "exact":
            response, state, windows, held = exact.solve(run, begin)
        else:
            response, state, windows = fast.solve(run, begin, keep_response)
        worst = excess(run.vertices, self.limits)
        if hold and worst > 1.0 and self.settings.inverse == "fast":
            response, state, held = limited.hold(run, begin, keep_response)
            worst = excess(run.vertices, self.limits)
        return RunResult(run.vertices, state, response, windows, len(held), worst, tuple(held))


def drive_lag(drive: Drive | None) -> tuple[float, float]:
    """p and q of the drive filter's inverse, 1 + p s + q s² + …; s and s²."""
    if drive is None:
        return 0.0, 0.0
    d0, d1, d2 = drive.d0_per_s2, drive.d1_per_s, drive.d2_per_s
    return (d2 - d1) / d0, 1.0 / d0 - (d2 - d1) * d1 / d0**2


def steady_delay(machine: Machine) -> float:
    """τ of G(s) ≈ I − τ s: how far the machine lags behind a steady motion, s, on average of its towers."""
    carriage = machine.carriage
    if machine.has_straight_axes:
        return float(np.mean(low_frequency(machine)[0]))
    lag = carriage.guide_damping_n_s_per_m / carriage.belt_stiffness_n_per_m
    return float(np.mean(lag)) + drive_lag(carriage.drive)[0]
