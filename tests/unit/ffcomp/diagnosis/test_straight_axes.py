"""The engine on runs of an independent printer with straight axes: a cartesian one and a CoreXY."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.diagnosis.diagnosis import diagnose
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.result import DiagnosisResult
from ffcomp.diagnosis.verb import measure_gap
from ffcomp.measurement.recording import Recording
from models.arrays import FloatArray
from models.file import load_machine
from models.machine import Machine
from models.printer.printer import simulate_printer
from validation.plants.straight_plant import COREXY, Plant, simulate

RATE_HZ = 1600
PLACES = ((100.0, 100.0), (40.0, 150.0), (160.0, 60.0))
PLANT = Plant(tool_kg=(0.12, 0.0), mount_n_s_per_m=(36, 0.0))  # so damped that the modes keep their own
BELTS = replace(PLANT, mount_n_s_per_m=(18 * 8 / 4.4, 0.0))
BELTS = replace(BELTS, motors=tuple(map(tuple, COREXY.tolist())), belt_n_per_m=(2.2e4, 2.2e4))


def filed(plant: Plant, kind: str, folder: Path) -> Machine:
    """The machine file of the plant without what it hides; its first frequency is off by half a percent."""
    text = f'format = "ffcomp-machine/1"\nname = "box"\n[kinematics]\ntype = "{kind}"\n'
    text += "".join(f"{axis}_range_mm = [0.0, 200.0]\n" for axis in "xyz")
    for axis in range(2):
        frequency, damping, share = plant.axis_modes(axis)
        frequency[0] *= 1.005
        text += f"[axes.{'xy'[axis]}]\nfrequency_hz = {frequency}\ndamping_ratio = {damping}\nshare = {share}\n"
    text += "[limits]\nvelocity_mm_per_s = 300.0\nacceleration_mm_per_s2 = 5000.0\n"
    path = folder / "box.toml"
    path.write_text(text, encoding="utf-8")
    return load_machine(path)


def moved(place: tuple[float, float], seed: int, seconds: float = 0.7) -> FloatArray:
    """Commands of x and y (n, 2) mm: tones between 4 and 110 Hz on a slow motion of some millimetres."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE_HZ))[:, None] / RATE_HZ
    f = rng.uniform(4, 110, (12, 2))
    tones = sum(0.6 / each * np.sin(2 * np.pi * each * t + 6.28 * each) for each in f)
    slow = 8 * np.sin(2 * np.pi * np.array([1.5, 1.1]) * t)
    return np.array(place) + (tones + slow) * np.minimum(1, t / 0.3) ** 2


def recorded(plant: Plant, noise: float = 0.3, heights: tuple[float, ...] = (30.0,) * 3) -> list[Recording]:
    """Two repeats at each of three places, with an accelerometer of the head and one of the bed."""
    rng = np.random.default_rng(0)
    found = []
    for number, place in enumerate(PLACES):
        command = moved(place, number)
        felt = simulate(plant, command, RATE_HZ, heights[number])["acceleration_m_per_s2"]
        t = np.arange(len(command)) / RATE_HZ
        for repeat in (1, 2):
            named = dict(zip(("acc_x", "acc_y"), (felt + noise * rng.standard_normal(felt.shape)).T, strict=True))
            nozzle = np.column_stack([command, heights[number] + 0 * t])
            found.append(Recording(f"p{number}-{repeat}.csv", t, nozzle, "nozzle", named, {}, {}))
    return found


def test_the_plant_is_our_printer_where_nothing_is_hidden(tmp_path: Path) -> None:
    for plant, kind in ((PLANT, "cartesian"), (BELTS, "corexy")):
        command = moved(PLACES[0], 0)
        own = filed(plant, kind, tmp_path)
        exact = {f"axes.{a}.frequency_hz[0]": plant.axis_modes("xy".index(a))[0][0] for a in "xy"}
        own = replace(own, vibration=own.vibration.with_parameters(exact))
        ours = simulate_printer(own, np.column_stack([command, 30 + 0 * command[:, 0]]), 1 / RATE_HZ, hold="linear")
        apart = np.abs(ours.nozzle_mm[:, :2] - simulate(plant, command, RATE_HZ)["position_mm"]).max(axis=0)
        assert apart.max() < 1e-6


