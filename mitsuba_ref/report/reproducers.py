"""Reproducers: one pixel as a scene file of its own, exact to the bit; and replay commands."""

import re
import shlex
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import replace as with_fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from caster.cameras.single_ray import Ray
from caster.description.errors import SceneError
from caster.geometry.packing import Packed, pack
from caster.geometry.world_space import as_float32
from caster.scene.export import SECTION_ORDER, format_toml
from caster.scene.model import Film, Scene
from caster.system.atomic_files import write_text
from mitsuba_ref.error_model.lambert import direction_to_light
from mitsuba_ref.judge.checks.knife_edges import AimedFailure
from mitsuba_ref.judge.classification import CLASS_CODE, EXACT, Judge, Judgement, scene_judge
from mitsuba_ref.judge.explanations import format_primitive, pixel_answers, reproducer_header
from mitsuba_ref.judge.pipeline import Seen
from mitsuba_ref.judge.verdict import CLASSES, REFERENCE_WRONG, UNLISTED, WRONG, Failure, SceneVerdict
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.shared_input import pixel_of
from mitsuba_ref.report.builtin_scenes import shown_path
from mitsuba_ref.shapes import kind_of, reference_of
from mitsuba_ref.subjects.subject import packs_identically

TRAILING_ZEROS = re.compile(r"\.?0+(?=p)")  # of a hex float's digits behind the point, which there always is


class Reproducer(NamedTuple):
    """A scene of one pixel, and notes on what differs from the original scene."""

    scene: Scene
    prims: tuple[int, ...]  # numbers of its primitives in the scene it was taken from
    notes: tuple[str, ...]

    def text(self, head: Sequence[str]) -> str:
        """The scene file. head: comment lines at its beginning, first the purpose of the file."""
        lines = [*head, *(f"note: {note}" for note in self.notes)]
        comment = "".join(f"# {line}".rstrip() + "\n" for line in lines)
        return comment + "\n" + format_toml(with_hex_floats(tomllib.loads(self.scene.to_toml())), SECTION_ORDER)


