"""A real print as the experiment: the print stays what it is, and the plan holds the motion of its sections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ffcomp.cli.app import app
from ffcomp.record.gcode_writer import Recorder
from ffcomp.record.join import join_captures
from ffcomp.record.plan import Plan, load_plan, save_plan
from ffcomp.record.prints import plan_of, plan_print, print_lines
from gcode.program import Program
from models.file import load_machine
from models.machine import Machine
from tests.support.cli import CliRunner
from tests.support.recordings import write_captures

EXAMPLE = Path(__file__).parents[4] / "docs" / "examples" / "print.gcode"
COREXY = EXAMPLE.with_name("corexy.toml")


@pytest.fixture(scope="module")
def planned(machine: Machine) -> tuple[Plan, Program]:
    return plan_print(EXAMPLE, machine, "klipper")


def text_of(planned: tuple[Plan, Program]) -> list[bytes]:
    return list(print_lines(*planned, Recorder("klipper")))


def test_the_print_stays_what_it_is(planned: tuple[Plan, Program]) -> None:
    ours = (b"; ", b";\n", b"SET_INPUT_SHAPER", b"M400\n", b"G4 P", b"ACCELEROMETER_MEASURE", b"FFCOMP_RESTORE")
    lines, original = text_of(planned), EXAMPLE.read_bytes().splitlines(keepends=True)
    kept = iter(lines)
    assert all(any(line == other for other in kept) for line in original)  # in order
    added = len(lines) - len(original)
    starts = sum(line.startswith(b"ACCELEROMETER_MEASURE") for line in lines)
    assert starts == 2 * len(planned[0].experiments) > 0
    assert added < sum(line.startswith(ours) for line in lines) + 1


def test_captures_of_a_print_are_joined(planned: tuple[Plan, Program], machine: Machine, tmp_path: Path) -> None:
    save_plan(planned[0], tmp_path / "p.json")
    again = load_plan(tmp_path / "p.json")
    assert again.print_file == "print.gcode" and again.repeats == 1
    captures = write_captures(tmp_path / "p.json", machine, tmp_path)
    found = join_captures(captures, again, machine)
    assert len(found.joined) == len(captures) and not found.refused


def test_a_print_with_its_captures_commands_is_its_own_plan(
    planned: tuple[Plan, Program], machine: Machine, tmp_path: Path
) -> None:
    """Read from the G-code, the experiments are those of the plan beside it, to the last digit."""
    path = tmp_path / "recorded.gcode"
    path.write_bytes(b"".join(text_of(planned)))
    read = plan_of(path, machine)
    assert (read.rest_before_s, read.rest_after_s) == (planned[0].rest_before_s, planned[0].rest_after_s)
    assert [each.name for each in read.experiments] == [each.name for each in planned[0].experiments]
    for ours, theirs in zip(read.experiments, planned[0].experiments, strict=True):
        t = np.linspace(0.0, theirs.duration_s, 200)
        assert np.array_equal(ours.motion.nozzle(t), theirs.motion.nozzle(t))


def test_whole_layers_are_recorded_by_what_a_slicer_puts_between_them(machine: Machine, tmp_path: Path) -> None:
    """A layer with a retraction and a dwell inside is one experiment; Klipper's toggles and M956 say the same."""
    layer = "G1 X20 Y10 F9000\nG1 E-2 F2400\nG4 P50\nG1 X-20 Y0 F6000\nG1 X0 Y0\n"
    texts = {
        "klipper": "ACCELEROMETER_MEASURE CHIP=bed NAME=layer_{0}\nG4 P400\n{1}G4 P300\n"
        "ACCELEROMETER_MEASURE CHIP=bed NAME=layer_{0}\n",
        "reprapfirmware": 'M956 P0 S9999 A0 F"layer_{0}.csv"\nG4 P400\n{1}G4 P300\n',
    }
    plans = []
    for flavor, text in texts.items():
        path = tmp_path / f"{flavor}.gcode"
        body = "".join(text.format(k, layer) + f"G1 Z{5 + k} F600\n" for k in (3, 14))
        path.write_text(f"G28\nG90\nM83\nG1 X0 Y0 Z5 F3000\n{body}", encoding="utf-8")
        plans.append(plan_of(path, replace(machine, flavor=flavor)))
    for plan in plans:
        assert [each.name for each in plan.experiments] == ["layer_3", "layer_14"]
        assert (plan.rest_before_s, plan.rest_after_s) == (0.4, 0.3)
        t = np.linspace(0.0, 1.0, 100)
        assert plan.experiments[0].duration_s == plans[0].experiments[0].duration_s
        assert np.array_equal(plan.experiments[0].motion.nozzle(t), plans[0].experiments[0].motion.nozzle(t))
    waits = plans[0].experiments[0].motion
    assert waits.wait_before.tolist() == [0.0, 0.0, 0.05, 0.0] and waits.nozzle(np.array([9.0]))[0, 0] == 0.0


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Path]]:
    """A print of three layers that records each, on a CoreXY: its G-code, and the captures."""
    folder, rng = tmp_path_factory.mktemp("recorded"), np.random.default_rng(3)
    return _recorded(folder, "part.gcode", rng)


def _recorded(folder: Path, name: str, rng: np.random.Generator) -> tuple[Path, list[Path]]:
    lines = ["G28", "G90", "G1 X110 Y110 Z5 F3000"]
    for k in range(3):
        toggle = f"ACCELEROMETER_MEASURE NAME=layer_{k}"
        moves = [f"G1 X{x:.2f} Y{y:.2f} F9000" for x, y in rng.uniform(100.0, 120.0, (12, 2))]
        lines += [toggle, "G4 P400", *moves, "G1 X110 Y110", "G4 P300", toggle]
    path = folder / name
    path.write_text("\n".join(lines), encoding="utf-8")
    machine = load_machine(str(COREXY))
    save_plan(plan_of(path, machine), path.with_suffix(".json"))
    return path, write_captures(path.with_suffix(".json"), machine, folder / path.stem)


def updated(print_file: Path, captures: Sequence[Path], folder: Path) -> tuple[int, str]:
    """Run `identify update`, and see that nothing is written; its exit code, and what it says."""
    output = folder / "better.toml"
    words = ["identify", "update", *map(str, captures), "--plan", str(print_file), "-m", str(COREXY)]
    result = CliRunner().invoke(app, [*words, "-o", str(output), "-q"])
    assert not list(folder.glob("better*"))
    return result.exit_code, result.output


@pytest.mark.parametrize(
    ("more", "sentence"), [(7, "The file breaks off there: copy it again, or record again"), (0, "Record longer")]
)
def test_a_print_that_was_cancelled_leaves_too_little(
    more: int, sentence: str, recorded: tuple[Path, list[Path]], tmp_path: Path
) -> None:
    """The first layer is whole, the second breaks off, in the middle of a row or behind one; the third was not made."""
    print_file, (first, second, _) = recorded
    broken = tmp_path / second.name
    text = second.read_text(encoding="utf-8")
    broken.write_text(text[: text.index("\n", len(text) // 2) + 1 + more], encoding="utf-8")
    machine = load_machine(str(COREXY))
    joined = join_captures([first, broken], plan_of(print_file, machine), machine)
    assert [each.experiment for each in joined.joined] == ["layer_0"]
    assert [each.file for each in joined.refused] == [str(broken)]
    assert sentence in joined.refused[0].why
    code, said = updated(print_file, [first, broken], tmp_path)
    assert code == 5 and "There is one layer only" in said and "give captures of two or more" in said
