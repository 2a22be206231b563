"""The written file as Marlin's queue plays it, in whole steps, on plants that share no equation with ffcomp."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from ffcomp.compensation.job import Job
from ffcomp.compensation.request import CompensateOptions
from ffcomp.firmware.marlin import Marlin
from ffcomp.firmware.marlin_planner import cut_moves
from ffcomp.firmware.program import plan_program
from ffcomp.planner.lookahead import stops_and_waits
from models.file import load_machine
from tests.support.compensated import plainly
from tests.support.marlin_played import CIRCLE, judge, read
from validation.invariants import told_apart, violations


@pytest.mark.parametrize(("case", "better"), [("tower", 3.0), ("star", 3.0), ("circle", 2.0)])
def test_marlin_leaves_what_is_predicted(case: str, better: float) -> None:
    """A cartesian printer, a delta far out, and slow: the contour error's p99 within 1.3 times the prediction."""
    (_, before, _), (_, after, predicted) = judge(case, 12.0)
    assert after.p99_um < 1.3 * predicted.contour_p99_um
    assert better * after.rms_um < before.rms_um
    assert after.seconds == pytest.approx(before.seconds, rel=0.03)


def test_slow_segments_of_a_delta_have_limits_of_its_motors() -> None:
    """Six steps last longer than a line that Marlin leaves whole; after a line that raises limits they come again."""
    machine, options = load_machine("mp-delta-pro"), CompensateOptions(flavor="marlin", predict=False)
    lines = Job(CIRCLE.encode(), "circle", machine, options).lines()
    text = b"".join(lines)
    assert text.count(b"\nM203 ") > 100
    assert re.search(rb"\nM204 P1500\n(M20[1345] .*\n){4}(;~.*\n)*M203 .*\nG1 ", text)


@pytest.mark.parametrize("sd", [0.05, 0.2])
def test_a_slow_printer_errs_no_more_than_with_the_best_shaper(sd: float) -> None:
    """An Ender-3 as it comes: 12.5 µm a step, infill at 0.5 m/s², where six steps last nine knots as it turns back."""
    lines = ["G90", "M83", "G28", "M201 X500 Y500", "M204 P500 T500", "G1 X60 Y60 Z.2 F6000"]
    for i in range(24):
        back, x = 9.0 * (i % 2), 60 + 0.45 * i
        lines += [f"G1 X{x + back:.3f} Y{69.0 - back + 0.3 * (i % 7):.3f} E.2 F3000", f"G1 X{x + back + 0.45:.3f} E.02"]
    machine = load_machine("ender-3")
    limits = replace(machine.limits, carriage_acceleration_mm_per_s2=5000.0, acceleration_mm_per_s2=500.0)
    machine = replace(machine, limits=limits, uncertainty={"default": sd})
    written = Job("\n".join(lines).encode(), "infill", machine, CompensateOptions(flavor="marlin")).lines()
    assert len(b"".join(written))
    expected = written.value.forecast.expected
    assert expected is not None and expected.compensated_um < 1.05 * expected.shaper_um


@pytest.mark.parametrize("name", ["prusa-mk3s", "ender-3"])
def test_the_stated_time_is_that_of_the_queue(name: str) -> None:
    """At squares with z-hops: early segments count as well as late ones, and a lift before a retraction ends fast."""
    lines = ["G90", "M83", "G28", "G1 X60 Y60 Z0.3 F6000"]
    for i in range(12):
        x, y = 60 + 37 * i % 80, 60 + 23 * i % 80
        lines += ["G1 E-0.8 F2100", "G1 Z0.7 F600", f"G1 X{x} Y{y} F7200", "G1 Z0.3 F600", "G1 E0.8 F2100"]
        lines += [f"G1 X{x + dx} Y{y + dy} E0.5 F3000" for dx, dy in ((12, 0), (12, 12), (0, 12), (0, 0))]
    machine = load_machine(name)
    options = CompensateOptions(flavor="marlin", predict=False)
    written = Job("\n".join(lines).encode(), "squares", machine, options).lines()
    data = b"".join(written)
    stated = written.value.statistics.print_time_s
    assert stated == pytest.approx(plan_program(read(data, machine), machine).trajectory.end_t, rel=6e-3)


@pytest.mark.parametrize("robust", [False, True])
def test_slow_lifts_are_late_rather_than_slower(robust: bool) -> None:
    """Z may do 100 mm/s² only, and no file can raise it: beside a lift the travel waits, which costs far less."""
    lines = ["G90", "M83", "G28", "G1 X60 Y60 Z.2 F6000"]
    for x in range(60, 80):
        lines += ["G1 E-1 F1800", "G1 Z.6 F600", f"G0 X{x} Y60 F9000", "G1 Z.2 F600", "G1 E1 F1800"]
        lines += [f"G1 X{x + 10} Y65 E.4 F3000", f"G1 X{x} Y70 E.4"]
    machine = load_machine("ender-3")
    options = plainly(predict=False, flavor="marlin", robust="on" if robust else "off")
    stream = Job("\n".join(lines).encode(), "lifts", machine, options).lines()
    assert len(b"".join(stream))
    found = stream.value.statistics
    assert not found.slowed
    assert found.print_time_s < 1.035 * found.original_print_time_s