def with_hex_floats(value: Any) -> Any:
    """Replace floats by hex floats in nested lists and dictionaries."""
    if isinstance(value, dict):
        return {key: with_hex_floats(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [with_hex_floats(each) for each in value]
    return TRAILING_ZEROS.sub("", value.hex()) if isinstance(value, float) else value


def reproducer(judge: Judge, row: int, *, lit: bool = False) -> Reproducer:
    """A scene of the ray of one pixel and the primitives that it may hit.

    lit: with lights, and primitives that may shadow the hit. Raises SceneError for a pixel without a ray.
    """
    rays, scene = judge.pair.rays.for_reference(), judge.scene
    if rays.t_max[row] < 0.0:
        raise SceneError("there is no ray through this pixel, so there is nothing to reproduce")
    t_max = float(rays.t_max[row])
    camera = Ray(origin=rays.o[row], direction=rays.d[row], t_max=t_max if np.isfinite(t_max) and t_max > 0.0 else None)
    prims = tuple(sorted(involved_prims(judge, row, lit)))
    shapes: list[dict[str, Any]] = []
    notes: list[str] = []
    for prim in prims:
        shape, note = shape_of(judge, prim)
        if shape not in shapes:
            shapes.append(shape)
        notes += note
    used = {shape["material"] for shape in shapes if shape.get("material")}
    parts: dict[str, Any] = {
        "film": Film(width=1, height=1),
        "camera": camera,
        "lights": scene.lights if lit else (),
        "materials": {name: scene.materials[name] for name in scene.materials if name in used},
        "shapes": shapes,
        "shading": scene.shading,
        "checks": scene.checks,
    }
    return Reproducer(Scene(**parts), prims, tuple(dict.fromkeys(notes)))


def involved_prims(judge: Judge, row: int, lit: bool = False) -> set[int]:
    """Numbers of the primitives that may be hit in float32, are hit exactly, or are named by either side."""
    o, d, t_max = judge.o[row : row + 1], judge.d[row : row + 1], judge.t_max[row : row + 1]
    found = set(judge.reference_bracket.possible_hits(o, d, t_max).prim.tolist())
    for answer in judge.oracle.first_hits(o, d, judge.t_min[row : row + 1], t_max):
        found |= {hit.prim for hit in answer.ties}
    found |= {int(judge.pair.prim[row]), int(judge.reference_prim[row])}
    if lit and judge.pair.prim[row] >= 0:
        for light in judge.scene.lights:
            if light.type != "ambient":
                to_light, reach = direction_to_light(light, judge.point[row : row + 1])
                found |= set(
                    judge.reference_bracket.possible_hits(judge.point[row : row + 1], to_light, reach).prim.tolist()
                )
    return found - {-1}


def shape_of(judge: Judge, prim: int) -> tuple[dict[str, Any], list[str]]:
    """(description of one primitive that packs to the same numbers, notes on what could not be kept)."""
    packed = judge.model.packed
    i = int(packed.shape_of(np.array([prim]))[0])
    k = int(prim - packed.first[i])
    name = f"{judge.scene.shape_names()[i]}, prim {k}"
    whole = judge.scene.shapes[i]
    try:
        shape = kind_of(packed.parts[i]).describe(packed.parts[i], k)
        kept = packs_identically(packed.parts[i], k, pack_one(shape))
    except (SceneError, LookupError):
        shape, kept = {}, False
    if not kept:  # as it was described, with all its primitives
        note = f"{judge.scene.shape_names()[i]} is here as a whole, as it was described"
        return whole.model_dump(by_alias=True, exclude_none=True), [note]
    notes = []
    if note := reference_of(whole).stand_in_note:
        notes.append(note)
    return shape | {"name": name, "material": whole.material}, notes


def pack_one(shape: dict[str, Any]) -> Packed:
    """Pack the description of one shape in float32. Raises SceneError."""
    return pack(Scene(camera=Ray(origin=(0, 0, 0), direction=(0, 0, 1)), shapes=[shape]), as_float32)


# ---- files, for pixels where the subject or the reference is wrong

MAX_REPRODUCERS_PER_CASE = 2  # per scene and case; each is verified with Mitsuba


class StoredReproducers(NamedTuple):
    """The reproducers that were written for a scene."""

    files: tuple[str, ...]
    left_out: int  # pixels of the same classes without a file


def write_reproducers(folder: Path, name: str, source: str, seen: Seen, first_ray: int = 0) -> StoredReproducers:
    """Write failing rays as scene files: of our caster, or of the answers to a list of rays. Raises OutputError.

    first_ray: number of the first ray of that list.
    """
    if seen.judge.pair.rays.is_list:
        return _write_list_reproducers(folder, name, seen, first_ray)
    if not seen.judge.names_prims:
        return StoredReproducers((), 0)
    pixels = _write_pixel_reproducers(folder, name, source, seen)
    return StoredReproducers((*pixels.files, *_write_aimed(folder, name, source, seen.wrong_rays)), pixels.left_out)


def _write_pixel_reproducers(folder: Path, name: str, source: str, seen: Seen) -> StoredReproducers:
    """Write NAME.CASE.X-Y.toml for pixels where ours or the reference is wrong, some for each case."""
    judge, judgement = seen.judge, seen.judgement
    files: list[str] = []
    left_out = 0
    for label, rows in _rows_by_label(judgement).items():
        left_out += len(rows[MAX_REPRODUCERS_PER_CASE:])
        for row in rows[:MAX_REPRODUCERS_PER_CASE]:
            x, y = pixel_of(judge.scene, row)
            path = folder / f"{name}.{label}.{x}-{y}.toml"
            write_reproducer(path, judge, judgement, row, f"{source}, pixel ({x}, {y})")
            files.append(path.name)
    return StoredReproducers(tuple(files), left_out)


def _write_aimed(folder: Path, name: str, source: str, failures: Sequence[AimedFailure]) -> Iterator[str]:
    """Write NAME.knife-edge.K.toml for wrong aimed rays, on which `validate` fails again; their names."""
    for number, failure in enumerate(failures):
        path = folder / f"{name}.knife-edge.{number}.toml"
        head = [f"A ray aimed at {source}, in float64.", f"Wrong:     {failure.what}"]
        write_text(path, Reproducer(failure.scene, (), ()).text(head))
        yield path.name


def write_reproducer(
    path: Path, judge: Judge, judgement: Judgement, row: int, source: str, more: Sequence[str] = ()
) -> bool:
    """Write the reproducer of one pixel; returns whether its primitives alone show the same. more: comment lines.

    Raises OutputError, SceneError.
    """
    found = reproducer(judge, row, lit=bool(judgement.ratio("diffuse")[row] > 1.0))
    same, words = reproduces(found, judge, judgement, row)
    write_text(path, found.text([*reproducer_header(judge, judgement, row, source), words, *more]))
    return same


def reproduces(found: Reproducer, judge: Judge, judgement: Judgement, row: int) -> tuple[bool, str]:
    """(whether the scene alone gives the same class and the same answer of Mitsuba, the result as text)."""
    again = scene_judge(found.scene)
    if isinstance(again, Crash):
        return False, f"Checked:   Mitsuba ended without an answer on this file ({again.exit})."
    verdict, before = (CLASSES[int(code)] for code in (again.judge().classes[0], judgement.classes[row]))
    t, t_before = float(again.pair.result.t[0]), float(judge.pair.result.t[row])
    if verdict == before and (t == t_before or (np.isnan(t) and np.isnan(t_before))):
        return True, "Checked:   this file alone gives the same class, and the same t of Mitsuba."
    differs = f"class {verdict}, Mitsuba: {format_primitive(again, 0, subject=False)}"
    return (False, f"Checked:   NOT THE SAME from this file alone, so what else is in the scene matters: {differs}.")


def _rows_by_label(judgement: Judgement) -> dict[str, list[int]]:
    """Pixels by the label of their files, worst first."""
    rows: dict[str, list[int]] = {}
    for row in _worst_first(judgement, REFERENCE_WRONG):
        case = judgement.cases.get(row)
        rows.setdefault(UNLISTED if case is None else f"case-{case}", []).append(row)
    for row in _worst_first(judgement, WRONG):
        rows.setdefault(WRONG.replace("_", "-"), []).append(row)
    return rows


def _worst_first(judgement: Judgement, name: str) -> Iterator[int]:
    rows = np.flatnonzero(judgement.classes == CLASS_CODE[name])
    worst = np.max([judgement.excess(check)[rows] for check in judgement.names], axis=0)
    yield from rows[np.argsort(-worst, kind="stable")].tolist()


def _write_list_reproducers(folder: Path, name: str, seen: Seen, first: int) -> StoredReproducers:
    """Write NAME.wrong.N.toml for the first rays of each diagnosis; the given answers are comments there."""
    judge, judgement, rows_of = seen.judge, seen.judgement, seen.diagnosis.rows_of
    files: list[str] = []
    for what, all_rows in rows_of.items():
        rows = [row for row in all_rows.tolist() if judge.t_max[row] >= 0.0][:MAX_REPRODUCERS_PER_CASE]
        for row in rows:
            found = reproducer(judge, row)
            text = pixel_answers(judge, judgement, row, EXACT)
            head = [
                f"One ray that {judge.pair.answer.precision} answers were judged on: {what}.",
                "",
                f"from:      {name}, ray {first + row} of t_min {float(judge.t_min[row])!r}",
                f"answer:    {text.subject}",
                f"Mitsuba:   {text.reference}",
                f"exact:     {text.exact}",
                "The ray below is Mitsuba's: in float32, from t_min on.",
            ]
            path = folder / f"{name}.wrong.{first + row}.toml"
            write_text(path, found.text(head))
            files.append(path.name)
    return StoredReproducers(tuple(files), sum(map(len, rows_of.values())) - len(files))


# ---- replay commands, which repeat the options of the run


def with_replay(scene: SceneVerdict) -> SceneVerdict:
    """Add the commands that show the scene and each of its failures again."""

    def shown(failure: Failure) -> Failure:
        return with_fields(failure, replay=replay(scene, (failure.x, failure.y)))

    return with_fields(
        scene,
        failures=tuple(map(shown, scene.failures)),
        worst_by={check: shown(failure) for check, failure in scene.worst_by.items()},
        replay=replay(scene),
    )


def replay(scene: SceneVerdict, pixel: tuple[int, int] | None = None) -> str:
    """The command that shows one pixel, or else the scene, again."""
    if scene.command == "judge":
        ray = scene.ray_at(*pixel) if pixel else None
        rows = "" if ray is None else f" --rows {ray}"
        return "mitsuba-ref judge" + "".join(f" {shlex.quote(word)}" for word in scene.options) + rows
    if pixel is None:
        thorough = " --thorough" if scene.thorough else ""
        return f"mitsuba-ref validate {_path(scene)}{thorough}{repeated_options(scene)}"
    before, after = replay_around(scene)
    return f"{before}{pixel[0]} {pixel[1]}{after}"


def replay_around(scene: SceneVerdict) -> tuple[str, str]:
    """The command that shows a pixel again: its parts before and after the column and row."""
    return f"mitsuba-ref probe {_path(scene)} ", repeated_options(scene)


def _path(scene: SceneVerdict) -> str:
    return shlex.quote(shown_path(scene.path) or "SCENE")


def repeated_options(scene: SceneVerdict) -> str:
    """The options of the run as the end of a command."""
    size = ["--size", *map(str, scene.size)] if scene.resized else []
    return "".join(f" {shlex.quote(word)}" for word in (*size, *scene.options, *_named_candidate(scene)))


def _named_candidate(scene: SceneVerdict) -> Iterator[str]:
    """Options for a candidate that was given in Python, of which only the name is known."""
    if not scene.candidate or any(word.startswith("--candidate") for word in scene.options):
        return
    as_typed = ":" in scene.candidate or "{" in scene.candidate
    yield from ("--candidate", scene.candidate if as_typed else f"MODULE:{scene.candidate}")
    if scene.precision:
        yield from ("--candidate-precision", scene.precision)
