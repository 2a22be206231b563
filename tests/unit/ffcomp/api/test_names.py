"""Every public name is a documented function."""

from __future__ import annotations

import inspect

import pytest

import ffcomp


@pytest.mark.parametrize("name", [name for name in ffcomp.__all__ if name != "__version__"])
def test_every_name_is_a_documented_function(name: str) -> None:
    function = getattr(ffcomp, name)
    assert inspect.isfunction(function)
    assert function.__doc__ and "Parameters" in function.__doc__ and "Raises" in function.__doc__
    parameters = set(inspect.signature(function).parameters)
    described = function.__doc__.split("Parameters")[1]
    assert all(parameter in described for parameter in parameters - {"progress"}), name
    assert name in dir(ffcomp)
    assert inspect.signature(function).return_annotation not in (None, inspect.Signature.empty)
