"""Wrong pixels as a few numbers: intersections are written down, no scene, reference or caster takes part."""

from types import SimpleNamespace

import numpy as np

from mitsuba_ref.error_model.bracket import RayIntersections
from mitsuba_ref.error_model.intersections import Intersections
from mitsuba_ref.judge.hypotheses import WrongPixels

INF, NAN = np.inf, np.nan
Z = (0.0, 0.0, 1.0)


def intersections(t, t_error=0.0, n=Z, n_error=0.0, sh_n=Z, certain=True, possible=True) -> Intersections:
    t = np.array(t, float)
    count = len(t)

    def rows(value, width=0):
        return np.array(np.broadcast_to(value, (count, width) if width else count))

    return Intersections(
        t, rows(t_error), rows(n, 3), rows(n_error), rows(sh_n, 3), rows(0.0), rows(possible), rows(certain),
        rows(0.0), rows(0.0, 3), rows(0.0),
    )  # fmt: skip


def roots_of(*rows, **more) -> RayIntersections:
    """(ray, prim, t) each."""
    ray, prim, t = zip(*rows, strict=True) if rows else ((), (), ())
    return RayIntersections(np.array(ray, int), np.array(prim, int), intersections(t, **more))


def pixels(exact, given, bound=0.0, *, prim=None, roots=None, at=None, image=None, **more) -> WrongPixels:
    """Pixels with the exact t, INF for a miss, and the subject's."""
    exact, given = np.array(exact, float), np.array(given, float)
    count = len(exact)
    plain = {
        "t_rounding": 0.0, "hits_only": False, "precision": "float64", "exact_visibility": False, "ku": 0.5,
        "o": np.zeros((count, 3)), "d": np.tile(Z, (count, 1)), "hit": ~np.isposinf(given),
        "t_min": np.zeros(count), "t_max": np.full(count, INF), "is_list": True, "camera": "ray",
        "prim_id": None, "shape_id": None,
    } | more  # fmt: skip
    names = ("t_rounding", "hits_only", "precision", "exact_visibility", "ku", "prim_id", "shape_id")
    answer = SimpleNamespace(t=given, prim=None, **{name: plain[name] for name in names})
    judge = SimpleNamespace(
        answer=answer, hit=np.array(plain["hit"]), o=plain["o"], d=np.array(plain["d"], float),
        t_min=np.array(plain["t_min"], float), t_max=np.array(plain["t_max"], float),
        scene=SimpleNamespace(camera=SimpleNamespace(type=plain["camera"])),
        pair=SimpleNamespace(rays=SimpleNamespace(is_list=plain["is_list"]), shape=image or (1, count)),
        bracket=SimpleNamespace(possible_hits=lambda o, d, t_max, t_min=None: roots),
    )  # fmt: skip
    hit = ~np.isposinf(exact)
    prim = np.where(hit, 0, -1) if prim is None else np.array(prim)
    return WrongPixels(judge, np.arange(count), hit, exact, prim, at or intersections(exact, bound))


def explained(hypothesis, f, right=None) -> dict[str, tuple[list[bool], str, bool]]:
    return {
        each.what: (each.fits.tolist(), each.remedy, each.single)
        for each in hypothesis(f, pixels([], []) if right is None else right)
    }
