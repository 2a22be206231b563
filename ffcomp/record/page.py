"""A page that a printer draws, to measure its vibrations from a picture of the page: layout and G-code.

A stroke is a short zigzag along one axis and then a straight, unhurried line along the other one. What the zigzag has
set ringing is written into that line as a wave, whose length is speed over frequency. Next to each stroke there is the
same line drawn slowly: scanner, lens and paper shift both alike, so their difference is the machine's. Discs mark where
the page is. They are scattered by a seed and the machine's hash, so that no two pages have them at the same places.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from ffcomp.errors import LimitsError
from ffcomp.planner.limits import PlannerLimits, planner_limits
from ffcomp.record.gcode_writer import Recorder, comments, lines, moves_within_limits, travel_feeds
from ffcomp.record.moves import MODES_HZ, carriage_gain, rounding_share
from ffcomp.record.plan import Experiment, Motion, Page, Plan, plain_motion
from gcode.emit import XYZ_COUNTS
from models.arrays import BoolArray, FloatArray
from models.kinematics.base import Kinematics
from models.machine import Machine

STROKE, SLOW, DISC, SKIRT = "stroke", "slow-line", "disc", "skirt"  # kinds of drawings

LINE_MM, PITCH_MM, TWIN_MM = 25.0, 4.4, 2.0  # a line; from stroke to stroke; from a stroke to its slow line
STROKES, CELLS = 5, 4  # a direction and a cell; where there is room
TUNED_WIDE, HIGHEST_HZ, RINGING = 1.35, 110.0, 0.3  # beyond the file's modes that ring: their damping ratio
RINGING_MM, MOST_LEGS, ADVANCE_SHARE = 0.3, 8, 0.1  # of a mode without damping; of a leg, along the line
SPEED_SHARES = (0.8, 0.9, 0.85, 0.95, 1.0)  # of the fastest line, from the slowest zigzag to the quickest
SLOW_MM_PER_S, SLOW_MM_PER_S2 = 20.0, 500.0  # of everything that must not ring
FASTEST_MM_PER_S, FLOW_MM3_PER_S = 100.0, 9.0  # of a line; what a hot end melts, on a first layer
STROKE_MM_PER_S2, CARRIAGE_SHARE = 8000.0, 0.3  # of strokes, at most; of the carriages' limit, which motors reach
DISCS, DISC_MM, DISC_APART_MM = 10, 2.6, 22.0  # how many; their radius; from one to the next
MARGIN_MM, SKIRT_MM = 4.0, 3.0  # around drawings; from them to the skirt
LARGEST_MM = 200.0  # of the page, as wide as a flatbed
FILAMENT_MM2 = np.pi * 1.75**2 / 4
HOP_MM, RETRACT_MM, RETRACT_MM_PER_S = 0.8, 0.8, 30.0


@dataclass(frozen=True)
class PageRequest:
    """The requested page."""

    page: Page = field(default_factory=Page)
    height_mm: float = 0.2  # of the layer, or of a pen's tip
    acceleration_mm_per_s2: float | None = None  # of the strokes; None: what STROKE_MM_PER_S2 and CARRIAGE_SHARE allow
    seed: int = 1


# ---- the plan ------------------------------------------------------------------------------------


def make_page(machine: Machine, request: PageRequest) -> Plan:
    """Lay out a page on the machine's bed; LimitsError where the bed is too small, or a limit is exceeded."""
    limits = _limits(machine, request)
    cells = _cells(machine.kinematics)
    rng = np.random.default_rng([request.seed, int(machine.sha256[:8] or "0", 16)])
    discs = _discs(machine.kinematics, cells, rng)
    draw = _Drawer(machine, request, limits)
    draw.skirt(cells, discs)
    for number, at in enumerate(discs):
        draw.disc(number, at)
    for number, cell in enumerate(cells):
        draw.cell(number, cell)
    return Plan(machine.name, machine.sha256, tuple(draw.experiments), repeats=1, seed=request.seed, page=request.page)


