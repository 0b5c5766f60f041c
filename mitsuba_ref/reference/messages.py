"""Requests to a Mitsuba process and its responses, as bytes: an .npz file of their arrays and of a JSON record.

Nothing is pickled, so that garbled bytes are an error and never code.
"""

import io
import json
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from mitsuba_ref.reference.interpreter import child_command
from mitsuba_ref.reference.subprocess_runner import (
    ProcessEnd,
    ProcessEnded,
    ResidentProcess,
    UnexpectedReply,
    user_import_path,
)

# Field -> shape and dtype of its array. A size with a name is the same in all arrays.
Layout = dict[str, tuple[tuple[int | str, ...], type]]

MALFORMED_ERRORS = (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile)  # of malformed bytes


class Message:
    """A record that is sent, with its arrays."""

    LAYOUT: ClassVar[Layout] = {}

    def to_bytes(self) -> bytes:
        """The fields, equal for equal ones."""
        return record_bytes(self)


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

    def response(self, content: bytes) -> "OpenResponse":
        """The response in a reply. Raises ValueError where it is cut short or malformed."""
        response: OpenResponse = whole(OpenResponse, content)
        return response


@dataclass(frozen=True, eq=False)
class OpenResponse(Message):
    """What Mitsuba holds of a file: unique shapes, where they are placed, the sensor's rays, lights."""

    LAYOUT: ClassVar[Layout] = {
        "numbers": (("numbers",), np.float32),  # rows of all shapes (reference/file_calls.py:_shape)
        "faces": (("faces", 3), np.int32),
        "texels": (("texels", 3), np.float32),  # of all bitmaps, row by row
        "rays": (("pixels", 7), np.float32),  # o, d, t_max through the pixel centres of the crop, row by row
    }

    numbers: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    faces: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), np.int32))
    texels: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    rays: np.ndarray = field(default_factory=lambda: np.zeros((0, 7), np.float32))
    shapes: Sequence[dict[str, Any]] = ()  # reference/file_calls.py:_shape
    placed: Sequence[Any] = ()  # Placements of reference/file_calls.py
    size: Sequence[int] = (1, 1)  # of the film
    crop: Sequence[int] = (0, 0, 1, 1)
    camera: Mapping[str, Any] = field(default_factory=dict)  # the sensor's plugin and numbers
    lights: Sequence[dict[str, Any]] = ()
    unlit: Sequence[str] = ()  # lights and materials that the caster has not
    dropped: Mapping[str, int] = field(default_factory=dict)  # left out before loading, with counts
    files: Sequence[str] = ()  # that the answer depends on
    variant: str = ""
    robust: bool = True  # Embree's mode, as requested or as the file says
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

    LAYOUT: ClassVar[Layout] = {
        "o": (("rays", 3), np.float32),
        "d": (("rays", 3), np.float32),
        "t_max": (("rays",), np.float32),
        "leaving": (("origins", 3), np.float32),
    }

    xml: Path
    variant: str  # scalar_rgb or llvm_ad_rgb
    o: np.ndarray  # (n, 3) float32
    d: np.ndarray  # (n, 3) float32
    t_max: np.ndarray  # (n,) float32, lengths of d; inf is no limit
    lights: bool = True  # whether to compute light_rgb, light_visible and albedo
    sensor: bool = False  # whether to sample the rays of the scene's own sensor
    strict: bool = True  # whether a warning of Mitsuba's is an error
    mesh_files: tuple[Path, ...] = ()  # to be read by Mitsuba's own loader as well
    original: Mapping[str, Any] | None = None  # of an OpenRequest: `xml` is a user's file, to be loaded as it says
    # (n, 3) float32, direction in which a ray leaves each hit, for spawn_ray; or none
    leaving: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), np.float32))

    def __post_init__(self) -> None:
        _check_arrays(self, {"rays": len(self.o), "origins": len(self.o) if len(self.leaving) else 0})

    def to_bytes(self) -> bytes:
        """The request with absolute paths: the child runs in another folder."""
        meshes = tuple(file.absolute() for file in self.mesh_files)
        return record_bytes(replace(self, xml=self.xml.absolute(), mesh_files=meshes))

    @classmethod
    def from_bytes(cls, content: bytes) -> "TraceRequest":
        """The inverse of `to_bytes`."""
        record = record_of(content)
        meshes = tuple(Path(file) for file in record["mesh_files"])
        return cls(**(record | {"xml": Path(record["xml"]), "mesh_files": meshes}))

    def response(self, content: bytes) -> "TraceResponse":
        """The response in a reply. Raises ValueError where it is cut short or malformed."""
        return TraceResponse.from_bytes(content, len(self.o))


