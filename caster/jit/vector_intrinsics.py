"""LLVM code of the functions of caster/jit/simd.py, which documents them, for numba.extending.intrinsic."""

import inspect
import operator
from collections.abc import Callable, Iterator
from functools import partial
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
    real, whole, none, index = types.float64, types.int64, types.none, types.uint64
    for stub, build, gives, *takes in (
        (simd.load_lanes, _load, VECTOR, None, index),
        (simd.load_children, _load, VECTOR, None, index),
        (simd.store, _store, none, VECTOR, None, index),
        (simd.splat, _splat, VECTOR, real),
        (operator.add, ir.IRBuilder.fadd, VECTOR, VECTOR, VECTOR),
        (operator.sub, ir.IRBuilder.fsub, VECTOR, VECTOR, VECTOR),
        (operator.mul, ir.IRBuilder.fmul, VECTOR, VECTOR, VECTOR),
        (simd.larger, _larger, VECTOR, VECTOR, VECTOR),
        (simd.lesser, _lesser, VECTOR, VECTOR, VECTOR),
        (simd.bits_below, partial(_bits, "<"), whole, VECTOR, VECTOR),
        (simd.bits_up_to, partial(_bits, "<="), whole, VECTOR, VECTOR),
        (simd.select, _select, VECTOR, whole, VECTOR, VECTOR),
        (simd.least, partial(_reduced, _lesser), real, VECTOR),
        (simd.largest, partial(_reduced, _larger), real, VECTOR),
        (simd.lowest_bit, _lowest_bit, whole, whole),
        (simd.prefetch, _prefetch, none, None, whole),
        (simd.gather_corners, _gather_corners, none, None, None, None, index, index, index),
        (machine_code.load_word, _load_word, whole, whole),
        (machine_code.store_word, _store_word, none, whole, whole),
        (machine_code.call_entry, _call_entry, whole, whole, whole),
    ):
        yield stub, _intrinsic(build, gives, *takes)


def _intrinsic(build: Callable[..., Any], gives: Any, *takes: Any) -> Callable[..., Any]:
    """Definition of an intrinsic: build(builder, *arguments) returns its value.

    takes: the type of each argument, None for a C-ordered array, which `build` gets as Numba's structure. A float64 may
    stand for all vectors but one.
    """

    def typed(typing: Any, *given: Any) -> Any:
        if VECTOR in takes and VECTOR not in given:
            return None
        pairs = list(zip(takes, given, strict=True))
        assert all(kind is not None or arg.layout == "C" for kind, arg in pairs)

        def body(context: Any, builder: Builder, signature: Any, arguments: Any) -> Any:
            values = list(arguments)
            for n, (kind, arg) in enumerate(pairs):
                if kind is None:
                    values[n] = context.make_array(arg)(context, builder, values[n])
                elif kind is VECTOR and arg == types.float64:
                    values[n] = _splat(builder, values[n])
            value = build(builder, *values)
            return context.get_dummy_value() if gives is types.none else value

        wanted = [arg if kind is None or (kind is VECTOR and arg == types.float64) else kind for kind, arg in pairs]
        return gives(*wanted), body

    names = ["typing", *(f"a{n}" for n in range(len(takes)))]  # Numba counts them
    parameters = [inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD) for name in names]
    typed.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # read by inspect
    return typed


def _load(builder: Builder, array: Any, i: Any) -> Any:
    """LANES numbers from element i of an array on, as float64."""
    element = array.data.type.pointee
    place = builder.bitcast(builder.gep(array.data, [i]), ir.VectorType(element, LANES).as_pointer())
    vector = builder.load(place, align=8 if element == REAL else 4)
    return vector if element == REAL else builder.fpext(vector, REALS)


def _store(builder: Builder, vector: Any, array: Any, i: Any) -> None:
    builder.store(vector, builder.bitcast(builder.gep(array.data, [i]), REALS.as_pointer()), align=8)


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


def _bits(relation: str, builder: Builder, v: Any, w: Any) -> Any:
    return builder.zext(builder.bitcast(builder.fcmp_ordered(relation, v, w), ir.IntType(LANES)), INT64)


def _select(builder: Builder, bits: Any, v: Any, w: Any) -> Any:
    chosen = builder.bitcast(builder.trunc(bits, ir.IntType(LANES)), ir.VectorType(ir.IntType(1), LANES))
    return builder.select(chosen, v, w)


def _reduced(chosen: Callable[[Builder, Any, Any], Any], builder: Builder, vector: Any) -> Any:
    """Reduce a vector by choosing between its halves."""
    half = LANES // 2
    while half:
        vector = chosen(builder, *(_picked(builder, vector, range(at, at + half)) for at in (0, half)))
        half //= 2
    return builder.extract_element(vector, INT32(0))


def _lowest_bit(builder: Builder, mask: Any) -> Any:
    return builder.cttz(mask, ir.Constant(ir.IntType(1), 1))


def _load_word(builder: Builder, address: Any) -> Any:
    return builder.load(builder.inttoptr(address, INT64.as_pointer()))


def _store_word(builder: Builder, address: Any, word: Any) -> None:
    builder.store(word, builder.inttoptr(address, INT64.as_pointer()))


def _call_entry(builder: Builder, entry: Any, block: Any) -> Any:
    kind = ir.FunctionType(INT32, [INT64]).as_pointer()
    return builder.sext(builder.call(builder.inttoptr(entry, kind), [block]), INT64)


FOR_READING, KEEP_IN_ALL_CACHES, DATA = INT32(0), INT32(3), INT32(1)


def _prefetch(builder: Builder, rows: Any, k: Any) -> None:
    byte = ir.IntType(8).as_pointer()
    step = builder.extract_value(rows.strides, 0)
    place = builder.gep(builder.bitcast(rows.data, byte), [builder.mul(k, step)])
    wanted = ir.FunctionType(ir.VoidType(), [byte, INT32, INT32, INT32])
    function = builder.module.declare_intrinsic("llvm.prefetch", [byte], wanted)
    builder.call(function, [place, FOR_READING, KEEP_IN_ALL_CACHES, DATA])


def _gather_corners(builder: Builder, rows: Any, faces: Any, lanes: Any, numbers: Any, into: Any, step: Any) -> None:
    whole = builder.fptosi(_load(builder, lanes, numbers), ir.VectorType(INT64, LANES))
    first = [builder.mul(builder.extract_element(whole, INT32(n)), INT64(3)) for n in range(LANES)]
    for corner in range(3):
        vertices = (builder.load(builder.gep(faces.data, [builder.add(at, INT64(corner))])) for at in first)
        starts = [builder.mul(builder.sext(vertex, INT64), INT64(3)) for vertex in vertices]
        for axis in range(3):
            column = ir.Constant(REALS, ir.Undefined)
            for n, start in enumerate(starts):
                number = builder.load(builder.gep(rows.data, [builder.add(start, INT64(axis))]))
                column = builder.insert_element(column, number, INT32(n))
            _store(builder, column, lanes, builder.add(into, builder.mul(step, INT64(3 * corner + axis))))
