"""Verbs run whole, but figures are composed and not drawn: `unit/ffcomp/report` draws them, and `test_cli.py` does."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.undrawn import save_nothing


@pytest.fixture(autouse=True, scope="module")
def _undrawn(request: pytest.FixtureRequest) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        if request.path.name != "test_cli.py":
            patch.setattr("matplotlib.figure.Figure.savefig", save_nothing)
        yield
