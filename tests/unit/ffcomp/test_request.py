"""An option is declared once: a request that gains a field has it on every surface, read and checked alike."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest

from ffcomp.cli.command import verb
from ffcomp.compensation.request import CompensateRequest
from ffcomp.errors import RequestError
from ffcomp.request import ACCURACY, Option, function
from ffcomp.serve.commands import KINDS, Kind, checked, forms, task_of
from ffcomp.serve.uploads import Refused
from tests.support.cli import CliRunner

STIRRED = list[float]()


@dataclass(frozen=True, kw_only=True)
class Stirred(CompensateRequest):
    """A request that has gained one option."""

    stir_hz: Annotated[float, Option("Stir at this rate.", ACCURACY, metavar="HZ", low=1.0, high=9.0, label="Stir")] = 2


@verb
def stir(request: Stirred) -> None:
    """Stir a print."""
    STIRRED.append(request.stir_hz)


def stirred(request: Stirred) -> float:
    """Stir a print."""
    return request.stir_hz


@pytest.fixture
def form(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(KINDS, "stir", Kind(("stir",), "stirring", range(1, 2), (Stirred,)))


def test_the_command_line_has_it() -> None:
    assert "Stir at this rate. [1 to 9]" in " ".join(CliRunner().invoke(stir, ["--help"]).output.split())
    assert CliRunner().invoke(stir, ["a.gcode", "-m", "kossel", "--stir-hz", "4"]).exit_code == 0 and STIRRED == [4.0]
    refused = CliRunner().invoke(stir, ["a.gcode", "-m", "kossel", "--stir-hz", "10"])
    assert refused.exit_code == 2 and "--stir-hz 10: it must be 1 to 9." in refused.output


def test_the_python_function_has_it() -> None:
    call = function(Stirred, stirred)
    assert inspect.signature(call).parameters["stir_hz"].default == 2
    assert "stir_hz : float, default 2\n    Stir at this rate. [1 to 9]" in str(call.__doc__)
    assert call(files=(Path("a"),), machine="m", stir_hz=5.0) == 5.0
    with pytest.raises(RequestError, match="it must be 1 to 9"):
        call(files=(Path("a"),), machine="m", stir_hz=0.0)


def test_the_page_has_it(form: None) -> None:
    (field,) = [each for each in forms()["stir"] if each["name"] == "stir_hz"]
    assert (field["label"], field["kind"], field["low"], field["high"]) == ("Stir", "number", 1.0, 9.0)
    task = task_of("stir", checked("stir", {"stir_hz": "4"}), "m", (Path("a"),), Path("out"))
    assert task.words == ("--stir-hz=4",)
    for wrong in ("10", "nan", "x"):
        with pytest.raises(Refused, match="--stir-hz"):
            checked("stir", {"stir_hz": wrong})
