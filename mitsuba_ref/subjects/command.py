"""Candidates that are programs: they read our scene and write an EXR file, or read rays and write hits."""

import atexit
import shlex
import shutil
import string
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from caster.description.errors import FileMissing, SceneError
from caster.geometry.packing import Packed
from caster.image.exr import Exr, UnreadableExr, read_exr
from caster.scene.model import Scene
from caster.system.atomic_files import write_bytes
from caster.system.terminal import printable
from mitsuba_ref.cameras import reference_of_camera
from mitsuba_ref.error_model.intersections import dot, norm
from mitsuba_ref.error_model.tolerances import KU, U32
from mitsuba_ref.reference.shared_input import export, pixel_of
from mitsuba_ref.reference.subprocess_runner import (
    ProcessEnd,
    ProcessEnded,
    ResidentProcess,
    UnexpectedReply,
    exit_name,
    length_first,
    run,
)
from mitsuba_ref.subjects.ray_files import (
    HIT_COLUMNS,
    answer_of_hits,
    hit_columns,
    is_given,
    read_arrays,
    spread_answer,
)
from mitsuba_ref.subjects.subject import (
    FLOAT32,
    FLOAT64,
    LAST_WORDS,
    PRECISIONS,
    Answer,
    CastRequest,
    NoAnswer,
    Unsupported,
    checked_answer,
)

SCENE_PLACEHOLDERS = ("xml", "toml")
PLACEHOLDERS = (*SCENE_PLACEHOLDERS, "exr", "width", "height")
RAY_PLACEHOLDERS = ("rays", "rays.raw", "hits", "hits.raw", "mesh", "mesh.raw", "scene")
OWN_CAMERA_NOTE = "its rays are its own camera's, and it is allowed what rounding to float32 may do to those, too"
ESCAPE_BRACES_HINT = "a brace that is meant is written twice"

UNSUPPORTED_CODE = 77  # exit code of a program that declines a scene, as of a skipped test in Automake

BESIDE_RAY = "the position is not on the ray of its pixel"
POSITION = ("position.X", "position.Y", "position.Z")
DEPTH, NORMAL, MASK = "depth.Z", ("normal.X", "normal.Y", "normal.Z"), "A"


def split_command(text: str, placeholders: Sequence[str]) -> tuple[tuple[str, ...], frozenset[str]]:
    """(words, names in braces): split as a shell would, nothing else of a shell is done. Raises SceneError."""
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise SceneError(f"--candidate {text!r}: {error}") from error
    if not words:
        raise SceneError(f"--candidate {text!r}: expected a program and its arguments, got blanks alone")
    try:
        fields = [each for word in words for each in string.Formatter().parse(word) if each[1] is not None]
    except ValueError as error:
        raise SceneError(f"--candidate {text!r}: {error}; {ESCAPE_BRACES_HINT}") from error
    for _, name, form, conversion in fields:
        if form or conversion:
            raise SceneError(f"--candidate {text!r}: {{{name}}} is a name and nothing behind it; {ESCAPE_BRACES_HINT}")
    named = {name for _, name, _, _ in fields if name is not None}
    if unknown := named - set(placeholders):
        known = ", ".join(f"{{{name}}}" for name in placeholders)
        raise SceneError(f"--candidate {text!r}: {{{min(unknown)}}} stands for nothing; known are {known}")
    if shutil.which(words[0]) is None:
        raise SceneError(f"--candidate {text!r}: there is no program '{words[0]}' to run")
    return tuple(words), frozenset(named)


def command_of(text: str, precision: str | None, seconds: float) -> "CommandSubject":
    """A program that reads a scene and writes an EXR file. Raises SceneError."""
    words, named = split_command(text, PLACEHOLDERS)
    if "exr" not in named or not named & set(SCENE_PLACEHOLDERS):
        raise SceneError(
            f"--candidate {text!r}: expected {{exr}}, the file to write, and {{xml}} or {{toml}}, the scene"
        )
    return CommandSubject(text, words, "xml" in named, "toml" in named, precision, seconds)


