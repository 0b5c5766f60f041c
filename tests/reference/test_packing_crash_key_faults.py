"""Faults that pixels do not show: of packing, of sharing work, of the end of a process, of the key of the kernel cache.

Each is planted in a copy of both packages, and has to be found by `validate` or by the test that is named. All of them
by `make faults` (FAULTS=all); without it only those in QUICK.
"""

import os
import re
import subprocess
import sys
from typing import NamedTuple

import pytest
from edited_tree import DEADLINE, ROOT, copy_tree, edit, run

DIGEST, WORLD, SPHERE = ("caster/jit/code_digest.py", "caster/geometry/world_space.py", "caster/shapes/sphere.py")
CHECKS = "mitsuba_ref/judge/checks/shapes.py"
SIZE = ("--size", "12", "10")
PACKED = "caster/geometry/packing.py"
RASTER, TREES, THREADS = (f"caster/rendering/{name}.py" for name in ("rasterization", "bvh_construction", "threads"))
KEY_TEST, GEOMETRY_TEST = (
    f"tests/unit/test_{name}.py" for name in ("kernel_cache_key", "geometry_checked_in_both_precisions")
)
SHARING_TEST = "tests/agreement/test_primitives_by_threads.py"


class Fault(NamedTuple):
    """An edit of a copy, the scene or the test that finds it, and a pattern of what is said then."""

    family: str
    what: str
    found_by: str  # the name of a shipped scene, for `validate`, or the path of a test
    message: str
    file: str
    old: str
    new: str


# What `render` casts is packed in float64; Mitsuba never sees it, and float32 hides a relative error of 1e-9.
ONLY_FLOAT64 = "(1.0 + {} * (rounded is as_given))"
RADIUS = "rounded(scale * radii)"
USER_FLOAT64 = "def as_given(numbers: np.ndarray) -> np.ndarray:\n    return np.asarray(numbers, np.float64)"
PACKING_FAULTS = (
    Fault(
        "packing",
        "vertices off by 1e-9 of themselves",
        "triangles",
        r"geometry: .* vertices of .* \(float64\)",
        WORLD,
        "return rounded(transform_points(matrix, mesh.vertices))",
        f"return {ONLY_FLOAT64.format(1e-9)} * rounded(transform_points(matrix, mesh.vertices))",
    ),
    Fault(
        "packing",
        "float32 geometry for users",
        "one-sphere",
        r"geometry: .* \(float64\)",
        WORLD,
        USER_FLOAT64,
        f"{USER_FLOAT64}.astype(np.float32).astype(np.float64)",
    ),
    Fault(
        "packing",
        "radius off by 1e-12 of itself",
        "one-sphere",
        r"geometry: .* radius of .* \(float64\)",
        SPHERE,
        RADIUS,
        f"(1.0 + 1e-12 * (rounded(np.array(0.1)) == 0.1)) * {RADIUS}",
    ),
    Fault(
        "packing",
        "centre of a cylinder or disk moved by 5e-7",
        "flat-shapes",
        r"geometry: .* \(float64\)",
        WORLD,
        "return rounded(center)[None], to_world[None], inverse(to_world)[None]",
        "return rounded(center)[None] + 5e-7 * (rounded is as_given), to_world[None], inverse(to_world)[None]",
    ),
    Fault(
        "packing",
        "inverse matrix off by 1e-10",
        "ellipsoids",
        r"knife_edges: ",
        SPHERE,
        "np.stack([inverse(to_world[i]) for i in first])",
        "(1.0 + 1e-10 * (rounded(np.array(0.1)) == 0.1)) * np.stack([inverse(to_world[i]) for i in first])",
    ),
    Fault(
        "packing",
        "vertex normals rounded to float32",
        "ply-normals",
        r"geometry: .* \(float64\)",
        WORLD,
        "normals = rounded(_world_normals(mesh, matrix, vertices, faces))",
        "normals = as_float32(_world_normals(mesh, matrix, vertices, faces))",
    ),
    Fault(
        "packing",
        "uv of vertices rounded to float32",
        "obj-meshes",
        r"geometry: .* uv of .* \(float64\)",
        WORLD,
        "else rounded(mesh.uv)",
        "else as_float32(mesh.uv)",
    ),
    Fault(
        "packing",
        "the judge keeps one precision only",
        GEOMETRY_TEST,
        r"ValueError: .* is checked twice",
        CHECKS,
        'shares.add(f"{claim.what} of {name} ({precision.name})", share)',
        'shares.add(f"{claim.what} of {name}", share)',
    ),
    Fault(
        "packing",
        "the judge's second value hides the first",
        GEOMETRY_TEST,
        r"DID NOT RAISE",
        CHECKS,
        "        if what in self._shares:\n",
        "        if False:\n",
    ),
    Fault(
        "packing",
        "the judge checks float32 twice",
        GEOMETRY_TEST,
        r"assert",
        CHECKS,
        'Precision("float64", packed,',
        'Precision("float64", packed_float32,',
    ),
    *(
        Fault("packing", what, scene, rf"geometry: .*{said}", file, old, new)
        for what, scene, said, file, old, new in (
            (
                "one key for float64 and float32",
                "one-sphere",
                "not rounded to float32",
                PACKED,
                'as_float32: "packed float32"',
                'as_float32: "packed"',
            ),
            (
                "the first packing for every rounding",
                "triangles",
                "not rounded to float32",
                PACKED,
                "key = CACHED_AS.get(rounded)",
                "key = next(iter(scene.derived), CACHED_AS.get(rounded))",
            ),
            (
                "float32 that is float64",
                "flat-shapes",
                "not rounded to float32",
                WORLD,
                ".astype(np.float32).astype(np.float64)",
                ".astype(np.float64)",
            ),
            ("radii not rounded", "one-sphere", "radius of .* not rounded", SPHERE, RADIUS, "scale * radii"),
            ("uv not rounded", "obj-meshes", "uv of .* not rounded", WORLD, "else rounded(mesh.uv)", "else mesh.uv"),
            (
                "normals not rounded where they are generated",
                "ply-normals",
                "normals of .* not rounded",
                WORLD,
                "normals = rounded(_world_normals(mesh, matrix, vertices, faces))",
                "normals = _world_normals(mesh, matrix, vertices, faces)",
            ),
        )
    ),
)

