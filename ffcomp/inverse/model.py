"""One machine's inverse: the tables over its bed, made once, and every run through them."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ffcomp.inverse.bandwidth import effort_weight
from ffcomp.inverse.command_limits import CommandLimits
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.riccati import PreviewGains
from ffcomp.inverse.robust import MARGIN, RobustReference
from ffcomp.inverse.settings import Settings
from ffcomp.numerics import disk_cache as kept
from models.arrays import FloatArray
from models.effects.catalogue import design_machine, without_effects
from models.machine import Drive, Machine
from models.vibration.modal import low_frequency
from models.vibration.scheduled import Schedule, interpolate, models_along, rest_state
from models.vibration.state_space import TABLE_ARRAYS, DiscretePlant, PlantTable, plant_table

GEOMETRY = "arm_geometry"  # a delta is calibrated, not compensated: at rest the nozzle must be where it is said to be


class InverseModel:
    """Inverts one machine."""

    def __init__(self, machine: Machine, settings: Settings) -> None:
        given = machine
        machine, beyond = design_machine(given)
        self.machine, self.settings = machine, settings
        self.not_modelled = tuple(name for name in beyond if name == GEOMETRY)
        # the whole printer, where the linear model cannot hold its effects; what the firmware believes of it stays
        own = without_effects(given, GEOMETRY)
        self.printer = own if len(beyond) > len(self.not_modelled) else None
        self.kinematics = machine.kinematics.compiled()
        s = settings
        self._kept = kept.name_of(machine, s.segment_s, s.substeps, s.rows_per_segment, s.bandwidth_hz, s.one_model)
        self._known = kept.load(self._kept)
        self.plant = Schedule(machine, self._table("fine", s.substeps))
        self.row_table = self._table("coarse", s.rows_per_segment)
        self.effort = effort_weight(machine, settings.bandwidth_hz, settings.segment_s, settings.rows_per_segment)
        self.delay_s = steady_delay(machine)
        self.limits = CommandLimits.of(machine, settings.segment_s)

    @cached_property
    def gains(self) -> PreviewGains:
        """The gains of the fast inverse."""
        reach = self.machine.kinematics.model_reach_mm
        preview = PreviewGains(self._plant_at, reach, self.settings.rows_per_segment, self.effort)
        if self._known:
            preview.take_up(self._known)
        return preview

    def _table(self, name: str, steps: int) -> PlantTable:
        """The plant over the bed, for that many steps a segment."""
        if self._known:
            return PlantTable.of_arrays({each: self._known[f"{name} {each}"] for each in TABLE_ARRAYS})
        table = plant_table(self.machine, self.settings.segment_s / steps)
        return table.frozen() if self.settings.one_model else table

    def save_cache(self) -> None:
        """Leave what was worked out for the next time."""
        worked_out = self.settings.inverse == "fast" and len(self.gains)
        if not worked_out or (self._known and worked_out == len(self._known["node"])):
            return
        if meanwhile := kept.load(self._kept):  # another process may have been elsewhere on the bed
            self.gains.take_up(meanwhile)
        tables = {"fine": self.plant.table, "coarse": self.row_table}
        arrays = {f"{name} {each}": array for name, table in tables.items() for each, array in table.arrays().items()}
        self._known = {**arrays, **self.gains.known()}
        kept.save(self._kept, self._known)

    def _plant_at(self, xy: FloatArray) -> tuple[DiscretePlant, FloatArray]:
        """The plant for half a segment at places (g, 2) mm, and the nozzle's Jacobian there."""
        step_s = self.settings.segment_s / self.settings.rows_per_segment
        return DiscretePlant(step_s, *models_along(self.row_table, xy)), self.machine.kinematics.jacobian(xy)

    def compliance_at(self, xy: FloatArray) -> FloatArray:
        """C of G⁻¹(s) ≈ I + τ s + C s² for the carriages at places (n, 2) mm: (n, 3, 3) s²."""
        table = self.row_table
        return interpolate(self._compliance, table.x0_mm, table.pitch_mm, table.nodes, np.ascontiguousarray(xy))

    @cached_property
    def _compliance(self) -> FloatArray:
        """It at the table's nodes: Eq. 29 and Eq. 34 turned over and expanded at s = 0."""
        carriage, effector, j = self.machine.carriage, self.machine.effector, self.row_table.jacobian
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
    def robust(self) -> RobustReference:
        """What is wanted of a machine that is not exactly known."""
        s = self.settings
        return RobustReference(self.machine, s.segment_s / s.rows_per_segment, s.bandwidth_hz, self.effort)

    def robust_offset(self, reference: Reference) -> FloatArray:
        """What is wanted beyond the path, (rows, 3) mm, at the rows of the run's segments; or nothing."""
        if not (self.settings.robust and any(self.machine.uncertainty.values())):
            return np.empty((0, 3))
        s = self.settings
        rows = np.arange(1 - MARGIN, reference.knots * s.rows_per_segment + 1 + MARGIN, dtype=np.float64)
        t = reference.t0 + rows * s.segment_s / s.rows_per_segment
        return self.robust.of(reference.nozzle(t), reference.moving(t))

    def state_after_rest(self, state: FloatArray, nozzle: FloatArray, duration_s: float) -> FloatArray:
        """The state after the command has rested at (3,) mm for a while: what still rings, rings on."""
        s = self.settings
        intervals = round(duration_s / s.segment_s)
        if intervals > 2 * s.memory:
            return rest_state(self.machine, nozzle)
        if intervals <= 0:
            return state
        still = np.repeat(nozzle[None], intervals * s.substeps + 1, axis=0)
        return self.plant.respond(still, np.zeros_like(still), state, s.substeps)[1]


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
