"""The module for Klipper's host, in the real Kalico's batch mode: what it plays, and what comes between.

Runs where KALICO_PYTHON names the python of an environment with Kalico in it; see validation/kalico.py.
"""

from __future__ import annotations

import json
import random
import subprocess
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ffcomp.compensation.job import Job
from ffcomp.steps.archive import MotorSteps, read_steps
from ffcomp.steps.sink import Board
from gcode.reader import read_program
from models.file import load_machine
from models.machine import Machine
from tests.support.compensated import job
from tests.support.klipper_host import E_STEPS_PER_MM, FOLDER, Place, Played, Steps, play, reader
from validation import kalico

pytestmark = pytest.mark.kalico


def host_job(data: bytes, machine: Machine, kind: str = "host") -> Job:
    return job(data, machine, kind=kind, extruder_steps_per_mm=E_STEPS_PER_MM, flavor="klipper", predict=False)


SAME_S = 1e-6
HOST_PIECES = Path(__file__).parents[1] / "support" / "host_pieces.py"
LIMITS = [300.0, 3000.0, 5.0, 0.5]  # of the configuration
LEAD_IN_STEPS = 4 * 80  # of each tower, at the least


def two_objects(layers: int = 4) -> bytes:
    """Two small squares a layer, each an object, with fans and retraction."""
    lines = ["G90\nM83\nEXCLUDE_OBJECT_DEFINE NAME=A\nEXCLUDE_OBJECT_DEFINE NAME=B\nG1 X-20 Y-5 Z0.2 F9000\n"]
    for layer in range(layers):
        lines.append(f"G1 Z{0.2 * (layer + 1):.1f} F1200\nM106 S{100 + layer}\n")
        for name, x in (("A", -20), ("B", 10)):
            lines.append(f"EXCLUDE_OBJECT_START NAME={name}\nG1 X{x} Y-5 F9000\nG1 E0.5 F2400\n")
            corners = ((10, 0), (10, 10), (0, 10), (0, 0)) * 4
            lines.extend(f"G1 X{x + u} Y{v - 5} E0.33 F3600\n" for u, v in corners)
            lines.append(f"G1 E-0.5 F2400\nEXCLUDE_OBJECT_END NAME={name}\n")
    return "".join(lines).encode()


@dataclass(frozen=True)
class Prints:
    """Files of motion in one folder, and the steps that they should become."""

    folder: Path
    begin: dict[str, Place]
    steps: dict[str, dict[str, MotorSteps]]

    def play(self, name: str = "compensated", **options: object) -> Played:
        return play(self.folder, f"FFCOMP_PRINT FILE={name}.ffm", self.begin[name], **options)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def prints(tmp_path_factory: pytest.TempPathFactory) -> Prints:
    folder, machine = tmp_path_factory.mktemp("host"), load_machine("mp-delta-pro")
    name = "compensated"
    with pytest.MonkeyPatch.context() as patch:
        for name_of in ("LEAST_KNOTS", "MOST_KNOTS"):  # short: pauses fall within a path, too
            patch.setattr(f"ffcomp.steps.motion.{name_of}", 128)
        patch.setattr("ffcomp.compensation.job.Board", partial(Board, clock_hz=50e6))
        host_job(two_objects(), machine).write_steps(folder / f"{name}.ffm")
        host_job(two_objects(), machine, kind="steps").write_steps(folder / f"{name}.npz")
    steps, begin = {name: read_steps(folder / f"{name}.npz")}, {name: begin_of(folder / f"{name}.ffm")}
    return Prints(folder, begin, steps)


def begin_of(path: Path) -> Place:
    """Where a file's motion begins."""
    stream, header = reader().open_motion(path)
    with stream:
        first = next(record for record in reader().records(stream, header) if hasattr(record, "places"))
    x, y, z = first.places[0, :3].tolist()
    return x, y, z


@pytest.fixture(scope="module")
def whole(prints: Prints) -> Played:
    return prints.play()


def same_ways(found: Steps, other: Steps) -> bool:
    return len(found.way) == len(other.way) and bool((found.way == other.way).all())


def test_steps_are_those_of_output_steps(prints: Prints, whole: Played) -> None:
    """To 1 µs; 0.04 was measured, two ticks of the board's clock."""
    assert whole.result["state"] == "complete"
    for motor, wanted in prints.steps["compensated"].items():
        n = len(wanted.time_s)
        assert n > 500
        found = whole.steps[motor]
        np.testing.assert_array_equal(found.way[-n:], wanted.direction)
        late = found.time_s[-n:] - wanted.time_s
        assert np.abs(late - np.median(late)).max() < SAME_S


