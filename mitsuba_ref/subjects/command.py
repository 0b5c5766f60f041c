"""Candidates that are programs: they read our scene and write an EXR file, or read rays and write hits."""

import atexit
import re
import shlex
import shutil
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from caster.description.errors import FileMissing, SceneError
from caster.geometry.packing import Packed, concatenate_parts
from caster.image.exr import Exr, UnreadableExr, read_exr
from caster.system.terminal import printable
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.error_model.tolerances import U32
from mitsuba_ref.reference.shared_input import export, pixel_of
from mitsuba_ref.reference.subprocess_runner import (
    HEAD_BYTES,
    ProcessEnd,
    ProcessEnded,
    ResidentProcess,
    UnexpectedReply,
    exit_name,
    length_first,
    run,
)
from mitsuba_ref.subjects.ray_files import answer_of_numbered_hits
from mitsuba_ref.subjects.subject import (
    FLOAT32,
    FLOAT64,
    LAST_WORDS,
    Answer,
    CastRequest,
    NoAnswer,
    Subject,
    Unsupported,
    checked_answer,
)

PLACEHOLDERS = ("xml", "toml", "exr", "width", "height")  # of a command that renders a scene
RAY_PLACEHOLDERS = ("rays", "hits", "mesh", "toml")  # of one that reads rays and writes hits
PLACEHOLDER = re.compile(r"\{(\w+)\}")
OWN_CAMERA_NOTE = "it casts the rays of its own camera, and is allowed the effect of rounding those to float32"

UNSUPPORTED_CODE = 77  # exit code of a program that declines a scene, as of a skipped test in Automake

DEPTH, NORMAL, MASK = "depth.Z", ("normal.X", "normal.Y", "normal.Z"), "A"


def split_command(text: str, placeholders: Sequence[str]) -> tuple[str, ...]:
    """The words of a command with no other placeholders, split as by a shell; no shell runs it. Raises SceneError."""
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise SceneError(str(error)) from error
    if not words:
        raise SceneError("expected a program and its arguments, got blanks alone")
    if unknown := {*PLACEHOLDER.findall(text)} - {*placeholders}:
        known = ", ".join(f"{{{name}}}" for name in placeholders)
        raise SceneError(f"{{{min(unknown)}}} stands for nothing; known are {known}")
    if shutil.which(words[0]) is None:
        raise SceneError(f"there is no program '{words[0]}' to run")
    return tuple(words)


@dataclass(frozen=True)
class Program(Subject):
    """A program that runs without a shell, in the user's current folder."""

    words: tuple[str, ...]
    precision: str | None
    seconds: float

    @property
    def placeholders(self) -> set[str]:
        return {name for word in self.words for name in PLACEHOLDER.findall(word)}

    def run(self, values: Mapping[str, Any]) -> None:
        """Run it once, with values in place of the placeholders. Raises NoAnswer with the tail of its output."""
        words = [PLACEHOLDER.sub(lambda found: str(values[found[1]]), word) for word in self.words]
        try:
            end = run(words, self.seconds)
        except OSError as error:
            raise NoAnswer(f"{words[0]} could not be started: {error.strerror}") from error
        raise_if_failed(end, self.seconds)


def raise_if_failed(end: ProcessEnd, seconds: float) -> None:
    """Raise NoAnswer for a program that was killed at its deadline or ended with a code other than 0."""
    if end.code is None:
        raise NoAnswer(f"killed after {seconds:g} s{_last_words(end)}")
    if end.code == UNSUPPORTED_CODE:
        raise Unsupported(f"the program declined the scene, exit {end.code}{_last_words(end)}")
    if end.code:
        how = "ended with" if end.code > 0 else "was ended by"
        raise NoAnswer(f"the program {how} {exit_name(end.code)}{_last_words(end)}")