def _limits(machine: Machine, request: PageRequest) -> PlannerLimits:
    """Return the limits of strokes: not a print's, which are chosen so that little rings.

    Waves that small drown in dry friction and the roughness of lines. Legs shorter than a millimetre are slower than a
    print, so that motors have torque to spare; the carriages' limit holds.
    """
    usual = planner_limits(machine)
    gain = max(carriage_gain(machine.kinematics, np.array(each)) for each in machine.kinematics.around(0.6, 30.0))
    most = min(STROKE_MM_PER_S2, CARRIAGE_SHARE * machine.limits.carriage_acceleration_mm_per_s2 / gain)
    requested = request.acceleration_mm_per_s2
    if requested is not None and requested > max(most, usual.acceleration_mm_per_s2):
        raise LimitsError(f"{requested:g} mm/s² is more than the carriages' limit allows; {most:.0f} would fit.")
    return replace(usual, acceleration_mm_per_s2=requested or most, minimum_cruise_ratio=0.0)


def _tuned_hz(machine: Machine) -> FloatArray:
    """Return frequencies of zigzags, from slow to quick, over the file's modes and as far beyond as it may be off."""
    places = [np.array(machine.kinematics.centre_mm), *machine.kinematics.around(0.6, 0.0)]
    modes = [machine.vibration.modes_at(place) for place in places]
    hz = np.concatenate([each.frequencies_hz[each.damping_ratios < RINGING] for each in modes])
    hz = hz[hz < HIGHEST_HZ]
    if not len(hz):
        raise LimitsError(f"No mode of this file rings below {HIGHEST_HZ:g} Hz: a page would show nothing.")
    return np.geomspace(hz.min() / TUNED_WIDE, min(hz.max() * TUNED_WIDE, HIGHEST_HZ), 2 * STROKES)


CELL_HALF_MM = np.array([0.5 * (LINE_MM + 5.0 + 3.0 + 5 * PITCH_MM), 0.5 * (LINE_MM + 5.0)])


def _corners(middles: FloatArray, half: FloatArray) -> FloatArray:
    """Return the corners (..., 4, 2) of rectangles around middles (..., 2), with half sides (2,), mm."""
    return middles[..., None, :] + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])


def _cells(kinematics: Kinematics) -> FloatArray:
    """Place the middles of cells (n, 2) mm: one on the bed's, others as far out and apart as bed and scanner allow."""
    centre = np.array(kinematics.centre_mm)
    if not np.all(_inside(kinematics, _corners(centre, CELL_HALF_MM))):
        raise LimitsError("The bed is too small for the page: its strokes need 55 x 30 mm in the middle of the bed.")
    angles = np.radians(np.arange(0, 360, 15))
    radii = np.arange(30.0, LARGEST_MM, 4.0)
    ring = centre + (radii[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)).reshape(-1, 2)
    room = 0.5 * LARGEST_MM - MARGIN_MM - 2 * DISC_MM - SKIRT_MM
    corners = _corners(ring, CELL_HALF_MM)
    inside = _inside(kinematics, corners.reshape(-1, 2), DISC_MM).reshape(-1, 4)
    usable = ring[np.all(inside & np.all(np.abs(corners - centre) < room, axis=2), axis=1)]
    chosen = centre[None]
    while len(chosen) < CELLS:
        usable = usable[np.any(np.abs(usable - chosen[-1]) >= 2 * CELL_HALF_MM + MARGIN_MM, axis=1)]
        if not len(usable):
            break
        distance = np.linalg.norm(usable[:, None] - chosen, axis=2).min(axis=1)
        chosen = np.vstack([chosen, usable[int(np.argmax(distance))]])
    return chosen


def _inside(kinematics: Kinematics, xy: FloatArray, margin: float = 0.0) -> BoolArray:
    return kinematics.contains(xy, -(margin + SKIRT_MM))