@dataclass(frozen=True)
class CommandSubject:
    """A program, run once a scene, without a shell, in the folder that the user is in."""

    name: str
    words: tuple[str, ...]
    reads_xml: bool
    reads_toml: bool
    precision: str | None
    seconds: float
    takes_rays: bool = False
    takes_limits: bool = False
    # (image, request) -> the image in our names and conventions, and what was done; None: it has to be so already
    convert: Callable[[Exr, CastRequest], tuple[Exr, tuple[str, ...]]] | None = None

    def answer(self, request: CastRequest) -> Answer:
        """Write the scene, run the program, read its image. Raises NoAnswer."""
        film, folder = request.scene.film, request.folder
        names = {"exr": folder / "candidate.exr", "width": film.width, "height": film.height}
        if self.reads_xml:
            names["xml"] = self._xml(request)
        if self.reads_toml:
            names["toml"] = folder / "scene.toml"
            (folder / "scene.toml").write_text(request.traced.to_toml(), encoding="utf-8")
        run_program([word.format(**names) for word in self.words], self.seconds)
        exr = self._picture(folder / "candidate.exr", request)
        exr, steps = self.convert(exr, request) if self.convert else (exr, ())
        found = answer_from_exr(exr, request, precision=self.precision, as_exported=self.reads_xml)
        return replace(found, notes=(*found.notes, *steps))

    def _xml(self, request: CastRequest) -> Path:
        camera = request.scene.camera
        exported = export(request.scene, request.model)
        if "<sensor" not in exported.xml:
            raise Unsupported(f"Mitsuba has no {camera.type} camera, so the XML has none; read {{toml}} for this scene")
        return exported.write(request.folder)

    def _picture(self, path: Path, request: CastRequest) -> Exr:
        try:
            exr = read_exr(path)
        except UnreadableExr as error:
            raise NoAnswer(f"the program ended well, but its image cannot be read: {error}") from error
        except FileMissing as error:
            raise NoAnswer("the program ended well, but wrote no {exr}") from error
        check_window(exr, request.scene)
        return exr


def run_program(words: list[str], seconds: float) -> None:
    """Run it to its end. Raises NoAnswer with its last words."""
    try:
        end = run(words, seconds)
    except OSError as error:
        raise NoAnswer(f"{words[0]} could not be started: {error.strerror}") from error
    raise_if_failed(end, seconds)


def raise_if_failed(end: ProcessEnd, seconds: float) -> None:
    """Raise NoAnswer for a program that was killed at its deadline, or ended with another code than 0."""
    if end.code is None:
        raise NoAnswer(f"killed after {seconds:g} s{_output_tail(end.output)}")
    if end.code == UNSUPPORTED_CODE:
        raise Unsupported(f"the program declined the scene, exit {end.code}{_output_tail(end.output)}")
    if end.code:
        how = "ended with" if end.code > 0 else "was ended by"
        raise NoAnswer(f"the program {how} {exit_name(end.code)}{_output_tail(end.output)}")


def check_window(exr: Exr, scene: Scene) -> None:
    """Raise NoAnswer for an image of other pixels than the film's."""
    film, (x0, y0, x1, y1) = scene.film, scene.film.window
    if exr.data_window not in ((x0, y0, x1, y1), (0, 0, x1 - x0, y1 - y0)):
        raise NoAnswer(
            f"the image shows pixels {exr.data_window}, expected {(x0, y0, x1, y1)} of the film of "
            f"{film.width} x {film.height}"
        )


def answer_from_exr(
    exr: Exr, request: CastRequest, *, precision: str | None = None, as_exported: bool = False
) -> Answer:
    """Answer from an EXR in our channels: depth along the ray from the eye, geometric normal, mask. Raises NoAnswer."""
    n = _normals(exr.channels, (DEPTH,), "the distance from the eye along the ray")
    rays = request.rays
    depth = exr.channels[DEPTH].ravel().astype(np.float64)
    length = np.linalg.norm(rays.d.astype(np.float64), axis=1)
    with np.errstate(invalid="ignore"):
        t = (depth - rays.start) / length
    if MASK in exr.channels:
        covered = _mask(exr.channels[MASK].ravel(), depth, request)
        t, depth = (np.where(covered, values, np.inf) for values in (t, depth))
    # From the eye to where the shared ray starts, and rounded to float32 as it was stored.
    with np.errstate(invalid="ignore"):
        stored = np.where(np.isfinite(depth), U32 * np.abs(depth) / length, 0.0)
    found = checked_answer(t, n, len(t), precision=precision or FLOAT32, as_exported=as_exported)
    return replace(found, t_rounding=stored, own_camera=True, notes=(OWN_CAMERA_NOTE,))


