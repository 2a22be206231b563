"""benchmarks/PERFORMANCE.md, from the numbers that `performance.py` keeps; a section without any is left out."""

from __future__ import annotations

import platform
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks import steps
from benchmarks.performance_methods import REACH, SAMPLE_S
from benchmarks.performance_prints import LARGEST, REPEATED, SMALL_S
from benchmarks.performance_verdicts import VERDICTS
from benchmarks.performance_ways import COMPENSATED, DENSE, MACHINE, ZERO_PHASE
from benchmarks.performance_where import ONCE, REST
from models.vibration.scheduled import SAME_MM
from studies.effects_compensated import LAYERS, PRINT, SECONDS, as_table
from studies.prose import WIDTH

Numbers = Mapping[str, Any]

AIM_MEMORY_MB, AIM_SPEED, AIM_FIRST_S, AIM_STEPS = 500.0, 300.0, 40.0, 5.0
ZERO_PHASE_SHOWN = ("us_per_segment", "contour_um", "tracking_no_delay_um", "peak_m_per_s2")


def page(found: Numbers) -> Iterator[str]:
    yield from introduction()
    for name, (title, write) in WRITERS.items():
        if name in found:
            yield f"\n## {title}\n"
            yield from write(found[name])
    if {"where", "ways", "lengths"} <= set(found):
        yield "\n## What limits it now\n"
        yield from limits(found)


def introduction() -> Iterator[str]:
    yield f"""# Performance

Made by `python -m benchmarks.performance --keep DIR --write` (Python {platform.python_version()}, machine file
`{MACHINE}.toml` if no other is named). One core; times are CPU times, the best of some rounds, and what is compared was
measured in turns in one process: the machine had other work to do, which is not counted, but shares its caches, so that
single figures scatter by a fifth. A *segment* is one of 250 a second, before straight ones are joined. Absolute speeds
are this processor's; ratios travel better.
"""


# ---- side by side --------------------------------------------------------------------------------


def side_by_side(found: Numbers) -> Iterator[str]:
    yield """What it costs to compute a command, and what that command is worth on the nonlinear virtual printer (which
is as the machine file says; [comparison.md](../studies/reports/comparison.md) has printers that are not). Errors are
rms in µm, tracking raw and in brackets with the best constant delay removed; peak is the largest acceleration that a
carriage is asked for over 4 ms.

"""
    yield listed(f"""
- **ours**: the inverse as `ffcomp compensate` uses it. **FBS, one model**: the same with the model of the bed's
  middle.
- **zero-phase-error tracking** (Tomizuka 1987): the inverse of the three towers' sampled model, from 4 ms to 4 ms, one
  for every 10 mm of the bed. Six of its zeros lie outside the unit circle (three near 14: the drive's own right
  half-plane zero; three near -3.5: of the sampling). They stay out of the inverse, their phase is cancelled, and what
  is left of them is a gain that falls to 0.9 at 40 Hz and 0.63 at 80 Hz. {REACH} samples before and after. It weighs no
  effort, knows no limit and no J̇ q̇.
- **shapers**: the frequency and damping ratio that serve these very stretches best, one for the bed or following the
  mode.
- The first two go the whole way: G-code text, read again and planned as the firmware plans it, with its ramps. The
  others are played as computed, which flatters them. Computing: from the plan to the nozzle's command at every
  segment's end; not the plan, and not the text. A firmware's shaper costs nothing before the print.
""")
    for name, table in found.items():
        yield f"\n### {name}\n\n{table['told']}\n"
        yield from one_table(table["rows"])
        if table[DENSE]:
            yield from dense_words(table[DENSE])