def _last_words(end: ProcessEnd, where: str = "") -> str:
    """What a program said in one line, then the end of all that it said; where: it is read from."""
    headline, words = printable(end.headline), printable(end.output).strip()[-LAST_WORDS:]
    more = f"\n{words}" if words != headline else ""
    return f": {headline}{more}" if words else f"; it printed nothing{where}"


# ---- a command that reads a scene and writes an EXR file ----


# (image, request) -> the image with our names and conventions, and the steps taken; None: the image has them
Convert = Callable[[Exr, CastRequest], tuple[Exr, tuple[str, ...]]]


@dataclass(frozen=True)
class CommandSubject(Program):
    """A program that reads a scene and writes an EXR file."""

    convert: Convert | None = None

    @property
    def reads_xml(self) -> bool:
        return "xml" in self.placeholders

    def answer(self, request: CastRequest) -> Answer:
        """Write the scene, run the program, read its image. Raises NoAnswer."""
        film, path = request.scene.film, request.folder / "candidate.exr"
        names: dict[str, Any] = {"exr": path, "width": film.width, "height": film.height}
        if self.reads_xml:
            exported = export(request.scene, request.model)
            if "<sensor" not in exported.xml:
                kind = request.scene.camera.type
                raise Unsupported(f"Mitsuba has no {kind} camera, so the XML has none; read {{toml}} for this scene")
            names["xml"] = exported.write(request.folder)
        if "toml" in self.placeholders:
            names["toml"] = write_toml(request)
        self.run(names)
        try:
            exr = read_exr(path)
        except UnreadableExr as error:
            raise NoAnswer(f"the program ended well, but its image cannot be read: {error}") from error
        except FileMissing as error:
            raise NoAnswer("the program ended well, but wrote no {exr}") from error
        return answer_from_exr(exr, request, self)


def write_toml(request: CastRequest) -> Path:
    """Write the scene with the values that are traced to a file."""
    path = request.folder / "scene.toml"
    path.write_text(request.traced.to_toml(), encoding="utf-8")
    return path


def answer_from_exr(exr: Exr, request: CastRequest, subject: "CommandSubject | ExrFile") -> Answer:
    """The answer from an image of the subject: depth along the ray from the eye, geometric normal, mask.

    Raises NoAnswer, also if its pixels are not those of the film.
    """
    film, (x0, y0, x1, y1) = request.scene.film, request.scene.film.window
    if exr.data_window not in ((x0, y0, x1, y1), (0, 0, x1 - x0, y1 - y0)):
        raise NoAnswer(
            f"the image shows pixels {exr.data_window}, expected {(x0, y0, x1, y1)} of the film of "
            f"{film.width} x {film.height}"
        )
    exr, steps = subject.convert(exr, request) if subject.convert else (exr, ())
    n = _normals(exr.channels)
    rays = request.rays
    depth = exr.channels[DEPTH].ravel().astype(np.float64)
    length = np.linalg.norm(rays.d.astype(np.float64), axis=1)
    with np.errstate(invalid="ignore"):
        t = (depth - rays.start) / length
    if MASK in exr.channels:
        covered = _mask(exr.channels[MASK].ravel(), depth, request)
        t, depth = (np.where(covered, values, np.inf) for values in (t, depth))
    # The depth, which counts from the eye, was rounded to float32 when it was stored.
    with np.errstate(invalid="ignore"):
        stored = np.where(np.isfinite(depth), U32 * np.abs(depth) / length, 0.0)
    return checked_answer(
        t,
        n,
        np.ones(len(t), bool),
        precision=subject.precision or FLOAT32,
        as_exported=subject.reads_xml,
        t_rounding=stored,
        own_camera=True,
        notes=(OWN_CAMERA_NOTE, *steps),
    )


@dataclass(frozen=True)
class ExrFile(Subject):
    """An EXR file that was rendered beforehand with the scene's camera."""

    exr: Exr
    precision: str | None
    convert: Convert | None = None

    def answer(self, request: CastRequest) -> Answer:
        """The answer from its channels. Raises NoAnswer."""
        return replace(answer_from_exr(self.exr, request, self), own_geometry=True)


