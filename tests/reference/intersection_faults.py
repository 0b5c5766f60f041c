"""Faults of an intersection kind, as edits of the caster's source: what somebody might get wrong, one at a time."""

from typing import NamedTuple

KERNELS = "caster/kernels"
TREE, ROOTS, TRIANGLES, NEAREST = (f"{KERNELS}/{name}.py" for name in ("bvh", "roots", "triangles", "nearest"))
VEC, SCREEN, INTEGERS = (f"{KERNELS}/{name}.py" for name in ("vec", "screen", "integers"))
PLANAR, QUADRIC, EXACT_ROOT = (f"{KERNELS}/exact_{name}.py" for name in ("planar", "quadric", "root"))
CASTING, HITS, PLACING = "caster/casting.py", "caster/hits.py", "caster/placing.py"
SPHERE, CYLINDER, DISK, PLANE = (f"caster/shapes/{name}.py" for name in ("sphere", "cylinder", "disk", "plane"))


class Edit(NamedTuple):
    """Text that is there exactly once, and what to put in its place."""

    file: str
    old: str
    new: str


class Fault(NamedTuple):
    """What is wrong, where to look for it, and what is found then."""

    what: str
    edits: tuple[Edit, ...]
    families: tuple[str, ...]
    kinds: frozenset[str]  # of findings, one of which has to come up
    suite: str = ""  # tests that fail as well, without the fuzzer; "": none is known to


def fault(what: str, families: str, kinds: str, *edits: tuple[str, str, str], suite: str = "") -> Fault:
    return Fault(what, tuple(Edit(*e) for e in edits), tuple(families.split()), frozenset(kinds.split()), suite)


UNPADDED = (
    (TREE, "pad = tree.reach * (max(abs(o[0]), abs(o[1]), abs(o[2])) + tree.extent)", "pad = 0.0"),
    (TREE, "FAR_PADDING = 1.0 + 2.0 * (3.0 * 2.0**-53) / (1.0 - 3.0 * 2.0**-53)", "FAR_PADDING = 1.0"),
)

