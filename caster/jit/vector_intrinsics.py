"""Several numbers handled at once, as LLVM's vectors: it makes none of a short loop by itself.

Each function here is for numba.extending.intrinsic; caster/jit/simd.py declares and documents what it computes.
"""

from typing import Any

from llvmlite import ir

INT32, INT64, REAL = ir.IntType(32), ir.IntType(64), ir.DoubleType()


class Vectors:
    """Vectors of so many numbers, within one function that is being built."""

    def __init__(self, builder: Any, lanes: int) -> None:
        self.builder, self.lanes = builder, lanes
        self.reals = ir.VectorType(REAL, lanes)

    def load(self, data: Any, at: Any, kind: Any = REAL) -> Any:
        """data[at:at + lanes] as float64, of numbers of a kind."""
        vector = ir.VectorType(kind, self.lanes)
        place = self.builder.bitcast(self.builder.gep(data, [at]), vector.as_pointer())
        loaded = self.builder.load(place, align=4 if kind is not REAL else 8)
        return loaded if kind is REAL else self.builder.fpext(loaded, self.reals)

    def store(self, vector: Any, data: Any) -> None:
        self.builder.store(vector, self.builder.bitcast(data, self.reals.as_pointer()), align=8)

    def rows_of_three(self, data: Any, starts: list[Any]) -> list[Any]:
        """The columns x, y, z of a row of three numbers from each of `starts` on, one a lane."""
        builder, two = self.builder, ir.VectorType(REAL, 2)
        pairs = (builder.bitcast(builder.gep(data, [start]), two.as_pointer()) for start in starts)
        joined = self._joined([builder.load(pair, align=8) for pair in pairs])
        x, y = (self._picked(joined, range(axis, 2 * self.lanes, 2)) for axis in (0, 1))
        z = ir.Constant(self.reals, ir.Undefined)
        for n, start in enumerate(starts):
            last = builder.load(builder.gep(data, [builder.add(start, INT64(2))]))
            z = builder.insert_element(z, last, INT32(n))
        return [x, y, z]

    def _joined(self, parts: list[Any]) -> Any:
        """One vector of several, one behind the other."""
        while len(parts) > 1:
            wide = range(2 * parts[0].type.count)
            parts = [self._picked(a, wide, b) for a, b in zip(parts[::2], parts[1::2], strict=True)]
        return parts[0]

    def _picked(self, vector: Any, places: Any, more: Any = None) -> Any:
        """The numbers at these places of one vector, or of two."""
        mask = ir.Constant(ir.VectorType(INT32, len(places)), list(places))
        return self.builder.shuffle_vector(vector, vector if more is None else more, mask)

    def all(self, number: Any) -> Any:
        """The same number everywhere."""
        nothing = ir.Constant(self.reals, ir.Undefined)
        first = self.builder.insert_element(nothing, number, INT32(0))
        return self.builder.shuffle_vector(
            first, nothing, ir.Constant(ir.VectorType(INT32, self.lanes), [0] * self.lanes)
        )

    def reduced(self, vector: Any, chosen: Any) -> Any:
        """One number of a vector, chosen(vectors, a, b) of any two."""
        vectors = self
        while vectors.lanes > 1:
            vector = chosen(vectors, *vectors.halves(vector))
            vectors = Vectors(self.builder, vectors.lanes // 2)
        return self.builder.extract_element(vector, INT32(0))

    def halves(self, vector: Any) -> tuple[Any, Any]:
        half = self.lanes // 2
        return self._picked(vector, range(half)), self._picked(vector, range(half, 2 * half))

    def larger(self, a: Any, b: Any) -> Any:
        return self.builder.select(self.builder.fcmp_ordered(">", a, b), a, b)

    def lesser(self, a: Any, b: Any) -> Any:
        return self.builder.select(self.builder.fcmp_ordered("<", a, b), a, b)

    def bits(self, comparison: Any) -> Any:
        """A bit for each lane, the first one lowest: int64."""
        return self.builder.zext(self.builder.bitcast(comparison, ir.IntType(self.lanes)), INT64)


def any_sum_reaches(lanes: int, types: Any) -> Any:
    def typed(typing: Any, a: Any, i: Any, j: Any, limit: Any) -> Any:
        return types.boolean(a, types.uint64, types.uint64, types.float64), build

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vectors = Vectors(builder, lanes)
        data = _data(context, builder, signature.args[0], arguments[0])
        total = builder.fadd(vectors.load(data, arguments[1]), vectors.load(data, arguments[2]))
        which = vectors.bits(builder.fcmp_ordered(">=", total, vectors.all(arguments[3])))
        return builder.icmp_unsigned("!=", which, INT64(0))

    return typed


FLOAT32 = ir.FloatType()
SIDES = 6  # rows of a node's boxes


class Children:
    """The boxes of one node's children, a lane each."""

    def __init__(self, vectors: Vectors, data: Any, node: Any) -> None:
        self.vectors, self.data = vectors, data
        self.first = vectors.builder.mul(node, INT64(SIDES * vectors.lanes))

    def row(self, number: Any) -> Any:
        builder = self.vectors.builder
        at = builder.add(self.first, builder.mul(number, INT64(self.vectors.lanes)))
        return self.vectors.load(self.data, at, FLOAT32)


def intersect_boxes(lanes: int, types: Any, far_padding: float, latest: float) -> Any:
    return _entering(lanes, types, (far_padding, latest), _by_one)


def intersect_boxes_packet(lanes: int, types: Any, far_padding: float, latest: float) -> Any:
    return _entering(lanes, types, (far_padding, latest), _by_several)


def _entering(lanes: int, types: Any, limits: tuple[float, float], sides_along: Any) -> Any:
    """sides_along(vectors, children, view, axis): where the children are entered and left along an axis."""

    def typed(typing: Any, boxes: Any, node: Any, view: Any, t_min: Any, t_max: Any, near: Any) -> Any:
        return types.int64(boxes, types.int64, view, types.float64, types.float64, near), build

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        boxes, node, view, t_min, t_max, near = arguments
        vectors = Vectors(builder, lanes)
        children = Children(vectors, _data(context, builder, signature.args[0], boxes), node)
        enter, leave = sides_along(vectors, children, view, 0)
        for axis in (1, 2):
            a, b = sides_along(vectors, children, view, axis)
            enter, leave = vectors.larger(enter, a), vectors.lesser(leave, b)
        padding, latest = (vectors.all(ir.Constant(REAL, number)) for number in limits)
        enter = vectors.larger(enter, vectors.all(t_min))
        leave = vectors.lesser(builder.fmul(leave, padding), vectors.all(t_max))
        vectors.store(vectors.lesser(enter, latest), _data(context, builder, signature.args[5], near))
        return vectors.bits(builder.fcmp_ordered("<=", enter, leave))

    return typed


def _data(context: Any, builder: Any, array_type: Any, array: Any) -> Any:
    return context.make_array(array_type)(context, builder, array).data


def _by_one(vectors: Vectors, children: Children, view: Any, axis: int) -> tuple[Any, Any]:
    builder = vectors.builder
    near, far, inverse, enter, leave = (builder.extract_value(view, [field, axis]) for field in range(5))
    slope = vectors.all(inverse)
    return (
        builder.fadd(builder.fmul(children.row(near), slope), vectors.all(enter)),
        builder.fadd(builder.fmul(children.row(far), slope), vectors.all(leave)),
    )


def _by_several(vectors: Vectors, children: Children, view: Any, axis: int) -> tuple[Any, Any]:
    builder = vectors.builder
    near, far, least, most, enter, leave = (builder.extract_value(view, [field, axis]) for field in range(6))
    unit, slopes = vectors.all(builder.extract_value(view, 6)), (vectors.all(least), vectors.all(most))
    begin = builder.fadd(builder.fmul(children.row(near), unit), vectors.all(enter))
    end = builder.fadd(builder.fmul(children.row(far), unit), vectors.all(leave))
    return (
        vectors.lesser(*(builder.fmul(begin, slope) for slope in slopes)),
        vectors.larger(*(builder.fmul(end, slope) for slope in slopes)),
    )


def lowest_bit(types: Any) -> Any:
    def typed(typing: Any, mask: Any) -> Any:
        return types.int64(types.int64), build

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return typed


def lane_min(lanes: int, types: Any) -> Any:
    def typed(typing: Any, a: Any, i: Any) -> Any:
        return types.float64(a, types.uint64), _chosen(lanes, Vectors.lesser)

    return typed


def lane_max(lanes: int, types: Any) -> Any:
    def typed(typing: Any, a: Any, i: Any) -> Any:
        return types.float64(a, types.uint64), _chosen(lanes, Vectors.larger)

    return typed


def lane_max_of_sums(lanes: int, types: Any) -> Any:
    def typed(typing: Any, a: Any, i: Any, j: Any) -> Any:
        return types.float64(a, types.uint64, types.uint64), _chosen(lanes, Vectors.larger)

    return typed


def _chosen(lanes: int, choose: Any) -> Any:
    """Of an array from one place on, or of the sums from two places on, one number by choose(vectors, a, b)."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vectors = Vectors(builder, lanes)
        data = _data(context, builder, signature.args[0], arguments[0])
        first, *more = (vectors.load(data, at) for at in arguments[1:])
        return vectors.reduced(builder.fadd(first, *more) if more else first, choose)

    return build


PREFETCH_FOR_READING, KEEP_IN_ALL_CACHES, DATA = INT32(0), INT32(3), INT32(1)


def prefetch(types: Any) -> Any:
    def typed(typing: Any, rows: Any, k: Any) -> Any:
        assert rows.layout == "C"
        return types.none(rows, types.int64), build

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        step = builder.extract_value(array.strides, 0)
        byte = ir.IntType(8).as_pointer()
        place = builder.gep(builder.bitcast(array.data, byte), [builder.mul(arguments[1], step)])
        wanted = ir.FunctionType(ir.VoidType(), [byte, INT32, INT32, INT32])
        function = builder.module.declare_intrinsic("llvm.prefetch", [byte], wanted)
        builder.call(function, [place, PREFETCH_FOR_READING, KEEP_IN_ALL_CACHES, DATA])
        return context.get_dummy_value()

    return typed


def lanes_in_range(lanes: int, types: Any) -> Any:
    def typed(typing: Any, a: Any, i: Any, least: Any, end: Any) -> Any:
        return types.int64(a, types.uint64, types.float64, types.float64), build

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vectors = Vectors(builder, lanes)
        numbers = vectors.load(_data(context, builder, signature.args[0], arguments[0]), arguments[1])
        return vectors.bits(_in_range(vectors, numbers, *map(vectors.all, arguments[2:])))

    return typed


def _in_range(vectors: Vectors, numbers: Any, least: Any, end: Any) -> Any:
    """Which lanes are: least <= number < end."""
    above = vectors.builder.fcmp_ordered("<=", least, numbers)
    return vectors.builder.and_(above, vectors.builder.fcmp_ordered("<", numbers, end))


def numbers_in_range(lanes: int, types: Any) -> Any:
    def typed(typing: Any, a: Any, i: Any, least: Any, end: Any, scratch: Any, into: Any) -> Any:
        return types.none(a, types.uint64, types.float64, types.float64, scratch, types.uint64), build

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vectors = Vectors(builder, lanes)
        numbers = vectors.load(_data(context, builder, signature.args[0], arguments[0]), arguments[1])
        least, end = map(vectors.all, arguments[2:4])
        out = builder.gep(_data(context, builder, signature.args[4], arguments[4]), [arguments[5]])
        counted, chosen = builder.fsub(numbers, least), _in_range(vectors, numbers, least, end)
        vectors.store(builder.select(chosen, counted, vectors.all(ZERO)), out)
        return context.get_dummy_value()

    return typed


def gather_corners(lanes: int, types: Any) -> Any:
    def typed(typing: Any, rows: Any, faces: Any, scratch: Any, numbers: Any, into: Any, step: Any) -> Any:
        assert rows.layout == faces.layout == scratch.layout == "C"
        places = types.uint64, types.uint64, types.uint64
        return types.none(rows, faces, scratch, *places), build

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vectors = Vectors(builder, lanes)
        arrays = zip(signature.args[:3], arguments[:3], strict=True)
        rows, faces, scratch = (_data(context, builder, *each) for each in arrays)
        numbers, into, step = arguments[3:]
        whole = builder.fptosi(vectors.load(scratch, numbers), ir.VectorType(INT64, lanes))
        first = [builder.mul(builder.extract_element(whole, INT32(n)), INT64(3)) for n in range(lanes)]
        for corner in range(3):
            vertices = (builder.load(builder.gep(faces, [builder.add(at, INT64(corner))])) for at in first)
            starts = [builder.mul(builder.sext(vertex, INT64), INT64(3)) for vertex in vertices]
            for axis, column in enumerate(vectors.rows_of_three(rows, starts)):
                place = builder.add(into, builder.mul(step, INT64(3 * corner + axis)))
                vectors.store(column, builder.gep(scratch, [place]))
        return context.get_dummy_value()

    return typed


ZERO = ir.Constant(REAL, 0.0)


def _all_of(vectors: Vectors, tests: list[Any]) -> Any:
    """The bits of lanes in which all comparisons hold."""
    held = tests[0]
    for test in tests[1:]:
        held = vectors.builder.and_(held, test)
    return vectors.bits(held)


def _parts(builder: Any, vectors: Vectors, group: Any, number: int) -> list[Any]:
    """The members of member `number` of a tuple of tuples, each in all lanes."""
    return [vectors.all(builder.extract_value(group, [number, n])) for n in range(3)]


def boxes_below(lanes: int, types: Any, fields: int) -> Any:
    def typed(typing: Any, boxes: Any, node: Any, limits: Any) -> Any:
        return types.int64(boxes, types.int64, limits), build

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vectors = Vectors(builder, lanes)
        data = _data(context, builder, signature.args[0], arguments[0])
        first = builder.mul(arguments[1], INT64(fields * lanes))
        rows = [vectors.load(data, builder.add(first, INT64(f * lanes))) for f in range(fields)]
        limits = [vectors.all(builder.extract_value(arguments[2], f)) for f in range(fields)]
        pairs = zip(rows, limits, strict=True)
        return _all_of(vectors, [builder.fcmp_ordered("<=", row, limit) for row, limit in pairs])

    return typed


def boxes_reach_lines(lanes: int, types: Any, fields: int) -> Any:
    def typed(typing: Any, boxes: Any, node: Any, lines: Any) -> Any:
        return types.int64(boxes, types.int64, lines), build

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vectors = Vectors(builder, lanes)
        data = _data(context, builder, signature.args[0], arguments[0])
        first = builder.mul(arguments[1], INT64(fields * lanes))

        def most(slope: Any, axis: int) -> Any:
            """slope x, where it is largest."""
            rises = builder.fcmp_ordered(">", slope, ZERO)
            row = builder.select(rises, INT64((2 * axis + 1) * lanes), INT64(2 * axis * lanes))
            factor = builder.select(rises, builder.fneg(slope), slope)
            return builder.fmul(vectors.all(factor), vectors.load(data, builder.add(first, row)))

        tests = []
        for n in range(3):
            a, b, c = (builder.extract_value(arguments[2], [n, m]) for m in range(3))
            total = builder.fadd(builder.fadd(most(a, 0), most(b, 1)), vectors.all(c))
            tests.append(builder.fcmp_ordered(">=", total, vectors.all(ZERO)))
        return _all_of(vectors, tests)

    return typed


def lanes_within_lines(lanes: int, types: Any) -> Any:
    def typed(typing: Any, xy: Any, i: Any, j: Any, lines: Any) -> Any:
        return types.int64(xy, types.uint64, types.uint64, lines), build

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vectors = Vectors(builder, lanes)
        data = _data(context, builder, signature.args[0], arguments[0])
        x, y = vectors.load(data, arguments[1]), vectors.load(data, arguments[2])
        tests = []
        for n in range(3):
            a, b, c = _parts(builder, vectors, arguments[3], n)
            total = builder.fadd(builder.fadd(builder.fmul(a, x), builder.fmul(b, y)), c)
            tests.append(builder.fcmp_ordered(">=", total, vectors.all(ZERO)))
        return _all_of(vectors, tests)

    return typed


def lanes_not_above(lanes: int, types: Any, atol: float) -> Any:
    def typed(typing: Any, tile: Any, x: Any, y: Any, z: Any, plane: Any) -> Any:
        return types.int64(tile, types.uint64, types.uint64, types.uint64, plane), build

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vectors = Vectors(builder, lanes)
        data = _data(context, builder, signature.args[0], arguments[0])
        p, normal, error = (_parts(builder, vectors, arguments[4], n) for n in range(3))
        heights, errors = [], []
        for axis in range(3):
            away = builder.fsub(p[axis], vectors.load(data, arguments[1 + axis]))
            heights.append(builder.fmul(normal[axis], away))
            errors.append(builder.fmul(error[axis], vectors.larger(away, builder.fneg(away))))
        height = builder.fadd(builder.fadd(heights[0], heights[1]), heights[2])
        most = builder.fadd(builder.fadd(errors[0], errors[1]), errors[2])
        most = builder.fadd(most, vectors.all(ir.Constant(REAL, atol)))
        return vectors.bits(builder.not_(builder.fcmp_ordered(">", height, most)))

    return typed