def one_table(rows: list[Numbers]) -> Iterator[str]:
    yield "| way | µs a segment | print-seconds a second | tracking (no delay) | contour | peak m/s² |"
    yield "|---|---|---|---|---|---|"
    for r in rows:
        yield (
            f"| {r['label']} | {r['us_per_segment']:.3g} | {r['print_s_per_s']:,.0f} "
            f"| {r['tracking_um']:.1f} ({r['tracking_no_delay_um']:.2f}) "
            f"| {r['contour_um']:.2f} | {r['peak_m_per_s2']:.1f} |"
        )
    yield ""


def dense_words(d: Numbers) -> Iterator[str]:
    yield f"""
*Dense, by cvxpy* (CLARABEL): all {d["unknowns"]:.0f} unknowns of one run of {d["run_s"]:.1f} s in one problem, and
again for each of two corrections: {d["dense_us"]:,.0f} µs a segment, where ours takes {d["ours_us"]:.1f}
({d["dense_us"] / d["ours_us"]:,.0f} times less). The two commands differ by {d["dense_to_ours_um"]:.3f} µm at most.
"""


# ---- whole prints --------------------------------------------------------------------------------


def whole_prints(found: Numbers) -> Iterator[str]:
    yield f"""From file to file: read, planned, inverted, written; without the prediction, as with `--no-predict`. The
first time, the tables over the bed and the gains of the places that the print comes by are worked out; they are kept in
the user's cache (`ffcomp/inverse/disk_cache.py`), and the second column of print-seconds is of a job that finds
them there (of a print that takes more than a minute of CPU it repeats the first). Memory is
the peak of a process that did nothing else; the aim is {AIM_MEMORY_MB:g} MB, and {AIM_SPEED:g} print-seconds a second.
The files of others are what `validation/all_files.py` reads; they are not part of this repository.

| file | machine | print s | segments | CPU s | print-seconds a second | again | µs a segment | MB in, out | MB |
|---|---|---|---|---|---|---|---|---|---|"""
    done = {name: r for name, r in found.items() if "failed" not in r}
    for name, r in done.items():
        yield _print_row(f"{name} | {r['machine']}", r)
    yield ""
    yield from (r["failed"] for r in found.values() if "failed" in r)
    yield ""
    over = [name for name, r in done.items() if r["peak_mb"] > AIM_MEMORY_MB]
    if over:
        yield f"More than {AIM_MEMORY_MB:g} MB: {', '.join(over)}.\n"
    slow = [name for name, r in done.items() if r["print_s"] / r["again_cpu_s"] < AIM_SPEED]
    if slow:
        yield f"Fewer than {AIM_SPEED:g} print-seconds a second, again too: {', '.join(slow)}.\n"


def _print_row(label: str, r: Numbers) -> str:
    return (
        f"| {label} | {r['print_s']:,.0f} | {r['segments']:,} | {r['cpu_s']:.2f} | {r['print_s'] / r['cpu_s']:,.0f} "
        f"| {r['print_s'] / r['again_cpu_s']:,.0f} | {1e6 * r['cpu_s'] / r['segments']:.1f} "
        f"| {r['in_mb']:.2g}, {r['out_mb']:.3g} | {r['peak_mb']:.0f} |"
    )


def lengths(found: Numbers) -> Iterator[str]:
    prints = found["prints"]
    most = max(r["peak_mb"] for r in prints.values())
    largest, loaded = max(r["in_mb"] for r in prints.values()), next(iter(prints.values()))["loaded_mb"]
    yield f"""The layers of a sample print again and again, as text: {REPEATED} has 172 runs between retractions in 346
s; {LARGEST} is the largest text for its time. (The nozzle would go down through the print at every beginning: this is
not to be printed.)

| print | print s | segments | CPU s | print-seconds a second | again | µs a segment | MB in, out | MB |
|---|---|---|---|---|---|---|---|---|"""
    for name, r in prints.items():
        yield _print_row(name, r)
    yield f"""
![CPU time and memory against length](performance_length.png)

CPU time is {found["once_s"]:.2f} s once and a second for every {found["print_s_per_s"]:.0f} print-seconds; between the
two longest it grows with the power {found["exponent"]:.3f} of the length. Memory does not grow: {most:.0f} MB at most,
for up to {largest:.0f} MB of text, of which {loaded:.0f} MB are there after a print of one layer
(Python, its libraries, the tables over the bed). A file is cut into chunks of five minutes at most, where the nozzle
rests or in motion, and only they are held.
"""


