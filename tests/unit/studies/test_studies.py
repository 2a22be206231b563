"""Every study can be started; what it measures takes minutes."""

from __future__ import annotations

from importlib import import_module

import pytest

from studies.render import STUDIES

NAMES = sorted(path.stem for path in STUDIES.glob("*.py"))


@pytest.mark.parametrize("name", NAMES)
def test_a_study_starts(name: str) -> None:
    assert import_module(f"studies.{name}").__doc__