def _discs(kinematics: Kinematics, cells: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Scatter discs (n, 2) mm around and between the cells, far from each other."""
    corners = _corners(cells, CELL_HALF_MM).reshape(-1, 2)
    outward = MARGIN_MM + 2 * DISC_MM
    low, high = corners.min(axis=0) - outward, corners.max(axis=0) + outward
    points = rng.uniform(low, high, (4000, 2))
    apart = np.any(np.abs(points[:, None] - cells) >= CELL_HALF_MM + DISC_MM + MARGIN_MM - 1.0, axis=2)
    points = np.round(points[np.all(apart, axis=1) & _inside(kinematics, points, DISC_MM)], 2)
    chosen = [points[int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]] if len(points) else []
    while len(chosen) < DISCS and len(points):
        distance = np.min([np.linalg.norm(points - each, axis=1) for each in chosen], axis=0)
        best = int(np.argmax(distance * rng.uniform(0.8, 1.0, len(points))))
        if distance[best] < DISC_APART_MM:
            break
        chosen.append(points[best])
    if len(chosen) < 6:
        raise LimitsError("The bed is too small for the page: no six discs fit around its strokes.")
    return np.array(chosen)


class _Drawer:
    """Collects drawings as experiments."""

    def __init__(self, machine: Machine, request: PageRequest, limits: PlannerLimits) -> None:
        self.machine, self.request, self.limits = machine, request, limits
        self.slow_limits = replace(limits, acceleration_mm_per_s2=min(SLOW_MM_PER_S2, limits.acceleration_mm_per_s2))
        page = request.page
        self.area = 0.0 if page.pen else page.line_width_mm * request.height_mm
        melted = FLOW_MM3_PER_S / self.area if self.area else np.inf
        self.fastest = min(FASTEST_MM_PER_S, melted, limits.velocity_mm_per_s)
        self.experiments: list[Experiment] = []
        self.strokes = 0
        self.tuned_hz = _tuned_hz(machine)

    def add(
        self,
        kind: str,
        number: int,
        place: int,
        xy: FloatArray,
        speed: FloatArray | float,
        flow: FloatArray | float = 1.0,
        at: FloatArray | None = None,
    ) -> None:
        """Add a drawing along xy (n, 2) mm that is `at` its first point, or at a given place."""
        limits = self.limits if kind == STROKE else self.slow_limits
        xy = np.rint(xy * XYZ_COUNTS) / XYZ_COUNTS
        xyz = np.column_stack([xy, np.full(len(xy), self.request.height_mm)])
        speeds = np.broadcast_to(np.asarray(speed, dtype=float), len(xy) - 1).copy()
        plain = plain_motion(xyz, speeds, limits)
        motion = replace(plain, ends_mm=plain.ends_mm.copy())
        motion.ends_mm[:, 3] = np.cumsum(flow * np.linalg.norm(np.diff(xy, axis=0), axis=1)) * self.area / FILAMENT_MM2
        rounding = 0.0
        if kind == STROKE:
            rounding = rounding_share(motion, self.machine.kinematics, self.machine.steps.per_motor, MODES_HZ)
        x, y = (xy[0] if at is None else at).tolist()
        where = (round(x, 4), round(y, 4), self.request.height_mm)
        self.experiments.append(Experiment(f"ffcomp-{kind}-{number}", kind, place, where, motion, rounding))

    def skirt(self, cells: FloatArray, discs: FloatArray) -> None:
        """Prime the nozzle around everything that is measured."""
        points = np.concatenate([*_corners(cells, CELL_HALF_MM), discs + DISC_MM, discs - DISC_MM])
        middle, kinematics = 0.5 * (points.min(axis=0) + points.max(axis=0)), self.machine.kinematics
        half = 0.5 * np.ptp(points, axis=0) + SKIRT_MM - 1.0
        box = _corners(middle, half)
        if not np.all(kinematics.contains(box)):  # a round bed: around the outermost point
            radius = np.linalg.norm(points - kinematics.centre_mm, axis=1).max() + 1.0
            turn = np.radians(np.arange(0, 360, 5))
            box = kinematics.centre_mm + radius * np.column_stack([np.cos(turn), np.sin(turn)])
        self.add(SKIRT, 0, 0, np.vstack([box, box[:1]]), SLOW_MM_PER_S)

    def disc(self, number: int, at: FloatArray) -> None:
        """Fill a disc by a spiral from the rim to the middle, and round its rim first."""
        spacing = 0.85 * self.request.page.line_width_mm
        outer = DISC_MM - 0.5 * self.request.page.line_width_mm
        rim = np.linspace(0, 2 * np.pi, 37)
        turns = outer / spacing
        inward = np.linspace(0, 2 * np.pi * turns, int(30 * turns))[1:]
        angle = np.concatenate([rim, inward])
        radius = np.concatenate([np.full(37, outer), outer * (1 - inward / inward[-1])])
        circle = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        keep = np.append(True, np.linalg.norm(np.diff(circle, axis=0), axis=1) > 0.02)
        self.add(DISC, number, 0, at + circle[keep], SLOW_MM_PER_S, at=at)

    def cell(self, number: int, middle: FloatArray) -> None:
        """Draw five strokes that ring along x, and five that ring along y."""
        left, (x, y) = middle - CELL_HALF_MM, np.eye(2)
        for i in range(STROKES):
            self.stroke(number, i, left + np.array([3.2 + i * PITCH_MM, 0.0]), x, y)
        for i in range(STROKES):
            self.stroke(number, i, left + np.array([4.2 + STROKES * PITCH_MM, 3.2 + i * PITCH_MM]), y, x)

    def stroke(self, place: int, i: int, corner: FloatArray, excited: FloatArray, along: FloatArray) -> None:
        """Draw a zigzag that ends at the line's foot, its line, and the slow line next to it."""
        tuned = self.tuned_hz[2 * i + place % 2]  # cells share the band
        length, legs = self.zigzag(float(tuned))
        advance = ADVANCE_SHARE * length
        leg = np.sqrt(length**2 - advance**2)
        foot = corner + 4.5 * along
        offsets = [(-leg * (k % 2), -advance * k) for k in range(legs + 1)][::-1]
        points = [foot + a * excited + b * along for a, b in offsets]
        line = np.vstack([*points, foot + LINE_MM * along])
        speeds = np.full(len(line) - 1, self.fastest)
        speeds[-1] = SPEED_SHARES[i] * self.fastest
        twin = foot + TWIN_MM * excited
        self.add(SLOW, self.strokes, place, np.vstack([twin, twin + LINE_MM * along]), SLOW_MM_PER_S)
        flow = np.ones(len(speeds))
        flow[:-1] = (leg + legs * advance) / (legs * length)  # a zigzag that treads one place lays one line there
        self.add(STROKE, self.strokes, place, line, speeds, flow)
        self.strokes += 1

    def zigzag(self, tuned_hz: float) -> tuple[float, int]:
        """Return the length of a leg, from rest to rest in half a period, mm, and how many ring enough."""
        acceleration = self.limits.acceleration_mm_per_s2
        legs = RINGING_MM * (2 * np.pi * tuned_hz) ** 2 / (2 * acceleration)  # each adds 2 a/ω²
        return acceleration / (4 * tuned_hz) ** 2, int(np.clip(round(legs), 1, MOST_LEGS))


# ---- the G-code ----------------------------------------------------------------------------------


def page_lines(plan: Plan, machine: Machine, recorder: Recorder) -> Iterator[bytes]:
    """Yield the G-code of a page line by line; the bed mesh is unchanged, the shaper is off until the end."""
    page, (travel, rising) = plan.page, travel_feeds(machine)
    assert page is not None
    height = plan.experiments[0].position_mm[2]
    yield from comments((*_instructions(plan, page), *recorder.explained(), ""))
    heating = [] if page.pen else [f"M140 S{page.bed_c:g}", f"M104 S{page.nozzle_c:g}"]
    waiting = [] if page.pen else [f"M190 S{page.bed_c:g}", f"M109 S{page.nozzle_c:g}"]
    units = ("G21", "G90", "M82", "M220 S100", "M221 S100")
    yield from lines((*heating, "G28", *waiting, *units, *recorder.shaper_off()))
    yield b"G92 E%.10g\nG1 Z%.10g F%.10g\n" % (-RETRACT_MM, height + 5.0, rising)
    for experiment in plan.experiments:
        x, y, z, _ = experiment.motion.start_mm.tolist()
        yield b"; %s\nG1 X%.10g Y%.10g F%.10g\nG1 Z%.10g F%.10g\n" % (experiment.name.encode(), x, y, travel, z, rising)
        if not page.pen:
            yield b"G92 E%.10g\nG1 E0 F%.10g\n" % (-RETRACT_MM, 60 * RETRACT_MM_PER_S)
        yield from moves_within_limits(experiment.motion, machine, recorder.firmware, machine.kinematics.raisable_axes)
        if not page.pen:
            yield b"G92 E0\nG1 E%.10g F%.10g\n" % (-RETRACT_MM, 60 * RETRACT_MM_PER_S)
        yield b"G1 Z%.10g F%.10g\n" % (z + HOP_MM, rising)
    yield b"G1 Z%.10g F%.10g\nM400\n" % (min(height + 50.0, machine.kinematics.height_mm), rising)
    yield from lines((*([] if page.pen else ["M104 S0", "M140 S0"]), *recorder.shaper_on()))


def _instructions(plan: Plan, page: Page) -> list[str]:
    what = "a pen in the nozzle's place, on paper" if page.pen else "one layer, on a clean bed or on paper taped to it"
    return [
        f"A page for {plan.machine} (machine file sha256 {plan.machine_sha256[:8]}): {what}.",
        "Lines and bed must differ in brightness. Scan it at 600 dpi or more, or take a photo of all of it, straight",
        "from above, without flash. Then: ffcomp identify scan PICTURE --plan THIS.json -m MACHINE -o better.toml",
        "Speed and flow overrides are 100 %.",
        "",
    ]


# ---- what the reader of a picture needs ----------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Line:
    """A straight line of the page: from `foot`, `length_mm` along `along`; the machine rings along `across`."""

    foot: FloatArray  # (2,) mm
    along: FloatArray  # (2,)
    length_mm: float

    @property
    def across(self) -> FloatArray:
        """Return the unit vector to the left of the line, (2,)."""
        return np.array([-self.along[1], self.along[0]])

    def at(self, s: FloatArray, t: FloatArray | float = 0.0) -> FloatArray:
        """Return page positions s along and t across: (..., 2) mm."""
        return np.asarray(self.foot + s[..., None] * self.along + np.asarray(t)[..., None] * self.across)


def last_line(motion: Motion) -> Line:
    """Return the last move of a motion as a line."""
    a, b = motion.vertices_mm[-2:, :2]
    length = float(np.linalg.norm(b - a))
    return Line(a, (b - a) / length, length)


def twins(plan: Plan) -> list[tuple[Experiment, Experiment]]:
    """Return each stroke with its slow line."""
    named = {each.name: each for each in plan.experiments}
    strokes = [each for each in plan.experiments if each.kind == STROKE]
    return [(each, named[each.name.replace(STROKE, SLOW)]) for each in strokes]


def discs_of(plan: Plan) -> FloatArray:
    """Return the middles of a page's discs, (n, 2) mm."""
    return np.array([each.position_mm[:2] for each in plan.experiments if each.kind == DISC])
