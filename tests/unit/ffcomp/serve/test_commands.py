"""Options of the page: only those of a kind, only values that the command line takes, never a word of the client's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ffcomp.cli.app import app
from ffcomp.cli.command import commands
from ffcomp.serve.commands import KINDS, checked, steps, task_of
from ffcomp.serve.uploads import Refused

OUT = Path("out")
INPUTS = {"compensate": ("a.gcode",), "compare": ("a.gcode",), "import": ("printer.cfg",), "diagnose": ("a.csv",)}
NAMED = {
    "robust": "on",
    "flavor": "klipper",
    "kinematics": "corexy",
    "only": "mzv",
    "sample": "10%",
    "at": "0,0",
    "offset_mm": "1,2",
}


def words_of(kind: str, options: dict[str, Any], *inputs: str) -> list[tuple[str, ...]]:
    files = tuple(Path(each) for each in inputs)
    task = task_of(kind, checked(kind, options), "/machines/kossel.toml", files, OUT)
    return [step.words for step in steps(kind, task)]


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("destroy", {}),
        ("compensate", {"scheduler": "tcp://evil:1"}),
        ("compensate", {"output_file": "/etc/passwd"}),
        ("compensate", {"max_flow_mm3_per_s": 10}),
        ("compensate", {"flavor": "klipper --force"}),
        ("compensate", {"force": "--scheduler=x"}),
        ("compensate", {"offset_mm": "1"}),
        ("compare", {"sample": "500%"}),
        ("compare", {"only": "mzv\0"}),
        ("plan", {"at": "nan,0"}),
        ("excite", {"seconds": 3}),
        ("fit", {"known_mass_kg": 21}),
        ("import", {"name": "../../etc/cron.d/x"}),
    ],
)
def test_what_the_page_would_not_ask_is_refused(kind: str, options: Any) -> None:
    with pytest.raises(Refused):
        checked(kind, options)


@pytest.mark.parametrize("kind", KINDS)
def test_every_option_is_one_of_the_command_line_and_names_no_file(kind: str) -> None:
    form = KINDS[kind].form
    together = {"max_error_um": "25"} if "max_error_um" in form else {}
    usual = {name: f"{min(3.0, each.option.high or 3.0):g}" for name, each in form.items()} | NAMED
    options = together | {name: each.is_switch or usual[name] for name, each in form.items()}
    for words in words_of(kind, options, *INPUTS.get(kind, ("a.csv",))):
        of_verb = next(each for path, _, each in reversed(list(commands(app))) if words[: len(path)] == path)
        known = {name for each in of_verb for name in (*each.names, each.negative)}
        assert {word.split("=")[0] for word in words if word.startswith("-")} <= known
    assert not {"jobs", "scheduler"} & set(form)
    assert not [name for name, each in form.items() if "Path" in str(each.type)]