def _normals(channels: Mapping[str, Array]) -> Array | None:
    """(n, 3) normals, None if they are not given. Raises NoAnswer, also if depth is missing or not float32."""
    if DEPTH not in channels:
        has = ", ".join(channels) or "none"
        raise NoAnswer(f"the image has no channel {DEPTH}, the distance from the eye along the ray; it has {has}")
    some = [name for name in NORMAL if name in channels]
    if some and len(some) < len(NORMAL):
        raise NoAnswer(f"the image has {', '.join(some)}, but not all of {', '.join(NORMAL)}")
    for name in (DEPTH, *some):
        if channels[name].dtype != np.float32:
            raise NoAnswer(f"channel {name} holds {channels[name].dtype}, expected float32: half has 11 bits")
    return np.stack([channels[name].ravel() for name in some], axis=1) if some else None


def _mask(mask: Array, depth: Array, request: CastRequest) -> Array:
    """(n,) bool: the hits. A miss may have depth 0 or inf. Raises NoAnswer where depth contradicts the mask."""
    covered: Array = mask != 0
    missed = np.isposinf(depth) | (~covered & (depth == 0.0))
    contradicts = (covered == missed) | ~np.isfinite(mask)
    if contradicts.any():
        i = int(np.argmax(contradicts))
        raise NoAnswer(
            f"A and {DEPTH} contradict each other at {int(contradicts.sum())} pixels, first "
            f"{pixel_of(request.scene, i)}: A is {mask[i]:g}, depth {depth[i]:.9g}; a miss has A 0 and depth inf"
        )
    return covered


# ---- rays in, hits out: one binary format in files and over stdin and stdout (docs/candidates.md) ----


def mesh_bytes(packed: Packed) -> bytes:
    """All triangles of a scene: v, f as int64, (v, 3) float32, (f, 3) int32. Raises Unsupported for other shapes."""
    if others := {type(part).__name__ for part in packed.parts if not hasattr(part, "faces")}:
        raise Unsupported(f"{{mesh}}: the scene has {', '.join(sorted(others))} beside triangles; read {{toml}}")
    mesh = concatenate_parts(packed.parts)
    counts = np.array([len(mesh.vertices), len(mesh.faces)], "<i8")
    return counts.tobytes() + mesh.vertices.astype("<f4").tobytes() + mesh.faces.astype("<i4").tobytes()


HIT_COLUMNS = {1: "t", 4: "t, n", 5: "t, n, prim_id"}


@dataclass(frozen=True)
class RayProgram(Program):
    """A program that casts given rays and answers with rows of HIT_COLUMNS."""

    takes_rays: ClassVar[bool] = True
    takes_limits: bool = True  # its interface has t_min and t_max

    @property
    def numbers(self) -> np.dtype[Any]:
        """The type of rays and hits, little-endian."""
        return np.dtype("<f8" if self.precision == FLOAT64 else "<f4")

    def ray_bytes(self, request: CastRequest) -> bytes:
        """The rays of all pixels that have one: rows of o, d, t_min, t_max."""
        rays = request.rays
        t_min = np.broadcast_to(rays.t_min, len(rays.t_max))
        rows = np.column_stack([rays.o, rays.d, t_min, rays.t_max])[rays.t_max >= 0.0]
        return rows.astype(self.numbers).tobytes()

    def known_lengths(self, request: CastRequest) -> tuple[dict[int, int], str]:
        """(columns of the hits by their bytes, the same in words)."""
        count = int((request.rays.t_max >= 0.0).sum())
        lengths = {count * columns * self.numbers.itemsize: columns for columns in HIT_COLUMNS}
        known = ", ".join(f"{length} for {HIT_COLUMNS[columns]}" for length, columns in lengths.items())
        return lengths, f"{count} rows: {known}"

    def answer_of_bytes(self, data: bytes, request: CastRequest, where: str) -> Answer:
        """The answer from rows of t; t, n; or t, n, prim, numbered through all triangles. Raises NoAnswer."""
        lengths, known = self.known_lengths(request)
        if len(data) not in lengths:
            raise NoAnswer(f"{where}: expected bytes of {known}, without a header; got {len(data)}")
        rows = np.frombuffer(data, self.numbers).reshape(-1, lengths[len(data)])
        hits = {"t": rows[:, 0]}
        if rows.shape[1] >= 4:
            hits["n"] = rows[:, 1:4]
        if rows.shape[1] == 5:
            number = rows[:, 4]
            whole = (np.abs(number) < 2.0**31) & (number == np.floor(number))
            hits["prim_id"] = np.where(whole, number, -2).astype(np.int64)
        return answer_of_numbered_hits(
            hits, request.rays, request.model.packed, self.precision, limits=self.takes_limits
        )


