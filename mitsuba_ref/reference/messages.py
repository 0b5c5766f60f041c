"""Requests to a Mitsuba process and its responses, as bytes: an .npz file of a JSON record and of the arrays in it.

Nothing is pickled, so that garbled bytes are an error and never code.
"""

import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.reference.interpreter import interpreter
from mitsuba_ref.reference.subprocess_runner import ProcessEnd, ProcessEnded, ResidentProcess, run_module

ARRAY = "\0"  # {ARRAY: name} stands in the record for an array of the file; no name in a scene has this character


class Message:
    """A record that is sent, with arrays in any place."""

    def to_bytes(self) -> bytes:
        """The fields, equal for equal ones. Paths become text."""
        arrays: dict[str, Array] = {}

        def beside(value: Any) -> Any:
            if not isinstance(value, np.ndarray):
                return str(value)
            name = str(len(arrays))
            arrays[name] = value
            return {ARRAY: name}

        record = json.dumps({"kind": type(self).__name__} | vars(self), default=beside).encode()
        file = io.BytesIO()
        np.savez(file, allow_pickle=False, record=np.frombuffer(record, np.uint8), **arrays)
        return file.getvalue()


def message_of(content: bytes) -> Any:
    """The inverse of `to_bytes`. Raises ValueError for bytes that are cut short or malformed."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            record = json.loads(
                file["record"].tobytes(), object_hook=lambda found: file[found[ARRAY]] if ARRAY in found else found
            )
        kind = {each.__name__: each for each in Message.__subclasses__()}[record.pop("kind")]
        return kind(**record)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"no whole answer: {type(error).__name__}: {error}") from error


@dataclass(frozen=True)
class OpenRequest(Message):
    """A user's Mitsuba file, to be opened: as its geometry and its sensor's rays, or to trace rays through it."""

    file: str  # absolute
    parameters: Mapping[str, str] = field(default_factory=dict)  # values of $names
    sensor: int = 0
    size: Sequence[int] | None = None  # of the film; None: the file's
    folders: Sequence[str] = ()  # where else its files are looked for
    robust: bool = True  # use Embree's mode that keeps meshes closed, whatever the file says
    variant: str = "scalar_rgb"  # for scenes of triangles; others are opened in scalar_rgb
    digest: str = ""  # of the contents of all its files, where these are known


@dataclass(frozen=True, eq=False)
class OpenResponse(Message):
    """What Mitsuba holds of a file: unique shapes, where they are placed, the sensor's rays, lights."""

    rays: Array  # (pixels, 7) float32: o, d, t_max through the crop's pixel centres, row by row
    shapes: Sequence[dict[str, Any]]  # reference/file_calls.py:_shape
    placed: Sequence[Any]  # Placements of reference/file_calls.py
    materials: Mapping[str, dict[str, Any]]  # by name, as the caster has them
    film: Mapping[str, Any]  # fields of the caster's
    camera: Mapping[str, Any]  # the sensor's plugin and numbers
    lights: Sequence[dict[str, Any]]
    unlit: Sequence[str]  # lights and materials that the caster has not
    dropped: Mapping[str, int]  # left out before loading, with counts
    files: Sequence[str]  # that the answer depends on
    variant: str
    robust: bool  # Embree's mode, as requested or as the file says


@dataclass(frozen=True)
class OpenRefusal(Message):
    """Why a file was not opened, in place of an OpenResponse."""

    missing: Sequence[str] = ()  # files that cannot be read
    problem: str = ""


@dataclass(frozen=True)
class Coverage:
    """What of a Mitsuba file is judged."""

    shapes: int  # in the file, copies by instances included
    judged: int
    left_out: tuple[str, ...] = ()  # shapes by name, each with its place and the reason
    hidden: int = 0  # pixels that are not judged, since Mitsuba hits a shape that is left out
    unlit: tuple[str, ...] = ()  # lights and materials for which diffuse is not compared
    dropped: dict[str, int] = field(default_factory=dict)  # left out before loading, since no geometry depends on it
    notes: tuple[str, ...] = ()
    strict: bool = False  # a scene that is judged in part fails

    @property
    def partial(self) -> bool:
        return self.judged < self.shapes

    @property
    def brief(self) -> str:
        """`3 of 4 shapes`; "" where all are judged."""
        return f"{self.judged} of {self.shapes} shapes" if self.partial else ""

    def lines(self) -> list[str]:
        """What is not judged, a line each."""
        found = [f"left out: {each}" for each in self.left_out]
        if self.hidden:
            found.append(f"not judged: {self.hidden} pixels, where Mitsuba hits a shape that is left out")
        if self.unlit:
            more = f" and {len(self.unlit) - 1} more" if len(self.unlit) > 1 else ""
            found.append(f"diffuse is not compared: {self.unlit[0]}{more}")
        if self.dropped:
            words = (f"{count} {name}" if count > 1 else name for name, count in self.dropped.items())
            found.append(f"geometry does not depend on, and not loaded: {', '.join(words)}")
        return [*found, *self.notes]