def test_pieces_handed_over_at_once_are_the_same_motion(tmp_path: Path) -> None:
    """Compiled, pieces that go on as the one before are one; without a compiler all go one by one."""
    words = [kalico._python(), str(HOST_PIECES), str(FOLDER), str(tmp_path / "pieces.so")]
    done = subprocess.run(words, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr
    single, compiled, without = json.loads(done.stdout)
    assert compiled["compiled"] and not without["compiled"] and without == single
    assert compiled["end"] == pytest.approx(single["end"], abs=1e-12)
    assert len(compiled["moves"]) < 0.8 * len(single["moves"])
    t = np.linspace(1.0, single["end"], 1000)
    np.testing.assert_allclose(*(along(np.array(each["moves"]), t) for each in (compiled, single)), atol=1e-12)


def along(moves: NDArray[np.float64], t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where moves (n, 6: begin, duration, place, speed, acceleration, direction) are at these times."""
    k = np.searchsorted(moves[:, 0], t, side="right") - 1
    begin, lasts, place, speed, change, way = moves[k].T
    since = np.minimum(t - begin, lasts)
    found: NDArray[np.float64] = place + way * (speed + 0.5 * change * since) * since
    return found


def test_twenty_pauses_lose_no_step_and_open_no_limit(prints: Prints, whole: Played) -> None:
    """The clock runs down on the path and up again: the same steps in the same order, none sooner than it may be."""
    first, last = 2, whole.result["records"] - 12  # the card reads ahead by some lines
    chosen = [round(first + (last - first) * (k + random.Random(k).random()) / 20) for k in range(20)]
    played = prints.play(at=[(n, "PAUSE\nM400\nRESUME") for n in chosen])
    assert played.result["state"] == "complete" and played.result["limits"] == LIMITS
    assert not [line for line in played.result["said"] if "paused" in line]
    assert played.result["position"] == pytest.approx(whole.result["position"], abs=1e-9)
    assert 1.0 < played.lasts_s - whole.lasts_s < 20 * 0.26
    for motor, steps in played.steps.items():
        assert same_ways(steps, whole.steps[motor])
        assert np.diff(steps.time_s).min() > 0.999 * np.diff(whole.steps[motor].time_s).min()


def test_cancel_ends_on_the_path(prints: Prints, whole: Played) -> None:
    played = prints.play(at=[(25, "CANCEL_PRINT")])
    assert played.result["state"] == "cancelled" and played.result["limits"] == LIMITS
    for motor, steps in played.steps.items():
        n = len(steps.way)
        assert LEAD_IN_STEPS * (motor != "e") < n < len(whole.steps[motor].way)
        np.testing.assert_array_equal(steps.way, whole.steps[motor].way[:n])


def test_an_excluded_object_is_left_out(prints: Prints, whole: Played) -> None:
    """B from its second layer (of four) on: its squares' filament is missing, and the nozzle ends where A does."""
    played = prints.play(at=[(24, "EXCLUDE_OBJECT NAME=B")])
    assert played.result["state"] == "complete"
    missing = whole.result["position"][3] - played.result["position"][3]
    assert missing == pytest.approx(16 * 0.33 * 3, abs=1e-3)
    assert played.result["position"][0] < -5.0 < 5.0 < whole.result["position"][0]


def test_babysteps_and_overrides(prints: Prints, whole: Played) -> None:
    """A new Z offset is taken up on the way, less speed makes the clock slower, less flow pushes less."""
    changes = [(10, "SET_GCODE_OFFSET Z_ADJUST=0.05"), (14, "M220 S50"), (20, "M221 S90"), (28, "M220 S300")]
    played = prints.play(at=changes)
    assert played.result["position"][2] == pytest.approx(whole.result["position"][2] + 0.05, abs=1e-9)
    assert played.lasts_s > whole.lasts_s + 1.0
    assert played.result["position"][3] < whole.result["position"][3] - 0.1
    for motor in "abc":
        assert np.diff(played.steps[motor].time_s).min() > 0.8 * np.diff(whole.steps[motor].time_s).min()


@pytest.fixture(scope="module")
def scaled(tmp_path_factory: pytest.TempPathFactory) -> tuple[Prints, float, float]:
    """A print with factors of its own; how much filament it pushes, mm, and how long it takes, s."""
    head, sides = b"G90\nM83\nG1 X-20 Y-5 Z0.2 F9000\nM220 S50\nM221 S90\n", ((10, 0), (10, 10), (0, 10), (0, 0)) * 4
    body = b"".join(b"G1 X%d Y%d E0.5 F6000\n" % side for side in sides)
    data = head + body[: len(body) // 2].rsplit(b"\n", 1)[0] + b"\nM221 S110\nM220 S80\n"
    data += body[len(body) // 2 :].split(b"\n", 1)[1]
    folder, machine = tmp_path_factory.mktemp("scaled"), load_machine("mp-delta-pro")
    path = folder / "compensated.ffm"
    host_job(data, machine).write_steps(path)
    stream, header = reader().open_motion(path)
    stream.close()
    filament = float(read_program(data, flavor="klipper").moves.end[-1, 3])
    return Prints(folder, {"compensated": begin_of(path)}, {}), filament, header["duration_s"]


def test_the_prints_own_factors_count_once(scaled: tuple[Prints, float, float]) -> None:
    """M220 and M221 are in the file's motion; what somebody sets during the print takes their place."""
    prints, filament, lasts_s = scaled
    played = prints.play()
    assert played.result["position"][3] == pytest.approx(filament, abs=1e-3)
    assert np.sum(played.steps["e"].way) == pytest.approx(filament * E_STEPS_PER_MM, abs=2)
    assert played.lasts_s == pytest.approx(lasts_s, abs=0.3)
    changed = prints.play(at=[(1, "M221 S45")])
    assert changed.result["position"][3] < played.result["position"][3] - 0.5


def test_an_emergency_stop_stops(prints: Prints, whole: Played) -> None:
    played = prints.play(at=[(60, "M112")])
    assert played.result["state"] == "stopped" and "Shutdown due to M112" in played.result["error"]
    assert "Traceback" not in (prints.folder / "host" / "log").read_text()
    assert len(played.steps["a"].way) < len(whole.steps["a"].way)


@pytest.mark.parametrize(
    ("more", "before", "why"),
    [
        ("[input_shaper]\nshaper_freq_x: 40\n", (), "input shaper is on"),
        ("max_accel: 100\n", (), "max_accel is 100"),
        ("", ("SET_VELOCITY_LIMIT VELOCITY=50",), "max_velocity"),
    ],
)
def test_what_the_printer_does_not_allow_is_refused(
    prints: Prints, more: str, before: tuple[str, ...], why: str
) -> None:
    played = prints.play(more=more, before=before)
    assert why in played.result["error"]


def test_homing_and_heating_are_lines_of_the_file(prints: Prints) -> None:
    """The host homes, waits for the heater, goes to where the motion begins, and plays it."""
    head = b"G28\nM104 S200\nM109 S200\n"
    work = host_job(head + two_objects(1), load_machine("mp-delta-pro"))
    work.write_steps(prints.folder / "homes.ffm")
    played = play(prints.folder, "FFCOMP_PRINT FILE=homes.ffm", (0.0, 0.0, 10.0))
    assert played.result["state"] == "complete", played.result
    assert played.result["position"][:3] == pytest.approx([10.0, -5.0, 0.2], abs=1e-4)  # on the grid
    risen = np.sqrt(300.0**2 - 140.0**2)  # from the towers' lower ends to where the endstops are
    assert max(np.cumsum(played.steps["a"].way)) > 80 * (320.0 - 10.0 - risen) - 80


MACRO = """\
[gcode_macro LIFT]
gcode:
  G91
  G1 Z7 F600
  G90
"""


def test_no_height_is_made_up_after_a_macro(prints: Prints) -> None:
    """The file names X and Y again, but no Z: the nozzle stays where the macro has left it."""
    square = b"".join(b"G1 X%d Y%d E0.3 F3600\n" % corner for corner in ((5, 0), (5, 5), (0, 5), (0, 0)))
    data = b"G90\nM83\nG1 X0 Y0 Z1 F6000\n" + square + b"LIFT\nG1 X0 Y0 F6000\n" + square * 3
    machine = load_machine("mp-delta-pro")
    host_job(data, machine).write_steps(prints.folder / "lifts.ffm")
    played = play(prints.folder, "FFCOMP_PRINT FILE=lifts.ffm", (0.0, 0.0, 1.0), more=MACRO)
    assert played.result["state"] == "complete", played.result
    assert played.result["position"][:3] == pytest.approx([0.0, 0.0, 8.0], abs=1e-3)


MESH = """\
[probe]
pin: gpio60
z_offset: 0
[bed_mesh]
mesh_radius: 100
round_probe_count: 3
[bed_mesh default]
version: 1
points:
  -0.1, 0.0, 0.1
  -0.1, 0.0, 0.1
  -0.1, 0.0, 0.1
x_count: 3
y_count: 3
mesh_x_pps: 0
mesh_y_pps: 0
algo: direct
tension: 0.2
min_x: -100
max_x: 100
min_y: -100
max_y: 100
"""


def test_a_bed_mesh_is_added(prints: Prints, whole: Played) -> None:
    """A bed that rises by 1 µm a millimetre along x: the nozzle ends so much higher, and so do the carriages."""
    played = prints.play(more=MESH, before=["BED_MESH_PROFILE LOAD=default"])
    assert played.result["state"] == "complete", played.result
    (x, *_), z = whole.result["position"], whole.result["position"][2]
    assert played.result["position"][2] == pytest.approx(z + 1e-3 * x, abs=1e-6)
    for motor in "abc":
        higher = played.result["steps"][f"stepper_{motor}"] - whole.result["steps"][f"stepper_{motor}"]
        assert abs(higher - 80 * 1e-3 * x) <= 1.0
    assert abs(played.lasts_s - whole.lasts_s) < 0.5