def two(found: Numbers) -> Iterator[str]:
    one, both = found["1"], found["2"]
    same = "the same bytes" if found["identical"] else "OTHER BYTES"
    yield f"""{one["print_s"]:,.0f} s of {REPEATED} with `--jobs 1` and `--jobs 2`, each the better of two:
{one["wall_s"]:.1f} and {both["wall_s"]:.1f} s of wall time ({one["wall_s"] / both["wall_s"]:.2f} times), {same}; a
load of {found["load"]:.1f} at the end, our own included. Starting a process, its compiled code and tables, takes some
2 s of CPU time, and reading, cutting and writing stay with one: that is much of so quick a job.
"""


def place(found: Numbers) -> Iterator[str]:
    ours = np.array(found["ours_us"])
    yield f"""Rings and zigzags 14 mm across, {found["print_s"][0]:.0f} s of them, at growing distance from the bed's
middle.

![Time against place](performance_place.png)

| radius, mm | {" | ".join(f"{r:g}" for r in found["radius_mm"])} |
|---|{"---|" * len(found["radius_mm"])}
| ours, µs a segment | {" | ".join(f"{us:.2f}" for us in ours)} |

From least to most it varies by {100 * np.ptp(ours) / ours.mean():.0f} %, without a trend: what depends on the place is
looked up, never searched.
"""


# ---- where the time goes -------------------------------------------------------------------------


def where(found: Numbers) -> Iterator[str]:
    stages = found["stages"]
    yield f"""CPU time of a whole job, file to file, by stage; a stage that another one calls is not counted twice. In
µs for each segment written, and in brackets the share. Gains and plant are worked out once for a machine and the
places a print comes by: they do not grow with its length.

![Stages of a job](performance_stages.png)

| stage | {" | ".join(stages)} |
|---|{"---|" * len(stages)}"""
    for stage in stage_order(stages):
        cells = [_share(each, stage) for each in stages.values()]
        yield f"| {stage} | {' | '.join(cells)} |"
    sums = [1e6 * sum(each["seconds"].values()) / each["segments"] for each in stages.values()]
    alone = [1e6 * each["unwatched_s"] / each["segments"] for each in stages.values()]
    yield f"| **together** | {' | '.join(f'{us:.2f}' for us in sums)} |"
    yield f"| unwatched | {' | '.join(f'{us:.2f}' for us in alone)} |"
    yield ""
    yield from kernels(found)


def stage_order(stages: Numbers) -> list[str]:
    names = dict.fromkeys(stage for each in stages.values() for stage in each["seconds"] if stage != REST)
    order = {"read": 0, "plan": 1, ONCE: 2, "write": 9}
    return [*sorted(names, key=lambda name: (order.get(name, 5), name)), REST]


def _share(each: Numbers, stage: str) -> str:
    seconds = each["seconds"].get(stage, 0.0)
    return f"{1e6 * seconds / each['segments']:.2f} ({100 * seconds / sum(each['seconds'].values()):.0f} %)"


