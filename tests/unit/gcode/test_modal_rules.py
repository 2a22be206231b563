"""What each firmware makes of the commands that change the meaning of later numbers: one table.

Rows are facts of the firmwares' documentation and sources: Klipper's docs/G-Codes.md and gcode_move.py, marlinfw.org
(G20, G60, G90 to G92, M82, M83, M120, M220, M221, M400), docs.duet3d.com (the same, and M120, G0's R), Prusa's and
Bambu's own.
"""

from __future__ import annotations

import re

import pytest

from gcode.errors import GcodeError, UnsupportedGcode
from gcode.program import Program
from gcode.reader import read_program

KLIPPER, MARLIN, DUET = "klipper", "marlin", "reprapfirmware"
ALL = (KLIPPER, MARLIN, DUET)
BEGIN = (10.0, 20.0, 5.0)  # mm, where the nozzle is
GROWING = "".join(f"G1 X{11 + k} E{2 + 0.1 * k:.1f} F600\n" for k in range(6))
SHRINKING = "".join(f"G1 X{11 + k} E{0.5 - 0.05 * k:.2f} F600\n" for k in range(6))


def read(text: str, firmware: str) -> Program:
    return read_program(text.encode(), flavor=firmware, start=BEGIN)


RULES: list[tuple[str, tuple[str, ...], str, tuple[float | None, ...]]] = [
    # name, firmwares, lines, where the last move ends (X Y Z E, mm; None: not looked at)
    ("absolute at first", ALL, "G1 X12 E1 F600", (12, 20, 5, 1)),
    ("G91 makes X Y Z relative", ALL, "G91\nG1 X1 Y1 Z1 F600", (11, 21, 6, 0)),
    ("G91 makes E relative", (KLIPPER, MARLIN), "G1 E2 F600\nG91\nG1 X1 E1", (11, 20, 5, 3)),
    ("G91 leaves E absolute", (DUET,), "G1 E2 F600\nG91\nG1 X1 E1", (11, 20, 5, 1)),
    ("M83 leaves X Y Z absolute", ALL, "G1 E2 F600\nM83\nG1 X12 E1", (12, 20, 5, 3)),
    ("M82 overrides G91", (MARLIN, DUET), "G1 E2 F600\nG91\nM82\nG1 X1 E1", (11, 20, 5, 1)),
    ("G91 counts more than M82", (KLIPPER,), "G1 E2 F600\nG91\nM82\nG1 X1 E1", (11, 20, 5, 3)),
    ("G90 leaves M83", (KLIPPER, DUET), "M83\nG1 E2 F600\nG91\nG1 Z2\nG90\nG1 X11 E1", (11, 20, 7, 3)),
    ("G90 takes M83 back", (MARLIN,), "M83\nG1 E2 F600\nG91\nG1 Z2\nG90\nG1 X11 E1", (11, 20, 7, 1)),
    ("and absolute numbers agree", (MARLIN,), f"M83\nG1 E2 F600\nG91\nG1 Z2\nG90\n{GROWING}", (16, 20, 7, 2.5)),
    ("older Marlins' relative ones too", (MARLIN,), f"M83\nG1 E2 F600\nG90\n{SHRINKING}", (16, 20, 5, 4.25)),
    ("Bambu's G90 leaves M83", (MARLIN,), "; BambuStudio 1.9\nM83\nG1 E2 F600\nG90\nG1 X11 E1", (11, 20, 5, 3)),
    ("G90 leaves M82", ALL, "M82\nG1 E2 F600\nG91\nG1 Z2\nG90\nG1 X11 E3", (11, 20, 7, 3)),
    ("M82 takes M83 back", ALL, "M83\nG1 E2 F600\nM82\nG1 X11 E1", (11, 20, 5, 1)),
    ("G92 renames what it names", ALL, "G92 X0 E5\nG1 X1 E6 F600", (11, 20, 5, 1)),
    ("G92 alone: all are zero", (KLIPPER,), "G1 E2 F600\nG92\nG1 X1 Y1 E1", (11, 21, 5, 3)),
    ("G92 alone: nothing", (MARLIN, DUET), "G1 E2 F600\nG92\nG1 X11 Y21 E3", (11, 21, 5, 3)),
    ("G92.1 takes names back", (MARLIN, DUET), "G92 X0\nG92.1\nG1 X11 F600", (11, 20, 5, 0)),
    ("G20 is inches, E too", (MARLIN, DUET), "G20\nG1 X1 E0.1 F60", (25.4, 20, 5, 2.54)),
    ("G21 is mm again", ALL, "G20\nG21\nG1 X12 F600", (12, 20, 5, 0)),
    ("M221 scales E", ALL, "M221 S50\nG1 X11 E2 F600", (11, 20, 5, 1)),
    ("M221 goes on without a jump", ALL, "G1 E2 F600\nM221 S50\nG1 X11 E4", (11, 20, 5, 3)),
    ("M221 D names a tool", ALL, "M221 S50 D0\nG1 X11 E2 F600", (11, 20, 5, 1)),
    ("G10 with a temperature", ALL, "G1 X11 F600\nG10 P0 S200\nG1 X12", (12, 20, 5, 0)),
    ("G10 and G11 move E by themselves", ALL, "G1 X11 E1 F600\nG10\nG11\nG1 X12 E2", (12, 20, 5, 2)),
    ("M120 keeps modes, M121 restores", (DUET,), "M120\nG91\nM83\nG1 Z2 F600\nM121\nG1 X12 E3", (12, 20, 7, 3)),
    ("M121 restores units", (DUET,), "M120\nG20\nM121\nG1 X12 F600", (12, 20, 5, 0)),
    ("they are about endstops", (MARLIN,), "M120\nG91\nM121\nG1 X2 F600", (12, 20, 5, 0)),
    ("SAVE and RESTORE modes", (KLIPPER,), "SAVE_GCODE_STATE NAME=a\nG91\nM83\nG1 X1 E1 F600\n"
     "RESTORE_GCODE_STATE NAME=a\nG1 X12 E1", (12, 20, 5, 2)),
    ("RESTORE with MOVE goes back", (KLIPPER,), "SAVE_GCODE_STATE NAME=a\nG1 X15 Z9 F600\n"
     "RESTORE_GCODE_STATE NAME=a MOVE=1\nG91\nG1 Y1", (10, 21, 5, 0)),
    ("SET_GCODE_OFFSET shifts later numbers", (KLIPPER,), "SET_GCODE_OFFSET Z=0.1\nG1 X11 Z5 F600", (11, 20, 5.1, 0)),
    ("M84 S is a timeout, M84 E the extruder's", ALL, "G1 X11 F600\nM84 S5\nM84 E\nG91\nG1 X1", (12, 20, 5, 0)),
    ("M84 forgets", ALL, "M84\nG1 X12 F600\nG1 X9 Y9 Z9\nG91\nG1 X1", (10, 9, 9, 0)),
    ("M121 alone restores nothing", (DUET,), "G91\nM121\nG1 X1 F600", (11, 20, 5, 0)),
    ("M221 without S", ALL, "M221\nG1 X11 E2 F600", (11, 20, 5, 2)),
    ("G10 with a tool's offsets forgets", (DUET,), "G10 P0 X1\nG1 X12 F600\nG1 X9 Y9 Z9\nG1 X1", (1, 9, 9, 0)),
    ("a tool from its dock does too", (MARLIN,), "P1\nG1 X12 F600\nG1 X9 Y9 Z9\nG1 X1", (1, 9, 9, 0)),
    ("a status light does not", (KLIPPER,), "_STATUS_BUSY\nG91\nG1 X1 F600", (11, 20, 5, 0)),
    ("RESTORE of what was never saved forgets", (KLIPPER,), "RESTORE_GCODE_STATE NAME=b\nG1 X1 F600\nG1 X9 Y9 Z9\n"
     "G1 X1", (1, 9, 9, 0)),
    ("and moves if asked", (KLIPPER,), "SET_GCODE_OFFSET Z_ADJUST=0.1 MOVE=1\nG1 X11 F600", (11, 20, 5.1, 0)),
]  # fmt: skip


