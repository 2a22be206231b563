"""The models as objects of python-control, to design with, simulate or plot.

Positions are dimensionless per command (mm per mm), so states are mm and mm/s; see `models.vibration.state_space`
for the equations. The library is an extra and heavy (seconds to import), so it is imported where it is used.

Example::

    from models.vibration.python_control import assembly
    from models.file import load_machine

    system = assembly(load_machine("mp-delta-pro"), (0.0, 0.0), of="nozzle", per="nozzle")
    print(system.damp())
"""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from models.machine import Effector, Machine
from models.vibration.carriage import damping
from models.vibration.receptance import Input, Output
from models.vibration.state_space import QD, WD, ContinuousPlant, Q, W, continuous_plant

if TYPE_CHECKING:
    from control import StateSpace, TransferFunction

Polynomial = NDArray[np.floating]  # (n,) coefficients, highest power first

CARRIAGES, AXES = "ABC", "xyz"
STATES = [
    *(f"{kind}_{letter}" for kind in ("drive", "drive_rate", "pos", "vel") for letter in CARRIAGES),
    *(f"{kind}_{letter}" for kind in ("extruder", "extruder_rate") for letter in AXES),
]
OUTPUTS = {"carriage": ("pos", CARRIAGES), "nozzle": ("pos", AXES), "acceleration": ("acc", AXES)}


def assembly(machine: Machine, xy: Sequence[float], of: Output = "carriage", per: Input = "carriage") -> StateSpace:
    """The printer frozen at one place: what `models.vibration.receptance.assembly_frf` is the frequency response of.

    Inputs cmd_A … or cmd_x …, outputs pos_A …, pos_x … or acc_x …; 18 states with a drive, 12 with an ideal one.

    An ideal drive hands the belt's damper the command's slope, ẋ = A x + B u + Bₛ u̇. The states z = x − Bₛ u need no
    slope: ż = A z + (B + A Bₛ) u, and only velocities differ between z and x, so positions read the same.

    Parameters
    ----------
    xy : (2,) mm, columns X Y.

    Raises
    ------
    ValueError
        For the acceleration with an ideal drive and a damped belt: it follows the command's slope, so no state space
        of the command has it.
    """
    place = np.array([xy], dtype=np.float64)
    plant, j = continuous_plant(machine, place), machine.kinematics.jacobian(place)[0]
    slope = plant.b_slope[0]
    a, b = plant.a[0], plant.b_command[0] + plant.a[0] @ slope
    rows = np.eye(len(a))[Q] if of == "carriage" else j @ np.eye(len(a))[Q]
    direct = np.zeros((3, 3))
    if of == "acceleration":
        _refuse_slope(machine, plant)
        rows, direct = j @ a[QD], j @ b[QD]
    turn = np.eye(3) if per == "carriage" else np.linalg.inv(j)
    keep = _states(machine)
    kind, letters = OUTPUTS[of]
    return _control().StateSpace(
        a[np.ix_(keep, keep)],
        b[keep] @ turn,
        rows[:, keep],
        direct @ turn,
        inputs=[f"cmd_{letter}" for letter in (CARRIAGES if per == "carriage" else AXES)],
        outputs=[f"{kind}_{letter}" for letter in letters],
        states=[STATES[i] for i in keep],
        name=f"{of}_per_{per}",
    )


def carriage_alone(machine: Machine, added_mass_kg: float = 0.0) -> TransferFunction:
    """G_qd of Eq. 31, or G'_qd of Eq. 37 with a mass screwed on: command to position."""
    carriage, drive = machine.carriage, machine.carriage.drive
    num: Polynomial = np.array([carriage.belt_damping_n_s_per_m, carriage.belt_stiffness_n_per_m])
    den = _carriage_polynomial(machine, added_mass_kg)
    if drive is not None:
        num = np.polymul(num, [drive.d1_per_s, drive.d0_per_s2])
        den = np.polymul(den, [1.0, drive.d2_per_s, drive.d0_per_s2])
    return _control().TransferFunction(num, den, inputs=["cmd"], outputs=["pos"], name="carriage_alone")


def carriage_load(machine: Machine) -> TransferFunction:
    """G_Fq of Eq. 44, m/N: the effector's load to position."""
    den = _carriage_polynomial(machine, 0.0)
    return _control().TransferFunction([-1.0], den, inputs=["force"], outputs=["pos"], name="carriage_load")


def effector_alone(machine: Machine, with_arms: bool = False) -> TransferFunction:
    """Eq. 45, 1/kg, one axis beside the other: force on the nozzle holder to its acceleration.

    with_arms : the arms' lower halves ride along, as they do in W.
    """
    nozzle_side = machine.nozzle_side_mass_kg if with_arms else machine.effector.nozzle_mass_kg
    return _diagonal(
        [_struck(machine.effector, nozzle_side, axis) for axis in range(3)], "force", "acc", "effector_alone"
    )


def effector_load(machine: Machine) -> TransferFunction:
    """W of Eq. 61, N/m: nozzle position to the force it takes. Improper: twice more zeros than poles."""
    struck = [_struck(machine.effector, machine.nozzle_side_mass_kg, axis) for axis in range(3)]
    return _diagonal([(np.polymul(den, [1.0, 0.0, 0.0]), num) for num, den in struck], "pos", "force", "effector_load")


def _control() -> ModuleType:
    try:
        import control
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "State spaces and transfer functions need python-control, which is not installed: "
            "pip install 'ffcomp[control]'.",
            name="control",
        ) from error
    return control


def _states(machine: Machine) -> list[int]:
    """With an ideal drive the filter's states idle, and are left out."""
    idle = set() if machine.carriage.drive is not None else {*range(18)[W], *range(18)[WD]}
    return [i for i in range(18) if i not in idle]


def _refuse_slope(machine: Machine, plant: ContinuousPlant) -> None:
    if np.any(plant.b_slope):
        raise ValueError(
            f"The acceleration of {machine.name!r} is no state space of its command: its drive is ideal and its belt "
            f"damping is {machine.carriage.belt_damping_n_s_per_m:g} N s/m, so it follows the command's slope at "
            "once; give the machine a drive, or ask for 'nozzle' and differentiate."
        )


def _carriage_polynomial(machine: Machine, added_mass_kg: float) -> Polynomial:
    """m s² + (c + b) s + k."""
    carriage = machine.carriage
    return np.array([carriage.moving_mass_kg + added_mass_kg, damping(carriage), carriage.belt_stiffness_n_per_m])


def _struck(effector: Effector, nozzle_side_kg: float, axis: int) -> tuple[Polynomial, Polynomial]:
    """Numerator and denominator of Eq. 45."""
    m2 = effector.extruder_mass_kg
    both, m12 = nozzle_side_kg + m2, nozzle_side_kg * m2
    b, k = effector.extruder_damping_n_s_per_m[axis], effector.extruder_stiffness_n_per_m[axis]
    return np.array([m2, b, k]), np.array([m12, both * b, both * k])


def _diagonal(fractions: Sequence[tuple[Polynomial, Polynomial]], of: str, to: str, name: str) -> TransferFunction:
    nothing = (np.zeros(1), np.ones(1))
    table = [[fractions[i] if i == k else nothing for k in range(3)] for i in range(3)]
    return _control().TransferFunction(
        [[num for num, _ in row] for row in table],
        [[den for _, den in row] for row in table],
        inputs=[f"{of}_{axis}" for axis in AXES],
        outputs=[f"{to}_{axis}" for axis in AXES],
        name=name,
    )
