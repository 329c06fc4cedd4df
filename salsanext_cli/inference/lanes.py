# SPDX-License-Identifier: MIT
"""Sixteen float32 numbers at once, as a type for compiled code.

Left to itself the compiler does not vectorise kernels that read and write a dozen places: it cannot
prove that they do not overlap. `Lanes` says what is meant, on any CPU: one register where there are
AVX-512's, two with AVX2, four with NEON.
"""

from __future__ import annotations

import operator
from typing import Any

from llvmlite import ir
from numba import extending, types

intrinsic: Any = extending.intrinsic
LANES = 16
VECTOR = ir.VectorType(ir.FloatType(), LANES)
FUSIBLE = ("contract",)
"""A product and the sum it goes into may be rounded once."""


class Lanes(types.Type):
    """The type of sixteen float32 numbers."""

    def __init__(self) -> None:
        super().__init__(name="Lanes")


lanes = Lanes()


@extending.register_model(Lanes)
class LanesModel(extending.models.PrimitiveModel):
    """Their form in compiled code: a vector of LLVM's."""

    def __init__(self, manager: Any, fe_type: Any) -> None:
        super().__init__(manager, fe_type, VECTOR)


def _place(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), VECTOR.as_pointer())


@intrinsic
def load(_: Any, array: Any, index: Any) -> Any:
    """Return ``array[index : index + 16]`` of a flat float32 array; bounds are not checked."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        loaded = builder.load(_place(context, builder, signature.args[0], *arguments))
        loaded.align = 4
        return loaded

    return lanes(array, types.int64), generate


@intrinsic
def store(_: Any, array: Any, index: Any, values: Any) -> Any:
    """Write ``array[index : index + 16] = values``; bounds are not checked."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        *place, written = arguments
        target = _place(context, builder, signature.args[0], *place)
        builder.store(written, target).align = 4
        return context.get_dummy_value()

    return types.void(array, types.int64, lanes), generate


@intrinsic
def splat(_: Any, number: Any) -> Any:
    """Return a number sixteen times."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        none = ir.Constant(VECTOR, ir.Undefined)
        zero = ir.Constant(ir.IntType(32), 0)
        first = builder.insert_element(none, arguments[0], zero)
        order = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
        return builder.shuffle_vector(first, none, order)

    return lanes(types.float32), generate


@intrinsic
def leaky(_: Any, values: Any, slope: Any) -> Any:
    """Return values where they are above 0, their product with the slope elsewhere."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        value, factor = arguments
        zero = ir.Constant(VECTOR, [0.0] * LANES)
        above = builder.fcmp_ordered(">", value, zero)
        return builder.select(above, value, builder.fmul(value, factor))

    return lanes(lanes, lanes), generate


def _lane_by_lane(instruction: str) -> Any:
    @intrinsic
    def combine(_: Any, left: Any, right: Any) -> Any:
        def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            return getattr(builder, instruction)(*arguments, flags=FUSIBLE)

        return lanes(lanes, lanes), generate

    # Numba wants the same bare names here as in what is returned.
    def resolve(left, right):  # type: ignore[no-untyped-def]
        if isinstance(left, Lanes) and isinstance(right, Lanes):
            return lambda left, right: combine(left, right)
        return None

    return resolve


extending.overload(operator.add)(_lane_by_lane("fadd"))
extending.overload(operator.sub)(_lane_by_lane("fsub"))
extending.overload(operator.mul)(_lane_by_lane("fmul"))
