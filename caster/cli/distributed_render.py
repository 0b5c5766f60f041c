"""Films whose bands are rendered by the workers of a Dask cluster."""

import hashlib
import platform
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from caster.description.errors import SceneError
from caster.geometry.packing import packed
from caster.rendering.images import RenderResult, bands_of, render_film
from caster.rendering.threads import core_count
from caster.scene.files import load_scene
from caster.scene.model import Scene
from caster.system.cluster import Cluster

LIBRARIES = ("numpy", "numba", "llvmlite")  # that results depend on
WAITING_BANDS = 4  # of some 100 MB


def bands_on(
    engine: str,
    workers: int | None,
    scene: Scene,
    files: Sequence[str],
    aovs: Sequence[str],
    on_progress: Callable[[int], None],
) -> Generator[RenderResult, None, None]:
    """Render the bands of a film on a cluster, by the names of `Cluster`; in order. Raises ClusterError.

    files: the scene's file, which every worker loads, and folders of its meshes.
    """
    film, arrays = (scene.film.width, scene.film.height), packed(scene)
    file, dirs = files[0], tuple(files[1:])
    sha256 = load_scene(file, dirs).sha256()
    calls = ((file, dirs, sha256, film, band.film.window, tuple(aovs)) for band in bands_of(scene))
    with (
        Cluster(engine, workers or core_count(), identity, "source code", "python", *LIBRARIES) as cluster,
        closing(cluster.map(render_band, calls, waiting=WAITING_BANDS)) as outcomes,
    ):
        for outcome in outcomes:
            band = replace(outcome.value(), scene=scene, packed=arrays)
            on_progress(band.aovs.hit.size)
            yield band


def render_band(
    file: str,
    mesh_dirs: tuple[str, ...],
    sha256: str,
    film: tuple[int, int],
    window: tuple[int, int, int, int],
    aovs: Sequence[str],
) -> Any:
    """Render one band, in a worker: a RenderResult without the scene and its arrays. sha256: of the scene."""
    scene = scene_of(file, mesh_dirs, sha256).with_film(width=film[0], height=film[1], crop=window)
    found: Any = render_film(scene, aovs, threads=1)
    return replace(found, scene=None, packed=None)


@cache
def scene_of(file: str, mesh_dirs: tuple[str, ...], sha256: str) -> Scene:
    """The scene, loaded once by each worker. Raises SceneError if it is another one here."""
    scene = load_scene(file, mesh_dirs)
    if scene.sha256() != sha256:
        raise SceneError(
            f"{file}: the worker on {platform.node()} has another version of the scene or a mesh than this run: "
            "copy the files there"
        )
    return scene


def identity() -> Mapping[str, str]:
    """What the bits of a film depend on; processors make no difference."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).resolve().parents[1].rglob("*.py")):
        digest.update(path.read_bytes())
    versions = {name: version(name) if find_spec(name) else "none" for name in LIBRARIES}  # Numba may be missing
    return {"source code": digest.hexdigest(), "python": platform.python_version(), **versions}
