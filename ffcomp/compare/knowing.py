"""What knowing a machine better is worth: the time of a quicker print at other uncertainties, on some of its slices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ffcomp.compare.quickest_plans import Stretch, WholePrint, seconds_of
from ffcomp.compare.sampling import Print, Sampling
from ffcomp.faster.bound import FIRST_LAYER, Bound, with_slicer_settings
from ffcomp.faster.program import faster_program
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import Settings
from ffcomp.planner.program import plan_program
from models.arrays import FloatArray
from models.machine import Machine

SLICE_S, SOME_S = 8.0, 24.0  # length of a slice, and of all of them
ENDS = 1 << 16  # bytes at both ends of a file, in which slicers say their settings


@dataclass(frozen=True, slots=True)
class Known:
    """What the print takes if no number of the machine file is less certain than this."""

    relative_sd: float
    share: float  # of the time that it takes with the machine file as it is
    print_time_s: float


def worth_knowing(
    data: bytes,
    path: str,
    machine: Machine,
    settings: Settings,
    bound: Bound,
    known: Sequence[float],
    print_time_s: float,
    *,
    offset: tuple[float, float] = (0.0, 0.0),
    flavor: str = "",
) -> list[Known]:
    """Plan slices that stand for the print at other uncertainties.

    Parameters
    ----------
    data, path, machine, settings, bound : what was compensated, and how
    known : relative standard deviations that no number of the machine file shall exceed
    print_time_s : of the quicker print, with the machine file as it is
    offset, flavor : as of `compare`
    """
    printed = Print(data, path, machine, offset, flavor)
    bound = with_slicer_settings(bound, data[:ENDS], data[-ENDS:])
    slices, _ = printed.slices(Sampling(), SLICE_S, SOME_S)
    stretches = [Stretch.of(each, printed.labels.features, bound) for each in slices]
    whole = WholePrint(printed, bound)

    def seconds(uncertainty: dict[str, float]) -> float:
        own = replace(machine, uncertainty=uncertainty)
        model = InverseModel(own, replace(settings, robust=True, robust_quickly=True))
        now = [_quick_s(each, model, bound, own) for each in stretches]
        return float(whole.cooled(whole.from_slices(stretches, now)).sum())

    as_it_is = seconds(dict(machine.uncertainty))
    found = []
    for sd in known:
        share = seconds({name: min(value, sd) for name, value in machine.uncertainty.items()}) / as_it_is
        found.append(Known(sd, share, share * print_time_s))
    return found


def _quick_s(stretch: Stretch, model: InverseModel, bound: Bound, machine: Machine) -> FloatArray:
    own = stretch.print_slice
    alone = replace(bound, min_layer_time_s=0.0, change_speed=(*bound.change_speed, FIRST_LAYER))
    kept = (own.layer == 0) & bound.keeps_first_layer
    found = faster_program(own.planned.program, model, alone, 1, stretch.features[own.feature[0]], kept)
    return seconds_of(plan_program(found.program, machine).trajectory)
