"""The contour error to expect on the printers that a machine file's `[uncertainty]` allows.

A file's numbers are never exact, and how much a command gains depends on that. So the command is simulated on printers
drawn from the file's `[uncertainty]`, and so are the plan as sliced and the plan through the firmware's own input
shaper, which is tuned to the file and of the kind that is best on the drawn printers. All are judged on the same pieces
of the print by their distance to the path: the root mean square on each printer, and its mean over the printers.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from ffcomp import shapers
from ffcomp.firmware.table import FIRMWARES
from ffcomp.inverse.robust import mode_sd
from ffcomp.metrics import distance_to_path, segments_near
from ffcomp.numerics.digits import um
from ffcomp.shapers.apply import shape_samples
from ffcomp.shapers.search import Scan, search
from ffcomp.simulation.command import Motion, Tuned
from ffcomp.simulation.linear import KEEP_EVERY, STEP_S, SUBSTEPS, LinearPlayback, whole_steps
from gcode.dialect import DIALECTS
from models.arrays import FloatArray
from models.effects.catalogue import design_machine
from models.file import machine_paths
from models.machine import Machine, assumed_modes, way_to_measure, with_values
from models.schema.documents import DEFAULT_UNCERTAINTY
from models.vibration.scheduled import OnCarriages

PRINTERS = 20
TABLE_PITCH_MM = 20.0  # of their tables over the bed; half of it changes the mean errors by 0.3 %
EXCERPT_S, PIECE_S = 24.0, 2.4  # of print time that is simulated on each printer, at most; and one piece of it
MARGIN = 400  # rows, 0.2 s: longer than half of any shaper above 7 Hz
TRUNCATION_SD = 2.5  # standard deviations; none is farther off
SETTLING_S = 0.5  # at the beginning of a piece, not judged: the nozzle comes from anywhere
JUMP_MM = 1.0  # from row to row: no motor does that
NEAR_S = 0.5  # around a piece, of its path that is kept: longer than the contour error looks
LEAST_VALUE = 0.2  # times its value, that a number keeps at least
KINDS = ("zv", "mzv", "ei", "2hump_ei")
TUNED_ON = 2  # pieces, the loudest: the shapers found leave within 1 % of those tuned on all, in a sixth of the time
FACTORS = tuple(np.geomspace(0.8, 1.9, 10).tolist())  # of a shaper's frequencies to those of the modes
SENTENCES = "shaper_name", "headline", "next_step"  # fields of `Expectation` that follow from the others
UNKNOWN_SD = 0.15  # of the modes: from there on the next step is a measurement


def draw_plants(machine: Machine, relative_sd: float | None, count: int) -> list[Machine]:
    """Draw printers whose numbers are off. Printer k is the same whatever their number.

    Each PRINTERS of them are a Latin hypercube: of every number, one lies in each twentieth of its distribution. The
    mean error of 20 then misses that of many by a third of what it does with independent draws, which are far off
    together, or on the side that favours one of two methods (M. D. McKay et al., Technometrics 21 (1979) 239-245).

    relative_sd : of every number of the machine file; None: from its `[uncertainty]`
    """
    parameters = machine.vibration.parameters()
    spread = parameters.relative_sd(machine.uncertainty if relative_sd is None else {"default": relative_sd})
    plants: list[Machine] = []
    while len(plants) < count:
        draws = truncated_normal(latin_hypercube(parameters.columns, len(plants)))
        plants += [with_values(machine, parameters.scaled(off, spread, LEAST_VALUE)) for off in draws]
    return plants[:count]


def latin_hypercube(columns: int, seed: int) -> FloatArray:
    """Draw (PRINTERS, columns) shares, 0 to 1: of every column, one lies in each PRINTERS-th."""
    rng = np.random.default_rng(seed)
    cells = np.stack([rng.permutation(PRINTERS) for _ in range(columns)], axis=1)
    return np.asarray((cells + rng.random(cells.shape)) / PRINTERS)


def truncated_normal(shares: FloatArray) -> FloatArray:
    """Return standard deviations from the mean that so large a share of a truncated normal distribution lies below."""
    from scipy.special import ndtr, ndtri

    below = ndtr(-TRUNCATION_SD)
    return np.asarray(ndtri(below + shares * (1.0 - 2.0 * below)))


class Printer(Protocol):
    """A printer that can be simulated."""

    def respond(self, nozzle: FloatArray, velocity: FloatArray) -> tuple[FloatArray, Any]:
        """Play rows STEP_S apart, positions mm and velocities mm/s (n + 1, 3), from rest.

        Returns the nozzle after every step, (n, 3) mm, and whatever else there is.
        """


class Commanded(NamedTuple):
    """Rows of a command STEP_S apart, (j + 1, 3) mm, and when they are due on the clock of the plan, (j + 1,) s."""

    rows: FloatArray
    due: FloatArray


@dataclass(frozen=True, eq=False)
class Piece:
    """A piece of a print: its path, its plan and its command. Rows are STEP_S apart."""

    path_t: FloatArray  # (k,) s, when its corners are due on the clock of the plan
    path: FloatArray  # (k, 3) mm
    begin_t: float  # s on that clock, of the plan's first row after its margin
    plan: FloatArray  # (MARGIN + n + 1 + MARGIN, 3) mm
    due: FloatArray  # (m + 1,) s on that clock, of the command's rows
    command: FloatArray  # (m + 1, 3) mm
    settling_s: float = 0.0  # at its beginning, not judged: the nozzle comes from anywhere

    @property
    def seconds(self) -> float:
        """Print time that it covers."""
        return STEP_S * (len(self.plan) - 1 - 2 * MARGIN)

    def planned(self, *by_axis: shapers.Shaper | None) -> Commanded:
        """Return the plan through shapers of x, y and z; of none where there are fewer."""
        rows = shape_samples(self.plan, (*by_axis, None, None, None)[:3], STEP_S, MARGIN)
        return Commanded(rows, self.begin_t + STEP_S * np.arange(len(rows), dtype=np.float64))

    def compensated(self) -> Commanded:
        """Return the command."""
        return Commanded(self.command, self.due)

    def squares(self, commanded: Commanded, printers: Sequence[Printer]) -> list[FloatArray]:
        """Return the squared contour errors (s,) mm² of commanded rows on each printer."""
        steps = SUBSTEPS * ((len(commanded.rows) - 1) // SUBSTEPS)
        rows = np.ascontiguousarray(commanded.rows[: steps + 1])
        velocity = np.gradient(rows, STEP_S, axis=0)
        judged = slice(round(self.settling_s / STEP_S), None, KEEP_EVERY)
        due = commanded.due[1 : steps + 1][judged]
        nozzles = (np.ascontiguousarray(printer.respond(rows, velocity)[0][judged]) for printer in printers)
        path, near = np.ascontiguousarray(self.path), segments_near(self.path_t, due)
        return [distance_to_path(path, nozzle, *near) ** 2 for nozzle in nozzles]


def pieces_of(plan: Motion, command: Motion, path: tuple[FloatArray, FloatArray]) -> list[Piece]:
    """Return pieces spread evenly over a print, without those where something else moves the nozzle.

    plan, command : the print as sliced, and compensated
    path : when its corners are due, (k,) s, and where they are, (k, 3) mm
    """
    seconds = plan.end_t - plan.begin_t
    count = 1 if seconds <= EXCERPT_S else round(EXCERPT_S / PIECE_S)
    length = seconds if count == 1 else PIECE_S
    executed = np.arange(command.begin_t, command.end_t, 10 * STEP_S)
    due = command.clock.plan_time(executed)
    pieces = []
    for first in np.linspace(plan.begin_t, plan.end_t - length, count).tolist():
        begin, end = np.interp([first, first + length], due, executed).tolist()
        begin = command.begin_t if first == plan.begin_t else begin  # a command leads its path, from rest
        t = begin + STEP_S * np.arange(whole_steps(end - begin) + 1, dtype=np.float64)
        planned = first + STEP_S * np.arange(-MARGIN, whole_steps(length) + 1 + MARGIN, dtype=np.float64)
        rows, commanded = plan.position(planned), command.position(t)
        if max(float(np.abs(np.diff(each, axis=0)).max(initial=0.0)) for each in (rows, commanded)) > JUMP_MM:
            continue
        near = _near(path[0], first, first + length)
        due_then, settling_s = command.clock.plan_time(t), SETTLING_S if first > plan.begin_t else 0.0
        pieces.append(Piece(path[0][near], path[1][near], first, rows, due_then, commanded, settling_s))
    return pieces


def pieces_of_segments(
    plan: Callable[[FloatArray], FloatArray],
    knots_t: FloatArray,
    vertices: FloatArray,
    path: tuple[FloatArray, FloatArray],
    share: float,
    lot: float,
) -> list[Piece]:
    """Return pieces of a section whose command passes points (k, 3) mm at times (k,) s of the plan's clock.

    plan : the nozzle as sliced, (m,) s → (m, 3) mm;  path : as for `pieces_of`
    share : of the print that is wanted; 1 or more: all of it
    lot : 0 to 1, evenly drawn for each section. So short ones, travel mostly, get their share like long ones
    """
    seconds = float(knots_t[-1] - knots_t[0])
    length = seconds if share >= 1.0 else min(seconds, PIECE_S)
    count = min(int(share * seconds / length + lot), int(seconds / length))
    pitch = seconds / max(count, 1)
    pieces = []
    for k in range(count):
        first = float(knots_t[0]) + k * pitch + 0.5 * (pitch - length)
        t = first + STEP_S * np.arange(-MARGIN, whole_steps(length) + 1 + MARGIN, dtype=np.float64)
        inside, near = t[MARGIN:-MARGIN], _near(path[0], first, first + length)
        command = np.stack([np.interp(inside, knots_t, column) for column in vertices.T], axis=1)
        settling_s = SETTLING_S if first > knots_t[0] else 0.0
        pieces.append(Piece(path[0][near], path[1][near], first, plan(t), inside, command, settling_s))
    return pieces


@dataclass(frozen=True, slots=True)
class Expectation:
    """What a print is expected to look like, whatever compensates it: contour errors, rms, mean over the printers."""

    uncertainty: float  # number: relative standard deviation of the modes, by the machine file's `[uncertainty]`
    # true or false: that is a guess: the modes are assumed, or no number of the file has an uncertainty of its own
    assumed: bool
    printers: int  # whole number: that were drawn; 0: the file is certain, and the printer is as it says
    over_s: float  # of the print that was simulated on each
    uncompensated_um: float  # as sliced
    compensated_um: float
    shaper_um: float  # with the firmware's best input shaper
    shaper_kind: str  # that shaper: `zv`, `mzv` or another,
    shaper_hz: tuple[float, float]  # and its frequencies for x and y
    # true or false: the file is the print as sliced, with commands that set this shaper
    shaper_written: bool

    shaper_name: str  # kind and frequencies
    headline: str  # what to expect, in a sentence; the shaper first where it is better
    next_step: str  # that a measurement comes first, with its command; empty: the file is known well enough

    @property
    def shaper_is_better(self) -> bool:
        """Whether the shaper is expected to leave less, in the digits that are stated."""
        return float(um(self.compensated_um)) > float(um(self.shaper_um))

    @property
    def tuned(self) -> Tuned:
        """The shaper."""
        return Tuned(self.shaper_kind, self.shaper_hz)

    def numbers(self) -> dict[str, Any]:
        """Return the fields that the others follow from: see `expectation_of`."""
        return {each.name: getattr(self, each.name) for each in fields(self) if each.name not in SENTENCES}


def expectation(machine: Machine, pieces: Sequence[Piece], flavor: str) -> Expectation | None:
    """Simulate pieces of a print on printers that the machine's `[uncertainty]` allows; None: no piece is long enough.

    Without any uncertainty the printer is the machine itself. flavor : of the firmware whose shapers are tried
    """
    pieces = [piece for piece in pieces if min(len(piece.plan) - 2 * MARGIN, len(piece.command)) > SUBSTEPS]
    if not pieces:
        return None
    plants = draw_plants(machine, None, PRINTERS) if any(machine.uncertainty.values()) else []
    printers = playbacks(plants or [machine])
    best, shaper = best_shaper(shaped_errors(pieces, printers, tuned_shapers(machine, pieces, flavor)))
    return expectation_of(
        machine,
        uncertainty=mode_sd(machine, BAND_HZ) if plants else 0.0,
        assumed=assumed_modes(machine) is not None or machine.uncertainty == {"default": DEFAULT_UNCERTAINTY},
        printers=len(plants),
        over_s=sum(piece.seconds for piece in pieces),
        uncompensated_um=_mean(errors_um(pieces, printers, Piece.planned)),
        compensated_um=_mean(errors_um(pieces, printers, Piece.compensated)),
        shaper_um=_mean(shaper),
        shaper_kind=best.kind,
        shaper_hz=best.hz,
        shaper_written=False,
    )


def playbacks(machines: Sequence[Machine]) -> list[LinearPlayback]:
    """Return the linear model of each machine, ready to be simulated."""
    designs = [design_machine(each)[0] for each in machines]
    carriages = {each.kinematics: OnCarriages(each.kinematics) for each in designs}
    return [LinearPlayback(each, TABLE_PITCH_MM, carriages[each.kinematics]) for each in designs]


def errors_um(
    pieces: Sequence[Piece], printers: Sequence[Printer], commanded: Callable[[Piece], Commanded]
) -> FloatArray:
    """Return the contour error, rms over all pieces, on each printer: (printers,) µm."""
    squares = [piece.squares(commanded(piece), printers) for piece in pieces]
    return np.array([1e3 * float(np.sqrt(np.mean(np.concatenate(each)))) for each in zip(*squares, strict=True)])


def tuned_shapers(machine: Machine, pieces: Sequence[Piece], flavor: str) -> list[Tuned]:
    """Return the best shaper of each kind, for the pieces that ring most on the printer of the machine file.

    flavor : whose kinds of `KINDS` are tried; all where it has none for this machine
    """
    (printer,) = playbacks([machine])
    loudest = sorted(pieces, key=lambda piece: -float(piece.squares(piece.planned(), [printer])[0].sum()))[:TUNED_ON]
    of_firmware = FIRMWARES[flavor].shapers(machine)
    kinds = [kind for kind in KINDS if kind in of_firmware] or KINDS
    return [_tuned(machine, printer, loudest, kind, DIALECTS[flavor].shapes_axes) for kind in kinds]


def shaped_errors(
    pieces: Sequence[Piece], printers: Sequence[Printer], tuned: Sequence[Tuned]
) -> dict[Tuned, FloatArray]:
    """Return the errors of the plan through each shaper, (printers,) µm."""

    def errors(shaper: Tuned) -> FloatArray:
        by_axis = shaper.by_axis()
        return errors_um(pieces, printers, lambda piece: piece.planned(*by_axis))

    return {each: errors(each) for each in tuned}


def best_shaper(errors: Mapping[Tuned, FloatArray]) -> tuple[Tuned, FloatArray]:
    """Return the shaper with the least mean error, and its errors."""
    return min(errors.items(), key=lambda one: _mean(one[1]))


def expectation_of(machine: Machine, **numbers: Any) -> Expectation:
    """Add what follows from an expectation's numbers, its fields before `shaper_name`."""
    made = Expectation(
        **numbers | {"shaper_hz": tuple(numbers["shaper_hz"])}, shaper_name="", headline="", next_step=""
    )
    before, after, shaper = map(um, (made.uncompensated_um, made.compensated_um, made.shaper_um))
    name, better = made.tuned.name, made.shaper_is_better
    unsure = {None: "An input shaper, if the firmware has one,", (): "An input shaper, which the firmware lacks,"}
    shaping = f"{unsure[own]} would be" if (own := machine.input_shaper) in unsure else "The firmware's input shaper is"
    first = f"{shaping} better here: e" if better else "E"
    ours, theirs = f"{after} µm rms", f"with the best input shaper ({name}) {shaper}"
    if made.shaper_written:
        first = f"The print is as sliced, through the firmware's input shaper ({name}), which is better here: e"
        ours, theirs = f"{shaper} µm rms", f"with ffcomp's own command (--robust on) {after}"
    condition = condition_of(made.uncertainty, made.assumed)
    headline = f"{first}xpected contour error {condition}: {ours}, {theirs}, without compensation {before}."
    unknown = made.assumed and made.uncertainty >= UNKNOWN_SD
    next_step = _measure_first(machine) if better or unknown else ""
    return replace(made, shaper_name=name, headline=headline, next_step=next_step)


