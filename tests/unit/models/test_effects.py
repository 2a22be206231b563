"""The catalogue of effects: complete, consistent, checked in machine files, and folded into machines."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from models import effects
from models.effects.catalogue import CATALOGUE, effective_machine, effects_of, measured, values_of, with_effect
from models.effects.effect import Effect, EffectParameter, Signals
from models.errors import MachineFileError
from models.file import LIBRARY, load_machine
from models.machine import Machine, value_of
from tests.support.effects import TABLES
from tests.unit.models.printer.test_one_axis import PROBES as PROBES_OF_AXIS
from validation.blind.delta import EFFECTS as EFFECTS_OF_DELTAS
from validation.blind.kinds import KINDS

ROOT = Path(__file__).parents[3]

EFFECTS = [pytest.param(effect, id=name) for name, effect in CATALOGUE.items()]
PARAMETERS = [pytest.param(p, id=f"{e.name}.{p.name}") for e in CATALOGUE.values() for p in e.parameters]


def test_the_catalogue_is_complete() -> None:
    """A to-do list for whoever adds an effect."""
    missing = list(_to_do())
    assert not missing, "\n".join(missing)


def _to_do() -> Iterator[str]:
    modules = [importlib.import_module(f"models.effects.{m.name}") for m in pkgutil.iter_modules(effects.__path__)]
    declared = {x.name for module in modules for x in vars(module).values() if isinstance(x, Effect)}
    yield from (f"{name}: declared, but not in CATALOGUE" for name in sorted(declared - CATALOGUE.keys()))
    blind = {*EFFECTS_OF_DELTAS, *(name for kind in KINDS.values() for name in kind.effects)}
    page = (ROOT / "docs" / "EFFECTS.md").read_text(encoding="utf-8")
    for name, effect in CATALOGUE.items():
        yield from (f"{name}.{p.name}: no probe" for p in effect.parameters if not p.probe > 0)
        if "carriages" in effect.of and effect.kind != "sensor" and name not in TABLES:
            yield f"{name}: no table in tests/support/effects.py"
        if "axis" in effect.of and name not in PROBES_OF_AXIS:
            yield f"{name}: no probe in tests/unit/models/printer/test_one_axis.py"
        if name not in blind and effect.kind != "sensor":
            yield f"{name}: not in the blind benchmark (validation/blind)"
        if name in effects_of() and f"`{name}`" not in page:
            yield f"{name}: not in docs/EFFECTS.md (python -m scripts.pages --write)"


@pytest.mark.parametrize("effect", EFFECTS)
def test_an_effect_is_one_thing_and_can_be_made(effect: Effect) -> None:
    assert [effect.fold, effect.measure, effect.terms].count(None) == 2
    assert effect.amplitudes or not effect.parameters
    assert effect.remedy.format(where="").endswith((".", ")"))


@pytest.mark.parametrize("parameter", PARAMETERS)
def test_ranges_are_in_order(parameter: EffectParameter) -> None:
    assert parameter.bounds[0] <= parameter.typical[0] < parameter.typical[1] <= parameter.bounds[1]
    assert 0 < parameter.probe <= parameter.typical[1]
    if parameter.role == "amplitude":
        assert parameter.bounds[0] <= parameter.probe <= parameter.bounds[1]
        assert parameter.neutral == np.inf or parameter.bounds[0] <= parameter.neutral <= parameter.bounds[1]


# --- In machine files

MINIMAL = (LIBRARY / "mp-delta-pro.toml").read_text(encoding="utf-8")


@pytest.fixture
def load(tmp_path: Path):
    def load(more: str) -> Machine:
        path = tmp_path / "printer.toml"
        path.write_text(MINIMAL + more, encoding="utf-8")
        return load_machine(path)

    return load


EVERY_EFFECT = """
[effects.stribeck_friction]
force_n = 1
extra_force_n = [1, 2, 3]
velocity_mm_per_s = 10
[effects.center_of_mass]
offset_mm = [1, 2.5, -3]
[effects.frame_mode]
mass_kg = 12
frequency_hz = 25
damping_ratio = 0.02
direction = [0.6, 0.8]
[effects.force_map]
[effects.sensor_time_offset]
offset_s = -0.02
"""


def test_a_file_may_list_effects(load) -> None:
    machine = load(EVERY_EFFECT)
    values = values_of(machine, "stribeck_friction")
    assert values is not None
    np.testing.assert_array_equal(values["force_n"], [1, 1, 1])
    np.testing.assert_array_equal(values["extra_force_n"], [1, 2, 3])
    frame = values_of(machine, "frame_mode")
    assert frame is not None
    np.testing.assert_array_equal(frame["direction"], [[0.6, 0.8]])
    assert values_of(machine, "cogging") is None


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        ("[effects.coulomb_friction]\nforce_n = -1", "coulomb_friction.force_n = -1 must be at least 0 (N)."),
        (
            "[effects.coulomb_friction]\nforce_n = [1, 2]",
            "must be a finite number (N), or a list of three, one a tower.",
        ),
        ("[effects.center_of_mass]\noffset_mm = 1", "offset_mm = 1 must be a list of three finite numbers (mm)."),
        ("[effects.frame_mode]\ndirection = [1, 1]", "direction = [1, 1] must be 'x', 'y', 'both', or a unit vector"),
        ("[effects.cogging]\namplitude_mm = 0.1", "effects.cogging.pitch_mm is missing; p: period of the ripple"),
        ("[effects.frame_mod]\nmass_kg = 1", "effects.frame_mod is not a known effect. Did you mean 'frame_mode'?"),
        (
            "[effects.growing_bed]\ngrowth_per_m = 1.0",
            "effects.growing_bed does not apply to a delta: it has no straight axes.",
        ),
    ],
)
def test_mistakes_are_sentences(load, more: str, sentence: str) -> None:
    with pytest.raises(MachineFileError) as caught:
        load(more)
    assert any(sentence in problem for problem in caught.value.problems)


# --- Folded into the machine


FOLDED = [
    ("guide_damping", {"added_n_s_per_m": 3.0}, "carriage.guide_damping_n_s_per_m", 18.76 + 3),
    ("belt_stiffness", {"relative_change": -0.1}, "carriage.belt_stiffness_n_per_m", 0.9 * 1.039e5),
    ("arm_inertia", {"share_along": 0.7}, "carriage.arm_mass_share_at_ends", 0.3),
    ("effector_mass", {"added_kg": 0.08}, "effector.nozzle_mass_kg", 0.536 + 0.08),
    ("center_of_mass", {"offset_mm": [1.0, 2.0, 3.0]}, "effector.center_of_mass_mm[1]", -16.52 + 2),
    (
        "extruder_mount",
        {"relative_stiffness_change": [0.5, 0.0, 0.0]},
        "effector.extruder_stiffness_n_per_m[0]",
        1.5 * 3.31e3,
    ),
    (
        "extruder_mount",
        {"relative_damping_change": [0.0, 0.0, 1.0]},
        "effector.extruder_damping_n_s_per_m[2]",
        2 * 19.6,
    ),
    ("arm_geometry", {"arm_length_mm": [0.0, -1.0, 0.0]}, "kinematics.arm_lengths_mm[1]", 299.0),
    ("arm_geometry", {"delta_radius_mm": 0.5}, "kinematics.delta_radii_mm[2]", 140.5),
]


@pytest.mark.parametrize(("name", "table", "number", "value"), FOLDED)
def test_effects_fold_into_the_machines_numbers(printer: Machine, name, table, number, value) -> None:
    folded = effective_machine(with_effect(printer, name, **table))
    assert value_of(folded, number) == pytest.approx(value, rel=1e-12)
    assert folded.effects == {}


# --- Sensors


@pytest.fixture
def signals() -> Signals:
    t = np.arange(0, 0.5, 1 / 3200)
    waves = np.stack([np.sin(60 * t), np.cos(80 * t), np.sin(100 * t)], axis=1)
    return Signals(t, waves, 2 * waves[:, ::-1])


def test_a_sensor_turned_by_a_right_angle_swaps_axes(printer: Machine, signals: Signals) -> None:
    seen = measured(with_effect(printer, "sensor_misalignment", angles_deg=[0.0, 0.0, 90.0]), signals)
    x, y, z = signals.nozzle.T
    np.testing.assert_allclose(seen.nozzle, np.stack([y, -x, z], axis=1), atol=1e-12)
    assert seen.carriage is signals.carriage


@pytest.mark.parametrize(
    ("name", "table", "true_time"),
    [
        ("sensor_time_offset", {"offset_s": 0.0123}, lambda t: t - 0.0123),
        ("sensor_clock_drift", {"relative_drift": 0.02}, lambda t: t / 1.02),
    ],
)
def test_clocks_shift_and_stretch(printer: Machine, signals: Signals, name: str, table, true_time) -> None:
    seen = measured(with_effect(printer, name, **table), signals)
    inside = true_time(signals.t_s) > 0.01
    expected = np.sin(60 * true_time(signals.t_s))
    np.testing.assert_allclose(seen.carriage[inside, 0], expected[inside], atol=1e-6)
