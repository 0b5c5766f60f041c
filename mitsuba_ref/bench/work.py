"""The task of a contestant: a folder with the scene in every form that one of them reads, and what to compute.

Light to import: what a contestant's process loads beside the contestant counts as its memory.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

# Tasks: an image of depth and normal; t and normal along given rays; whether given rays hit anything; a shaded
# image, of our caster alone.
FILM, NEAREST, ANY, SHADING = "film", "nearest", "any", "shading"

SCENE_FILE, MESH_FILE, RAYS_FILE = "scene.pickle", "mesh.npz", "rays.npz"  # files of a folder
ROBUST, DEFAULT = "robust", "default"  # folders within: a scene for Mitsuba in Embree's two modes
FIRST_RAY = (
    np.zeros((1, 3), np.float32),
    np.ones((1, 3), np.float32),
)  # for trees that are built on the first ray
SHADOW_END = 1.0  # t_max of shadow rays: t = 1 is the lamp


@dataclass(frozen=True)
class Work:
    """One contestant's job."""

    folder: str
    workload: str
    threads: int  # how many processors it may use
    entry: str  # "module:class" of the contestant, below mitsuba_ref.bench.entries
    options: Mapping[str, Any] = field(default_factory=dict)  # its own

    def to_json(self) -> str:
        return json.dumps(asdict(self))


class Entry(Protocol):
    """A contestant, in a process of its own; its class is called with the Work.

    Each method, and the class, raises CannotRun for what there is no way to do.
    """

    def build(self, size: int) -> None:
        """Everything between loaded arrays and the first ray, for a film of size x size or as many rays; once."""

    def take_rays(self) -> None:
        """Convert the rays of the folder, at most size * size, to the form they are cast in. Not timed."""

    def cast(self) -> int:
        """Cast all rays once, results in memory as arrays; the number of rays."""

    def answer(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        """(n,) float64 t along other rays (n, 3) float32, inf on a miss.

        Shadow rays: 0 where they hit anything.
        """


class CannotRun(Exception):  # noqa: N818 - the reason of an empty row, not an error
    """str(): what is missing."""


def given_rays(folder: str, size: int) -> tuple[np.ndarray, np.ndarray]:
    """o, d: (n, 3) float32; all of them, or size * size that are spread evenly."""
    with np.load(Path(folder) / RAYS_FILE) as file:
        o, d = file["o"], file["d"]
    if len(o) <= size * size:
        return o, d
    some = np.linspace(0, len(o) - 1, size * size).astype(int)
    return o[some], d[some]


def given_mesh(folder: str) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) float32 corners and (m, 3) int32 faces. Raises CannotRun where the scene is more than triangles."""
    path = Path(folder) / MESH_FILE
    if not path.exists():
        raise CannotRun("triangles only")
    with np.load(path) as file:
        return file["vertices"], file["faces"]


def blocked(hit: np.ndarray) -> np.ndarray:
    """Hits of shadow rays in the form of Entry.answer."""
    return np.where(hit, 0.0, np.inf)