def condition_of(sd: float, assumed: bool) -> str:
    """Say which printers an expectation is of."""
    if not sd:
        return "on a printer exactly as its file says"
    return f"with modes known to ±{100 * sd:.2g} %{' (assumed)' if assumed else ''}"


def _measure_first(machine: Machine) -> str:
    paths = {str(path): name for name, path in machine_paths().items()}
    options = f"-m {shlex.quote(paths.get(machine.path, machine.path) or machine.name)}"
    options += f" --flavor {machine.flavor}" if machine.flavor else ""
    return (
        f"Measure first: {way_to_measure(machine, f' {options} -o moves.gcode')}, then `ffcomp identify fit`; "
        f"without a sensor `ffcomp record plan --for scan {options} -o page.gcode`, then `ffcomp identify scan`."
    )


def _near(path_t: FloatArray, begin: float, end: float) -> slice:
    """Return the corners of a path around a time, with those whose moves are in progress."""
    first, last = np.searchsorted(path_t, [begin - NEAR_S, end + NEAR_S]).tolist()
    return slice(max(first - 2, 0), last + 2)


BAND_HZ = 100.0  # up to which modes count


def _tuned(machine: Machine, printer: Printer, pieces: Sequence[Piece], kind: str, by_axis: bool) -> Tuned:
    """Return a shaper with the frequencies that serve these pieces best on the printer of the machine file.

    by_axis : whether x and y have frequencies of their own
    """

    def of(settings: FloatArray) -> Tuned:
        return Tuned(kind, (float(settings[0]), float(settings[-1])))

    def cost(settings: FloatArray) -> float:
        by_axis = of(settings).by_axis()
        return float(errors_um(pieces, [printer], lambda piece: piece.planned(*by_axis))[0])

    centre = np.array(machine.kinematics.centre_mm, dtype=float)
    modes = shapers.dominant_frequencies(design_machine(machine)[0], centre)
    start = modes if by_axis else np.sqrt(np.prod(modes, keepdims=True))
    return of(search(cost, start, [Scan(range(len(start)), FACTORS)]).settings)


def _mean(errors: FloatArray) -> float:
    return float(np.mean(errors))
