"""Where the firmware's own shaper is expected to leave less, the print goes out as sliced and sets it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ffcomp.compensation.job import Job
from ffcomp.compensation.own_shaper import OwnShaper, with_shaper_off, with_shaper_set
from ffcomp.compensation.request import CompensateOptions
from ffcomp.compensation.result import CompensatedFile, Result
from ffcomp.compensation.text_stream import in_order
from ffcomp.simulation.command import read_gcode
from ffcomp.simulation.expectation import Tuned
from ffcomp.simulation.forecast import stored_forecast
from ffcomp.simulation.preview import preview
from gcode.embedded import find_shaper, original
from models.file import load_machine
from models.machine import Machine

OWN = ("M593 X F47 D0.1", "M593 Y F37 D0.1")


@pytest.fixture(scope="module")
def machine() -> Machine:
    """An Ender-3 as it comes, whose firmware has a shaper."""
    ender = load_machine("ender-3")
    limits = replace(ender.limits, carriage_acceleration_mm_per_s2=5000.0, acceleration_mm_per_s2=500.0)
    return replace(ender, limits=limits, uncertainty={"default": 0.2}, input_shaper=OWN)


def infill(*end: str) -> bytes:
    """Short lines at 45 degrees: the nozzle turns back every tenth of a second, and whole steps of Marlin count."""
    lines = ["G90", "M83", "G28", "M201 X500 Y500", "M204 P500 T500", "G1 X60 Y60 Z.2 F6000"]
    for i in range(40):
        back, x = 2.5 * (i % 2), 60 + 0.45 * i
        lines += [f"G1 X{x + back:.3f} Y{62.5 - back:.3f} E.2 F3000", f"G1 X{x + back + 0.45:.3f} E.02"]
    return "\n".join([*lines, *end]).encode()


def written(machine: Machine, data: bytes, **options: object) -> tuple[bytes, Result]:
    lines = Job(data, "infill", machine, CompensateOptions(flavor="marlin", **options)).lines()
    return b"".join(lines), lines.value


def test_no_more_error_is_expected_than_with_the_firmwares_own_shaper(machine: Machine) -> None:
    data = infill("M593 X F41", "T1", "G1 X5 Y5")
    text, result = written(machine, data)
    expected = result.forecast.expected
    assert expected is not None and expected.shaper_um < expected.compensated_um and expected.shaper_written
    assert expected.headline.startswith("The print is as sliced, through the firmware's input shaper (ZV, x ")
    assert original(text) == data and text.count(b"G1 X") == data.count(b"G1 X")
    before, after = text.split(b"G1 X60 Y60 Z.2")
    x, y = expected.shaper_hz
    assert before.endswith(b"M593 X F%.1f D0.1 ; ffcomp\nM593 Y F%.1f D0.1 ; ffcomp\n" % (x, y))
    set_again, restored = after.split(b"M593 X F41\n")[1].split(b"T1")
    assert b"M593 X F%.1f D0.1 ; ffcomp" % x in set_again
    assert restored.index(b"M593 F0") < restored.index(OWN[1].encode()) < restored.index(b"M593 X F41 ; ffcomp")
    assert CompensatedFile("", None, {"": result}).headline == expected.headline
    assert stored_forecast(text, machine) == result.forecast


def test_it_is_simulated_through_the_shaper(machine: Machine) -> None:
    text, _ = written(machine, infill())
    seen = preview(text, "infill", machine)
    assert 2.0 * seen.after.track.contour_rms_um < seen.before.track.contour_rms_um
    command, plain = (read_gcode(each, "infill", machine, flavor="marlin")[0] for each in (text, infill()))
    section, sliced = command.sections[0], plain.sections[0]
    t = section.begin_s + seen.after.t[:2000]
    assert 0.02 < abs(section.actuators(t) - sliced.actuators(t)).max() < 1.0


@pytest.mark.parametrize(
    ("own", "options"), [(OWN, {"robust": "on"}), (OWN, {"keep_shaper": True}), ((), {}), (None, {})]
)
def test_otherwise_our_command_is_written(machine: Machine, own: tuple[str, ...] | None, options: dict) -> None:
    data = infill("T1", "G1 X5 Y5", "G1 Z50 F600")  # after our last line: a restored shaper opens no block of ours
    text, result = written(replace(machine, input_shaper=own), data, **options)
    assert (expected := result.forecast.expected) and not expected.shaper_written and find_shaper(text) is None
    assert "better here" in expected.headline and result.statistics.segments > 500 and original(text) == data


def test_lines_keep_their_endings() -> None:
    shaper = OwnShaper("off", "", "klipper", (b"SET_INPUT_SHAPER SHAPER_FREQ_X=50\n",))
    lines = b"".join(with_shaper_set([b"G28\r\n", b";~ mine\r\nG1 X1\r\nG1 X2"], shaper, Tuned("mzv", (40.0, 41.0))))
    assert lines.startswith(b"G28\r\n;~;~ mine\r\nSET_INPUT_SHAPER SHAPER_TYPE_X=mzv SHAPER_FREQ_X=40.0 ")
    assert lines.endswith(b"SHAPER_FREQ_X=50 ; ffcomp\nG1 X2") and lines.count(b"; ffcomp") == 3


@pytest.mark.parametrize("ending", [b"\n", b"\r\n", b""])
def test_a_print_in_any_spelling_that_ends_with_a_shaper_of_its_own(machine: Machine, ending: bytes) -> None:
    """Its last line stands as it is; after ours, the axis that it does not name is as before."""
    own = OwnShaper("off", "", "marlin", tuple(f"{line}\n".encode() for line in OWN))
    data = b"G28\nN5 G1X60Y60F600\nN6 M593XF41\nG2I5J0" + b"\nM593 X F42" + ending
    text = b"".join(with_shaper_set([data], own, Tuned("zv", (46.0, 37.5))))
    assert original(text) == data and text.index(b"F46.0") < text.index(b"N5 G1X60") and text.count(b"F46.0 ") >= 2
    back = b"".join(b"%b ; ffcomp\n" % line for line in (OWN[1].encode(), b"M593XF41"))
    assert back in text.replace(b"\r", b"") and (ending or text.endswith(back + b"M593 X F42"))
    pieces = [b"G1 X1 ; ffcomp\nN6 M593XF41\nG1 X2 ; ffcomp\nM593 X F42" + ending]
    held = b"".join(in_order(with_shaper_off(pieces, own)))
    assert held.count(b"M593 F0 ; ffcomp") == 2 and b"M593 Y F37 D0.1 ; ffcomp" in held.split(b"X2")[1]
