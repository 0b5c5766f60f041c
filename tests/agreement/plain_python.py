"""What Numba and plain Python both cast; as a program, it writes what it gets to a file."""

import sys

import numpy as np
from hard_rays import hard_rays
from random_scenes import VIEWS, name, random_scene

from caster.aovs import BY_NAME
from caster.cameras import Pinhole
from caster.jit.kernel_cache import COMPILED
from caster.rendering.casting import find_nearest
from caster.rendering.hits import packed, validated_rays
from caster.rendering.images import render
from caster.shapes import SHAPES

FILM = (13, 9)
RAYS = 40  # of each family


def everything_cast(share: int = 1) -> dict[str, np.ndarray]:
    """Every AOV of every shape before every camera, or a share of the cameras, and hard rays.

    Of the two cullings that a film may go through, neighbours take turns: each shape and each camera has both.
    """
    results = {"compiled": np.array(COMPILED)}
    for i, shape in enumerate(SHAPES):
        for j, camera in enumerate(VIEWS):
            if (i + j // 2) % share:
                continue
            scene = random_scene(np.random.default_rng([30, i, j]), [shape], camera, count=5, film=FILM)
            culling = (None, "bvh")[(i + j) % 2]
            aovs = render(scene, tuple(BY_NAME), threads=1, culling=culling)
            results |= {f"{name(shape)} {name(camera)} {culling} {aov}": aovs[aov] for aov in aovs}
        results |= rays_cast(np.random.default_rng([31, i]), shape)
    return results


def rays_cast(rng: np.random.Generator, shape: type) -> dict[str, np.ndarray]:
    scene = random_scene(rng, [shape], Pinhole, count=5)
    results = {}
    for family, (o, d) in hard_rays(packed(scene), rng, RAYS).items():
        nearest = find_nearest(packed(scene), validated_rays(o, d, 0.0, np.inf), threads=1)
        results |= {f"{name(shape)} {family} {key}": array for key, array in nearest._asdict().items()}
        results |= {f"{name(shape)} {family} o": o, f"{name(shape)} {family} d": d}
    return results


if __name__ == "__main__":
    np.savez(sys.argv[1], **everything_cast(int(sys.argv[2])))
