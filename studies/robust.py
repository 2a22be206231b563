"""Robust inversion against the best input shaper, on printers that are not as their file says.

    python -m studies.robust [--printers N] [--nonlinear N]     studies/reports/robust.md, some 40 minutes

Six machines, 16 s of a print each, at the uncertainty that the machine file states: 5, 10 and 20 %. N linear printers
(100) are drawn as `[uncertainty]` says, and none of them was among those that the inversion or the expectation draws. N
others (20) have equations of their own, and errors of another kind: every mode or tower is off by itself, part of the
damping is in the belts, the guides rub, and the nozzle hangs on a second mass.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from ffcomp.comparison.methods import COMPENSATED, ROBUST, inversion
from ffcomp.comparison.sampling import Print, PrintSlice, Sampling
from ffcomp.inverse.settings import settings_for
from ffcomp.simulation.expectation import (
    KINDS,
    LEAST_VALUE,
    PRINTERS,
    Piece,
    Printer,
    best_shaper,
    draw_plants,
    errors_um,
    latin_hypercube,
    pieces_of,
    playbacks,
    shaped_errors,
    truncated_normal,
    tuned_shapers,
)
from ffcomp.simulation.linear import STEP_S
from models.arrays import FloatArray
from models.file import load_machine
from models.kinematics.cartesian import COREXY, CartesianKinematics
from models.machine import Machine, value_of
from studies.render import save
from validation.plants import delta_plant, straight_plant

ROOT = Path(__file__).parents[1]
CASES = (
    ("ender-3", "ringing_tower"),
    ("ender-3", "lobed_vase"),
    ("voron-300", "far_star"),
    ("prusa-mk4", "ringing_tower"),
    ("bambu-p1", "lobed_vase"),
    ("kossel", "ringing_tower"),
    ("mp-delta-pro", "far_star"),
)
SDS = (0.05, 0.1, 0.2)
NONLINEAR_SDS = (0.1, 0.2)
SECONDS, PIECE_S = 16.0, 4.0
DELTA_STEPS = 6  # of the delta's integration in one row of a command
TOOL_SHARE, TOOL_HZ = 0.1, (150.0, 300.0)  # second mass of a straight axis: of the moved mass, and its own frequency
FRICTION_N = (0.3, 1.0)
BRISTLE_N_PER_M = 5e4  # soft enough for so little friction in quick motion
STRAIGHT_NUMBERS, DELTA_NUMBERS = 9, 22  # that are drawn for one printer
SEED = 11


# ---- printers with equations of their own --------------------------------------------------------


@dataclass(frozen=True)
class Straight:
    """A printer with straight axes."""

    plant: straight_plant.Plant

    def respond(self, nozzle: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Play rows (n + 1, 3) mm: the nozzle after each but the first, (n, 3) mm; z follows."""
        place = straight_plant.simulate(self.plant, nozzle[:, :2], 1 / STEP_S)["position_mm"]
        return np.column_stack([place, nozzle[:, 2]])[1:], velocity