# Threads share thousands of primitives, which is long in plain Python: the test has them share few.
SHARING_FAULTS = tuple(
    Fault("threads", what, SHARING_TEST, r"threads", file, old, new)
    for what, file, old, new in (
        (
            "primitives beyond equal shares in no tile",
            RASTER,
            "number * (i + 1) // workers) for",
            "number // workers * (i + 1)) for",
        ),
        (
            "the first primitive of each share twice",
            RASTER,
            "(i, number * i // workers,",
            "(i, max(0, number * i // workers - 1),",
        ),
        (
            "shares in the order of threads, not of tiles",
            RASTER,
            "np.cumsum(counts.T.reshape(-1)).reshape(-1, workers).T",
            "np.cumsum(counts.reshape(-1)).reshape(workers, -1)",
        ),
        (
            "the last points of each share not projected",
            RASTER,
            "parallel_for(find, len(points), threads,",
            "parallel_for(find, len(points) - len(points) % threads, threads,",
        ),
        (
            "pieces of equal length alone",
            THREADS,
            "first + (stop - first) * i // max(count, 1)",
            "first + (stop - first) // max(count, 1) * i",
        ),
        (
            "the last piece left undone by three threads",
            THREADS,
            "    left = iter(pieces)  #",
            "    left = iter(pieces[:-1] if workers == 3 else pieces)  #",
        ),
        (
            "the last primitive of each part of a tree lost",
            TREES,
            "start, start + number, LEAF_SIZE)",
            "start, start + number - 1, LEAF_SIZE)",
        ),
        (
            "a part of a tree in place of the next",
            TREES,
            "links[start:stop] = part_boxes, part_links",
            "links[start:stop] = part_boxes, np.maximum(part_links, part_links[-1:])",
        ),
    )
)