@pytest.mark.parametrize(
    ("firmware", "lines", "end"),
    [pytest.param(firmware, *rule[2:], id=f"{firmware}: {rule[0]}") for rule in RULES for firmware in rule[1]],
)
def test_where_a_move_ends(firmware: str, lines: str, end: tuple[float, ...]) -> None:
    moves = read(lines, firmware).moves
    assert moves.end[-1].tolist() == pytest.approx(end, abs=1e-9)


SPEEDS = [
    ("M220 changes the speed in force", ALL, "G1 X11 F600\nM220 S50\nG1 X12", 5.0),
    ("M220 without S changes nothing", ALL, "M220\nG1 X11 F600", 10.0),
    ("M220 R takes back what B has kept", (MARLIN,), "M220 S80\nM220 B\nM220 S50\nM220 R\nG1 X11 F600", 8.0),
    ("M220 B may set too", (MARLIN,), "M220 B S50\nG1 X11 F600", 5.0),
    ("others have no B and R", (KLIPPER, DUET), "M220 S80\nM220 B\nM220 S50\nM220 R\nG1 X11 F600", 5.0),
    ("M121 restores the feed", (DUET,), "G1 X11 F600\nM120\nG1 X12 F60\nM121\nG1 X13", 10.0),
    ("M203 E holds back what pulls filament", (MARLIN,), "M203 E10\nG1 X11 E-2 F6000", 5.0),
    ("in mm/min", (DUET,), "M203 E600\nG1 X11 E-2 F6000", 5.0),
    ("a retraction too", (MARLIN,), "M203 E10\nG1 E-2 F6000", 10.0),
    ("but no travel", (MARLIN,), "M203 E10\nG1 X11 F6000", 100.0),
    ("Klipper reads no M203", (KLIPPER,), "M203 E10\nG1 X11 E-2 F6000", 100.0),
    ("F counts in inches", (MARLIN, DUET), "G20\nG1 X1 F60", 25.4),
    ("on a line that is read slowly too", (MARLIN, DUET), "G20\nG1 X1 (one) F60", 25.4),
]


