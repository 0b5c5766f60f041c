"""LLVM code of the functions of caster/jit/simd.py, which documents them, for numba.extending.intrinsic."""

import inspect
import operator
from collections.abc import Callable, Iterator
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.core.datamodel import models
from numba.extending import register_model

from caster.jit import machine_code, simd

INT32, INT64, REAL = ir.IntType(32), ir.IntType(64), ir.DoubleType()
LANES = simd.CHILDREN  # of every vector; simd.LANES is the same where anything is compiled
REALS = ir.VectorType(REAL, LANES)

Builder = Any


class VectorType(types.Type):
    """Numba's type of a vector."""

    def __init__(self) -> None:
        super().__init__(f"Vector({LANES})")


@register_model(VectorType)
class VectorModel(models.PrimitiveModel):  # type: ignore[misc]  # likewise
    """A vector as LLVM has it."""

    def __init__(self, manager: Any, of: Any) -> None:
        super().__init__(manager, of, REALS)


VECTOR = VectorType()


def intrinsics() -> Iterator[tuple[Callable[..., Any], Callable[..., Any]]]:
    """(plain Python function, definition) of each intrinsic."""
    yield simd.load_lanes, _intrinsic(_load, VECTOR, None, types.uint64)
    yield simd.load_children, _intrinsic(_load, VECTOR, None, types.uint64)
    yield simd.store, _intrinsic(_store, types.none, VECTOR, None, types.uint64)
    yield simd.splat, _intrinsic(lambda call, x: _splat(call.builder, x), VECTOR, types.float64)
    for stub, operation in (
        (operator.add, lambda call, v, w: call.builder.fadd(v, w)),
        (operator.sub, lambda call, v, w: call.builder.fsub(v, w)),
        (operator.mul, lambda call, v, w: call.builder.fmul(v, w)),
        (simd.larger, lambda call, v, w: _larger(call.builder, v, w)),
        (simd.lesser, lambda call, v, w: _lesser(call.builder, v, w)),
    ):
        yield stub, _intrinsic(operation, VECTOR, VECTOR, VECTOR)
    yield simd.bits_below, _intrinsic(lambda call, v, w: _bits(call.builder, "<", v, w), types.int64, VECTOR, VECTOR)
    yield simd.bits_up_to, _intrinsic(lambda call, v, w: _bits(call.builder, "<=", v, w), types.int64, VECTOR, VECTOR)
    yield simd.select, _intrinsic(_select, VECTOR, types.int64, VECTOR, VECTOR)
    yield simd.least, _intrinsic(lambda call, v: _reduced(call.builder, v, _lesser), types.float64, VECTOR)
    yield simd.largest, _intrinsic(lambda call, v: _reduced(call.builder, v, _larger), types.float64, VECTOR)
    yield simd.lowest_bit, _intrinsic(_lowest_bit, types.int64, types.int64)
    yield simd.prefetch, _intrinsic(_prefetch, types.none, None, types.int64)
    yield machine_code.load_word, _intrinsic(_load_word, types.int64, types.int64)
    yield machine_code.store_word, _intrinsic(_store_word, types.none, types.int64, types.int64)
    yield machine_code.call_entry, _intrinsic(_call_entry, types.int64, types.int64, types.int64)
    yield simd.gather_corners, _intrinsic(_gather_corners, types.none, None, None, None, *[types.uint64] * 3)


class Call:
    """A call that is being compiled."""

    def __init__(self, context: Any, builder: Builder, given: Any) -> None:
        self.context, self.builder, self.given = context, builder, given

    def data(self, place: int, array: Any) -> Any:
        """Address of the first element of an array, the argument at this place."""
        return self.context.make_array(self.given[place])(self.context, self.builder, array).data


def _intrinsic(build: Callable[..., Any], gives: Any, *takes: Any) -> Callable[..., Any]:
    """Definition of an intrinsic: build(call, *arguments) returns its value.

    takes: the type of each argument, None for a C-ordered array. A float64 may stand for all vectors but one.
    """

    def typed(typing: Any, *given: Any) -> Any:
        if VECTOR in takes and VECTOR not in given:
            return None
        pairs = list(zip(takes, given, strict=True))
        assert all(kind is not None or arg.layout == "C" for kind, arg in pairs)
        spread = [kind is VECTOR and arg == types.float64 for kind, arg in pairs]
        wanted = [arg if kind is None or number else kind for (kind, arg), number in zip(pairs, spread, strict=True)]

        def body(context: Any, builder: Builder, signature: Any, arguments: Any) -> Any:
            values = (_splat(builder, a) if number else a for a, number in zip(arguments, spread, strict=True))
            value = build(Call(context, builder, signature.args), *values)
            return context.get_dummy_value() if gives is types.none else value

        return gives(*wanted), body

    names = ["typing", *(f"a{n}" for n in range(len(takes)))]  # Numba counts them
    parameters = [inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD) for name in names]
    typed.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # read by inspect
    return typed


def _load(call: Call, array: Any, i: Any) -> Any:
    element = call.context.get_data_type(call.given[0].dtype)
    return _load_from(call.builder, call.builder.gep(call.data(0, array), [i]), element)


def _load_from(builder: Builder, place: Any, element: Any = REAL) -> Any:
    vector = builder.load(
        builder.bitcast(place, ir.VectorType(element, LANES).as_pointer()), align=8 if element == REAL else 4
    )
    return vector if element == REAL else builder.fpext(vector, REALS)


