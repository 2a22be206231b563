"""Content decides what a file is, and no file does worse than a sentence."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ffcomp.importers.builder import HINTS, build_draft, machine_text, read_printer_config
from ffcomp.importers.values import PrinterConfigError
from models.errors import MachineFileError
from models.file import check_text, entries, load_machine
from models.kinds import delta_vibration
from tests.support.configs import COREXY, SAVED, SHAPER, Delta, drafted, imported, written

DELTA = Delta()


@pytest.mark.parametrize("name", ["printer.cfg", "no_ending"])
@pytest.mark.parametrize(
    ("text", "firmware"),
    [(DELTA.klipper(), "Klipper"), (DELTA.reprapfirmware(), "RepRapFirmware"), (DELTA.marlin(), "Marlin")],
)
def test_content_decides_not_the_name(text: str, firmware: str, name: str, tmp_path: Path) -> None:
    assert read_printer_config(written(tmp_path, text, name)).firmware == firmware


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"", "no printer.cfg"),
        (b"M201 X1000 Y1000\nM203 X200 Y200\nM204 P1000\n", "no answer of Marlin to M503"),
        (b"\x89PNG\r\n\x1a\n\0\0\0", "byte 8 is zero; a printer configuration is a text file"),
        (b"#define STRING_CONFIG\n//#define DELTA\n#define DELTA_RADIUS 140\n", "send M503 to the printer"),
    ],
)
def test_what_is_none_of_them_is_refused(data: bytes, sentence: str, tmp_path: Path) -> None:
    with pytest.raises(PrinterConfigError, match=sentence):
        read_printer_config(written(tmp_path, data))


LINES = [
    *(COREXY + SHAPER + SAVED + "#*# delta_radius = 9").split("\n"),
    *["M669 K1", "M501", "M208 X0:1", "if x", "  M92 X1", "M593 F{1}", "M350 X0", "G20", "echo: M665 L1 R1"],
    *("arm_length: ${printer.x}", "[include *]", "[", "]", ":", "gear_ratio: 1:2:3", "M665 L::", "max_accel: 1e400"),
]
WHOLE = (DELTA.klipper(), DELTA.reprapfirmware(), DELTA.marlin(), COREXY + SHAPER)
edits = st.tuples(
    st.floats(0, 1), st.integers(0, 2), st.sampled_from(LINES) | st.sampled_from(LINES).map(lambda s: s[:9]) | st.text()
)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(text=st.sampled_from(WHOLE), changes=st.lists(edits, max_size=4))
def test_edited_configurations_end_in_a_machine_or_a_sentence(text: str, changes: list[tuple[float, int, str]]) -> None:
    """At a place some lines are replaced by another one."""
    lines = text.split("\n")
    for place, gone, line in changes:
        at = int(place * len(lines))
        lines[at : at + gone] = [line]
    with tempfile.TemporaryDirectory() as folder:
        sentence = outcome(written(Path(folder), "\n".join(lines).encode("utf-8", "surrogatepass")))
    assert sentence.endswith((".", "?")), sentence


def outcome(path: Path) -> str:
    """What is wrong with a configuration, or with the machine file made of it."""
    try:
        made = build_draft(read_printer_config(path, "cartesian"), "x")
        check_text(machine_text(made, path), "x.toml")
    except (PrinterConfigError, MachineFileError) as error:
        return str(error)
    assert made.is_complete
    return "It is a machine."


# ---- builder ----


@pytest.mark.parametrize(("arm", "like"), [(295.0, "mp-delta-pro"), (281.0, "flsun-qqs")])
def test_the_nearest_arm_lends_its_vibrations(arm: float, like: str, tmp_path: Path) -> None:
    path = written(tmp_path, Delta(arms=(arm, arm, arm)).klipper())
    assert drafted(path).like == like
    machine, lender = imported(path), load_machine(like)
    assert delta_vibration(machine).carriage == delta_vibration(lender).carriage
    assert (
        delta_vibration(machine).effector.extruder_stiffness_n_per_m.tolist()
        == delta_vibration(lender).effector.extruder_stiffness_n_per_m.tolist()
    )
    assert machine.kinematics.arm_lengths_mm.tolist() == [arm] * 3
    assert machine.uncertainty["default"] == 0.2


def test_every_value_says_where_it_is_from(tmp_path: Path) -> None:
    path = written(tmp_path, Delta().klipper(), "printer.cfg")
    imported(path)
    told = {entry.key: entry.provenance for entry in entries(path.with_suffix(".toml"))}
    assert told["kinematics.delta_radius_mm"] == "printer.cfg:26 [printer] delta_radius"
    assert told["carriage.mass_kg"] == "assumed: as the machine 'flsun-qqs'"
    assert [key for key, origin in told.items() if not origin] == []


def test_what_is_missing_stays_missing(tmp_path: Path) -> None:
    path = written(tmp_path, COREXY.replace("position_max: 302.5", "") + SHAPER.replace("shaper_freq_x: 61.2", ""))
    made = drafted(path)
    assert list(made.missing) == ["kinematics.y_range_mm", "axes.x.frequency_hz", "axes.x.damping_ratio"]
    text = machine_text(made, path)
    assert "# NOT COMPLETE: kinematics.y_range_mm" in text
    with pytest.raises(MachineFileError) as refused:
        check_text(text, "x.toml")
    assert [problem.split()[0] for problem in refused.value.problems] == list(made.missing)
    gap = "# y_range_mm is missing: " + made.missing["kinematics.y_range_mm"]
    assert HINTS["kinematics."] in gap
    assert gap in text
    filled = text.replace(gap, "y_range_mm = [0.0, 302.5]")
    for line in filled.splitlines():
        if line.startswith("# frequency_hz is missing"):
            filled = filled.replace(line, "frequency_hz = [50.0]\ndamping_ratio = [0.05]")
    check_text(filled, "x.toml")


@pytest.mark.parametrize("flavor", ["klipper", "reprapfirmware", "marlin"])
def test_the_firmware_of_the_configuration_is_the_printers(flavor: str, tmp_path: Path) -> None:
    text = getattr(Delta(), flavor)()
    machine = imported(written(tmp_path, text, "printer.txt"))
    assert machine.flavor == flavor
    assert machine.provenance["firmware.flavor"].startswith("the configuration is one of")
