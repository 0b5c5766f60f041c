"""Faults of an intersection kind, as edits of the caster's source: what somebody might get wrong, one at a time."""

from typing import NamedTuple

KERNELS = "caster/kernels"
TREE, ROOTS, TRIANGLES, NEAREST = (
    f"{KERNELS}/{name}.py" for name in ("bvh/traversal", "math/quadric_roots", "triangles", "nearest")
)
SCREEN, INTEGERS, BOXES = (f"{KERNELS}/{name}.py" for name in ("raster/tile_casting", "exact/numbers", "bvh/build"))
LEAF_OF_RAY, LEAF_OF_PACKET = (
    f"\n                k = tree.order[at]\n                {then}" for then in ("pre", "cast_lanes")
)
PLANAR = QUADRIC = f"{KERNELS}/exact/primitives.py"
EXACT_ROOT, SPANS = f"{KERNELS}/exact/numbers.py", f"{KERNELS}/raster/screen_bounds.py"
LANES, VECTORS = "caster/jit/simd.py", "caster/jit/vector_intrinsics.py"
CASTING, HITS, PLACING = ("caster/rendering/casting.py", "caster/rendering/hits.py", "caster/geometry/world_space.py")
SPHERE, CYLINDER, DISK, PLANE = (f"caster/shapes/{name}.py" for name in ("sphere", "cylinder", "disk", "plane"))
PANORAMA = "caster/cameras/panorama.py"


class Edit(NamedTuple):
    """Text that is there exactly once, and what to put in its place."""

    file: str
    old: str
    new: str


class Fault(NamedTuple):
    """What is wrong, where to look for it, and what is found then."""

    what: str
    edits: tuple[Edit, ...]
    family: str
    examples: int  # of the family, from the first on
    kinds: frozenset[str]  # of findings, one of which has to come up


def fault(what: str, family: str, examples: int, kinds: str, *edits: tuple[str, str, str]) -> Fault:
    return Fault(what, tuple(Edit(*each) for each in edits), family, examples, frozenset(kinds.split()))


UNPADDED = (
    (TREE, "return tree.reach * (max(abs(o[0]), abs(o[1]), abs(o[2])) + tree.extent)", "return 0.0"),
    (LANES, "FAR_PADDING = 1.0 + 2.0 * (3.0 * 2.0**-53) / (1.0 - 3.0 * 2.0**-53)", "FAR_PADDING = 1.0"),
    (BOXES, "return x + (abs(x) * ULP32 + SMALLEST32)", "return x"),
)

