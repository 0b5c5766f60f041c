"""LLVM code by which Numba replaces calls of the functions of caster/jit/simd.py, which documents them."""

import inspect
import operator
from collections.abc import Callable
from functools import partial
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.core.datamodel import models
from numba.core.typing import templates
from numba.extending import register_model

from caster.jit import machine_code, simd

INT32, INT64, REAL = ir.IntType(32), ir.IntType(64), ir.DoubleType()
LANES = simd.CHILDREN  # of every vector; simd.LANES is the same where anything is compiled
REALS = ir.VectorType(REAL, LANES)

Builder = Any


class VectorType(types.Type):
    """Numba's type of a vector."""


@register_model(VectorType)
class VectorModel(models.PrimitiveModel):  # type: ignore[misc]  # likewise
    """A vector as LLVM has it."""

    def __init__(self, manager: Any, of: Any) -> None:
        super().__init__(manager, of, REALS)


VECTOR = VectorType(f"Vector({LANES})")


def _register(stub: Callable[..., Any], build: Callable[..., Any], gives: Any, *takes: Any) -> None:
    """Replace calls of a Python function by LLVM code: build(builder, *arguments) returns the value.

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
    template = templates.make_intrinsic_template(stub, typed, stub.__name__)
    templates.infer(template)
    templates.infer_global(stub, types.Function(template))


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


def _picked(builder: Builder, vector: Any, places: Any) -> Any:
    """Elements of a vector, by their places."""
    return builder.shuffle_vector(vector, vector, ir.Constant(ir.VectorType(INT32, len(places)), list(places)))


def _chosen(relation: str, builder: Builder, v: Any, w: Any) -> Any:
    return builder.select(builder.fcmp_ordered(relation, v, w), v, w)


def _bits(relation: str, builder: Builder, v: Any, w: Any) -> Any:
    return builder.zext(builder.bitcast(builder.fcmp_ordered(relation, v, w), ir.IntType(LANES)), INT64)


def _select(builder: Builder, bits: Any, v: Any, w: Any) -> Any:
    chosen = builder.bitcast(builder.trunc(bits, ir.IntType(LANES)), ir.VectorType(ir.IntType(1), LANES))
    return builder.select(chosen, v, w)


def _reduced(relation: str, builder: Builder, vector: Any) -> Any:
    """Reduce a vector by choosing between its halves."""
    half = LANES // 2
    while half:
        vector = _chosen(relation, builder, *(_picked(builder, vector, range(at, at + half)) for at in (0, half)))
        half //= 2
    return builder.extract_element(vector, INT32(0))


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


real, whole, none, index = types.float64, types.int64, types.none, types.uint64
NOT_ZERO = ir.Constant(ir.IntType(1), 1)  # the mask, so that 0 needs no code
WORD = INT64.as_pointer()

_register(simd.load_lanes, _load, VECTOR, None, index)
_register(simd.load_children, _load, VECTOR, None, index)
_register(simd.store, _store, none, VECTOR, None, index)
_register(simd.splat, _splat, VECTOR, real)
_register(operator.add, ir.IRBuilder.fadd, VECTOR, VECTOR, VECTOR)
_register(operator.sub, ir.IRBuilder.fsub, VECTOR, VECTOR, VECTOR)
_register(operator.mul, ir.IRBuilder.fmul, VECTOR, VECTOR, VECTOR)
_register(simd.larger, partial(_chosen, ">"), VECTOR, VECTOR, VECTOR)
_register(simd.lesser, partial(_chosen, "<"), VECTOR, VECTOR, VECTOR)
_register(simd.bits_below, partial(_bits, "<"), whole, VECTOR, VECTOR)
_register(simd.bits_up_to, partial(_bits, "<="), whole, VECTOR, VECTOR)
_register(simd.select, _select, VECTOR, whole, VECTOR, VECTOR)
_register(simd.least, partial(_reduced, "<"), real, VECTOR)
_register(simd.largest, partial(_reduced, ">"), real, VECTOR)
_register(simd.lowest_bit, lambda builder, mask: builder.cttz(mask, NOT_ZERO), whole, whole)
_register(simd.prefetch, _prefetch, none, None, whole)
_register(simd.gather_corners, _gather_corners, none, None, None, None, index, index, index)
_register(machine_code.load_word, lambda builder, at: builder.load(builder.inttoptr(at, WORD)), whole, whole)
_register(
    machine_code.store_word, lambda builder, at, w: builder.store(w, builder.inttoptr(at, WORD)), none, whole, whole
)
_register(machine_code.call_entry, _call_entry, whole, whole, whole)