def kernels(found: Numbers) -> Iterator[str]:
    counts, peaks = found["counts"], found["peaks"]
    yield f"""### Kernels

Operations are counted from the loops' bounds: a multiplication and an addition for each entry of a matrix.
`sweep_back` multiplies with 33 × 27 numbers a segment ({counts["sweep_back"]:,} operations), `sweep_forward` with
27 × 24 ({counts["sweep_forward"]:,}), both in single precision: they answer an error that is left, and that is
then measured again. `simulate` multiplies with 27 × 12 and three drives at each of 4 steps
({counts["simulate, a step"]} a step) in double precision, and wherever the nozzle has gone {SAME_MM:g} mm it
interpolates its model between four places ({counts["a model"]:,}). Each kernel by itself, on what a print calls it
with.

| print | kernel | passes over each segment | operations a pass | ns | GFLOP/s | share of gemm | share of a recursion |
|---|---|---|---|---|---|---|---|"""
    for name, each in found["kernels"].items():
        for kernel, k in each.items():
            yield (
                f"| {name} | `{kernel}` | {k['passes']:.2f} | {k['operations_per_knot']:,.0f} | {k['ns_per_knot']:.0f} "
                f"| {k['gflops']:.1f} | {100 * k['gflops'] / peaks['gemm ' + k['precision']]:.0f} % "
                f"| {100 * k['gflops'] / peaks['recursion ' + k['precision']]:.0f} % |"
            )
    yield f"""
What this core can do, in GFLOP/s: a product of large matrices (gemm) {peaks["gemm double"]:.0f} in double and
{peaks["gemm single"]:.0f} in single precision; a recursion z ← Gᵀ z of 25 × 24, our own, with one matrix that stays in
the nearest cache {peaks["recursion double"]:.0f} and {peaks["recursion single"]:.0f}; in double precision a matrix of
0.5 MB times a vector {peaks["gemv near"]:.0f}, a matrix from memory times a vector {peaks["gemv far"]:.1f}, and one
multiplication and addition after the other, each waiting for the last, {peaks["chain"]:.1f}.
"""


def limits(found: Numbers) -> Iterator[str]:
    lengths_, work, tables = found["lengths"], floor(found), found["ways"].values()
    cheaper, contour, tracking, peak = (zero_phase(tables, what) for what in ZERO_PHASE_SHOWN)
    yield listed(f"""
- **The arithmetic itself**: the kernels, with all their passes over it, need {work["operations"]:,.0f}
  operations for a segment of 4 ms. At the speed of a gemm that would be {work["gemm_us"]:.2f} µs, at that of a
  recursion {work["recursion_us"]:.2f} µs; it is {work["kernels_us"]:.2f} µs. A job of ten hours takes
  {work["job_us"]:.1f} µs for each 4 ms of print: {work["job_us"] / work["gemm_us"]:.0f} times the floating-point
  limit of this core, {work["job_us"] / work["recursion_us"]:.0f} times that of such a recursion.
- **Why not the speed of a gemm**: each product needs the one before it, state after state, so that there is never more
  to compute than one small matrix times one vector. Every entry of a matrix is used once for each time it is loaded,
  from the second cache where the place has just changed, and 24 or 27 rows are few additions to do while the last
  result is on its way. Several runs side by side would share a matrix only where they are at one place.
- **Around the kernels**: they are {100 * work["kernel_share"]:.0f} % of a job on a sample print;
  {100 * work["once_share"]:.0f} % is done once for a machine and the places a print comes by, and the largest of all
  other stages, "{work["largest"]}", is {100 * work["largest_share"]:.0f} %.
- **Short prints**: {lengths_["once_s"]:.2f} s go to what is done once, and a process takes more than a second to start
  (the first run on a machine has its own section): that is most of what one waits for.
- **What is cheaper**: shapers, and zero-phase-error tracking, which costs {between(cheaper)} of ours. Its contour error
  is {between(contour)} times ours, its tracking error {between(tracking)} times, and it asks for {between(peak)} times
  the peak acceleration, without a way to hold a limit.
""")


