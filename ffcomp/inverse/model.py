"""What a machine's inverse needs: its plant over the bed, gains, limits, and how the possible printers differ."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ffcomp.inverse import disk_cache
from ffcomp.inverse.command_limits import CommandLimits
from ffcomp.inverse.gains import PreviewGains
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.robust import Path, RobustReference
from ffcomp.inverse.sensitivity import MARGIN, Sensitivity
from ffcomp.inverse.settings import Settings, control_weight_at
from ffcomp.planner.segment_timing import sample_even_segments
from models.arrays import FloatArray
from models.effects.catalogue import design_machine, without_effects
from models.kinematics.base import Compiled
from models.machine import Machine
from models.vibration.scheduled import (
    PlantTable,
    Schedule,
    interpolate,
    models_along,
    plant_table,
    table_positions,
)
from models.vibration.state_space import DiscretePlant

GEOMETRY = "arm_geometry"  # calibrated, not compensated: the nozzle's rest position must be the commanded one


@dataclass(frozen=True, eq=False)
class InverseModel:
    """What a machine's inverse needs, computed once and only where it is needed: tables, gains, weights, limits."""

    full_machine: Machine  # with the effects that its file lists
    settings: Settings

    def __reduce__(self) -> tuple[Any, ...]:
        """Another process builds its own tables, and keeps them for its next task."""
        return model_of, (self.full_machine, self.settings)

    @cached_property
    def _design(self) -> tuple[Machine, tuple[str, ...]]:
        return design_machine(self.full_machine)

    @property
    def machine(self) -> Machine:
        """The machine with the effects that a linear model can hold."""
        return self._design[0]

    @cached_property
    def not_modelled(self) -> tuple[str, ...]:
        """Names of the effects that no command compensates."""
        return tuple(name for name in self._design[1] if name == GEOMETRY)

    @cached_property
    def printer(self) -> Machine | None:
        """The nonlinear printer, where the linear model cannot hold its effects; its firmware's geometry stays."""
        return without_effects(self.full_machine, GEOMETRY) if len(self._design[1]) > len(self.not_modelled) else None

    @cached_property
    def kinematics(self) -> Compiled:
        """The machine's compiled kinematics."""
        return self.machine.kinematics.compiled()

    @cached_property
    def plant(self) -> Schedule:
        """The plant along any path, at the substeps of a segment."""
        return Schedule(self.machine.kinematics, self._table(self.settings.substeps))

    @cached_property
    def row_table(self) -> PlantTable:
        """The plant over the bed, at the rows of a segment."""
        return self._table(self.settings.rows_per_segment)

    @cached_property
    def control_weight(self) -> float:
        """The weight ρ of the command's second differences."""
        s = self.settings
        return control_weight_at(self.machine, s.inverse_hz, s.segment_s, s.rows_per_segment)

    @cached_property
    def delay_s(self) -> float:
        """τ of G(s) ≈ I − τ s, the machine's lag behind a steady motion, s, on average of its towers."""
        return float(np.mean(self.machine.vibration.low_frequency(np.zeros((1, 2)))[0]))

    @cached_property
    def limits(self) -> CommandLimits:
        """The limits of the carriages' commands."""
        return CommandLimits.of(self.machine, self.settings.segment_s)

    @cached_property
    def gains(self) -> PreviewGains:
        """The gains of the preview inverse."""
        reach = self.machine.kinematics.model_reach_mm
        states = self.row_table.plant.a.shape[1]
        return PreviewGains(self.plant_at, states, reach, self.settings.rows_per_segment, self.control_weight)

    def _table(self, steps: int) -> PlantTable:
        """Tabulate the plant over the bed, for so many steps a segment."""
        table = plant_table(self.machine.kinematics, self.machine.vibration, self.settings.segment_s / steps)
        return table.frozen() if self.settings.one_model else table

    def save_cache(self) -> None:
        """Save on disk, for the next time, how the possible printers differ."""
        robust = self.__dict__.get("_robust")
        if robust is not None and robust.sensitivity.has_grown:
            # another process may have been elsewhere on the bed
            robust.sensitivity.take_up(disk_cache.load(self._cache_name))
            disk_cache.save(self._cache_name, robust.sensitivity.known())
            robust.sensitivity.has_grown = False

    @cached_property
    def _cache_name(self) -> str:
        s = self.settings
        return disk_cache.name_of(self.machine, s.segment_s, s.rows_per_segment, s.inverse_hz)

    def plant_at(self, xy: FloatArray) -> tuple[DiscretePlant, FloatArray]:
        """Return the plant for half a segment at positions (g, 2) mm, and the nozzle's Jacobian there."""
        step_s = self.settings.segment_s / self.settings.rows_per_segment
        p = self.row_table.plant
        at = DiscretePlant(step_s, *models_along(self.row_table, xy), p.carriage, p.drive_states, p.oscillators)
        return at, self.machine.kinematics.jacobian(xy)

    def compliance_at(self, xy: FloatArray) -> FloatArray:
        """Return C of G⁻¹(s) ≈ I + τ s + C s² for the carriages at positions (n, 2) mm: (n, 3, 3) s²."""
        table = self.row_table
        return interpolate(self._compliance, table.x0_mm, table.pitch_mm, table.nodes, np.ascontiguousarray(xy))

    @cached_property
    def _compliance(self) -> FloatArray:
        """Return C at the table's nodes: Eq. 29 and Eq. 34, inverted and expanded at s = 0."""
        _, positions = table_positions(self.machine.kinematics)
        if self.settings.one_model:
            positions = np.broadcast_to(positions[len(positions) // 2], positions.shape)
        return self.machine.vibration.low_frequency(positions)[1]

    @cached_property
    def _robust(self) -> RobustReference:
        s = self.settings
        row_s = s.segment_s / s.rows_per_segment
        robust = RobustReference(self.machine, row_s, s.inverse_hz, self.control_weight)
        robust.sensitivity.take_up(disk_cache.load(self._cache_name))
        return robust

    @cached_property
    def sensitivity(self) -> Sensitivity:
        """How printers that the machine file allows differ, each span of a path being at one place."""
        s = self.settings
        row_s = s.segment_s / s.rows_per_segment
        return Sensitivity(self.machine, row_s, s.inverse_hz, self.control_weight, sampled=False)

    def robust_offsets(self, references: Sequence[Reference]) -> list[FloatArray]:
        """Return each robust reference's offset from its path, (rows, 3) mm; empty where it is not used."""
        s, machine = self.settings, self.machine
        if not s.robust or not np.any(machine.vibration.parameters().relative_sd(machine.uncertainty)):
            return [np.empty((0, 3))] * len(references)
        paths = []
        for reference in references:
            rows = np.arange(1 - MARGIN, reference.knots * s.rows_per_segment + 1 + MARGIN, dtype=np.float64)
            t = reference.t0 + rows * s.segment_s / s.rows_per_segment
            paths.append(Path(reference.nozzle(t), reference.moving(t)))
        return self._robust.offsets(paths)

    def executed(self, reference: Reference, vertices: FloatArray) -> FloatArray:
        """Return a section's command at its knots (n + 1, 3) mm as the firmware executes it, after every substep."""
        s = self.settings
        return sample_even_segments(vertices, np.diff(reference.extrusion()), s.segment_s, s.output, s.substeps)

    def respond(self, reference: Reference, command: FloatArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the nozzle (n, 3) mm after every substep of a section, and the plant's state (18,) at its end.

        command : (n + 1, 3) mm, of the nozzle;  state : (18,) at the section's beginning
        """
        nozzle, velocity = map(np.ascontiguousarray, reference.substeps(reference.knots))
        rates, moved = self.kinematics.rate_term(nozzle, velocity), self.kinematics.inverse(command)
        q, states = self.plant.play(self.places(nozzle), rates, moved, state, self.settings.substeps)
        return self.kinematics.forward(q), states[-1]

    def places(self, nozzle: FloatArray) -> FloatArray:
        """Return where the plant is looked up for each segment, (n, 2) mm, of a nozzle at the substeps (m, 3) mm."""
        substeps = self.settings.substeps
        return np.ascontiguousarray(nozzle[substeps // 2 :: substeps, :2])

    def state_after_rest(self, state: FloatArray, nozzle: FloatArray, duration_s: float) -> FloatArray:
        """Return the state after the command has rested at (3,) mm for a while: what still rings, rings on."""
        s = self.settings
        intervals = round(duration_s / s.segment_s)
        if intervals > 2 * s.memory:
            return self.machine.equilibrium(nozzle)
        if intervals <= 0:
            return state
        command = np.repeat(self.kinematics.inverse(nozzle[None]), intervals * s.substeps + 1, axis=0)
        place = np.repeat(nozzle[None, :2], intervals, axis=0)
        return self.plant.play(place, np.zeros_like(command), command, state, s.substeps)[1][-1]


_per_thread = threading.local()


def model_of(machine: Machine, settings: Settings) -> InverseModel:
    """Return a thread's inverse model, the same one from chunk to chunk and from file to file."""
    key = pickle.dumps((machine, settings))
    if getattr(_per_thread, "key", None) != key:
        _per_thread.model, _per_thread.key = InverseModel(machine, settings), key
    model: InverseModel = _per_thread.model
    return model
