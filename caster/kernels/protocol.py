"""The functions that a kind of primitive and a camera implement. A kind is a NamedTuple of arrays, a row a primitive.

Points and vectors inside kernels are tuples of three floats; arrays hold them as rows. A function with a body here is
optional: the body serves those that implement no other.
"""

import math
from typing import Any

from caster.jit.decorators import generic, generic_inlined, optional

Vec3 = tuple[float, float, float]


@generic_inlined
def load(prims: Any, k: int) -> Any:
    """The numbers of primitive k that `prepare` reads, loaded once, since arrays are slow in loops over rays."""


@generic_inlined
def prepare(prims: Any, prim: Any, o: Vec3) -> Any:
    """Precompute what depends only on the ray origin; prim: the result of `load`."""


@generic_inlined
def intersect(prims: Any, pre: Any, d: Vec3, t_min: float, t_max: float) -> Any:
    """(t, error): the smallest t in (t_min, t_max] at which o + t d lies on the prepared primitive, within error.

    A float64 filter with proven bounds: MISS and results with a finite error are certain; UNDECIDED leaves the decision
    to `exact_intersect`. It has no branch and never divides by 0, so that several rays can be tested at once.
    """


@optional(generic_inlined)
def surely_misses(prims: Any, pre: Any, d: Vec3) -> Any:
    """Quick rejection: True only if `intersect` would return MISS."""
    return False


@optional(generic_inlined)
def t_lower_bound(prims: Any, pre: Any, low: Vec3, high: Vec3) -> Any:
    """A lower bound of t > 0 at the prepared primitive for rays with low <= d <= high, by component; inf: no hit."""
    return 0.0


@optional(generic_inlined)
def same_geometry(prims: Any, k: int, j: int) -> Any:
    """Whether `exact_intersect` reads the same numbers of primitives k and j; False is always correct."""
    return False


@generic
def exact_intersect(prims: Any, k: int, o: Vec3, d: Vec3, t_min: float, t_max: float) -> Any:
    """The exact hit of a ray on primitive k: an exact.numbers.Root."""


@optional(generic_inlined)
def prefetch_numbers(prims: Any, k: int, referred: bool) -> None:
    """Prefetch the arrays that `load` reads for primitive k; referred: those that its numbers refer to."""
    return None


# Surfaces are computed for several hits at a time: the numbers of each hit's primitive lie in a lane of a scratch
# (raster/tile.py), and `fast_surface` and `fast_uv` have no branch. A plug-in may implement `surface` alone.


ZERO = (0.0, 0.0, 0.0)


@optional(generic_inlined)
def surface_setup(prims: Any, k: int, start: Any, stop: Any, scratch: Any, wants: int) -> None:
    """Write the numbers of primitive k that `fast_surface` and `fast_uv` read to lanes start..stop of a scratch.

    wants: raster.tile.NORMALS, SURFACES or SURFACES_WITH_UV.
    """
    return None


@generic_inlined
def setup_lanes(prims: Any, scratch: Any, wants: int) -> None:
    """`surface_setup` for all lanes of a scratch, each with its primitive LANE_NUMBER; by default run by run."""


@optional(generic_inlined)
def fast_surface(prims: Any, scratch: Any, x: Any, o: Vec3, d: Vec3, t: float) -> Any:
    """(normal_is_safe, all_is_safe, p, n, sh_n, local) of lane x; n and sh_n are unit vectors.

    A flag that is True stands for the bits of `surface`. local: three numbers that `fast_uv` reads.
    """
    return False, False, ZERO, ZERO, ZERO, ZERO


@optional(generic_inlined)
def fast_uv(prims: Any, scratch: Any, x: Any, local: Vec3) -> Any:
    """(u, v) of lane x."""
    return 0.0, 0.0


@optional(generic)
def surface(prims: Any, k: int, o: Vec3, d: Vec3, t: float, wants_uv: bool) -> Any:
    """(p, n, sh_n, u, v) where a ray meets primitive k at t, for numbers of any size.

    For hits that `fast_surface` is not safe for; a kind whose flags are always True has no body for this.
    """
    return ZERO, ZERO, ZERO, 0.0, 0.0


@optional(generic_inlined)
def hull_size(prims: Any) -> Any:
    """The number of hull points of each primitive, by default the corners of a box; 0 for a kind without bounds."""
    return 8


@generic_inlined
def hull_point(prims: Any, k: int, j: int) -> Any:
    """Point j of a set whose convex hull contains primitive k."""


@generic_inlined
def tight_sphere(prims: Any, k: int) -> Any:
    """(center, r) of a bounding sphere that is tighter than the box of primitive k; for screen bounds. Optional."""


@generic_inlined
def camera_ray(camera: Any, x: float, y: float) -> Any:
    """(o, d, t_min, t_max) of the ray through film position (x, y), in pixels; t_max < 0: no ray.

    d is of length 1 (vec.UNIT_SQUARE_ATOL).
    """


@generic_inlined
def project(camera: Any, p: Vec3) -> Any:
    """(x, y, pixels, depth, valid): where p falls on the film; a unit step of p moves it by at most so many pixels.

    depth: how far p is in front of where the rays start, along camera.forward, or, if negative, behind; the distance
    from the eye for a camera that implements `distortion_bound`. Not valid where straight edges would bend.
    """


@optional(generic_inlined)
def distortion_bound(camera: Any, extent: float) -> Any:
    """(pixels, share, valid): for a convex hull whose projected points are no more than `extent` pixels apart.

    On the film, its projection reaches no more than so many pixels beyond the box around those, and, in general, beyond
    any line; nothing of it is nearer than that share of the nearest point's depth. Not valid: nothing is known. A
    rectilinear camera has no other body than this one.
    """
    return 0.0, 1.0, True


@optional(generic_inlined)
def project_bounding_sphere(camera: Any, center: Vec3, r: float) -> Any:
    """(left, top, right, bottom, depth, valid): the screen bounds of a sphere, and its least depth.

    Depth counts as for `project`. Not valid: nothing is known, but for the depth.
    """
    return 0.0, 0.0, 0.0, 0.0, -math.inf, False
