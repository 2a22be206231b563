"""Content decides what a file is, and no file does worse than a sentence."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ffcomp.importers.builder import build_draft, machine_text, read_printer_config
from ffcomp.importers.values import PrinterConfigError
from models.errors import MachineFileError
from models.file import check_text
from tests.support.configs import COREXY, SAVED, SHAPER, Delta, written

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
