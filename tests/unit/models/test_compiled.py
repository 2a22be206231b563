"""Loops that come compiled, and numba for what does not."""

from __future__ import annotations

import ast
import json
import sys
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest

from models import compiled
from models.printer.kernels.record import PARAMETERS
from models.printer.kernels.vectors import unrolled

ROOT = Path(__file__).parents[3]
LOADER = SourceFileLoader("wheel_script", str(ROOT / "scripts" / "wheel"))
SPEC = spec_from_loader("wheel_script", LOADER)
assert SPEC is not None
WHEEL = module_from_spec(SPEC)
LOADER.exec_module(WHEEL)


def test_python_calls_no_kernel_that_is_only_inlined() -> None:
    """A wheel has no code of these by themselves."""
    for path in (ROOT / "models" / "printer").rglob("*.py"):
        functions = [n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.FunctionDef)]
        inlined = {f.name for f in functions if "inlined" in map(ast.unparse, f.decorator_list)}
        called = {ast.unparse(n.func) for f in functions if not f.decorator_list for n in _calls(f)}
        assert not inlined & called, path


def _calls(function: ast.FunctionDef) -> list[ast.Call]:
    return [n for n in ast.walk(function) if isinstance(n, ast.Call)]


class Pair(NamedTuple):
    first: float
    second: int


VALUES = [
    1.5,
    3,
    True,
    np.float64(2),
    np.float32(2),
    np.uint8(7),
    np.bool_(False),
    np.ones((2, 3)),
    np.ones((2, 3)).T,
    np.ones((4, 4))[::2, ::2],
    np.ones(5)[::2],
    np.ones((2, 1, 3), np.float32),
    np.zeros(3, np.uint8),
    np.zeros(3, bool),
    (1.0, 2.0),
    (1, np.ones(2)),
    Pair(1.0, 2),
    np.zeros(2, PARAMETERS),
    np.zeros(2, PARAMETERS)[0],
]


@pytest.mark.parametrize("value", VALUES, ids=lambda value: str(type(value).__name__))
def test_a_value_and_its_type_of_numba_are_of_one_kind(value: Any) -> None:
    kind = compiled.kind_of(value)
    by_type = WHEEL.kind_of_type(numba.typeof(value))
    assert compiled._kind_of_json(json.loads(json.dumps(by_type))) == kind
    records, tuples = {",".join(PARAMETERS.names or ()): PARAMETERS}, {"Pair": Pair}
    assert WHEEL.kind_of_type(WHEEL.type_of_kind(json.loads(json.dumps(by_type)), records, tuples)) == by_type


def twice(x: float) -> float:
    return 2 * x


@pytest.fixture
def library(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A library with one kernel for one kind of argument; returns what it was called with."""
    calls: list[float] = []

    def k0_0(x: float) -> float:
        calls.append(x)
        return 2 * x

    name = f"{__name__}.twice"
    monkeypatch.setattr(compiled, "_table", lambda: {name: {("f8",): "k0_0"}})
    monkeypatch.setitem(sys.modules, f"models.{compiled.LIBRARY}", SimpleNamespace(k0_0=k0_0))
    monkeypatch.delenv(compiled.VARIABLE, raising=False)
    return calls


def test_the_library_answers_for_what_it_has_and_numba_for_the_rest(library: list[float]) -> None:
    doubled = compiled.kernel(twice)
    assert doubled(1.5) == 3.0 and library == [1.5]
    assert doubled(3) == 6 and library == [1.5]
    assert doubled.made.signatures == [(numba.int64,)]


def test_a_kernel_compiled_by_numba_calls_one_of_the_library(library: list[float]) -> None:
    doubled = compiled.kernel(twice)

    def thrice(x: float) -> float:
        return doubled(x) + x

    assert compiled.compiled(thrice, {}, sources=None)(2.0) == 6.0
    assert library == []


@pytest.mark.parametrize("fixture", ["monkeypatch", "library"])
def test_a_function_of_tuples_takes_any_length(fixture: str, request: pytest.FixtureRequest) -> None:
    """Also where a library leaves some lengths to numba."""
    request.getfixturevalue(fixture)

    @unrolled(end=-0.0)
    def total(y: Any) -> float:
        return y[0] + total(y[1:])

    def summed(y: Any) -> float:
        return total(y)

    kernel = compiled.compiled(summed, {}, sources=None)
    assert kernel((1.0, 2.0, 4.0)) == 7.0 and kernel((1.0,)) == 1.0


def test_the_environment_leaves_the_library_alone(library: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(compiled.VARIABLE, "1")
    assert compiled.kernel(twice)(1.5) == 3.0 and library == []


def test_another_processor_leaves_the_library_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    table = {"processor": ["no-such-processor"], "kernels": {"a.b": {"k0_0": ["f8"]}}}
    (tmp_path / f"{compiled.LIBRARY}.json").write_text(json.dumps(table), encoding="ascii")
    monkeypatch.setattr(compiled, "__file__", str(tmp_path / "compiled.py"))
    assert compiled._table.__wrapped__() == ({} if Path("/proc/cpuinfo").exists() else {"a.b": {("f8",): "k0_0"}})
    table["processor"] = []
    (tmp_path / f"{compiled.LIBRARY}.json").write_text(json.dumps(table), encoding="ascii")
    assert compiled._table.__wrapped__() == {"a.b": {("f8",): "k0_0"}}
