"""Every error of the input ends in a sentence and its documented exit code."""

from __future__ import annotations

import re

import pytest

from ffcomp import errors
from ffcomp.errors import interrupts_restored
from ffcomp.importers.values import PrinterConfigError
from ffcomp.steps.archive import StepsError
from gcode.errors import GcodeError, UnsupportedGcode
from models.errors import MachineFileError, UnreachableError

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
