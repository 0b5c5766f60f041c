"""Several numbers compared at once, as LLVM's vectors: it makes none of a short loop by itself."""

from typing import Any

from llvmlite import ir


def any_reaches(lanes: int, types: Any) -> Any:
    """For numba.extending.intrinsic: whether a[i + n] + a[j + n] >= limit for one n of 0..lanes - 1; types: Numba's."""

    def typed(typing: Any, a: Any, i: Any, j: Any, limit: Any) -> Any:
        return types.boolean(a, types.uint64, types.uint64, types.float64), build

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        vector = ir.VectorType(ir.DoubleType(), lanes)
        nothing = ir.Constant(vector, ir.Undefined)

        def load(at: Any) -> Any:
            return builder.load(builder.bitcast(builder.gep(data, [at]), vector.as_pointer()), align=8)

        total = builder.fadd(load(arguments[1]), load(arguments[2]))
        first = builder.insert_element(nothing, arguments[3], ir.IntType(32)(0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)
        limits = builder.shuffle_vector(first, nothing, zeros)
        which = builder.bitcast(builder.fcmp_ordered(">=", total, limits), ir.IntType(lanes))
        return builder.icmp_unsigned("!=", which, ir.IntType(lanes)(0))

    return typed
