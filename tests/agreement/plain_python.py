"""Results whose bits must be equal on every machine: hits, images and packed scenes. As a program:

    python plain_python.py INPUTS OUT    # two .npz files: what to cast, and the results

Scenes and rays are drawn once and passed on, since random numbers depend on the machine's NumPy and C library.
"""

import hashlib
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from hard_rays import hard_rays
from random_scenes import VIEWS, name, random_scene

from caster import load_scene
from caster.aovs import BY_NAME
from caster.cameras import Pinhole
from caster.geometry.world_space import as_float32, as_given
from caster.jit.kernel_cache import COMPILED
from caster.kernels.math.angles import polar_fraction, turn_fraction
from caster.rendering.casting import find_nearest
from caster.rendering.hits import packed, validated_rays
from caster.rendering.images import camera_rays, render
from caster.scene.files import scene_from_text
from caster.shapes import SHAPES

ROOT = Path(__file__).resolve().parents[2]
PATIENCE = 3600  # seconds; takes about 10 where nothing is compiled, and minutes where everything is

FILM = (11, 6)
RAYS = 8  # of each family

Arrays = dict[str, np.ndarray]


def inputs(share: int, shapes: Sequence[type] = SHAPES) -> Arrays:
    """Hard rays at the shapes, and films of each by every camera, or one camera in `share`; share 0: no shape.

    Neighbours take different cullings, so that each shape and each camera has both.
    """
    found = {"points": np.random.default_rng(33).normal(size=(500, 2))}
    for j, camera in enumerate(VIEWS):
        found[f"view {name(camera)}"] = drawn([32, j], SHAPES[0], camera)
    for i, shape in enumerate(shapes if share else ()):
        for j, camera in enumerate(VIEWS):
            if (i + j // 2) % share == 0:
                culling = (None, "bvh")[(i + j) % 2]
                found[f"film {name(shape)} {name(camera)} {culling}"] = drawn([30, i, j], shape, camera)
        rng = np.random.default_rng([31, i])
        scene = random_scene(rng, [shape], Pinhole, count=5)
        found[f"shape {name(shape)}"] = np.array(scene.canonical_json())
        for family, rays in hard_rays(packed(scene), rng, RAYS).items():
            found[f"rays {name(shape)}/{family}"] = np.array(rays)
    return found


def drawn(seed: list[int], shape: type, camera: type) -> np.ndarray:
    return np.array(random_scene(np.random.default_rng(seed), [shape], camera, count=5, film=FILM).canonical_json())


def everything(given: Arrays) -> Arrays:
    """All arrays that must be equal; `libraries` may differ, and so may whether kernels were compiled."""
    return {"compiled": np.array(COMPILED), **libraries(), **everything_packed(), **everything_cast(given)}


def everything_cast(given: Arrays) -> Arrays:
    """Every AOV of the films, nearest hits of the rays, camera rays of the views, angles of the points."""
    found = {"turns": np.array([turn_fraction(y, x) for y, x in given["points"].tolist()])}
    found["polar angles"] = np.array([polar_fraction(x / (1.0 + abs(x))) for x in given["points"][:, 0].tolist()])
    for key, array in given.items():
        kind, _, what = key.partition(" ")
        if kind == "view":
            found |= {f"{what} {field}": rows for field, rows in camera_rays(scene_of(array))._asdict().items()}
        elif kind == "film":
            culling = {"None": None, "bvh": "bvh"}[what.split()[-1]]
            aovs = render(scene_of(array), tuple(BY_NAME), threads=1, culling=culling)
            found |= {f"{what} {aov}": aovs[aov] for aov in aovs}
        elif kind == "rays":
            prims = packed(scene_of(given[f"shape {what.partition('/')[0]}"]))
            with np.errstate(all="ignore"):  # of kernels in plain Python, for directions with a denormal component
                nearest = find_nearest(prims, validated_rays(*array, 0.0, np.inf), threads=1)
            found |= {f"{what} {field}": rows for field, rows in nearest._asdict().items()}
    return found


def scene_of(text: np.ndarray):
    return scene_from_text(str(text), "json", mesh_dirs=[tempfile.gettempdir()])  # where meshes were written


def everything_packed() -> Arrays:
    """Digests of the packed arrays of all shipped scenes, in float64 and rounded to float32, and of their cameras."""
    found = {}
    for file in sorted(ROOT.glob("scenes/*.toml")):
        scene = load_scene(file)
        for rounded in (as_given, as_float32):
            for shape, part in zip(scene.shape_names(), packed(scene, rounded).parts, strict=True):
                for field, array in part._asdict().items():
                    found[f"{file.stem} {shape} {rounded.__name__} {field}"] = digest(array)
        found[f"{file.stem} camera"] = digest(np.hstack(scene.camera.pack(scene.film.width, scene.film.height)))
    return found


def digest(array: np.ndarray) -> np.ndarray:
    return np.frombuffer(hashlib.sha256(np.ascontiguousarray(array).tobytes()).digest(), np.uint64)


def libraries() -> Arrays:
    """Results of the machine's math libraries, which the caster must not use."""
    numbers = np.random.default_rng(34).random((3000, 3))
    return {
        "BLAS": digest(numbers @ np.array([[0.1, 0.7, 0.3], [0.4, 0.2, 0.9], [0.8, 0.6, 0.5]])),
        "NumPy": digest(np.arctan2(numbers[:, 0], numbers[:, 1])),
        "C": digest(np.array([math.sin(x) for x in numbers.ravel().tolist()])),
    }


def elsewhere(folder: Path, given: Arrays, **environment: str) -> Arrays:
    """Run `everything` in another process with these environment variables; folder: for temporary files."""
    np.savez(folder / "inputs.npz", **given)
    variables = os.environ | {"PYTHONPATH": str(ROOT)} | environment
    command = [sys.executable, "-W", "error", __file__, str(folder / "inputs.npz"), str(folder / "out.npz")]
    run = subprocess.run(command, env=variables, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE)
    assert run.returncode == 0, run.stderr
    return loaded(folder / "out.npz")


def loaded(path: Path) -> Arrays:
    with np.load(path) as arrays:
        return dict(arrays)


if __name__ == "__main__":
    np.savez(sys.argv[2], **everything(loaded(Path(sys.argv[1]))))