@dataclass(frozen=True, eq=False)
class TraceResponse(Message):
    """Intersections of n rays by Mitsuba. On a miss: t inf, shape and prim -1, everything else 0."""

    LAYOUT: ClassVar[Layout] = {
        "t": (("rays",), np.float32),
        "n": (("rays", 3), np.float32),
        "sh_n": (("rays", 3), np.float32),
        "p": (("rays", 3), np.float32),
        "uv": (("rays", 2), np.float32),
        "prim_uv": (("rays", 2), np.float32),
        "shape": (("rays",), np.int32),
        "prim": (("rays",), np.int32),
        "albedo": (("rays", 3), np.float32),
        "light_rgb": (("lights", "rays", 3), np.float32),
        "light_visible": (("lights", "rays"), np.bool_),
        "sensor": (("pixels", 7), np.float32),
        "mesh_corners": (("faces", 3, 8), np.float32),
        "mesh_vertices": (("faces", 3), np.int32),
        "origin": (("origins", 3), np.float32),
    }

    t: np.ndarray  # (n,) float32, lengths of d
    n: np.ndarray  # (n, 3) float32, geometric normal
    sh_n: np.ndarray  # (n, 3) float32, shading normal
    p: np.ndarray  # (n, 3) float32
    uv: np.ndarray  # (n, 2) float32
    prim_uv: np.ndarray  # (n, 2) float32, where on a triangle: barycentrics b1, b2, of which p is made
    shape: np.ndarray  # (n,) int32, index into names; of the instance where an instance was hit
    prim: np.ndarray  # (n,) int32
    names: list[str]  # ids of the shapes, as in the XML
    light_rgb: np.ndarray  # (lights, n, 3) float32, radiance reflected from each light, unshadowed
    light_visible: np.ndarray  # (lights, n) bool, Mitsuba's shadow test
    albedo: np.ndarray  # (n, 3) float32
    versions: dict[str, str]  # mitsuba, drjit, variant, libllvm, processor
    seconds: float  # loading and tracing, without starting Python
    stored: bool = False  # the stored response to an equal request; no Mitsuba ran, and `seconds` is 0
    # (m, 7) float32: o, d, t_max of the sensor's rays through the pixel centres of the crop window, row by row
    sensor: np.ndarray = field(default_factory=lambda: np.zeros((0, 7), np.float32))
    # (f, 3, 8) float32: position, normal and uv at the corners of all faces of the mesh files
    mesh_corners: np.ndarray = field(default_factory=lambda: np.zeros((0, 3, 8), np.float32))
    mesh_vertices: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), np.int32))  # (f, 3) indices
    # (n, 3) float32: the origin of the ray that leaves each hit, by spawn_ray, where these were requested
    origin: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    mesh_faces: Sequence[int] = ()  # face count of each file
    mesh_problems: Sequence[str] = ()  # for each file, why Mitsuba's loader refused it; "" if it did not

    @property
    def meshes(self) -> tuple["LoadedMesh", ...]:
        """The mesh files of the request."""
        ends = np.cumsum(self.mesh_faces, dtype=int)
        corners, vertices = (
            np.split(each, ends[:-1]) if len(ends) else []
            for each in (self.mesh_corners.astype(np.float64), self.mesh_vertices)
        )
        rows = zip(corners, vertices, self.mesh_problems, strict=True)
        return tuple(LoadedMesh(c[..., :3], c[..., 3:6], c[..., 6:], v, problem) for c, v, problem in rows)

    @classmethod
    def from_bytes(cls, content: bytes, rays: int) -> "TraceResponse":
        """The response to a request of `rays` rays. Raises ValueError where it is cut short or malformed."""
        response: TraceResponse = whole(cls, content)
        response.check(rays)
        return response

    def check(self, rays: int) -> None:
        """Raise ValueError unless every array has its length, dtype and range."""
        lights, pixels, faces = len(self.light_rgb), len(self.sensor), sum(self.mesh_faces)
        origins = rays if len(self.origin) else 0
        _check_arrays(self, {"rays": rays, "lights": lights, "pixels": pixels, "faces": faces, "origins": origins})
        if len(self.mesh_faces) != len(self.mesh_problems):
            raise ValueError("mesh_problems: expected one for each mesh file")
        known = (self.shape >= 0) & (self.shape < len(self.names))
        if np.any(known != (self.t != np.inf)):
            raise ValueError("shape: expected one of the named where t is not inf and -1 elsewhere, got others")


