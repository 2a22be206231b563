"""The wrappers, called as Cura and Moonraker call them, and the recipes for all the others."""

from __future__ import annotations

import configparser
import json
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from ffcomp import __version__
from ffcomp.integrations.recipes import HERE, RECIPES, Recipe, wrapper
from gcode.embedded import already_processed, original
from tests.support.moonraker import metadata, thumbnail

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> str:
    """An ffcomp to be run, in a folder with a space."""
    path = tmp_path_factory.mktemp("program files") / "ffcomp"
    start = "from ffcomp.cli.app import main; main()"
    python = f'PYTHONPATH={shlex.quote(str(ROOT))} FFCOMP_LOG=off exec {sys.executable} -c "{start}" "$@"'
    path.write_text(f"#!/bin/sh\n{python}\n")
    path.chmod(0o755)
    return str(path)


def loaded(name: str, recipe: Recipe, machine: str, program: str) -> ModuleType:
    """A wrapper as it is installed; its lines are those of the file that it is made from."""
    module = ModuleType(name)
    module.__package__ = name.rpartition(".")[0]
    exec(compile(wrapper(recipe, machine, program), HERE / recipe.wrapper, "exec"), vars(module))
    return module


def stand_in(monkeypatch: pytest.MonkeyPatch, name: str, **contents: Any) -> None:
    module = ModuleType(name)
    vars(module).update(contents)
    monkeypatch.setitem(sys.modules, name, module)


# -- Cura --

CURA = [
    ";FLAVOR:Marlin\n;TIME:3\n;Filament used: 0.01m\n;Layer height: 0.2\n",
    "T0\nM82 ;absolute\nG28 ;Straße\nG92 E0\nM107\n;LAYER_COUNT:2\n",
    ";LAYER:0\nM107\nG0 F6000 X10 Y10 Z0.3\n;TYPE:WALL-OUTER\nG1 F3000 X30 Y12 E1\n;TIME_ELAPSED:1.0\n",
    ";LAYER:1\nM106 S85\nG0 F6000 X30 Y14 Z0.5\nG1 F3000 X10 Y10 E2\n;TIME_ELAPSED:2.0\n",
    "G1 F2700 E1\nG0 F6000 X12 Y10\n",
    "M140 S0\nM107\nM84\n;End of Gcode\n",
]


class Script:
    """Cura's base class, as far as scripts see it."""

    values: dict[str, str]

    def getSettingDataString(self) -> str:
        raise NotImplementedError

    def getSettingValueByKey(self, key: str) -> str:
        default: str = json.loads(self.getSettingDataString())["settings"][key]["default_value"]
        return self.values.get(key, default)


@pytest.fixture
def told() -> list[str]:
    """What appeared on Cura's screen."""
    return []


@pytest.fixture
def printer() -> dict[str, Any]:
    """Cura's settings of the printer."""
    return {"machine_width": 220, "machine_depth": 200.0, "machine_center_is_zero": False}


@pytest.fixture
def cura_script(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, program: str, told: list[str], printer: dict[str, Any]
) -> ModuleType:
    """The script, loaded as Cura's plugin loads it."""

    class Message:
        def __init__(self, text: str, lifetime: int, title: str) -> None:
            assert lifetime == 0  # until it is closed
            self.text = text

        def show(self) -> None:
            told.append(self.text)

    cura = SimpleNamespace(
        getGlobalContainerStack=lambda: SimpleNamespace(getProperty=lambda key, _: printer[key]),
        getPrintInformation=lambda: SimpleNamespace(jobName="CE3_Würfel"),
    )
    stand_in(monkeypatch, "UM")
    stand_in(monkeypatch, "UM.Application", Application=SimpleNamespace(getInstance=lambda: cura))
    stand_in(monkeypatch, "UM.Message", Message=Message)
    stand_in(monkeypatch, "PostProcessingPlugin", __path__=[])
    stand_in(monkeypatch, "PostProcessingPlugin.PostProcessingPlugin", __path__=[])
    stand_in(monkeypatch, "PostProcessingPlugin.Script", Script=Script)
    return loaded("PostProcessingPlugin.PostProcessingPlugin.Ffcomp", RECIPES["cura"], "kossel", program)


@pytest.fixture
def cura(cura_script: ModuleType) -> Callable[..., list[str]]:
    """Runs it over a print, as Cura's plugin does when a file is saved."""

    def save(data: list[str], **settings: Any) -> list[str]:
        script = cura_script.Ffcomp()
        script.values = settings
        if ";POSTPROCESSED" not in data[0]:
            data = script.execute(data)
            data[0] += ";POSTPROCESSED\n"
        return data

    return save