def step_timings(found: Numbers) -> Iterator[str]:
    slowest = min(row["steps"] / row["cpu_s"] for rows in found.values() for row in rows[:2]) / 1e6
    yield f"""`--kind steps` (exact) and `--kind klipper-steps` (compressed): from a print's plan to an archive,
three carriages and the filament. *Sampled* is what one would write in NumPy at first, and it writes no file: the plan
at every moment, inverse kinematics, whole microsteps, straight lines between. Errors are against the exact
steps, which are off by half a tick of the board's clock.

{steps.HEAD}"""
    for name, rows in found.items():
        yield from (steps.line(name, steps.Row(**row)) for row in rows)
    yield f"\nAt the least {slowest:.0f} million steps a second; the aim is {AIM_STEPS:g} million."


def floor(found: Numbers) -> dict[str, Any]:
    """Of a segment, on average of the prints: operations, µs at the limits, in the kernels, in a long job; shares."""
    kernels_, peaks = found["where"]["kernels"].values(), found["where"]["peaks"]
    count = np.mean([sum(map(_operations, each.values())) for each in kernels_])
    at_best = {
        limit: np.mean([sum(_operations(k) / peaks[f"{limit} {k['precision']}"] for k in e.values()) for e in kernels_])
        for limit in ("gemm", "recursion")
    }
    ns = np.mean([sum(k["passes"] * k["ns_per_knot"] for k in each.values()) for each in kernels_])
    longest = max(found["lengths"]["prints"].values(), key=lambda r: r["print_s"])
    stages = [each["seconds"] for each in found["where"]["stages"].values()]
    share = {name: np.mean([each.get(name, 0.0) / sum(each.values()) for each in stages]) for name in stages[0]}
    kernel, once = ("invert: sweeps", "invert: simulation"), (ONCE, "invert: gains")
    largest = max((name for name in share if name not in (*kernel, *once)), key=lambda name: share[name])
    return {
        "operations": float(count),
        "gemm_us": float(at_best["gemm"]) / 1e3,
        "recursion_us": float(at_best["recursion"]) / 1e3,
        "kernels_us": float(ns) / 1e3,
        "job_us": 1e6 * longest["cpu_s"] / longest["print_s"] * SAMPLE_S,
        "kernel_share": sum(share[name] for name in kernel),
        "once_share": sum(share[name] for name in once),
        "largest": largest.removeprefix("invert: "),
        "largest_share": share[largest],
    }


def _operations(kernel: Numbers) -> float:
    """With all passes over a segment."""
    return float(kernel["passes"] * kernel["operations_per_knot"])


def zero_phase(tables: Iterable[Numbers], what: str) -> list[float]:
    """A number of zero-phase-error tracking, as a share of ours; one of each print."""
    pairs = [
        [next(r[what] for r in t["rows"] if r["name"] == name) for name in (ZERO_PHASE, COMPENSATED)] for t in tables
    ]
    return [its / ours for its, ours in pairs]


def between(ratios: Sequence[float]) -> str:
    """From the least to the greatest, or one number if they read alike."""
    low, high = (f"{x:.2g}" if x < 1 else f"{x:.1f}" if x < 10 else f"{x:,.0f}" for x in (min(ratios), max(ratios)))
    return low if low == high else f"{low} to {high}"


def listed(text: str) -> str:
    """A list whose items are filled anew: numbers have any length."""
    items = re.split(r"^- ", text.strip(), flags=re.MULTILINE)[1:]
    return "\n".join(
        textwrap.fill(
            " ".join(item.split()),
            WIDTH,
            initial_indent="- ",
            subsequent_indent="  ",
            break_long_words=False,
            break_on_hyphens=False,
        )
        for item in items
    )


def _us(rows: list[Numbers], name: str) -> float:
    return float(next(r for r in rows if r["name"] == name)["us_per_segment"])


# ---- first runs, effects -------------------------------------------------------------------------


