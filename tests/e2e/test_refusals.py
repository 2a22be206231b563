"""What a verb cannot do is refused: exit code, a sentence with the place and the rule, and every file unchanged."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.cli import ffcomp
from tests.support.prints import squares

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
SMALL = b"G28\nG90\nM83\nG1 Z0.3 F6000\nG1 X10 Y10 F9000\n;LAYER:0\nG1 X30 Y12 E1\nG1 X28 Y30 E1\nM107\n"


def responses(rows: str = "1,1,0\n2,1,0\n", columns: str = "", **labels: str) -> bytes:
    """A file of a frequency response."""
    stated = {"input": "cmd_A", "output": "pos_A", **labels}
    head = "".join(f"# {key}: {value}\n" for key, value in stated.items())
    return f"{head}frequency_hz,real,imag{columns}\n{rows}".encode()


def rising(tail: str = "", count: int = 40) -> str:
    return "".join(f"{k},{1 + 0.1 * k},0.1{tail}\n" for k in range(1, count))


def steps(**changed: Any) -> bytes:
    """An archive of step timings: two steps of each motor."""
    one = {"direction": np.array([1, 1]), "start_mm": 300.0, "step_mm": 0.01, "tick": np.array([10, 20])}
    arrays = {f"{motor}_{key}": value for motor in "abc" for key, value in one.items()} | {"clock_hz": 1e6} | changed
    np.savez(found := io.BytesIO(), **{key: np.asarray(value) for key, value in arrays.items() if value is not None})
    return found.getvalue()


AXIS = """format = "ffcomp-machine/1"
name = "a slide"
[kinematics]
type = "axis"
[axis]
input = "position"
mass_kg = 1.0
stiffness_n_per_m = 1e5
damping_n_s_per_m = 20.0
"""
SMALL_BED = re.sub(r"220\.0", "40.0", (EXAMPLES / "corexy.toml").read_text(encoding="utf-8"))
ROWS = {"a_tick": None, "a_interval": np.array([5]), "a_count": np.array([2]), "a_add": np.array([0])}
FILES = {
    "a.gcode": SMALL,
    **dict.fromkeys(("a/x.gcode", "b/x.gcode", "a.csv", "old.toml", "old.json"), b"kept"),
    "squares.gcode": squares(2),
    "nothing.gcode": b"; only comments\nM117 hello\n",
    "binary.gcode": b"GCDE\x01\x00",
    "zip.gcode": b"PK\x03\x04zip",
    "empty": b"",
    "huge.gcode": SMALL + b"G1 X1e30\n",
    "outside.gcode": SMALL + b"G1 X400 E9\n",
    "shifted.gcode": SMALL.replace(b" X", b" X1").replace(b" Y", b" Y1"),
    "everywhere.gcode": SMALL + b"G1 X900 E9\nG1 X0 E12\n",
    "short.gcode": b"G90\nM83\nG1 X0 Y0 Z1 F6000\nG1 X5 E1\n",
    "bad.toml": b'format = "ffcomp-machine/1"\n',
    "nan.csv": b"frequency_hz,real,imag\n1,nan,0\n2,1,0\n",
    "columns.csv": b"frequency_hz,real\n1,1\n2,1\n",
    "run.csv": b"t_s,cmd_A_mm\n0,1\n",
    "cut.gcode": b"; Processed by ffcomp v0.1.0, machine x sha256:00, flavor klipper\n" + SMALL,
    "text.csv": b"hello world\n1 2\n",
    "zero.csv": responses("".join(f"{k},0,0\n" for k in range(1, 40))),
    "coherent.csv": responses(rising(",1.5"), ",coherence"),
    "variance.csv": responses(rising(",-1"), ",variance"),
    "averages.csv": responses(rising(), averages="0"),
    "averaged.csv": responses(rising()),
    "struck.csv": responses(rising(), input="force_A"),
    "alone.csv": responses(rising(), input="force_x", setup="carriage"),
    "head.csv": responses(rising(), input="cmd_x", setup="effector"),
    "spectrum.csv": b"freq,psd_x,psd_y,psd_z,psd_xyz,mzv\n5,1,1,1,3,1\n10,1,1,1,3,1\n",
    "comments.csv": b"\n\n",
    "unit.csv": b"t,x,y,z\n" + b"".join(b"%.3f,0,0,3\n" % (k / 1e3) for k in range(2000)),
    "nameless.csv": b"t_s,,cmd_A_mm\n" + b"".join(b"%.3f,0,1\n" % (k / 1e3) for k in range(200)),
    "silent.csv": b"t_s,acc_x_m_per_s2\n" + b"".join(b"%.3f,0\n" % (k / 1e3) for k in range(200)),
    "powerless.csv": b"freq,psd_x,psd_y,psd_z,psd_xyz,mzv\n" + b"".join(b"%d,0,0,0,0,1\n" % k for k in range(5, 60)),
    "model.stl": b"solid cube\nfacet normal 0 0 1\n",
    "bare.gcode": b"X10 Y10\nG1 X5\n",
    "axis.toml": AXIS.encode(),
    "arms.g": b"M665 L200:201:202:203 R100 H200 B80\nM669 K3\n",
    "bed.cfg": b"[printer]\nkinematics: corexy\nmax_velocity: 300\nmax_accel: 3000\n",
    "small.toml": SMALL_BED.encode(),
    "no_clock.npz": steps(clock_hz=None),
    "column.npz": steps(a_tick=np.array([[10, 20]])),
    "two_starts.npz": steps(a_start_mm=np.zeros(2)),
    "no_size.npz": steps(b_step_mm=0.0),
    "falling.npz": steps(c_tick=np.array([20, 10])),
    "short.npz": steps(a_direction=np.array([1])),
    "endless.npz": steps(**{**ROWS, "a_count": np.array([2**33]), "a_direction": np.array([1])}),
    "uneven.npz": steps(**ROWS),
    "still.npz": steps(**{f"{m}_{key}": np.zeros(0, int) for m in "abc" for key in ("tick", "direction")}),
}
DELTA = "-m mp-delta-pro"
CASES = [
    (f"compensate nothing.gcode {DELTA}", 3, "nothing to compensate"),
    (f"compensate empty {DELTA}", 4, "empty"),
    (f"compensate binary.gcode {DELTA}", 4, "binary"),
    (f"compensate zip.gcode {DELTA}", 4, "zip"),
    (f"compensate huge.gcode {DELTA}", 4, "huge.gcode:10: "),
    (f"compensate outside.gcode {DELTA}", 4, "outside.gcode:10: "),
    (f"compensate shifted.gcode {DELTA} --offset-mm 0,0", 4, "--offset-mm -119,-120 brings it inside"),
    (f"compensate everywhere.gcode {DELTA}", 4, "no offset helps"),
    (f"compensate . {DELTA}", 2, "Is a directory"),
    ("compensate a.gcode -m mp-delta-por", 5, "Did you mean"),
    ("compensate a.gcode -m bad.toml", 5, "kinematics"),
    (f"compensate a.gcode {DELTA} --flavor marlyn", 2, "marlyn"),
    (f"compensate a.gcode {DELTA} --offset-mm 1;2", 2, "offset"),
    (f"compensate a.gcode {DELTA} --kind hex", 2, '"gcode", "steps", "klipper-steps", "host"'),
    (f"compensate a.gcode {DELTA} --kind steps", 2, "extruder_steps_per_mm"),
    (f"compensate a.gcode squares.gcode {DELTA} -o out.gcode", 2, "-o is for one file"),
    (f"compensate a.gcode {DELTA} --output-dir .", 2, "would be overwritten"),
    (f"compensate a.gcode a.gcode {DELTA}", 2, "would both be written"),
    # no verb writes over what it reads, over what exists, or where nothing can be written
    ("compensate a/x.gcode b/x.gcode -m kossel --output-dir c", 2, "would both be written to c/x.gcode"),
    ("compensate a/x.gcode b/x.gcode -m kossel --output-dir b", 2, "b/x.gcode, which is read as well, would be"),
    ("diagnose a.csv -m kossel -o a.csv", 2, "a.csv is read as well; give another --output."),
    ("diagnose a.csv -m kossel -o old.toml", 2, "old.toml exists already; give another --output, or --force."),
    ("diagnose a.csv -m kossel -o none/b.toml", 2, "b.toml: --output names a file in a folder that exists."),
    ("diagnose a.csv -m kossel -o b.toml --trace b.toml", 2, "b.toml is named twice; give another --"),
    ("gap a.csv -m kossel --report old.toml", 2, "old.toml: --report writes a page; end its name in .html."),
    ("record plan -m kossel -o old.gcode", 2, "old.json exists already; give another -o, or --force."),
    ("record join a.csv --plan old.json -m kossel --output-dir .", 2, ".: the captures are there; give another --out"),
    ("record join a.csv --plan old.json -m kossel --output-dir old.toml", 2, "--output-dir names a folder."),
    (f"compare short.gcode {DELTA}", 3, "less than 1.5 s"),
    (f"compare squares.gcode {DELTA} --layers 7:9", 3, "the print has 2 layers, 0 to 1"),
    (f"compare squares.gcode {DELTA} --layers 2:1", 2, "the last must not be"),
    (f"compare squares.gcode {DELTA} --layers a", 2, "10:20"),
    (f"compare squares.gcode {DELTA} --sample 0", 2, "above 0"),
    ("restore cut.gcode", 4, "The compensated file is cut short"),
    (f"compare squares.gcode {DELTA} --only mzw", 2, "mzw"),
    (f"compare squares.gcode {DELTA} --plant kossel", 5, "kinematics.arm_lengths_mm is 269"),
    ("identify fit empty -m kossel -o out.toml", 5, "empty"),
    ("identify fit nan.csv -m kossel -o out.toml", 5, "numbers are missing"),
    ("identify fit nan.csv -m kossel --known effector.total_mass_kg=600", 2, "--known effector.total_mass_kg=600: eff"),
    ("identify fit nan.csv -m kossel --known carriage.mass_kg=nan", 2, "--known 'carriage.mass_kg=nan': it reads"),
    ("identify fit columns.csv -m kossel -o out.toml", 5, "imag"),
    ("identify fit run.csv -m kossel -o out.toml", 5, "cmd_B"),
    ("identify fit text.csv -m kossel -o out.toml", 5, "first line must be"),
    ("record check text.csv -m ender-3", 2, "--plan"),
    (f"simulate a.gcode {DELTA} --rate nan", 2, "nan"),
    (f"simulate cut.gcode {DELTA} --offset-mm 1,1", 2, "--offset-mm is for sliced prints; cut.gcode states"),
    (f"simulate cut.gcode {DELTA}", 4, "The compensated file is cut short"),
    (f"simulate a.gcode {DELTA} --from 2 --to 1", 2, "--from"),
    (f"simulate a.gcode {DELTA} --signals acc,vel", 2, "vel"),
    (f"simulate a.gcode {DELTA} --from 1e6", 3, "too few to simulate"),
    (f"simulate a.gcode {DELTA} --plant kossel", 5, "kinematics.arm_lengths_mm is 269"),
    (f"simulate a.gcode {DELTA} --plant ender-3", 5, "the machine's kind of kinematics"),
    (f"simulate a.gcode {DELTA} -o a.gcode", 2, "this is the command itself"),
    (f"simulate a.gcode {DELTA} --as-captures here", 2, "needs the plan of the G-code"),
    (f"simulate no_clock.npz {DELTA}", 4, "has no clock_hz"),
    (f"simulate column.npz {DELTA}", 4, "one row of whole numbers"),
    (f"simulate two_starts.npz {DELTA}", 4, "must be one finite number"),
    (f"simulate no_size.npz {DELTA}", 4, "one finite number above zero"),
    (f"simulate falling.npz {DELTA}", 4, "c_tick[1] is 10 after 20; ticks are not negative and rise"),
    (f"simulate short.npz {DELTA}", 4, "they belong together"),
    (f"simulate endless.npz {DELTA}", 4, "at most 2147483648 can be played"),
    (f"simulate uneven.npz {DELTA}", 4, "they belong together"),
    (f"simulate still.npz {DELTA}", 3, "no step of a carriage"),
    (f"show a.gcode {DELTA}", 3, "not compensated by ffcomp; first: ffcomp compensate"),
    ("estimate a.gcode", 2, "does not name its machine"),
    ("integrations show slicer", 2, "slicer: not one of"),
    ("integrations install orcaslicer -m kossel", 2, "needs no wrapper"),
    ("serve --certificate a.gcode", 2, "go together"),
    (f"compensate a.gcode {DELTA} -o b.gcode --output-dir .", 2, "give one of them"),
    (f"compensate a.gcode {DELTA} --max-error-um 9 --keep-speed Infill --change-speed infill", 2, "both name 'infill'"),
    (f"compare squares.gcode {DELTA} --only none", 2, "name at least one shaper"),
    ("identify fit gone.csv -m kossel -o out.toml", 2, "no such file"),
    ("identify fit comments.csv -m kossel -o out.toml", 5, "the file is empty"),
    ("identify fit zero.csv -m kossel -o out.toml", 5, "zero at every frequency"),
    ("identify fit coherent.csv -m kossel -o out.toml", 5, "coherence lies between 0 and 1"),
    ("identify fit variance.csv -m kossel -o out.toml", 5, "a variance is not negative"),
    ("identify fit averages.csv -m kossel -o out.toml", 5, "an estimate has at least one"),
    ("identify fit struck.csv -m kossel -o out.toml", 5, "there is no input 'force_A'"),
    ("identify fit alone.csv -m kossel -o out.toml", 5, "is driven by its command"),
    ("identify fit head.csv -m kossel -o out.toml", 5, "by itself is struck"),
    ("identify fit struck.csv -m voron-300 -o out.toml", 5, "does not describe an axis"),
    ("identify fit head.csv -m voron-300 --method stepwise", 2, "are for deltas"),
    ("identify fit head.csv -m kossel --method stepwise", 2, "needs the effector's weight"),
    ("identify ringing -m ender-3 -o out.toml", 2, "a frequency is needed"),
    ("record check spectrum.csv -m ender-3 --plan gone.json", 2, "gone.json"),
    ("identify fit unit.csv -m ender-3 -o out.toml --axis x", 5, "gravity does not show it"),
    ("identify fit nameless.csv -m kossel -o out.toml", 5, "a column has no name"),
    ("identify fit silent.csv -m kossel -o out.toml", 5, "cmd_"),
    ("identify fit powerless.csv -m ender-3 -o out.toml --axis x", 5, "nothing was measured"),
    ("identify fit averaged.csv -m kossel --known carriage.mas=1", 2, "carriage.mas"),
    ("identify fit spectrum.csv -m kossel --offset-mm 1", 2, "offset"),
    ("record plan --for identify -m kossel -o p.gcode --highest-hz 2000", 6, "segments a second"),
    ("record plan --for identify -m kossel -o p.gcode --lowest-hz 50 --highest-hz 40", 6, "must rise from above zero"),
    ("record plan --for scan -m kossel -o p.gcode --amplitude-mm-per-s2 1e6", 6, "carriages' limit allows"),
    ("record plan --for scan -m small.toml -o p.gcode", 6, "the bed is too small for the page"),
    ("record plan -m kossel -o a.gcode --kind spiral", 2, "there is no 'spiral'"),
    ("diagnose run.csv -m axis.toml --plan a.gcode", 2, "there is no plan of moves for it"),
    (f"compensate model.stl {DELTA}", 4, "slice it first"),
    (f"compensate bare.gcode {DELTA}", 4, "the first move must say g0 or g1"),
    (f"compensate a.gcode {DELTA} -o . --force", 2, "only a file can be written"),
    (f"compensate a.gcode {DELTA} --offset-mm inf,1", 2, "offset"),
    (f"estimate nothing.gcode {DELTA}", 3, "no time to estimate"),
    ("machines import arms.g", 5, "ffcomp has deltas of three towers"),
    ("machines import bed.cfg --like kossel", 5, "cannot lend values"),
    ("frf -m kossel --of effector-alone --per carriage", 2, "no response of the whole printer"),
]


@pytest.mark.parametrize(("words", "code", "said"), CASES, ids=[words for words, _, _ in CASES])
def test_it_is_refused_in_a_sentence(words: str, code: int, said: str, tmp_path: Path) -> None:
    for name, content in FILES.items():
        if name in words.replace("old.gcode", "old.json"):
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).write_bytes(content)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.*")}
    answer = ffcomp(*words.split(), cwd=tmp_path)
    assert answer.exit_code == code, answer.output
    assert said.lower() in " ".join(answer.stderr.replace("│", " ").split()).lower()
    assert "Traceback" not in answer.output
    assert {path: path.read_bytes() for path in tmp_path.rglob("*.*")} == before
