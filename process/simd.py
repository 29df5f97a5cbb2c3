"""Vector operations of the fold as numba intrinsics: 64 pixels at a time, with the processor's SIMD instructions.

They are written as LLVM vectors, which LLVM lowers to AVX-512, AVX2, SSE or NEON; the result is the same integers
everywhere. The same loops in plain numba take 1.6 to 4 times as long, because its loop vectoriser gives up on them or
widens the levels (figures: docs/decisions/0001-dependencies.md). All take flat C-contiguous uint8 or uint16 arrays and
element offsets; nothing is bounds-checked.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import intrinsic

BLOCK = 64
"""Pixels in one vector operation; one bit each in a uint64 mask."""

GREY_BLOCK = 128
"""Pixels that grey_block converts at once."""

GREY_WEIGHTS = (9798, 19235, 3735)
"""Weights of red, green and blue, in units of 2^-15: OpenCV's 0.299, 0.587, 0.114."""

_operation: Any = intrinsic
"""Untyped: numba's annotation counts the typing context among the arguments."""

_FIRST = ir.Constant(ir.IntType(32), 0)
_BIT = ir.IntType(1)
_BYTE_POINTER = ir.IntType(8).as_pointer()


def _require_levels(*arrays: Any) -> None:
    for array in arrays:
        flat = isinstance(array, types.Array) and array.ndim == 1 and array.layout == "C"
        if not flat or array.dtype not in (types.uint8, types.uint16):
            raise TypingError("needs a flat contiguous uint8 or uint16 array")


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, offset: Any) -> Any:
    """Pointer to the 64-pixel vector that starts at element `offset`."""
    data = context.make_array(array_type)(context, builder, array).data
    vector = ir.VectorType(ir.IntType(array_type.dtype.bitwidth), BLOCK)
    return builder.bitcast(builder.gep(data, [offset]), vector.as_pointer())


def _load(builder: Any, pointer: Any) -> Any:
    return builder.load(pointer, align=1)


def _repeated(builder: Any, number: Any, vector: Any) -> Any:
    """A vector of `vector`'s type, every element the low bits of a uint64."""
    level = builder.trunc(number, vector.element)
    one = builder.insert_element(ir.Constant(vector, ir.Undefined), level, _FIRST)
    places = ir.Constant(ir.VectorType(ir.IntType(32), BLOCK), [0] * BLOCK)
    return builder.shuffle_vector(one, ir.Constant(vector, ir.Undefined), places)


@_operation
def fold_block(typing_context: Any, frame: Any, frame_at: Any, flip: Any, state: Any, state_at: Any, plane: Any) -> Any:
    """Fold 64 pixels into three planes that lie `plane` elements apart: maximum, tail dip, tail rise.

    The values are frame[frame_at + i] ^ flip. Bit i of the uint64 result: the value is a new maximum. The maximum
    itself is only read; for a new maximum the caller sets all three planes, after it has read the dip up to there.
    """
    _require_levels(frame, state)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds = signature.args
        maximum_at, stride = arguments[4], arguments[5]
        dip_at = builder.add(maximum_at, stride)
        values = _load(builder, _pointer(context, builder, kinds[0], arguments[0], arguments[1]))
        values = builder.xor(values, _repeated(builder, arguments[2], values.type))
        maximum = _load(builder, _pointer(context, builder, kinds[3], arguments[3], maximum_at))
        dip_pointer = _pointer(context, builder, kinds[3], arguments[3], dip_at)
        rise_pointer = _pointer(context, builder, kinds[3], arguments[3], builder.add(dip_at, stride))
        dip, rise = _load(builder, dip_pointer), _load(builder, rise_pointer)
        dip = builder.select(builder.icmp_unsigned("<", values, dip), values, dip)
        height = builder.sub(values, dip)
        rise = builder.select(builder.icmp_unsigned(">", height, rise), height, rise)
        builder.store(dip, dip_pointer, align=1)
        builder.store(rise, rise_pointer, align=1)
        return builder.bitcast(builder.icmp_unsigned(">", values, maximum), ir.IntType(64))

    return types.uint64(frame, types.intp, types.uint64, state, types.intp, types.intp), generate