# Ends of the process that casts, in the first line of packing a sphere: the scene of triangles is judged all the same.
PACK = "    linear = matrix[:3, :3]\n    moved = rounded("
ENDS = {
    "a null pointer is read": ("__import__('ctypes').string_at(0)", "SIGSEGV"),
    "the C library aborts": ("__import__('os').abort()", "SIGABRT"),
    "killed for its memory": ("__import__('os').kill(__import__('os').getpid(), 9)", "SIGKILL"),
    "an illegal instruction": (
        "__import__('os').kill(__import__('os').getpid(), __import__('signal').SIGILL)",
        "SIGILL",
    ),
    "the process exits with 0": ("__import__('os')._exit(0)", "exit code 0"),
    "sys.exit with 0": ("raise SystemExit(0)", "exit code 0|SystemExit"),
    "memory runs out": ("np.empty(2**50)", "not enough memory"),
    "calls itself for ever": ("pack_spheres(centers, radii, matrix, rounded)", "RecursionError"),
    "an exception of Python": ("np.zeros(3)[4]", "IndexError"),
}
EXIT_CODES = {"memory runs out": 2, "calls itself for ever": 70, "an exception of Python": 70}  # of others 1
END_FAULTS = tuple(
    Fault("process", what, "one-sphere", rf"FAIL  one-sphere  [^\n]*(?:{message})", SPHERE, PACK, f"    {code}\n{PACK}")
    for what, (code, message) in ENDS.items()
)

KEYS = {
    "no constants": ("label(constant) for constant in constants if", "str() for constant in constants if"),
    "no byte code": ("code.co_code.hex(), ", ""),
    "constants without their values": ("{type(value).__name__} {value!r}", "{type(value).__name__}"),
    "arrays without their numbers": (" {value.tobytes().hex()}", ""),
    "arrays without their types": ("array {value.dtype.str} ", "array "),
    "no members of tuples": ("""return f"({', '.join(map(label, value))})\"""", 'return "()"'),
    "no functions that are called": ("waiting += own.functions", "pass"),
    "no bodies of the protocol": ("waiting += [_plain(g.bodies[c]) for", "_ = [_plain(g.bodies[c]) for"),
    "no classes of the arguments": ("{object, *classes}", "{object}"),
    "no classes made within": ("classes.append(value)", "pass"),
    "no fields of classes": ("{getattr(kind, '_fields', '')}", ""),
    "no closures": ("or (), strict=True):", "or (), strict=True) and ():"),
    "no code within code": ("yield from _codes(constant)", "pass"),
    "the first file of the package alone": ('.glob("*.py"))', '.glob("*.py"))[:1]'),
}
KEY_FAULTS = tuple(Fault("cache key", what, KEY_TEST, r"assert", DIGEST, *change) for what, change in KEYS.items())

FAULTS = (*PACKING_FAULTS, *SHARING_FAULTS, *END_FAULTS, *KEY_FAULTS)
QUICK = ("radius off by 1e-12 of itself", "the C library aborts")  # of the key, test_kernel_cache_key plants some
CHOSEN = [fault for fault in FAULTS if fault.what in QUICK or os.environ.get("FAULTS") == "all"]


def run_test(tree, path):
    """A test file with the packages of a copy, without the compiler."""
    words = [sys.executable, "-P", "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", path]
    environment = {**os.environ, "PYTHONPATH": str(tree), "CASTER_JIT": "0", "COLUMNS": "200"}  # of pytest's messages
    return subprocess.run(
        words, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=DEADLINE, check=False
    )


@pytest.mark.parametrize("fault", CHOSEN, ids=lambda fault: fault.what)
@pytest.mark.slow("each judges in plain Python", keep=1)
def test_a_planted_fault_is_found(tmp_path, fault):
    tree = copy_tree(tmp_path / "tree")
    edit(tree, fault.file, fault.old, fault.new)
    if fault.found_by.endswith(".py"):
        found = run_test(tree, fault.found_by)
    else:
        scenes = (f"scenes/{fault.found_by}.toml", "scenes/triangles.toml")
        found = run(tree, "validate", *dict.fromkeys(scenes), "--thorough", *SIZE, "-j", "1")
    print(found.stdout)
    code = EXIT_CODES.get(fault.what, 1)
    assert found.returncode == code, f"this passes: {fault.what}\n{found.stdout}{found.stderr}"
    assert re.search(fault.message, found.stdout), found.stdout
    if fault.family == "process":
        assert "PASS  triangles " in found.stdout and ("Traceback" in found.stderr) == (code == 70)


def test_every_fault_fits_the_source_of_today():
    for fault in FAULTS:
        assert (ROOT / fault.file).read_text(encoding="utf-8").count(fault.old) == 1, fault
    assert set(QUICK) <= {fault.what for fault in FAULTS}