FAULTS = (
    fault(
        "the far root for the near one",
        "tangents",
        4,
        "t missed prim",
        (
            ROOTS,
            "near = certain_in_range(roots.near, roots.near_error, t_min, t_max)",
            "near = certain_in_range(roots.far, roots.far_error, t_min, t_max)",
        ),
    ),
    fault(
        "t_min forgotten by exact roots",
        "surfaces",
        4,
        "phantom t prim",
        (EXACT_ROOT, "    if compare(x, surd_of_float(t_min)) <= 0:\n        return False\n", ""),
    ),
    fault(
        "t_min included",
        "surfaces",
        4,
        "phantom t prim",
        (EXACT_ROOT, "compare(x, surd_of_float(t_min)) <= 0", "compare(x, surd_of_float(t_min)) < 0"),
    ),
    fault(
        "t_max excluded",
        "any",
        4,
        "missed prim",
        (EXACT_ROOT, "or compare(x, surd_of_float(t_max)) <= 0", "or compare(x, surd_of_float(t_max)) < 0"),
    ),
    fault(
        "strict pruning of unpadded boxes",
        "lattice",
        4,
        "culling missed prim",
        *UNPADDED,
        (VECTORS, 'fcmp_ordered("<=", enter, leave)', 'fcmp_ordered("<", enter, leave)'),
        (TREE, "while entries[top - 1] > limit:", "while entries[top - 1] >= limit:"),
    ),
    fault("slabs unpadded", "edges", 24, "culling missed prim", *UNPADDED),
    fault(
        "-0.0 taken for a step forward",
        "lattice",
        4,
        "culling missed prim",
        (
            TREE,
            "near = 0 if x > 0.0 else 3, 1 if y > 0.0 else 4,",
            "near = 0 if d[0] >= 0.0 else 3, 1 if d[1] >= 0.0 else 4,",
        ),
    ),
    fault(
        "the last primitive of a leaf forgotten",
        "clutter",
        4,
        "culling missed prim",
        *(
            (TREE, f"start + number):{leaf}", f"start + max(number - 1, 0)):{leaf}")
            for leaf in (LEAF_OF_RAY, LEAF_OF_PACKET)
        ),
    ),
    fault(
        "edges excluded", "edges", 4, "missed prim", (PLANAR, "if sign(u) * sign(v) < 0:", "if sign(u) * sign(v) <= 0:")
    ),
    fault(
        "edge functions of two neighbours not antisymmetric",
        "edges",
        4,
        "missed phantom prim",
        (
            TRIANGLES,
            "        cross(a, b),\n        n,\n",
            "        add(cross(a, b), scaled(2.0**-45, n)),\n        n,\n",
        ),
    ),
    fault(
        "edge functions trusted to the last bit",
        "edges",
        4,
        "missed phantom prim",
        (TRIANGLES, "EDGE_ERROR = 16.0 * U", "EDGE_ERROR = 0.0"),
    ),
    fault(
        "the textbook's quadratic formula",
        "offsets",
        4,
        "missed phantom prim t",
        (ROOTS, "    within = setup.rr - gg\n", "    within = (b * b - a * setup.c) * over_a\n"),
    ),
    fault(
        "tubes without a far wall",
        "tangents",
        4,
        "missed prim",
        (
            CYLINDER,
            "    far = clip_to_height(certain_in_range(roots.far, roots.far_error, t_min, t_max), axis)\n",
            "    far = math.inf, 0.0\n",
        ),
    ),
    fault(
        "tubes open at the top", "tangents", 10, "missed prim t", (QUADRIC, "slope, root.r) <= 0", "slope, root.r) < 0")
    ),
    fault(
        "tangents excluded",
        "tangents",
        4,
        "missed prim",
        (QUADRIC, "if sign(a) == 0 or sign(within) < 0:", "if sign(a) == 0 or sign(within) <= 0:"),
    ),
    fault(
        "rims of disks excluded",
        "lattice",
        24,
        "missed prim",
        (
            PLANAR,
            "minus(plus(times(x, x), times(y, y)), times(rim, rim))) > 0",
            "minus(plus(times(x, x), times(y, y)), times(rim, rim))) >= 0",
        ),
    ),
    fault(
        "t not brought back to the direction's own length",
        "any",
        4,
        "culling",
        (HITS, "t = np.ldexp(view.nearest.t, -exponent)", "t = view.nearest.t"),
    ),
    fault(
        "float32 in one place",
        "planes",
        12,
        "t prim",
        (PLANE, "    t = height / slope\n", "    t = float(np.float32(height)) / slope\n"),
    ),
    fault(
        "doubts not looked into",
        "ties",
        4,
        "missed phantom prim t",
        (CASTING, "    if len(rows):\n        exact", "    if len(rows) < 0:\n        exact"),
    ),
    fault(
        "ties to the higher number", "ties", 4, "prim", (NEAREST, "(first == 0 and k < j)", "(first == 0 and k > j)")
    ),
    fault(
        "ties between kinds to whichever came first",
        "ties",
        4,
        "prim",
        (NEAREST, "            contested[i] = True\n", "            pass\n"),
    ),
    fault(
        "planes missed that are nearly edge-on",
        "planes",
        8,
        "missed prim",
        (PLANE, "filter_result(steep, all_products_zero(n, d), t, error)", "filter_result(steep, not steep, t, error)"),
    ),
    fault(
        "the last bit of a number lost in the exact arithmetic",
        "edges",
        4,
        "missed phantom prim t",
        (INTEGERS, "out[at] = (whole & MASK) << left", "out[at] = (whole & (MASK - 1)) << left"),
    ),
    fault(
        "boxes of pictures half a pixel too small",
        "pictures",
        4,
        "culling",
        (SPANS, "MARGIN = 2.0**-10", "MARGIN = -0.5"),
    ),
    fault(
        "nothing crosses the seam of a panorama",
        "surroundings",
        6,
        "culling",
        (PANORAMA, "if abs(longitude) + reach > math.pi", "if abs(longitude) - reach > math.pi"),
    ),
    fault(
        "boxes of ellipsoids around half of them",
        "clutter",
        16,
        "culling missed prim",
        (
            SPHERE,
            "@implement(hull_size, Ellipsoids)\ndef _hull_size_ellipsoid(prims: Any) -> int:\n    return 8",
            "@implement(hull_size, Ellipsoids)\ndef _hull_size_ellipsoid(prims: Any) -> int:\n    return 4",
        ),
    ),
    fault(
        "normals not brought to length 1",
        "edges",
        4,
        "surface",
        (TRIANGLES, "known, unit = fast_normalize(n)", "known, unit = True, n"),
    ),
)