def _store(call: Call, vector: Any, array: Any, i: Any) -> None:
    _store_to(call.builder, vector, call.builder.gep(call.data(1, array), [i]))


def _store_to(builder: Builder, vector: Any, place: Any) -> None:
    builder.store(vector, builder.bitcast(place, REALS.as_pointer()), align=8)


def _splat(builder: Builder, x: Any) -> Any:
    nothing = ir.Constant(REALS, ir.Undefined)
    return _picked(builder, builder.insert_element(nothing, x, INT32(0)), [0] * LANES)


def _picked(builder: Builder, vector: Any, places: Any, more: Any = None) -> Any:
    """Elements of one vector or two, by their places."""
    mask = ir.Constant(ir.VectorType(INT32, len(places)), list(places))
    return builder.shuffle_vector(vector, vector if more is None else more, mask)


def _larger(builder: Builder, v: Any, w: Any) -> Any:
    return builder.select(builder.fcmp_ordered(">", v, w), v, w)


def _lesser(builder: Builder, v: Any, w: Any) -> Any:
    return builder.select(builder.fcmp_ordered("<", v, w), v, w)


def _bits(builder: Builder, relation: str, v: Any, w: Any) -> Any:
    return builder.zext(builder.bitcast(builder.fcmp_ordered(relation, v, w), ir.IntType(LANES)), INT64)


def _select(call: Call, bits: Any, v: Any, w: Any) -> Any:
    chosen = call.builder.bitcast(call.builder.trunc(bits, ir.IntType(LANES)), ir.VectorType(ir.IntType(1), LANES))
    return call.builder.select(chosen, v, w)


def _reduced(builder: Builder, vector: Any, chosen: Callable[[Builder, Any, Any], Any]) -> Any:
    """Reduce a vector by choosing between its halves."""
    half = LANES // 2
    while half:
        vector = chosen(builder, *(_picked(builder, vector, range(at, at + half)) for at in (0, half)))
        half //= 2
    return builder.extract_element(vector, INT32(0))


def _lowest_bit(call: Call, mask: Any) -> Any:
    return call.builder.cttz(mask, ir.Constant(ir.IntType(1), 1))


def _load_word(call: Call, address: Any) -> Any:
    return call.builder.load(call.builder.inttoptr(address, INT64.as_pointer()))


def _store_word(call: Call, address: Any, word: Any) -> None:
    call.builder.store(word, call.builder.inttoptr(address, INT64.as_pointer()))


def _call_entry(call: Call, entry: Any, block: Any) -> Any:
    kind = ir.FunctionType(INT32, [INT64]).as_pointer()
    return call.builder.sext(call.builder.call(call.builder.inttoptr(entry, kind), [block]), INT64)


FOR_READING, KEEP_IN_ALL_CACHES, DATA = INT32(0), INT32(3), INT32(1)


def _prefetch(call: Call, rows: Any, k: Any) -> None:
    builder, byte = call.builder, ir.IntType(8).as_pointer()
    array = call.context.make_array(call.given[0])(call.context, builder, rows)
    step = builder.extract_value(array.strides, 0)
    place = builder.gep(builder.bitcast(array.data, byte), [builder.mul(k, step)])
    wanted = ir.FunctionType(ir.VoidType(), [byte, INT32, INT32, INT32])
    function = builder.module.declare_intrinsic("llvm.prefetch", [byte], wanted)
    builder.call(function, [place, FOR_READING, KEEP_IN_ALL_CACHES, DATA])


def _gather_corners(call: Call, rows: Any, faces: Any, lanes: Any, numbers: Any, into: Any, step: Any) -> None:
    builder = call.builder
    rows, faces, lanes = call.data(0, rows), call.data(1, faces), call.data(2, lanes)
    whole = builder.fptosi(_load_from(builder, builder.gep(lanes, [numbers])), ir.VectorType(INT64, LANES))
    first = [builder.mul(builder.extract_element(whole, INT32(n)), INT64(3)) for n in range(LANES)]
    for corner in range(3):
        vertices = (builder.load(builder.gep(faces, [builder.add(at, INT64(corner))])) for at in first)
        starts = [builder.mul(builder.sext(vertex, INT64), INT64(3)) for vertex in vertices]
        for axis, column in enumerate(_rows_of_three(builder, rows, starts)):
            place = builder.add(into, builder.mul(step, INT64(3 * corner + axis)))
            _store_to(builder, column, builder.gep(lanes, [place]))


def _rows_of_three(builder: Builder, data: Any, starts: list[Any]) -> list[Any]:
    """The columns x, y, z of rows of three numbers that begin at `starts`."""
    two = ir.VectorType(REAL, 2).as_pointer()
    joined = [builder.load(builder.bitcast(builder.gep(data, [start]), two), align=8) for start in starts]
    while len(joined) > 1:  # concatenate pairs
        wide = range(2 * joined[0].type.count)
        joined = [_picked(builder, a, wide, b) for a, b in zip(joined[::2], joined[1::2], strict=True)]
    z = ir.Constant(REALS, ir.Undefined)
    for n, start in enumerate(starts):
        last = builder.load(builder.gep(data, [builder.add(start, INT64(2))]))
        z = builder.insert_element(z, last, INT32(n))
    return [*(_picked(builder, joined[0], range(axis, 2 * LANES, 2)) for axis in (0, 1)), z]