@dataclass(frozen=True)
class RayCommand(RayProgram):
    """A program that reads rays and writes hits."""

    def answer(self, request: CastRequest) -> Answer:
        """Write rays and scene, run the program, read its hits. Raises NoAnswer."""
        paths = {name: request.folder / f"{name}.raw" for name in ("rays", "hits", "mesh")}
        paths["rays"].write_bytes(self.ray_bytes(request))
        if "toml" in self.placeholders:
            paths["toml"] = write_toml(request)
        if "mesh" in self.placeholders:
            paths["mesh"].write_bytes(mesh_bytes(request.model.packed))
        paths["hits"].unlink(missing_ok=True)  # left by an earlier request
        self.run(paths)
        try:
            data = paths["hits"].read_bytes()
        except OSError as error:
            raise NoAnswer(f"the program ended well, but its hits cannot be read: {error}") from error
        return self.answer_of_bytes(data, request, "{hits}")


served: dict[tuple[str, ...], ResidentProcess] = {}  # the programs that run, by the words of their commands
_one_at_a_time = threading.Lock()  # scenes are judged several at a time

DECLINED = -1  # in place of the length of a response: the program does not support the scene


@dataclass(frozen=True)
class ServedCommand(RayProgram):
    """A program that is started once, reads meshes and rays from stdin and writes hits to stdout."""

    def answer(self, request: CastRequest) -> Answer:
        """Send triangles and rays, read hits; restart a program that has ended. Raises NoAnswer."""
        parts = mesh_bytes(request.model.packed), self.ray_bytes(request)
        lengths, known = self.known_lengths(request)

        def length_of(head: bytes) -> int:
            length = int.from_bytes(head, "little", signed=True)
            if length != DECLINED and length not in lengths:
                raise UnexpectedReply(
                    f"its response starts with the bytes {head!r}, as an int64 {length}; expected the length of "
                    f"{known}; or {DECLINED} to decline the scene. Only responses go to stdout"
                )
            return max(length, 0)

        try:
            with _one_at_a_time:
                if self.words not in served or not served[self.words].alive:
                    served[self.words] = ResidentProcess(self.words)
                    atexit.register(served[self.words].close)
                reply = served[self.words].request(b"".join(map(length_first, parts)), self.seconds, length_of)
        except OSError as error:
            raise NoAnswer(f"{self.words[0]} could not be started: {error.strerror}") from error
        except UnexpectedReply as error:
            raise NoAnswer(f"the program gave no answer to read: {error}") from error
        except ProcessEnded as ended:
            raise_if_failed(ended.end, self.seconds)
            raise NoAnswer(
                f"the program ended before its response was whole{_last_words(ended.end, ' to standard error')}"
            ) from None
        if int.from_bytes(reply[:HEAD_BYTES], "little", signed=True) == DECLINED:
            raise Unsupported("the program declined the scene")
        return self.answer_of_bytes(reply[HEAD_BYTES:], request, "its response")
