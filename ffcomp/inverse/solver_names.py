"""Names of the solvers of quadratic programmes, apart from `qp.py` so that the command line can list them cheaply."""

from __future__ import annotations

from typing import Literal, get_args

Backend = Literal["osqp", "piqp", "clarabel", "cvxpy"]
SOLVERS: tuple[Backend, ...] = get_args(Backend)