@dataclass(frozen=True)
class Delta:
    """A delta."""

    machine: dict[str, Any]

    def respond(self, nozzle: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Play rows (n + 1, 3) mm: the nozzle after each but the first, (n, 3) mm."""
        halves = 2 * DELTA_STEPS
        at = np.arange(halves * (len(nozzle) - 1) + 1) / halves
        fine = np.stack([np.interp(at, np.arange(len(nozzle)), column) for column in nozzle.T], axis=1)
        command = delta_plant.carriages_of(self.machine, fine)
        played = delta_plant.simulate(self.machine, command, STEP_S / DELTA_STEPS, keep_every=DELTA_STEPS)
        return np.asarray(played["nozzle_mm"][1:]), velocity


def nonlinear(machine: Machine, sd: float, count: int) -> list[Printer]:
    """Draw printers of the other kind, PRINTERS of them as a Latin hypercube."""
    delta = machine.vibration.position_dependent
    shares: list[FloatArray] = []
    while len(shares) < count:
        shares += list(latin_hypercube(DELTA_NUMBERS if delta else STRAIGHT_NUMBERS, SEED + len(shares)))
    draws = [_Draws(each, sd) for each in shares[:count]]
    if delta:
        file = delta_plant.load_machine(machine.path)
        return [_delta(file, draw) for draw in draws]
    return [_straight(machine, draw) for draw in draws]


class _Draws:
    """The numbers of one printer, from shares 0 to 1."""

    def __init__(self, shares: FloatArray, sd: float) -> None:
        self._shares, self._sd = iter(shares.tolist()), sd

    def _next(self, count: int) -> FloatArray:
        return np.fromiter(islice(self._shares, count), float, count)

    def factors(self, count: int) -> FloatArray:
        """Draw what numbers of the file are multiplied by."""
        return np.asarray(1.0 + self._sd * truncated_normal(self._next(count))).clip(LEAST_VALUE)

    def between(self, range_: tuple[float, float], count: int) -> FloatArray:
        """Draw evenly from a range."""
        return range_[0] + (range_[1] - range_[0]) * self._next(count)


def _straight(machine: Machine, draw: _Draws) -> Straight:
    axes = [(value_of(machine, f"axes.{x}.stiffness[0]"), value_of(machine, f"axes.{x}.damping[0]")) for x in "xy"]
    omega = np.sqrt([stiffness for stiffness, _ in axes]) * draw.factors(2)
    held = np.array([damping for _, damping in axes]) * draw.factors(2)  # 2 ζ ω
    assert isinstance(machine.kinematics, CartesianKinematics)
    corexy = np.array_equal(machine.kinematics.motor_matrix, COREXY)
    stiffness = np.full(2, 3e4)
    mass = (2.0 if corexy else 1.0) * stiffness / omega**2
    tool, in_belts = TOOL_SHARE * mass, draw.between((0.0, 1.0), 1)
    mount = tool * (2 * np.pi * draw.between(TOOL_HZ, 2)) ** 2
    belts = in_belts * held * mass
    plant = straight_plant.Plant(
        motors=((1.0, 1.0), (1.0, -1.0)) if corexy else ((1.0, 0.0), (0.0, 1.0)),
        carriage_kg=_pair(mass - tool),
        tool_kg=_pair(tool),
        belt_n_per_m=_pair(stiffness),
        mount_n_per_m=_pair(mount),
        guide_n_s_per_m=_pair((1.0 - in_belts) * held * mass),
        belt_n_s_per_m=_pair(np.full(2, belts.mean() / 2) if corexy else belts),
        mount_n_s_per_m=_pair(2 * 0.03 * np.sqrt(mount * tool)),
        friction_n=_pair(draw.between(FRICTION_N, 2)),
        bristle_n_per_m=BRISTLE_N_PER_M,
    )
    return Straight(plant)


def _delta(machine: dict[str, Any], draw: _Draws) -> Delta:
    carriage, effector = machine["carriage"], dict(machine["effector"])
    towers: dict[str, Any] = {
        key: (carriage[key] * draw.factors(3)).tolist()
        for key in ("mass_kg", "belt_stiffness_n_per_m", "belt_damping_n_s_per_m", "guide_damping_n_s_per_m")
    }
    towers["carriage_mass_kg"] = towers.pop("mass_kg")
    towers["friction_n"] = draw.between(FRICTION_N, 3).tolist()
    for key in ("extruder_stiffness_n_per_m", "extruder_damping_n_s_per_m"):
        effector[key] = (np.asarray(effector[key]) * draw.factors(3)).tolist()
    effector["nozzle_mass_kg"] *= float(draw.factors(1)[0])
    return Delta({**machine, "effector": effector, "towers": towers, "effects": {}})


def _pair(values: FloatArray) -> tuple[float, float]:
    x, y = values.tolist()
    return x, y


# ---- what is compared ----------------------------------------------------------------------------


def slices_of(machine: Machine, name: str) -> list[PrintSlice]:
    """Return parts of a print, in the middle of a bed that begins at zero."""
    data = (ROOT / "sample_prints" / f"{name}.gcode").read_bytes()
    x, y = machine.kinematics.centre_mm
    whole = Print(data, name, machine, (float(x), float(y)), flavor="klipper")
    return whole.slices(Sampling(share=min(1.0, SECONDS / whole.print_time_s)), PIECE_S)[0]


def pieces(slices: Sequence[PrintSlice], believed: Machine, kind: str) -> list[Piece]:
    """Return the parts with the commands of an inversion that believes the machine file."""
    way = inversion(believed, settings_for(believed), kind)
    return [piece for each in slices for piece in pieces_of(each.motion, way.motion(each)[0], each.corners)]


def rows(name: str, printed: str, counts: tuple[int, int]) -> Iterator[dict[str, Any]]:
    """Yield the rows of a print: linear printers, then the others."""
    machine = load_machine(name)
    slices = slices_of(machine, printed)
    shapers = tuned_shapers(machine, pieces(slices, machine, COMPENSATED), "klipper")
    for sd in SDS:
        believed = replace(machine, uncertainty={"default": sd})
        plain, robust = (pieces(slices, believed, kind) for kind in (COMPENSATED, ROBUST))
        exact = errors_um(robust, playbacks([machine]), Piece.compensated)[0]
        kinds: dict[str, Sequence[Printer]] = {
            "linear": playbacks(draw_plants(believed, None, PRINTERS + counts[0])[PRINTERS:])
        }
        if sd in NONLINEAR_SDS:
            kinds["nonlinear"] = nonlinear(machine, sd, counts[1])
        for kind, printers in kinds.items():
            shaper, theirs = best_shaper(shaped_errors(robust, printers, shapers))
            ours, plainly = (errors_um(each, printers, Piece.compensated) for each in (robust, plain))
            yield {
                "machine": name,
                "print": printed,
                "sd": sd,
                "printers": kind,
                "shaper": shaper.kind.upper(),
                "exact_um": exact,
                **{
                    f"{who}_{what}_um": of(errors)
                    for who, errors in (("shaper", theirs), ("plain", plainly), ("robust", ours))
                    for what, of in (("mean", np.mean), ("median", np.median), ("worst", np.max))
                },
                "above": float(np.mean(ours > theirs)),
            }


def main() -> None:
    """Measure, and write the results and the page."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--printers", type=int, default=100)
    parser.add_argument("--nonlinear", type=int, default=PRINTERS)
    arguments = parser.parse_args()
    counts = arguments.printers, arguments.nonlinear
    write([row for name, printed in CASES for row in rows(name, printed, counts)], counts)


def write(found: Sequence[dict[str, Any]], counts: tuple[int, int]) -> None:
    """Write the results and the page."""
    of_kind = {kind: [row for row in found if row["printers"] == kind] for kind in ("linear", "nonlinear")}
    save(
        "robust",
        {
            "seconds": SECONDS,
            "counts": dict(zip(of_kind, counts, strict=True)),
            "shapers": [kind.upper() for kind in KINDS],
            "rows": of_kind,
            "summary": {
                kind: {
                    "rows": len(some),
                    **{
                        f"better_{what}": sum(row[f"robust_{what}_um"] <= row[f"shaper_{what}_um"] for row in some)
                        for what in ("mean", "median")
                    },
                }
                for kind, some in of_kind.items()
            },
        },
    )


if __name__ == "__main__":
    main()