@pytest.mark.parametrize(("flavor", "most_s"), [("marlin", 0.6), ("klipper", 0.2)])  # of 5.6 s
def test_a_purge_line_that_descends_keeps_nearly_its_speed(flavor: str, most_s: float) -> None:
    """Z's own acceleration limits the ramps, and Z stops at the corner: both are slowed there, and only there."""
    lines = b"G90\nM83\nG28\nM201 X4000 Y4000 Z200\nM204 P4000 T4000\nM205 X8 Y8 Z2 E10\nG0 X0 Y-4 Z15 F4800\n"
    lines += b"G0 E7 X15 Z0.2 F500\nG0 X25 E4\nG0 X35 E4 F650\nG0 X45 E4\nG0 X48 Z0.05 F8000\nG0 X51 Z0.2\n"
    stream = Job(lines, "purge", load_machine("prusa-mk4"), CompensateOptions(flavor=flavor, predict=False)).lines()
    assert len(b"".join(stream))
    assert sum(each.seconds for each in stream.value.statistics.slowed) < most_s


def test_a_long_lift_of_a_delta_keeps_its_speed() -> None:
    """Its ends on whole steps lie a few µm beside each other, and Marlin cuts its line: it is as long as planned."""
    lines = b"G90\nM83\nG28\nG1 X-100 Y2 Z.9 F6000\nG1 X-108.243 Y1.579 E.5 F3000\nG1 E-1 F3600\nG1 Z60 F6000\n"
    written = Job(lines, "lift", load_machine("flsun-qqs"), CompensateOptions(flavor="marlin", predict=False)).lines()
    text = b"".join(written)
    assert max(float(feed) for feed in re.findall(rb"^G1[^;\n]* F([\d.]+)", text, re.MULTILINE)) < 9000


def test_a_wipe_of_few_steps_takes_the_filaments_time() -> None:
    """Of a stroke of 0.1 mm out and back only the filament is left: it was to take 70 s."""
    lines = b"G90\nM83\nG28\nG1 X119.636 Y113.77 Z9 F9000\nG1 E.8 F1800\nG1 X119.67 Y113.67 E.00175 F15000\n"
    lines += b"; WIPE_START\nG1 X119.636 Y113.77 E-.76 F33600\n; WIPE_END\nG1 E-.04 F1800\n"
    written = Job(lines, "wipe", load_machine("bambu-a1"), plainly(flavor="marlin", predict=False)).lines()
    text, found = b"".join(written), written.value.statistics
    assert re.search(rb"^G1 E-.7", text, re.MULTILINE) and found.print_time_s < found.original_print_time_s + 0.2


@pytest.mark.parametrize(
    ("name", "middle", "filament"), [("ender-3", 60, "M83"), ("ender-3", 60, "M82\nM221 S90"), ("kossel", 0, "M82")]
)
def test_no_segment_is_dropped_before_a_line_of_the_file(name: str, middle: int, filament: str) -> None:
    """Lines every 0.02 mm, at slow lifts and just before a retraction: all go out where they stood, within six steps.

    What Marlin drops it joins to the next line, which may be a retraction, whose time and acceleration are its own.
    """
    lines, e = ["G90", filament, "G28", f"G1 X{middle} Y{middle} Z0.3 F6000"], 0.0

    def fed(mm: float) -> str:
        nonlocal e
        e = e + mm if filament.startswith("M82") else mm
        return f"E{e:.5f}"

    for i in range(0, 12, 2):
        x, y = middle + 7 * i % 20, middle + 11 * i % 30
        lines += [f"G1 {fed(0.8)} F2100"]
        for k in range(24):
            lines += [f"G1 X{x + 0.02 * k:.2f} Y{y} {fed(0.001)} F{60 * (i + 1)}", f"M106 S{k}"]
            if k == 7:
                lines, e = [*lines, "G92 E0"], 0.0
        lines += [f"G1 X{x + 20} {fed(0.7)} F3000", "M107", f"G1 X{x + 20.03:.2f} {fed(0.001)}", "M106 S9"]
        lines += [f"G1 X{x + 20.05:.2f}", "M107", f"G1 {fed(-0.8)} F2100"]
        lines += [
            "G1 Z0.7 F600",
            f"G1 X{middle + (7 * i + 14) % 20} Y{middle + (11 * i + 22) % 30} F7200",
            "G1 Z0.3 F600",
        ]
    machine, data = load_machine(name), "\n".join(lines).encode()
    written = Job(data, "lines", machine, CompensateOptions(flavor="marlin", predict=False)).lines()
    text = b"".join(written)
    assert violations(data, text, machine, written.value.placement.offset, flavor="marlin") == []
    program = cut_moves(read(text, machine), machine)
    moves, (stops, waits) = program.moves, stops_and_waits(program)
    blocks, ends = Marlin().planner(program, machine).blocks(moves, stops | (waits > 0.0))
    executed = np.zeros(len(moves), dtype=np.bool_)
    executed[ends[blocks.target]] = True
    ours = np.isin(moves.line, told_apart(text.splitlines(keepends=True)).segments)
    ours &= np.any(moves.end[:, :3] != moves.start[:, :3], axis=1)
    assert np.count_nonzero(ours) > 200
    assert executed[ours].all()