class LoadedMesh(NamedTuple):
    """A mesh file as Mitsuba's loader reads it: float32 values at the corners of its faces, in the file's order."""

    corners: np.ndarray  # (f, 3, 3)
    normals: np.ndarray  # (f, 3, 3), 0 where there are none
    uv: np.ndarray  # (f, 3, 2), 0 where there are none
    vertices: np.ndarray  # (f, 3) int32: corners with the same number share a vertex
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


CHILD_MODULE = "mitsuba_ref.reference.mitsuba_process"


def start(environment: Mapping[str, str], command: Sequence[str] | None = None) -> ResidentProcess:
    """Start a process that answers requests. Raises ProcessEnded while starts are refused."""
    path = {"PYTHONPATH": user_import_path()}
    return ResidentProcess(command or child_command(CHILD_MODULE), {**environment, **path}, cwd=tempfile.gettempdir())


def run_request(
    request: Any, timeout: float, environment: Mapping[str, str], command: Sequence[str] | None = None
) -> Any:
    """The response or Crash of a new process, which ends after one request. environment: added to that of this one."""
    try:
        with start(environment, command) as process:
            reply = process.ask(request.to_bytes(), timeout)
        return request.response(reply)
    except ProcessEnded as ended:
        return Crash(ended.end.code, ended.end.output, ended.end.seconds)
    except (UnexpectedReply, ValueError) as error:
        return Crash(0, str(error), 0.0)


def _check_arrays(record: Any, sizes: dict[Any, int]) -> None:
    """Raise ValueError unless every array fits its LAYOUT. sizes: by the names there."""
    for name, (layout, dtype) in record.LAYOUT.items():
        array, shape = getattr(record, name), tuple(sizes.get(size, size) for size in layout)
        if not isinstance(array, np.ndarray) or array.shape != shape or array.dtype != dtype:
            got = f"{array.dtype}{list(array.shape)}" if isinstance(array, np.ndarray) else type(array).__name__
            raise ValueError(f"{name}: expected {np.dtype(dtype)}{list(shape)}, got {got}")


def record_bytes(record: Any) -> bytes:
    """The fields of a record, equal for equal ones."""
    values = {field.name: getattr(record, field.name) for field in fields(record)}
    arrays = {name: value for name, value in values.items() if name in record.LAYOUT}
    rest = {name: value for name, value in values.items() if name not in arrays}
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, record=np.frombuffer(json.dumps(rest, default=str).encode(), np.uint8), **arrays)
    return file.getvalue()


def request_of(content: bytes) -> OpenRequest | TraceRequest:
    """The inverse of a request's `to_bytes`."""
    record = record_of(content)
    return OpenRequest(**record) if "file" in record else TraceRequest.from_bytes(content)


def whole(kind: Any, content: bytes) -> Any:
    """A response of this kind. Raises ValueError where it is cut short or malformed."""
    try:
        return kind(**record_of(content))
    except MALFORMED_ERRORS as error:
        raise ValueError(f"no whole answer: {type(error).__name__}: {error}") from error


def record_of(content: bytes) -> dict[str, Any]:
    with np.load(io.BytesIO(content), allow_pickle=False) as found:
        values = {name: found[name] for name in found.files}
    return json.loads(values.pop("record").tobytes()) | values
