"""The caster uses no function whose last bits depend on the machine; each use is reported with its line.

BLAS and LAPACK (`@`, `np.linalg`), NumPy's and the C library's sines, powers and logarithms all choose code by the
processor. In their place: caster/description/transform.py and caster/kernels/math/angles.py.
`tests/agreement/test_machines.py` compares the bits themselves.
"""

import ast
from pathlib import Path

import pytest
from places import ROOT

BLAS = {"dot", "einsum", "inner", "kron", "matmul", "matvec", "tensordot", "vdot", "vecdot", "vecmat"}
TRANSCENDENTAL = {
    *("acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "cos", "cosh", "sin", "sinc", "sinh", "tan", "tanh"),
    *(
        "arccos",
        "arccosh",
        "arcsin",
        "arcsinh",
        "arctan",
        "arctan2",
        "arctanh",
        "cbrt",
        "erf",
        "erfc",
        "gamma",
        "lgamma",
    ),
    *("exp", "exp2", "expm1", "float_power", "geomspace", "log", "log10", "log1p", "log2", "logaddexp", "logaddexp2"),
    *("logspace", "pow", "power"),
}
KERNEL_FOLDERS = ("aovs", "cameras", "jit", "kernels", "shapes")  # compiled, where math.hypot is the C library's
EXACT_BASES = (-1.0, 2.0, 10.0)  # powers of these are exact, or of whole numbers

# Who may: what is written is bytes, which last bits of float64 change where a colour lies on the border of two.
PREVIEWS = "caster/image/previews.py"

# The judge's modules whose numbers go to Mitsuba, or into scene files.
JUDGE = (
    "mitsuba_ref/cameras/camera_reference.py",
    "mitsuba_ref/reference/*.py",
    "mitsuba_ref/scene_xml/*.py",
    "mitsuba_ref/shapes/plane.py",
)


def uses(source: str, *, compiled: bool = False) -> list[tuple[int, str]]:
    """(line, what) of each use of such a function. compiled: it holds kernels."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.BinOp, ast.AugAssign)) and isinstance(node.op, ast.MatMult):
            found.append((node.lineno, "@"))
        elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow) and not _is_exact_power(node):
            found.append((node.lineno, "**"))
        elif isinstance(node, ast.Attribute):
            found += [(node.lineno, name) for name in _named(node, compiled)]
        elif isinstance(node, ast.ImportFrom) and node.module in ("math", "numpy", "numpy.linalg", "cmath"):
            found += [(node.lineno, f"from {node.module} import {each.name}") for each in node.names]
    return found


def _is_exact_power(node: ast.BinOp) -> bool:
    base = node.left.operand if isinstance(node.left, ast.UnaryOp) else node.left
    return isinstance(base, ast.Constant) and base.value in (1.0, *map(abs, EXACT_BASES))


def _named(node: ast.Attribute, compiled: bool) -> list[str]:
    whole = ast.unparse(node)
    if node.attr == "dot" or (whole.startswith("np.") and node.attr in BLAS | TRANSCENDENTAL):
        return [whole]
    if whole.startswith("np.linalg.") and node.attr != "LinAlgError":
        return [whole]
    if whole.startswith("math.") and node.attr in TRANSCENDENTAL | ({"hypot", "dist"} if compiled else set()):
        return [whole]
    return []


def used_in(root: Path) -> list[str]:
    """One line for each use in the caster, and in what the judge gives to Mitsuba."""
    files = [path for path in sorted(root.glob("caster/**/*.py")) if path.relative_to(root).as_posix() != PREVIEWS]
    files += [path for pattern in JUDGE for path in sorted(root.glob(pattern))]
    lines = []
    for path in files:
        place = path.relative_to(root).as_posix()
        compiled = place.split("/")[0] == "caster" and place.split("/")[1] in KERNEL_FOLDERS
        found = uses(path.read_text(encoding="utf-8"), compiled=compiled)
        lines += [f"{place}:{line}: {what}" for line, what in found]
    return lines


def test_nothing_is_made_of_functions_that_depend_on_the_machine():
    found = used_in(ROOT)
    assert not found, "\n".join(["their last bits depend on the processor:", *found])


@pytest.mark.parametrize(
    "line",
    [
        "a @ b",
        "a @= b",
        "np.dot(a, b)",
        "a.dot(b)",
        "np.linalg.norm(a)",
        "np.linalg.inv(a)",
        "np.einsum('ij,ij->i', a, b)",
        "np.sin(a)",
        "np.arctan2(a, b)",
        "math.cos(a)",
        "math.log(a)",
        "a ** 0.5",
        "x**2",
        "from math import sin",
        "from numpy.linalg import inv",
    ],
)
def test_a_use_is_found(line):
    assert [number for number, _ in uses(f"\n{line}\n")] == [2]


def test_a_length_of_the_c_library_is_found_in_kernels_alone():
    assert uses("math.hypot(a, b)", compiled=True) and not uses("math.hypot(a, b)")


def test_previews_would_be_named():
    assert uses((ROOT / PREVIEWS).read_text(encoding="utf-8"))