@dataclass(frozen=True, eq=False)
class TraceRequest(Message):
    """Rays through one exported scene, in the exact float32 values to trace; d need not be of unit length."""

    xml: Path  # absolute, as mesh_files: the child runs in another folder
    variant: str  # scalar_rgb or llvm_ad_rgb
    o: Array  # (n, 3) float32
    d: Array  # (n, 3) float32
    t_max: Array  # (n,) float32, lengths of d; inf is no limit
    lights: bool = True  # whether to compute light_rgb, light_visible and albedo
    sensor: bool = False  # whether to sample the rays of the scene's own sensor
    strict: bool = True  # whether a warning of Mitsuba's is an error
    mesh_files: Sequence[Path] = ()  # to be read by Mitsuba's own loader as well
    original: Mapping[str, Any] | None = None  # of an OpenRequest: `xml` is a user's file, to be loaded as it says
    leaving: Array | None = None  # (n, 3) float32, direction of a ray from each hit, for spawn_ray


@dataclass(frozen=True, eq=False)
class TraceResponse(Message):
    """Intersections of n rays by Mitsuba. On a miss: t inf, shape and prim -1, everything else 0."""

    names: list[str]  # ids of the shapes, as in the XML
    versions: dict[str, str]  # mitsuba, drjit, variant, libllvm, processor
    seconds: float  # loading and tracing, without starting Python
    t: Array  # (n,) float32, lengths of d
    n: Array  # (n, 3) float32, geometric normal
    sh_n: Array  # (n, 3) float32, shading normal
    p: Array  # (n, 3) float32
    uv: Array  # (n, 2) float32
    prim_uv: Array  # (n, 2) float32, where on a triangle: barycentrics b1, b2, of which p is made
    shape: Array  # (n,) int32, index into names; of the instance where one was hit
    prim: Array  # (n,) int32
    light_rgb: Array  # (lights, n, 3) float32, radiance reflected from each light, unshadowed
    light_visible: Array  # (lights, n) bool, Mitsuba's shadow test
    albedo: Array  # (n, 3) float32
    sensor: Array  # (pixels, 7) float32: o, d, t_max through the crop's pixel centres, row by row; none, if not wanted
    origin: Array  # (n, 3) float32, of the ray that leaves each hit, by spawn_ray; none, if not wanted
    loaded: Sequence[Any]  # of each mesh file: (faces, 3, 8) float32 position, normal, uv; the rest as in LoadedMesh
    stored: bool = False  # the stored response to an equal request; no Mitsuba ran, and `seconds` is 0

    def __post_init__(self) -> None:
        """Raise ValueError where a hit has no shape, or a miss has one."""
        known = (self.shape >= 0) & (self.shape < len(self.names))
        if np.any(known != (self.t != np.inf)):
            raise ValueError("shape: expected one of the named where t is not inf and -1 elsewhere, got others")

    @property
    def meshes(self) -> tuple["LoadedMesh", ...]:
        """The mesh files of the request."""
        files = ((corners.astype(np.float64), *rest) for corners, *rest in self.loaded)
        return tuple(LoadedMesh(c[..., :3], c[..., 3:6], c[..., 6:], *rest) for c, *rest in files)


class LoadedMesh(NamedTuple):
    """A mesh file as Mitsuba's loader reads it: float32 values at the corners of its faces, in the file's order."""

    corners: Array  # (f, 3, 3)
    normals: Array  # (f, 3, 3), 0 where there are none
    uv: Array  # (f, 3, 2), 0 where there are none
    vertices: Array  # (f, 3) int32: corners with the same number share a vertex
    problem: str = ""  # the loader's message if it refused the file


class MitsubaError(RuntimeError):
    """Mitsuba is not here, or ended without an answer; the text says how, with its output."""


class Crash(ProcessEnd):
    """The end of a Mitsuba process without a whole response."""

    @property
    def brief(self) -> str:
        """The exit and the headline."""
        return f"{self.exit}: {self.headline}".removesuffix(": ")

    @property
    def message(self) -> str:
        """The whole crash as the problem of a scene."""
        return f"Mitsuba ended without an answer ({self.exit}): {self.output}".strip()


def start(environment: Mapping[str, str]) -> ResidentProcess:
    """Start a process that answers requests. Raises ProcessEnded while starts are refused."""
    return run_module(interpreter(), "mitsuba_ref.reference.mitsuba_process", environment=environment)


def run_request(request: Message, timeout: float, environment: Mapping[str, str]) -> Any:
    """The response or Crash of a new process, which ends after one request. environment: added to that of this one."""
    try:
        with closing(start(environment)) as process:
            return message_of(process.ask(request.to_bytes(), timeout))
    except ProcessEnded as ended:
        return Crash(**vars(ended.end))
    except ValueError as error:
        return Crash(0, str(error), 0.0)
