"""Code of one step of a recursion: state ← matrix · (state, input), for small matrices of a fixed shape.

A compiled loop over an array stores each partial sum and loads it again, and the next addition waits for that. Here the
shape is known when the product is compiled: every column of the matrix is one vector, the sums stay in registers, and
there are several of them, so that additions need not wait for each other.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

SUMS = 3  # at a time


def recursion(rows: int, of_state: int, of_input: int) -> Any:
    """Return a compiled function step(matrices, at, state, given, k).

    matrices (g, of_state + of_input, rows): the matrix is number `at`, its columns one after the other.
    state (rows,): the first `of_state` enter the product, which overwrites it.
    given (n, of_input): row k is the input.   All of one type, each contiguous.
    """

    @intrinsic
    def step(typing: Any, matrices: Any, at: Any, state: Any, inputs: Any, k: Any) -> Any:
        return types.void(matrices, at, state, inputs, k), _emitter(rows, of_state, of_input, matrices.dtype, 0)

    return step


def sized_recursion(of_input: int) -> Any:
    """Return a compiled function step(rows, of_state, matrices, at, state, given, k), as `recursion` for any size.

    rows, of_state: tuples whose lengths are the sizes. A tuple's length is part of its type, so that each size is
    compiled by itself, and cached.
    """

    @intrinsic
    def step(typing: Any, rows: Any, of_state: Any, matrices: Any, at: Any, state: Any, inputs: Any, k: Any) -> Any:
        emit = _emitter(rows.count, of_state.count, of_input, matrices.dtype, 2)
        return types.void(rows, of_state, matrices, at, state, inputs, k), emit

    return step


def _emitter(rows: int, of_state: int, of_input: int, dtype: Any, before: int) -> Any:
    """Return the code generator of the step; its own arguments follow `before` others."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        where = [
            context.make_array(kind)(context, builder, value).data
            for kind, value in zip(signature.args, arguments, strict=True)
            if isinstance(kind, types.Array)
        ]
        size = context.get_abi_sizeof(context.get_data_type(dtype))
        column = ir.VectorType(context.get_value_type(dtype), rows)
        index = [context.cast(builder, arguments[i], signature.args[i], types.intp) for i in (before + 1, before + 4)]
        first = builder.gep(where[0], [builder.mul(index[0], _number(rows * (of_state + of_input)))])
        inputs = builder.gep(where[2], [builder.mul(index[1], _number(of_input))])
        # fused where the processor can, a multiplication and an addition where it cannot
        name = f"llvm.fmuladd.v{rows}f{8 * size}"
        kind = ir.FunctionType(column, [column] * 3)
        multiply_add = cgutils.get_or_insert_function(builder.module, kind, name)
        sums: list[Any] = [None] * SUMS
        # inputs first: they need not wait for the previous step
        for turn, c in enumerate([*range(of_state, of_state + of_input), *range(of_state)]):
            source, i = (where[1], c) if c < of_state else (inputs, c - of_state)
            factor = _spread(builder, builder.load(builder.gep(source, [_number(i)])), rows)
            pointer = builder.bitcast(builder.gep(first, [_number(c * rows)]), column.as_pointer())
            entries = builder.load(pointer, align=size)
            so_far = sums[turn % SUMS]
            added = [factor, entries] if so_far is None else [factor, entries, so_far]
            sums[turn % SUMS] = builder.fmul(*added) if so_far is None else builder.call(multiply_add, added)
        total = sums[0]
        for each in sums[1:]:
            total = builder.fadd(total, each)
        builder.store(total, builder.bitcast(where[1], column.as_pointer()), align=size)
        return context.get_dummy_value()

    return emit


def _number(value: int) -> Any:
    return ir.Constant(ir.IntType(64), value)


def _spread(builder: Any, value: Any, count: int) -> Any:
    """Return a vector of one value."""
    empty = ir.Constant(ir.VectorType(value.type, count), ir.Undefined)
    one = builder.insert_element(empty, value, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, empty, ir.Constant(ir.VectorType(ir.IntType(32), count), [0] * count))
