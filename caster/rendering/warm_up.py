"""Compile kernels ahead, by rendering small films of all kinds of primitives before all cameras."""

from collections.abc import Callable, Iterable, Iterator
from itertools import count
from typing import Any, NamedTuple, get_args

import numpy as np

from caster.aovs import AOVS
from caster.cameras import CAMERAS
from caster.geometry.packing import Packed, packed
from caster.geometry.world_space import as_given
from caster.jit.decorators import COMPILATION_LOG, compile_ahead
from caster.jit.simd import LANES
from caster.kernels.bvh.build import LEAF_SIZE, MAX_PRIMITIVES
from caster.kernels.bvh.traversal import cast_packets_brute_force
from caster.kernels.nearest import Rays
from caster.kernels.raster.tile import WIDTH, new_tile
from caster.rendering.casting import BVH_MIN_RAYS, Culling, cast_tiles, exact_nearest, find_any
from caster.rendering.hits import validated_rays
from caster.rendering.images import DEFAULT_AOVS, culling_for, render_film
from caster.rendering.ray_tiles import TileCaster, tiles_in_order
from caster.rendering.threads import default_threads
from caster.scene.model import Ambient, Diffuse, Directional, Point, Scene
from caster.scene.textures import Checkerboard
from caster.shapes import SHAPES, Sphere
from caster.shapes.triangle import Triangle

__all__ = ["compile_for", "warm_decisions"]

# Each alone, the default ones, and all at once: other sets share most kernels with these.
WARM_UP_AOV_SETS: tuple[tuple[str, ...], ...] = (
    *((aov.NAME,) for aov in AOVS),
    ("depth", "normal"),
    DEFAULT_AOVS,
    tuple(aov.NAME for aov in AOVS),
)

WARM_UP_FILM_SIDE = 4  # pixels; kernels do not depend on it


class WarmUpCounts(NamedTuple):
    """Numbers of kernels that were compiled, and loaded from the cache."""

    compiled: int
    loaded: int


def warm_up(scenes: Iterable[Scene]) -> WarmUpCounts:
    """Compile or load all kernels that the scenes may need."""
    log = COMPILATION_LOG
    compiled, loaded = len(log.compiled), len(log.loaded)
    for scene in scenes:
        small = scene.with_film(width=WARM_UP_FILM_SIDE, height=WARM_UP_FILM_SIDE, crop=None)
        planned = culling_for(small.camera.pack(WARM_UP_FILM_SIDE, WARM_UP_FILM_SIDE))
        for culling in get_args(Culling):
            if culling != "raster" or planned == "raster":
                for aovs in WARM_UP_AOV_SETS:
                    render_film(small, aovs, threads=1, culling=culling)
        render_film(small.model_copy(update={"shapes": ()}), WARM_UP_AOV_SETS[-1], threads=1)  # tiles without anything
        for trees in (True, False):
            warm_decisions(small, BVH_MIN_RAYS + 1, trees)
        _warm_rays(packed(small))
    return WarmUpCounts(len(log.compiled) - compiled, len(log.loaded) - loaded)


def compile_for(scene: Scene, about: str, work: Callable[[Scene], Any]) -> None:
    """Compile the kernels of `work` for a scene, by several processes, by doing it for a small scene of the same
    kernels.

    about: names the work. Nothing is done if these sources have done it before.
    """
    kinds = [(type(kind.prims), min(len(kind.ids), LEAF_SIZE + 1)) for kind in packed(scene).kinds]
    camera, lights = type(scene.camera), [type(light) for light in scene.lights]
    words = [about, camera, kinds, lights, scene.shading, len(scene.materials) > 0]

    def run() -> None:
        few = _few_of_each_kind()
        shapes = [shape for kind, count in kinds for shape in few.get(kind, [])[:count]]
        small = Scene(camera=camera(**camera.MINIMAL), shapes=shapes, lights=scene.lights, shading=scene.shading)
        with default_threads(1):  # others would wait for a process that compiles
            work(small.with_film(width=WARM_UP_FILM_SIDE, height=WARM_UP_FILM_SIDE))

    compile_ahead(" ".join(map(str, words)), run)


def warm_decisions(scene: Scene, count: int = 1, trees: bool = True) -> None:
    """Compile or load the kernels that decide so many rays of a scene exactly."""
    rays = Rays(np.zeros((count, 3)), np.ones((count, 3)), np.zeros(count), np.full(count, np.inf))
    exact_nearest(packed(scene), rays, 1, trees=trees)


def _few_of_each_kind() -> dict[type, list[Any]]:
    """Shapes of one primitive by kind, enough for a tree; no two coincide, which would be decided exactly."""
    found: dict[type, list[Any]] = {}
    number = count()

    def turned() -> list[Any]:
        """Different transforms at each call, so that no ray of a small film hits an edge or two surfaces at once."""
        i = next(number)
        rotated = {"rotate": {"axis": (0.31, -0.17, 1.0), "degrees": 17.3 + 5.9 * i}}
        return [rotated, {"translate": (0.0071 * i, 0.0053 * i, 0.0037 * i)}]

    for shape in SHAPES:
        if "file" in shape.MINIMAL or (hasattr(shape, "mesh") and shape is not Triangle):
            continue
        for placed in ([], [STRETCHED]):
            few = [shape(**shape.MINIMAL, to_world=[*placed, *turned()]) for _ in range(LEAF_SIZE + 1)]
            found[type(few[0].pack(as_given))] = few
    return found


def _warm_rays(packed: Packed) -> None:
    """The kernels of shadow rays and of rays from elsewhere, which small films may not need.

    Some shadow rays start too far away for a fan.
    """
    o = np.zeros((WIDTH, 3))
    o[LANES:] = 2.0**100
    rays = validated_rays(o, np.ones((WIDTH, 3)), 0.0, 1.0)
    find_any(packed, rays, threads=1)
    caster = TileCaster(packed, any_hit=True, light=LAMPS[0].pack(), rays=MAX_PRIMITIVES)
    cast_tiles(packed, rays, tiles_in_order(caster, rays, 1), 1)
    for kind in packed.kinds:
        cast_packets_brute_force(kind.prims, 1, 0, WIDTH, new_tile(), True)


STRETCHED = {"scale": (1.0, 2.0, 3.0)}  # another kind of primitive, for some shapes
WHITE = (1.0, 1.0, 1.0)
LAMPS = (
    Point(position=(0.0, 0.0, 9.0), intensity=WHITE),
    Directional(direction=(0.0, 0.0, -1.0), irradiance=WHITE),
    Ambient(radiance=WHITE),
)


def warm_up_scenes() -> Iterator[Scene]:
    """All kinds of primitives before each camera, with a texture and with normals that point inwards."""
    shapes = [shape for few in _few_of_each_kind().values() for shape in few]
    shapes += [Sphere(center=(9.0, 9.0, 9.0), flip_normals=True, material="squares")]
    materials = {"squares": Diffuse(reflectance=Checkerboard())}
    for camera in CAMERAS:
        yield Scene(camera=camera(**camera.MINIMAL), shapes=shapes, lights=LAMPS, materials=materials)
