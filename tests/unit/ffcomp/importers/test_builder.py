"""What is assumed, what stays missing, and what the file says of both."""

from __future__ import annotations

from pathlib import Path

import pytest

from ffcomp.importers.builder import HINTS, machine_text
from models.errors import MachineFileError
from models.file import check_text, entries, load_machine
from models.kinds import delta_vibration
from tests.support.configs import COREXY, SHAPER, Delta, drafted, imported, written


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
