"""What a verb cannot do is refused: exit code, a sentence with the place and the rule, and every file unchanged."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.cli import ffcomp
from tests.support.prints import squares

SMALL = b"G28\nG90\nM83\nG1 Z0.3 F6000\nG1 X10 Y10 F9000\n;LAYER:0\nG1 X30 Y12 E1\nG1 X28 Y30 E1\nM107\n"
FILES = {
    "a.gcode": SMALL,
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
]


@pytest.mark.parametrize(("words", "code", "said"), CASES, ids=[words for words, _, _ in CASES])
def test_it_is_refused_in_a_sentence(words: str, code: int, said: str, tmp_path: Path) -> None:
    for name, content in FILES.items():
        if name in words:
            (tmp_path / name).write_bytes(content)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    answer = ffcomp(*words.split(), cwd=tmp_path)
    assert answer.exit_code == code, answer.output
    assert said.lower() in " ".join(answer.stderr.replace("│", " ").split()).lower()
    assert "Traceback" not in answer.output
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