@pytest.mark.parametrize(
    ("firmware", "lines", "speed"),
    [pytest.param(firmware, *rule[2:], id=f"{firmware}: {rule[0]}") for rule in SPEEDS for firmware in rule[1]],
)
def test_how_quick_a_move_is(firmware: str, lines: str, speed: float) -> None:
    assert read(lines, firmware).moves.speed[-1] == pytest.approx(speed)


WAITS = [
    ("G4 P counts in ms", ALL, "G4 P500", 0.5),
    ("G4 S counts in s", (MARLIN, DUET), "G4 S2", 2.0),
    ("Klipper reads P only", (KLIPPER,), "G4 S2", 0.0),
    ("S counts more than P", (MARLIN, DUET), "G4 P500 S2", 2.0),
    ("Bambu's M400 waits", (MARLIN,), "M400 S3", 3.0),
    ("others' does not", (KLIPPER, DUET), "M400 S1", 0.0),
]


@pytest.mark.parametrize(
    ("firmware", "line", "seconds"),
    [pytest.param(firmware, *rule[2:], id=f"{firmware}: {rule[0]}") for rule in WAITS for firmware in rule[1]],
)
def test_how_long_a_command_waits(firmware: str, line: str, seconds: float) -> None:
    (event,) = read(f"G1 X11 F600\n{line}\nG1 X12", firmware).events
    assert event.dwell_s == pytest.approx(seconds)


@pytest.mark.parametrize("line", ["G52 X1", "G55", "G56", "G59.3", "G68 R30", "G93", "G10 L2 P1 X5", "M200 D1.75"])
@pytest.mark.parametrize("firmware", [MARLIN, DUET])
def test_numbers_that_cannot_be_followed_are_refused(firmware: str, line: str) -> None:
    with pytest.raises(UnsupportedGcode, match=r"^2: .*not followed"):
        read(f"G1 X11 F600\n{line}\nG1 X12", firmware)


@pytest.mark.parametrize(
    ("line", "rule"),
    [
        ("G4 P-5", "G4 waits -0.005 s; a wait cannot be negative."),
        ("M220 S0", "M220 S0 is not a factor; a percentage must be above zero."),
        ("M204 P-1 T5", "M204 sets a limit of -1; limits must be above zero."),
        ("G1 X12 (one) F-1", "F-1 is not a speed; a feed must be above zero."),
        ("G1 X10000000", "X1e+07 is out of range; numbers reach ±1,000,000."),
        ("G2 I90000 F600", "The arc is 565487 mm long; arcs may be 100000 mm long at most."),
    ],
)
def test_numbers_that_no_firmware_follows_are_refused(line: str, rule: str) -> None:
    with pytest.raises(GcodeError, match=rf"^2: .*{re.escape(rule)}"):
        read(f"G1 X11 F600\n{line}", KLIPPER)


@pytest.mark.parametrize(
    ("firmware", "line"),
    [
        *((each, "G53 G1 X3") for each in ALL),
        (MARLIN, "G61"), (DUET, "G1 R1 X0"), (DUET, "G1 H1 X-9"), (DUET, "M98 P\"a.g\""), (KLIPPER, "G55"),
        *((each, "M206 X3") for each in ALL),
    ],
)  # fmt: skip
def test_after_these_nobody_knows_the_place(firmware: str, line: str) -> None:
    """The next move goes out as it is; one that names all axes makes the place known again."""
    program = read(f"G1 X11 F600\n{line}\nG1 X12 Y20 Z5\nG1 X13", firmware)
    assert program.moves.line.tolist() == [0, 3]


def test_the_numbers_say_which_marlin_it_is_and_a_warning_tells() -> None:
    program = read(f"M83\nG90\n{SHRINKING}", MARLIN)
    assert program.warnings == [
        "line 2: no M82 or M83 after this G90 sets how E counts; Marlin 2 makes E absolute by G90, older ones keep "
        "M83; the numbers do not grow, so E is relative."
    ]
    assert read(f"M83\nG90\nM83\n{SHRINKING}", MARLIN).warnings == []


@pytest.mark.parametrize("firmware", [KLIPPER, MARLIN])
def test_a_kept_place_is_reprapfirmwares_alone(firmware: str) -> None:
    program = read("G1 X11 F600\nG1 R1 X0", firmware)
    assert any("R1" in warning for warning in program.warnings)


@pytest.mark.parametrize(
    ("lines", "places"),
    [
        ("M83\nM622 J1\nG92 E0\nG1 E-1 F600\nM623", 0),  # filament alone: its relative numbers mean the same
        ("M82\nM622 J1\nG92 E5\nM623", 1),
        ("M622 J1\nG1 X30\nM623\nM622 J1\nM971 S11\nM623", 1),  # nothing moves from the unknown place
        ("M622 J1\nM622 J0\nM623\nM623", 0),
    ],
)
def test_a_condition_in_which_nothing_moves_leaves_the_place(lines: str, places: int) -> None:
    program = read(f"G1 X20 Y20 F600\n{lines}\n", MARLIN)
    assert sum(event.moves_itself for event in program.events) == places