def first(found: Numbers) -> Iterator[str]:
    a, b = found["first"], found["again"]
    met = "met" if a["cpu_s"] < AIM_FIRST_S else "not met"
    yield f"""`ffcomp compensate` as a user calls it, on {SMALL_S:g} s of {REPEATED}, prediction included; with an empty
`NUMBA_CACHE_DIR`, and again. Once compiled, the code is kept ({found["cache_mb"]:.1f} MB).

| | CPU s | wall s |
|---|---|---|
| first run on a machine | {a["cpu_s"]:.1f} | {a["wall_s"]:.1f} |
| second | {b["cpu_s"]:.1f} | {b["wall_s"]:.1f} |

Aim: {AIM_FIRST_S:g} s, {met} in CPU time; wall time depends on what else the machine does.
"""
    yield VERDICTS


def effects(found: Numbers) -> Iterator[str]:
    yield f"""Effects that no linear model holds are compensated by playing the command on the whole virtual printer and
correcting it, round by round (`ffcomp/inverse/nonlinear.py`). Here each effect is hidden in the
*independent* printer of
`validation/blind` (other equations; the last column says where the effect has another shape than the machine file's),
and {SECONDS:g} s of `{PRINT.name}` (layers {LAYERS.first_layer} to {LAYERS.last_layer}) are printed there. Contour
error, rms, µm: with no compensation; with a file that is right in all but the effect; with one that names the effect
and its size; on the printer without the effect (the same as before if nothing were lost); and with the knowing command
on our own virtual printer, whose effect has the file's shape. *Rounds* of the whole printer: 0 where the linear model
holds the effect by itself. *Share of a limit*: the most that a carriage is asked for, with the file that does not know
the effect and with the one that does. Sizes are draws of the blind test. Made also by
`python -m studies.effects_compensated`. `arm_inertia` is not among them yet: the independent printer can hide
it only since its arms turn. The linear model holds it as it holds `effector_mass`.
"""
    yield ""
    yield from as_table(found)
    yield ""
    beyond = {name: r for name, r in found.items() if r["rounds"]}
    if beyond:
        yield from _beyond(beyond, max(r["cpu_s_per_print_s"] for r in found.values() if not r["rounds"]))


def _beyond(beyond: Numbers, linear: float) -> Iterator[str]:
    def words(names: list[str]) -> str:
        return ", ".join(f"`{name}` ({beyond[name]['knowing_um'] / beyond[name]['without_um']:.1f})" for name in names)

    left = {name: r["knowing_um"] / r["without_um"] for name, r in beyond.items()}
    near, far = [n for n in left if left[n] <= 2.0], [n for n in left if left[n] > 2.0]
    shape = [n for n in far if beyond[n]["own_um"] < 2.0 * beyond[n]["without_um"]]
    loop = [n for n in far if n not in shape]
    slowest = max(beyond, key=lambda name: beyond[name]["cpu_s_per_print_s"])
    most = beyond[slowest]["cpu_s_per_print_s"]
    yield listed(f"- Within twice of the printer without the effect (times, in brackets): {words(near) or 'none'}.")
    if far:
        yield listed(f"- Not: {words(far)}.")
    if shape:
        yield listed(
            f"- Of these, {_named(shape)} would be, on a printer whose effect has the shape that the file can say: "
            "what is left comes of the other shape."
        )
    if loop:
        yield listed(f"- The loop itself does not get there for {_named(loop)}.")
    yield listed(
        f"- The cost: up to {most:.2f} s of CPU time a print-second (`{slowest}`), {1 / most:.0f} print-seconds a "
        f"second, against {1e3 * linear:.0f} ms where the linear model holds the effect."
    )


def _named(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


WRITERS: Mapping[str, tuple[str, Callable[[Numbers], Iterator[str]]]] = {
    "ways": ("Ways to a command, side by side", side_by_side),
    "prints": ("Whole prints, end to end", whole_prints),
    "lengths": ("Time and memory against length", lengths),
    "two": ("Two processes", two),
    "place": ("Time against bed position", place),
    "where": ("Where the time goes", where),
    "steps": ("Step timings", step_timings),
    "first": ("The first run on a machine", first),
    "effects": ("Effects that are not linear", effects),
}