FAULTS = (
    fault(
        "the far root for the near one",
        "tangents",
        "t missed prim",
        (ROOTS, "    if near[0] != math.inf:\n        return near\n    return sure", "    return sure"),
    ),
    fault(
        "t_min forgotten by exact roots",
        "surfaces any",
        "phantom t prim",
        (EXACT_ROOT, "    if order(x, number(t_min)) <= 0:\n        return False\n", ""),
    ),
    fault(
        "t_min included",
        "surfaces any",
        "phantom t prim",
        (EXACT_ROOT, "order(x, number(t_min)) <= 0", "order(x, number(t_min)) < 0"),
    ),
    fault(
        "t_max excluded",
        "surfaces any",
        "missed prim",
        (EXACT_ROOT, "or order(x, number(t_max)) <= 0", "or order(x, number(t_max)) < 0"),
    ),
    fault(
        "< for <= where the tree is pruned, boxes unpadded",
        "lattice ties clutter",
        "culling missed prim",
        *UNPADDED,
        (TREE, "return near <= far", "return near < far"),
    ),
    fault("slabs unpadded", "edges clutter transforms", "culling missed prim", *UNPADDED),
    fault(
        "-0.0 taken for a step forward",
        "lattice",
        "culling missed prim",
        (TREE, "if math.copysign(1.0, inverse[c]) > 0.0:", "if inverse[c] > 0.0 or inverse[c] == -math.inf:"),
    ),
    fault(
        "the last primitive of a leaf forgotten",
        "clutter edges",
        "culling missed prim",
        (TREE, "tree.first[node] + tree.prims_in[node]):", "tree.first[node] + max(tree.prims_in[node] - 1, 0)):"),
    ),
    fault(
        "edges excluded",
        "edges",
        "missed prim",
        (PLANAR, "if sign(u) * sign(v) < 0:", "if sign(u) * sign(v) <= 0:"),
    ),
    fault(
        "edge functions of two neighbours not antisymmetric",
        "edges",
        "missed phantom prim",
        (TRIANGLES, "return cross(b, c), cross(c, a), cross(a, b), n, spread", "return cross(b, c), cross(c, a), scaled(1.0 + 2.0**-45, cross(a, b)), n, spread"),
    ),
    fault(
        "edge functions trusted to the last bit",
        "edges transforms",
        "missed phantom prim",
        (TRIANGLES, "EDGE_ERROR = 16.0 * U", "EDGE_ERROR = 0.0"),
    ),
    fault(
        "the textbook's quadratic formula",
        "offsets tangents",
        "missed phantom prim t",
        (ROOTS, "    within = ball.rr - gg\n", "    within = (b * b - a * ball.c) * over_a\n"),
    ),
    fault(
        "tubes without a far wall",
        "tangents",
        "missed prim",
        (CYLINDER, "    return between_ends(far, axis) if far[0] < math.inf else MISS\n", "    return MISS\n"),
    ),
    fault(
        "tubes open at the top",
        "tangents lattice",
        "missed prim t",
        (QUADRIC, "slope, root.r) <= 0", "slope, root.r) < 0"),
    ),
    fault(
        "tangents excluded",
        "tangents",
        "missed prim",
        (QUADRIC, "if sign(a) == 0 or sign(within) < 0:", "if sign(a) == 0 or sign(within) <= 0:"),
    ),
    fault(
        "rims of disks excluded",
        "lattice ties",
        "missed prim",
        (PLANAR, "minus(plus(times(x, x), times(y, y)), times(rim, rim))) > 0", "minus(plus(times(x, x), times(y, y)), times(rim, rim))) >= 0"),
    ),
    fault(
        "t not brought back to the direction's own length",
        "any",
        "culling",
        (HITS, "t = np.ldexp(view.nearest.t, -exponent)", "t = view.nearest.t"),
    ),
    fault(
        "float32 in one place",
        "planes any",
        "t prim",
        (PLANE, "    t = height / slope\n", "    t = float(np.float32(height)) / slope\n"),
    ),
    fault(
        "doubts not looked into",
        "ties edges",
        "missed phantom prim t",
        (CASTING, "    if len(rows):\n", "    if len(rows) < 0:\n"),
    ),
    fault(
        "ties to the higher number",
        "ties",
        "prim",
        (NEAREST, "(first == 0 and k < j)", "(first == 0 and k > j)"),
    ),
    fault(
        "ties between kinds to whichever came first",
        "ties",
        "prim",
        (NEAREST, "            contested[i] = True\n", "            pass\n"),
    ),
    fault(
        "planes missed that are nearly edge-on",
        "planes",
        "missed prim",
        (PLANE, "return MISS if no_terms(n, d) else UNDECIDED", "return MISS"),
    ),
    fault(
        "the last bit of a number lost in the exact arithmetic",
        "edges any",
        "missed phantom prim t",
        (INTEGERS, "out[at] = (whole & MASK) << left", "out[at] = (whole & (MASK - 1)) << left"),
    ),
    fault(
        "pictures' boxes half a pixel too small",
        "pictures",
        "culling",
        (SCREEN, "MARGIN = 1.0", "MARGIN = -0.5"),
    ),
    fault(
        "boxes of ellipsoids around half of them",
        "pictures clutter",
        "culling missed prim",
        (SPHERE, "@implement(hull_size, Ellipsoids)\ndef _hull_size_ellipsoid(prims: Any) -> int:\n    return 8", "@implement(hull_size, Ellipsoids)\ndef _hull_size_ellipsoid(prims: Any) -> int:\n    return 4"),
    ),
    fault(
        "normals not brought to length 1",
        "edges",
        "surface",
        (TRIANGLES, "    n = unit(cross(sub(b, a), sub(c, a)))\n", "    n = cross(sub(b, a), sub(c, a))\n"),
    ),
)