def answer_from_positions(exr: Exr, request: CastRequest, *, precision: str | None = None) -> Answer:
    """The same from the position channels and the mask: t is where they project to on the ray. Raises NoAnswer.

    A position farther beside its ray than rounding allows is no answer: that of the camera, of o + t d or of
    barycentric coordinates, K times each, and of the file.
    """
    n = _normals(exr.channels, (*POSITION, MASK), "the position of what is hit, and what A has to mark as hit")
    precision = precision or FLOAT32
    o, d = request.rays.o.astype(np.float64), request.rays.d.astype(np.float64)
    p = np.stack([exr.channels[name].ravel() for name in POSITION], axis=1).astype(np.float64)
    covered, length = exr.channels[MASK].ravel() != 0, np.linalg.norm(d, axis=1)
    with np.errstate(invalid="ignore", over="ignore"):
        t = np.where(covered, dot(p - o, d) / (length * length), np.inf)
        beside = norm(p - o - t[:, None] * d)
        rounded = PRECISIONS[precision] * (norm(o) + np.abs(t) * length + norm(p)) + U32 * norm(p)
        turn, shift = camera_rounding(request.scene)
        aside = covered & (beside > turn * np.abs(t) * length + shift + rounded)
        stored = np.where(np.isfinite(rounded), rounded / length, 0.0)
    found = checked_answer(t, n, len(t), precision=precision)
    broken = dict(found.broken) | ({BESIDE_RAY: aside} if aside.any() else {})
    return replace(found, t_rounding=stored, own_camera=True, notes=(OWN_CAMERA_NOTE,), broken=broken)


def camera_rounding(scene: Scene) -> tuple[float, float]:
    """What rounding to float32 may do to a camera's rays: a turn of d as a share of it, a shift of o, scene units."""
    turn = KU * reference_of_camera(scene.camera).amplification(scene.camera, scene.film)
    reach = float(np.abs(scene.camera.eye).max()) + getattr(scene.camera, "width", 0.0)
    return turn, turn * reach


@dataclass(frozen=True)
class ExrFile:
    """An EXR file that was rendered beforehand, by the scene's camera."""

    name: str
    exr: Exr
    precision: str | None
    by_position: bool = False  # its position channels, not its depth
    reads_xml: bool = False
    takes_rays: bool = False
    takes_limits: bool = False

    def answer(self, request: CastRequest) -> Answer:
        """Its channels. Raises NoAnswer."""
        check_window(self.exr, request.scene)
        read = answer_from_positions if self.by_position else answer_from_exr
        return replace(read(self.exr, request, precision=self.precision), own_geometry=True)


def _normals(channels: Mapping[str, np.ndarray], needed: Sequence[str], what: str) -> np.ndarray | None:
    """(n, 3) the normals, None if they are not given. needed: channels beside them. Raises NoAnswer."""
    for name in needed:
        if name not in channels:
            has = ", ".join(channels) or "none"
            raise NoAnswer(f"the image has no channel {name}, {what}; it has {has}")
    some = [name for name in NORMAL if name in channels]
    if some and len(some) < len(NORMAL):
        raise NoAnswer(f"the image has {', '.join(some)}, but not all of {', '.join(NORMAL)}")
    for name in (*(name for name in needed if name != MASK), *some):
        if channels[name].dtype != np.float32:
            raise NoAnswer(f"channel {name} holds {channels[name].dtype}, expected float32: half has 11 bits")
    return np.stack([channels[name].ravel() for name in some], axis=1) if some else None


def _mask(mask: np.ndarray, depth: np.ndarray, request: CastRequest) -> np.ndarray:
    """(n,) bool: hit, by the mask. Raises NoAnswer where depth contradicts it; 0 is no depth, and may be a miss's."""
    covered: np.ndarray = mask != 0
    missed = np.isposinf(depth) | (~covered & (depth == 0.0))
    contradicts = (covered == missed) | ~np.isfinite(mask)
    if contradicts.any():
        i = int(np.argmax(contradicts))
        raise NoAnswer(
            f"A and {DEPTH} contradict each other at {int(contradicts.sum())} pixels, first "
            f"{pixel_of(request.scene, i)}: A is {mask[i]:g}, depth {depth[i]:.9g}; a miss has A 0 and depth inf"
        )
    return covered


