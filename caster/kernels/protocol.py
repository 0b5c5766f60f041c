"""What a kind of primitive and a camera must answer. A kind is a NamedTuple of arrays, one row a primitive.

Points and vectors inside kernels are tuples of three floats; arrays hold them as rows.
"""

# The parameters of the stubs below are read by their bodies alone.

from typing import Any

from caster.kernels.jit import generic

Vec3 = tuple[float, float, float]


@generic
def prepare(prims: Any, k: int, o: Vec3) -> Any:
    """Everything about primitive k that depends on the ray origin only."""


@generic
def intersect(prims: Any, pre: Any, d: Vec3, t_min: float) -> Any:
    """The smallest t > t_min at which o + t d lies on the prepared primitive, or MISS."""


@generic
def surface(prims: Any, k: int, o: Vec3, d: Vec3, t: float) -> Any:
    """(p, n, sh_n, u, v) where the ray meets primitive k at t; n and sh_n are unit vectors."""


@generic
def hull_size(prims: Any) -> Any:
    """How many points hull_point gives for each primitive; 0 for a kind without bounds."""


@generic
def hull_point(prims: Any, k: int, j: int) -> Any:
    """Point j of a set whose convex hull holds primitive k."""


@generic
def ray(camera: Any, x: float, y: float) -> Any:
    """(o, d, t_min, t_max) of the ray through film position (x, y), in pixels; t_max < 0 says: no ray."""


@generic
def project(camera: Any, p: Vec3) -> Any:
    """(x, y, pixels, valid): where p falls on the film; a unit step of p moves it by at most so many pixels.

    Not valid where straight edges would not stay straight. A camera without a body for this goes through the
    tree.
    """
