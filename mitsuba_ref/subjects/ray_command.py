"""A candidate that is a program of any language: rays in, hits out, as files of plain numbers."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from caster.description.errors import FileMissing
from caster.geometry.packing import Packed
from caster.system.atomic_files import write_bytes
from mitsuba_ref.subjects.answer import FLOAT64, Answer, NoAnswer
from mitsuba_ref.subjects.command import run_program
from mitsuba_ref.subjects.ray_files import (
    HIT_COLUMNS,
    answer_of_hits,
    hit_columns,
    read_arrays,
    spread_answer,
)
from mitsuba_ref.subjects.subject import CastRequest


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
    any_hit: bool = False

    def answer(self, request: CastRequest) -> Answer:
        """Write rays and scene, run the program, read its hits. Raises NoAnswer."""
        folder, rays = request.folder, request.rays
        there = rays.t_max >= 0.0
        rows = np.column_stack([rays.o, rays.d, np.zeros(len(there)), rays.t_max])[there]
        rows = rows.astype("<f8" if self.precision == FLOAT64 else "<f4")
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
        hits = self._hits(names["hits"], len(rows))
        prim = hits.pop("prim_id", None)
        found = answer_of_hits(hits, len(rows), self)
        if prim is not None:  # numbered through all triangles of {mesh}
            packed = request.model.packed
            known = np.where(found.hit & (prim >= 0) & (prim < packed.first[-1]), prim, -1)
            found = replace(found, shape_id=packed.shape_of(known), prim_id=packed.index_in_shape(known))
        found = spread_answer(found, there)
        beyond = "a hit beyond t_max"
        late = found.hit & (found.t > rays.t_max.astype(np.float64))
        return replace(found, broken={**found.broken, **({beyond: late} if late.any() else {})})

    def _hits(self, path: ArrayPath, count: int) -> dict[str, np.ndarray]:
        try:
            if "hits" in self.fields:
                arrays = read_arrays(path)
                return hit_columns(arrays[""], "{hits}") if "" in arrays else {}
            data = Path(path.raw).read_bytes()
        except (OSError, FileMissing) as error:
            raise NoAnswer(f"the program ended well, but its hits cannot be read: {error}") from error
        size = 8 if self.precision == FLOAT64 else 4
        columns, left = divmod(len(data), count * size)
        if left or columns not in HIT_COLUMNS:
            known = ", ".join(f"{count * each * size} for {what}" for each, what in HIT_COLUMNS.items())
            raise NoAnswer(f"{{hits.raw}}: expected bytes of {count} rows: {known}; got {len(data)}")
        return hit_columns(np.frombuffer(data, f"<f{size}").reshape(count, columns), "{hits.raw}")


def write_mesh(path: Path, packed: Packed) -> ArrayPath:
    """All triangles of a scene as binary PLY, and beside it .raw: v, f as int64, (v, 3) float32, (f, 3) int32.

    Raises NoAnswer for a scene with other primitives.
    """
    if others := {type(part).__name__ for part in packed.parts if not hasattr(part, "faces")}:
        raise NoAnswer(
            f"{{mesh}}: the scene has {', '.join(sorted(others))} beside triangles; read {{scene}}"
        )
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