def _output_tail(words: str) -> str:
    words = printable(words).strip()
    return f"; its last words:\n{words[-LAST_WORDS:]}" if words else "; it printed nothing"


# ---- a command that reads rays and writes hits ----


class ArrayPath(str):
    """The path of a .npy file; {NAME.raw} is that of its numbers alone, beside it."""

    @property
    def raw(self) -> str:
        return str(Path(self).with_suffix(".raw"))


@dataclass(frozen=True)
class RayCommand:
    """A program, run once a scene, without a shell: it reads rays and writes hits (docs/rays-and-hits.md)."""

    name: str
    words: tuple[str, ...]
    fields: frozenset[str]
    precision: str | None
    seconds: float
    reads_xml: bool = False
    takes_rays: bool = True
    takes_limits: bool = True
    any_hit: bool = False

    def answer(self, request: CastRequest) -> Answer:
        """Write rays and scene, run the program, read its hits. Raises NoAnswer."""
        folder, rows = request.folder, ray_rows(request, self.precision)
        names = {"rays": ArrayPath(folder / "rays.npy"), "hits": ArrayPath(folder / "hits.npy")}
        np.save(names["rays"], rows)
        write_bytes(Path(names["rays"].raw), rows.tobytes())
        if "scene" in self.fields:
            names["scene"] = ArrayPath(folder / "scene.toml")
            (folder / "scene.toml").write_text(request.traced.to_toml(), encoding="utf-8")
        if self.fields & {"mesh", "mesh.raw"}:
            names["mesh"] = write_mesh(folder / "mesh.ply", request.model.packed)
        for path in (names["hits"], names["hits"].raw):  # of an earlier request
            Path(path).unlink(missing_ok=True)
        run_program([word.format(**names) for word in self.words], self.seconds)
        return answer_of_rows(self._hits(names["hits"], len(rows)), request, self)

    def _hits(self, path: ArrayPath, count: int) -> dict[str, np.ndarray]:
        try:
            if "hits" in self.fields:
                arrays = read_arrays(path)
                return hit_columns(arrays[""], "{hits}") if "" in arrays else {}
            data = Path(path.raw).read_bytes()
        except (OSError, FileMissing) as error:
            raise NoAnswer(f"the program ended well, but its hits cannot be read: {error}") from error
        return raw_hits(data, count, self.precision, "{hits.raw}")


def ray_rows(request: CastRequest, precision: str | None) -> np.ndarray:
    """(n, 8) the rays that there are, little-endian."""
    rays = request.rays
    t_min = np.broadcast_to(rays.t_min, len(rays.t_max))
    rows = np.column_stack([rays.o, rays.d, t_min, rays.t_max])[rays.t_max >= 0.0]
    return rows.astype("<f8" if precision == FLOAT64 else "<f4")


def raw_hits(data: bytes, count: int, precision: str | None, where: str) -> dict[str, np.ndarray]:
    """Arrays of `count` rows of hits without a header. Raises NoAnswer."""
    size = 8 if precision == FLOAT64 else 4
    columns, left = divmod(len(data), count * size) if count else (1, len(data))
    if left or columns not in HIT_COLUMNS:
        known = ", ".join(f"{count * each * size} for {what}" for each, what in HIT_COLUMNS.items())
        raise NoAnswer(f"{where}: expected bytes of {count} rows: {known}; got {len(data)}")
    return hit_columns(np.frombuffer(data, f"<f{size}").reshape(count, columns), where)


def answer_of_rows(hits: dict[str, np.ndarray], request: CastRequest, of: "RayCommand | ServedCommand") -> Answer:
    """The answer to a request from the hits of its rays; prim is numbered through all triangles. Raises NoAnswer."""
    there = request.rays.t_max >= 0.0
    prim = hits.pop("prim_id", None)
    found = answer_of_hits(hits, int(there.sum()), of)
    if prim is not None and is_given(prim, found.hit):
        packed = request.model.packed
        known = np.where(found.hit & (prim >= 0) & (prim < packed.first[-1]), prim, -1)
        found = replace(found, shape_id=packed.shape_of(known), prim_id=packed.index_in_shape(known))
    found = spread_answer(found, there)
    beyond = "a hit beyond t_max"
    late = found.hit & (found.t > request.rays.t_max.astype(np.float64))
    return replace(found, broken={**found.broken, **({beyond: late} if late.any() else {})})