def test_cura_gets_the_compensated_print_in_its_pieces(cura: Callable[..., list[str]], told: list[str]) -> None:
    data = cura(list(CURA), options="--no-predict --quiet")
    text = "".join(data).replace(";POSTPROCESSED\n", "").encode()
    assert already_processed(text) is not None and original(text) == "".join(CURA).encode()
    firsts = [piece.partition("\n")[0].removeprefix(";~") for piece in CURA]
    assert [piece.partition("\n")[0].removeprefix(";~") for piece in data] == firsts
    assert ";POSTPROCESSED" in data[0] and cura(data) == data
    assert len(told) == 1 and "--offset-mm -110,-100" in told[0]  # a warning is seen


@pytest.mark.parametrize(
    ("settings", "why"),
    [
        ({"machine": "kosel"}, "Did you mean 'kossel'?"),
        ({"executable": "/no/such ffcomp"}, "No such file"),
        ({"options": "--offset-mm '"}, "No closing quotation"),
        ({"options": "--fast"}, "Unknown option: --fast. See: ffcomp compensate --help. (exit code 2)"),
        ({"executable": None}, "NoneType"),  # whatever it is
    ],
)
def test_a_failure_in_cura_is_seen_and_the_print_stays(
    cura: Callable[..., list[str]], told: list[str], settings: dict[str, Any], why: str
) -> None:
    data = cura(list(CURA), **settings)
    first, comment, *rest = "".join(data).replace(";POSTPROCESSED\n", "").splitlines(keepends=True)
    assert first + "".join(rest) == "".join(CURA) and len(data) == len(CURA)
    assert comment.startswith(";ffcomp FAILED, this print is NOT compensated: ") and why in comment
    assert "│" not in comment  # the frame of an error of usage
    assert len(told) == 1 and "NOT compensated" in told[0] and why in told[0]


# -- Moonraker --


class Config:
    """A section of moonraker.conf, as components are given it."""

    error = ValueError

    def __init__(self, text: str, registered: dict[str, Any]) -> None:
        parser = configparser.ConfigParser(interpolation=None)
        parser.read_string(f"[ffcomp]\n{text}")
        self.section, self.registered = parser["ffcomp"], registered

    def get(self, option: str, default: str | None = None) -> str | None:
        return self.section.get(option, default)

    def getfloat(self, option: str, default: float, above: float) -> float:
        value = float(self.section.get(option, str(default)))
        assert value > above
        return value

    def get_server(self) -> Any:
        storage = SimpleNamespace(register_gcode_processor=self.registered.__setitem__)
        return SimpleNamespace(
            lookup_component={"file_manager": SimpleNamespace(get_metadata_storage=lambda: storage)}.__getitem__
        )


@pytest.fixture
def moonraker(tmp_path: Path, program: str) -> Callable[[str], dict[str, Any]]:
    """The processor that a section of moonraker.conf registers."""
    component = loaded("ffcomp", RECIPES["moonraker"], "", program)

    def processor(section: str) -> dict[str, Any]:
        registered: dict[str, Any] = {}
        component.load_component(Config(section, registered))
        one: dict[str, Any] = registered["ffcomp"]
        return one

    return processor


def test_moonraker_processes_a_print_once_and_reads_it_as_before(
    moonraker: Callable[[str], dict[str, Any]], tmp_path: Path
) -> None:
    lines = (ROOT / "sample_prints" / "ringing_tower.gcode").read_bytes().splitlines(keepends=True)
    sliced = b"".join([lines[0], *thumbnail(), *lines[1:300], *lines[-400:]])
    path = tmp_path / "tower.gcode"
    path.write_bytes(sliced)
    before, _ = metadata(tmp_path, path.name, [])
    one = moonraker("machine: mp-delta-pro\noptions: --no-predict")
    after, _ = metadata(tmp_path, path.name, [one])
    done = path.read_bytes()
    assert original(done) == sliced and before["file_processors"] == [] and after["file_processors"] == ["ffcomp"]
    changed = {key for key in before | after if before.get(key) != after.get(key)}
    ours = {"file_processors", "gcode_start_byte", "gcode_end_byte", "estimated_time"}
    assert changed <= {"size", "modified", "uuid"} | ours
    read = {"slicer", "layer_height", "first_layer_height", "object_height", "filament_total", "nozzle_diameter"}
    assert read | {"thumbnails", "estimated_time", "first_layer_extr_temp"} <= before.keys()
    assert 0 < after["estimated_time"] < before["estimated_time"]  # the slicer's is still that of the whole print
    again, log = metadata(tmp_path, path.name, [one])
    assert f"previously processed by ffcomp v{__version__}" in log
    assert again["file_processors"] == ["ffcomp"] and path.read_bytes() == done
