"""Declare that the other map distributes the effector's load among the carriages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

from models.arrays import FloatArray
from models.delta_machine import delta_vibration, with_parts
from models.effects.effect import Effect
from models.machine import Machine

OTHER: Mapping[str, Literal["virtual_work", "paper"]] = {"virtual_work": "paper", "paper": "virtual_work"}


def fold(machine: Machine, values: Mapping[str, FloatArray]) -> Machine:
    """Replace the machine's force map by the other one."""
    effector = delta_vibration(machine).effector
    return with_parts(machine, effector=replace(effector, force_map=OTHER[effector.force_map]))


EFFECT = Effect(
    name="force_map",
    title="The effector's load is shared the other way",
    kind="parameter",
    physics=(
        "By virtual work the carriages feel the effector's whole load; by Eqs. 22-27 about a third of it. The effect "
        "says that the machine follows the map its file does not name. It has no parameters: it is there or it is not."
    ),
    equation="F_q = Jᵀ W X against F_qi = J_iᵀ P_i W X   (Eq. 25)",
    parameters=(),
    in_data="The lowest modes are off by a factor near 1.5, differently over the bed.",
    confounded_with={"effector_mass": "Three places on the bed: no single mass mends all of them."},
    fold=fold,
    of=("carriages",),
)