# ---- a program that stays, and answers over stdin and stdout ----

DECLINED = -1  # in place of the length of a response: the program lacks something that the scene has


@dataclass(frozen=True)
class ServedCommand:
    """A program that is started once: it reads meshes and rays from stdin and writes hits to stdout."""

    name: str
    words: tuple[str, ...]
    precision: str | None
    seconds: float
    reads_xml: bool = False
    takes_rays: bool = True
    takes_limits: bool = True
    any_hit: bool = False
    running: list[ResidentProcess] = field(default_factory=list, compare=False)  # at most one
    turn: Any = field(default_factory=threading.Lock, compare=False)  # scenes are judged several at a time

    def answer(self, request: CastRequest) -> Answer:
        """Send triangles and rays, read hits; a program that has ended is started again. Raises NoAnswer."""
        mesh = Path(write_mesh(request.folder / "mesh.ply", request.model.packed).raw).read_bytes()
        rows = ray_rows(request, self.precision)
        data = b"".join(length_first(each) for each in (mesh, rows.tobytes()))
        with self.turn:
            reply = self._reply(data, len(rows))
        if int.from_bytes(reply[:8], "little", signed=True) == DECLINED:
            raise Unsupported("the program declined the scene")
        return answer_of_rows(raw_hits(reply[8:], len(rows), self.precision, "its response"), request, self)

    def _reply(self, data: bytes, count: int) -> bytes:
        size = 8 if self.precision == FLOAT64 else 4
        lengths = {count * size * columns: what for columns, what in HIT_COLUMNS.items()}

        def length_of(head: bytes) -> int:
            length = int.from_bytes(head, "little", signed=True)
            if length != DECLINED and length not in lengths:
                known = ", ".join(f"{each} for {what}" for each, what in lengths.items())
                raise UnexpectedReply(
                    f"its response starts with the bytes {head!r}, as an int64 {length}; expected the length of "
                    f"{count} rows: {known}; or {DECLINED} to decline the scene. Only responses go to stdout"
                )
            return max(length, 0)

        try:
            if not self.running or not self.running[0].alive:
                self.running[:] = [ResidentProcess(self.words)]
                atexit.register(self.running[0].close)
            return self.running[0].request(data, self.seconds, length_of)
        except OSError as error:
            raise NoAnswer(f"{self.words[0]} could not be started: {error.strerror}") from error
        except UnexpectedReply as error:
            raise NoAnswer(f"the program gave no answer to read: {error}") from error
        except ProcessEnded as ended:
            raise_if_failed(ended.end, self.seconds)
            raise NoAnswer(f"the program ended before its response was whole{_output_tail(ended.end.output)}") from None


def write_mesh(path: Path, packed: Packed) -> ArrayPath:
    """All triangles of a scene as binary PLY, and beside it .raw: v, f as int64, (v, 3) float32, (f, 3) int32.

    Raises NoAnswer for a scene with other primitives.
    """
    if others := {type(part).__name__ for part in packed.parts if not hasattr(part, "faces")}:
        raise Unsupported(f"{{mesh}}: the scene has {', '.join(sorted(others))} beside triangles; read {{scene}}")
    first = np.cumsum([0, *(len(part.vertices) for part in packed.parts)])
    vertices = np.concatenate([part.vertices for part in packed.parts]).astype("<f4")
    numbers = [part.faces + start for part, start in zip(packed.parts, first, strict=False)]
    corners = np.concatenate(numbers).astype("<i4")
    shape = np.repeat(np.arange(len(packed.parts)), [len(part.faces) for part in packed.parts])
    faces = np.zeros(len(corners), [("count", "u1"), ("corners", "<i4", 3), ("shape_id", "<i4")])
    faces["count"], faces["corners"], faces["shape_id"] = 3, corners, shape
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nproperty int shape_id\nend_header\n"
    )
    write_bytes(path, header.encode("ascii") + vertices.tobytes() + faces.tobytes())
    counts = np.array([len(vertices), len(faces)], "<i8")
    write_bytes(path.with_suffix(".raw"), counts.tobytes() + vertices.tobytes() + corners.tobytes())
    return ArrayPath(path)