@_operation
def higher_than(typing_context: Any, frame: Any, frame_at: Any, bound: Any, bound_at: Any) -> Any:
    """Bit i of the uint64 result: frame[frame_at + i] > bound[bound_at + i]."""
    _require_levels(frame, bound)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds = signature.args
        values = _load(builder, _pointer(context, builder, kinds[0], arguments[0], arguments[1]))
        bounds = _load(builder, _pointer(context, builder, kinds[2], arguments[2], arguments[3]))
        return builder.bitcast(builder.icmp_unsigned(">", values, bounds), ir.IntType(64))

    return types.uint64(frame, types.intp, bound, types.intp), generate


@_operation
def grey_block(typing_context: Any, rgb: Any, rgb_at: Any, grey: Any, grey_at: Any) -> Any:
    """Grey of GREY_BLOCK pixels of 8 bit: (9798 r + 19235 g + 3735 b + 16384) >> 15, as OpenCV's RGB to grey.

    In 16 bits, so that a register holds twice as many pixels as in 32: each weight is split into 128 x high + low.
    Neither sum overflows, and of the low sum only its carry (its value >> 7) matters to the result.
    """
    _require_levels(rgb, grey)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds = signature.args
        source = context.make_array(kinds[0])(context, builder, arguments[0]).data
        target = context.make_array(kinds[2])(context, builder, arguments[2]).data
        bytes_in = ir.VectorType(ir.IntType(8), 3 * GREY_BLOCK)
        pixels = _load(builder, builder.bitcast(builder.gep(source, [arguments[1]]), bytes_in.as_pointer()))
        wide = ir.VectorType(ir.IntType(16), GREY_BLOCK)

        def all_of(number: int) -> Any:
            return ir.Constant(wide, [number] * GREY_BLOCK)

        high, low = all_of(1 << 7), all_of(0)  # the rounding's 16384, in units of the high part
        for channel, weight in enumerate(GREY_WEIGHTS):
            places = [3 * pixel + channel for pixel in range(GREY_BLOCK)]
            chosen = ir.Constant(ir.VectorType(ir.IntType(32), GREY_BLOCK), places)
            values = builder.shuffle_vector(pixels, ir.Constant(bytes_in, ir.Undefined), chosen)
            values = builder.zext(values, wide)
            high = builder.add(high, builder.mul(values, all_of(weight >> 7)))
            low = builder.add(low, builder.mul(values, all_of(weight & 127)))
        level = builder.lshr(builder.add(high, builder.lshr(low, all_of(7))), all_of(8))
        level = builder.trunc(level, ir.VectorType(ir.IntType(8), GREY_BLOCK))
        pointer = builder.bitcast(builder.gep(target, [arguments[3]]), level.type.as_pointer())
        builder.store(level, pointer, align=1)
        return context.get_dummy_value()

    return types.void(rgb, types.intp, grey, types.intp), generate


@_operation
def lowest_bit(typing_context: Any, mask: Any) -> Any:
    """Index of the lowest set bit of a uint64; 64 for zero."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.cttz(arguments[0], ir.Constant(_BIT, 0))

    return types.uint64(types.uint64), generate


@_operation
def count_bits(typing_context: Any, mask: Any) -> Any:
    """Number of set bits of a uint64."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return types.uint64(types.uint64), generate


@_operation
def prefetch(typing_context: Any, array: Any, offset: Any) -> Any:
    """Load the cache line of array[offset] ahead of its use; no effect on values."""
    if not (isinstance(array, types.Array) and array.ndim == 1 and array.layout == "C"):
        raise TypingError("needs a flat contiguous array")

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        address = builder.bitcast(builder.gep(data, [arguments[1]]), _BYTE_POINTER)
        number = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [_BYTE_POINTER, number, number, number])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        builder.call(function, [address, number(0), number(3), number(1)])
        return context.get_dummy_value()

    return types.void(array, types.intp), generate