@pytest.mark.parametrize(
    ("kind", "plant", "hidden", "name", "key", "truth"),
    [
        ("cartesian", PLANT, {"friction_n": (0.52, 0.5)}, "coulomb_friction", "force_n_per_kg", 1.0),
        ("corexy", BELTS, {"delay_s": 1.5e-3}, "command_delay", "delay_s", 1.5e-3),
        ("corexy", BELTS, {"belt_n_per_m": (2.64e4, 2.2e4)}, "belt_stiffness", "relative_change", (0.2, 0.0, 0.0)),
    ],
    ids=["friction", "delay", "one tighter belt of a CoreXY"],
)
def test_what_is_hidden_is_named_and_the_better_file_closes_the_gap(
    kind: str, plant: Plant, hidden: dict[str, Any], name: str, key: str, truth: Any, tmp_path: Path
) -> None:
    machine, runs = filed(plant, kind, tmp_path), recorded(replace(plant, **hidden))
    problem = PrinterProblem(machine, runs, list(dict.fromkeys([name, "command_delay"])))
    found = diagnose(problem)
    assert (found.verdict, found.named.names) == ("effects", (name,))
    told = DiagnosisResult(search=found)
    said, true = (np.broadcast_to(each, 3)[:2] for each in (told.parameters(name)[key].value, truth))  # z rests
    np.testing.assert_allclose(said, true, rtol=0.15, atol=0.03)
    text = told.better_file("better", ["x.csv sha256:0"])
    (tmp_path / "better.toml").write_text(text, encoding="utf-8")
    closed = measure_gap(load_machine(tmp_path / "better.toml"), runs)
    assert closed.residual.total.nrms == pytest.approx(told.gap.after, rel=0.05)
    assert told.gap.after < 0.5 * told.gap.before


def test_damping_of_the_belts_is_no_offset_of_the_sensors(tmp_path: Path) -> None:
    """Without the effect 15 % were a sensor_time_offset of −76 µs."""
    share = 0.15
    plain = replace(PLANT, tool_kg=(0.0, 0.0))
    held = {"guide_n_s_per_m": (18.0 * (1 - share),) * 2, "belt_n_s_per_m": (18.0 * share,) * 2}
    names = ("belt_damping", "sensor_time_offset", "command_delay", "guide_damping")
    problem = PrinterProblem(filed(plain, "cartesian", tmp_path), recorded(replace(plain, **held)), names)
    found = diagnose(problem)
    assert found.named is not None and (found.verdict, found.named.names) == ("effects", ("belt_damping",))
    told = DiagnosisResult(search=found)
    assert told.parameters("belt_damping")["share"].value == pytest.approx(share, abs=0.02)


@pytest.mark.parametrize(
    ("kind", "hidden", "name", "key", "truth"),
    [
        ("corexy", {"yaw_kg_m2": 0.009, "yaw_hz": 45.0, "head_kg": 0.3}, "gantry_racking", "radius_mm", 173.2),
        ("cartesian", {"growth_per_m": 2.5}, "growing_bed", "growth_per_m", (0.0, 2.5, 0.0)),
    ],
)
def test_what_depends_on_the_place_is_named(
    kind: str, hidden: dict[str, Any], name: str, key: str, truth: Any, tmp_path: Path
) -> None:
    plain = replace(BELTS if kind == "corexy" else PLANT, tool_kg=(0.0, 0.0))
    runs = recorded(replace(plain, **hidden), heights=(5.0, 60.0, 120.0))
    problem = PrinterProblem(filed(plain, kind, tmp_path), runs, (name, "guide_damping"))
    found = diagnose(problem)
    assert found.named is not None and (found.verdict, found.named.names) == ("effects", (name,))
    told = DiagnosisResult(search=found)
    np.testing.assert_allclose(told.parameters(name)[key].value, truth, rtol=0.05, atol=0.05)


def test_nothing_is_said_of_the_place_where_all_is_recorded_at_one(tmp_path: Path) -> None:
    names = ("gantry_racking", "growing_bed", "toolhead_mode", "guide_damping")
    machine, runs = filed(PLANT, "cartesian", tmp_path), recorded(PLANT)
    racking, tool, guides = PrinterProblem(machine, runs, names).candidates
    assert (racking.name, tool.name, guides.name) == ("gantry_racking", "toolhead_mode", "guide_damping")
    (centre,) = (n for n in racking.shapes if n.name.endswith(".x_centre_mm"))
    assert (centre.start, centre.sd) == (pytest.approx(100, abs=3), pytest.approx(136, abs=6))  # 40 to 160, and swings
    assert [c.name for c in PrinterProblem(machine, runs[:2], names).candidates] == ["guide_damping"]
