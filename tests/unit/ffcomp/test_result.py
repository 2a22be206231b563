"""A result is said once: text, JSON, the page of `ffcomp serve`, Python and notebooks hold the same."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import pytest

from ffcomp import errors
from ffcomp.errors import interrupts_restored
from ffcomp.importers.values import PrinterConfigError
from ffcomp.numerics.serialise import keys
from ffcomp.result import Answer, Result
from ffcomp.serve.commands import KINDS
from ffcomp.serve.messages import answer_of
from ffcomp.steps.archive import StepsError
from gcode.errors import GcodeError, UnsupportedGcode
from models.errors import MachineFileError, UnreachableError

HEADLINE, FACT, WARNING, STEP = "2 < 3 µm.", ("Print time", "1.0 s"), "It may be off.", "Measure."


@dataclass(frozen=True, repr=False)
class Found(Result):
    schema = "found/1"
    json_keys: ClassVar = keys("number", place="at.name", unknown="nothing.name")

    number: float = 1.0
    at: Path = Path("folder/here")
    nothing: None = None
    headline = HEADLINE
    facts = (FACT,)
    warnings = (WARNING,)
    next_steps = (STEP,)


def test_everybody_has_the_same_words() -> None:
    found = Found()
    assert list(found.answer.lines()) == [f"Warning: {WARNING}", HEADLINE, "  Print time  1.0 s", STEP]
    told = found.to_dict()
    assert told["schema"] == "found/1" and told["number"] == 1.0
    assert told["place"] == "here" and told["unknown"] is None  # beyond an attribute that is None
    assert answer_of(told) == Answer(HEADLINE, [FACT], [WARNING], [STEP])
    assert repr(found) == f"<Found: {HEADLINE}>"
    notebook = found._repr_html_()
    assert "2 &lt; 3 µm." in notebook and all(each in notebook for each in (*FACT, WARNING, STEP))


def test_the_page_leaves_commands_out_and_findings_in() -> None:
    told = {
        "headline": "It fits.",
        "facts": [["Against none", "ffcomp makes this print worse. See ffcomp show a. If exact: --robust off."]],
        "warnings": ["Modes are assumed. Measure them: `ffcomp record plan`.", "Give --known mass=1."],
        "next_steps": ["Look at it: ffcomp show out.gcode", "Print it.", "Measure first: `ffcomp record plan`"],
    }
    shown = answer_of({"answer": told}, KINDS["compensate"].form)
    named = "If exact: “Robust to what the machine file does not know: off”."
    assert list(shown.facts) == [("Against none", f"ffcomp makes this print worse. {named}")]
    assert list(shown.warnings) == ["Modes are assumed.", "Give --known mass=1."]  # no warning is lost
    assert list(shown.next_steps) == ["Print it.", "Measure the machine: see Know my machine."]


# ---- errors ----


ELSEWHERE = [PrinterConfigError, StepsError, GcodeError, UnsupportedGcode, MachineFileError, UnreachableError]
OURS = [each for each in vars(errors).values() if isinstance(each, type) and each.__module__ == "ffcomp.errors"]


def test_the_tree_names_every_error_with_its_exit_code() -> None:
    drawn = dict(re.findall(r"(\w+) +(\d)  ", errors.__doc__ or ""))
    known = {each.__name__: str(each.exit_code) for each in {*OURS, *ELSEWHERE}}
    assert drawn == {**known, "OSError": "2"}


@pytest.mark.parametrize("interrupt", [KeyboardInterrupt(), SystemExit(143)], ids=["Ctrl-C", "SIGTERM"])
def test_an_interrupt_that_compiled_code_has_wrapped_comes_out_as_itself(interrupt: BaseException) -> None:
    unpickled, simulated = SystemError("<_numba_unpickle> …"), SystemError("<simulate> returned a result …")
    unpickled.__cause__, simulated.__cause__ = interrupt, unpickled
    with pytest.raises(type(interrupt)) as caught, interrupts_restored():
        raise simulated
    assert caught.value is interrupt
