"""Reproducers: one pixel as a scene file of its own, exact to the bit; and replay commands."""

import shlex
from collections.abc import Iterable
from dataclasses import replace as with_fields
from pathlib import Path

import numpy as np

from caster.cameras.single_ray import Ray
from caster.description.errors import SceneError
from caster.geometry.packing import Packed, pack
from caster.geometry.world_space import as_float32
from caster.scene.model import Scene
from caster.scene.textures import MeshColors
from caster.system.atomic_files import write_text
from mitsuba_ref.error_model.intersections import Rays
from mitsuba_ref.error_model.lambert import direction_to_light
from mitsuba_ref.judge.checks.knife_edges import scene_of_ray
from mitsuba_ref.judge.classification import CLASS_CODE, Judge, Judgement, judge_of
from mitsuba_ref.judge.explanations import format_defect, reproducer_header
from mitsuba_ref.judge.pipeline import Seen
from mitsuba_ref.judge.verdict import CLASSES, REFERENCE_WRONG, UNLISTED, WRONG, Failure, SceneVerdict
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.shared_input import pixel_of
from mitsuba_ref.report.builtin_scenes import shown_path
from mitsuba_ref.shapes import kind_of, reference_of
from mitsuba_ref.shapes.shape_reference import Fields
from mitsuba_ref.subjects.requests import request_answer
from mitsuba_ref.subjects.subject import OURS, kept_fields, packs_identically


def write_scene(path: Path, scene: Scene, head: Iterable[str]) -> None:
    """Write a scene file. head: comment lines at its beginning, first the purpose of the file. Raises OutputError."""
    comment = "".join(f"# {line}".rstrip() + "\n" for line in head)
    write_text(path, f"{comment}\n{scene.to_toml()}")


def reproducer(judge: Judge, row: int, *, lit: bool = False) -> tuple[Scene, Iterable[str]]:
    """A scene of the ray of one pixel and the primitives that it may hit; notes on what differs from its scene.

    lit: with lights, and primitives that may shadow the hit. Raises SceneError for a pixel without a ray.
    """
    rays, scene = judge.rays.for_reference(), judge.scene
    if rays.t_max[row] < 0.0:
        raise SceneError("there is no ray through this pixel, so there is nothing to reproduce")
    shapes: list[Fields] = []
    materials: Fields = {}
    notes: list[str] = []
    for prim in sorted(involved_prims(judge, row, lit)):
        shape, note = shape_of(judge, prim)
        if material := shape.get("material"):
            materials[material] = scene.materials[material]
        if shape not in shapes:
            shapes.append(shape)
        notes += note
    ray = scene_of_ray(scene, rays.o[row], rays.d[row], float(rays.t_max[row]))
    parts: Fields = {
        "film": ray.film,
        "camera": ray.camera,
        "lights": scene.lights if lit else (),
        "materials": materials,
        "shapes": shapes,
        "shading": scene.shading,
        "checks": scene.checks,
    }
    return Scene(**parts), dict.fromkeys(notes)


def has_other_light(judgement: Judgement, row: int) -> bool:
    """Whether the diffuse value of a pixel is beyond its bound, so that its lights belong to its reproducer."""
    return bool("diffuse" in judgement.ratios and judgement.ratios["diffuse"][row] > 1.0)


def involved_prims(judge: Judge, row: int, lit: bool = False) -> set[int]:
    """Numbers of the primitives that may be hit in float32, are hit exactly, or are named by either side."""
    line = judge.lines.take([row])
    possible = [line._replace(t_min=np.zeros(1))]
    found: set[int] = set()
    for answer in judge.oracle.first_hits(*line):
        found |= set(answer.prims.tolist())
    found |= {int(judge.subject_prim[row]), int(judge.reference_prim[row])}
    if lit and judge.subject_prim[row] >= 0:
        for light in judge.scene.lights:
            if light.type != "ambient":
                point = judge.point[row : row + 1]
                to_light, reach = direction_to_light(light, point)
                possible.append(Rays(point, to_light, np.zeros(1), reach))
    for each in possible:
        found |= set(judge.reference_bracket.possible_hits(each).prim.tolist())
    return found - {-1}


def shape_of(judge: Judge, prim: int) -> tuple[Fields, list[str]]:
    """(description of one primitive that packs to the same numbers, notes on what could not be kept)."""
    packed = judge.model.packed
    i = int(packed.shape_of(np.array([prim]))[0])
    k = int(prim - packed.first[i])
    name = f"{judge.scene.shape_names()[i]}, prim {k}"
    whole = judge.scene.shapes[i]
    material = judge.scene.materials.get(getattr(whole, "material", None) or "")
    try:
        shape = kind_of(packed.parts[i]).describe(packed.parts[i], k)
        kept = packs_identically(packed.parts[i], k, pack_one(shape))
        kept = kept and not isinstance(material and material.texture, MeshColors)  # colours belong to a whole mesh
    except (SceneError, LookupError):
        shape, kept = {}, False
    if not kept:  # as it was described, with all its primitives
        note = f"note: {judge.scene.shape_names()[i]} is here as a whole, as it was described"
        return whole.model_dump(by_alias=True, exclude_none=True), [note]
    note = reference_of(whole).stand_in_note
    return shape | {"name": name, **kept_fields(whole)}, [f"note: {note}"] if note else []


def pack_one(shape: Fields) -> Packed:
    """Pack the description of one shape in float32. Raises SceneError."""
    return pack(Scene(camera=Ray(origin=(0, 0, 0), direction=(0, 0, 1)), shapes=[shape]), as_float32)


# ---- files, for pixels where the subject or the reference is wrong

MAX_REPRODUCERS_PER_CASE = 2  # per scene and case; each is verified with Mitsuba


def write_reproducers(folder: Path, name: str, source: str, seen: Seen, first_ray: int) -> tuple[tuple[str, ...], int]:
    """Write failing rays as scene files: of our caster, or of the answers to a list of rays. Raises OutputError.

    NAME.CASE.X-Y.toml for pixels where ours or the reference is wrong, NAME.knife-edge.K.toml for wrong aimed rays, and
    NAME.wrong.N.toml for rays of a list; some for each case or diagnosis. first_ray: number of the first ray of that
    list. Returns the names of the files, and the number of pixels of the same classes without a file.
    """
    judge, judgement, files = seen.judge, seen.judgement, list[str]()
    is_list = judge.rays.is_list
    if not (judge.names_prims or is_list):
        return (), 0
    groups = {cause.what: cause.rows.tolist() for cause in seen.diagnosis} if is_list else rows_by_case(judgement)
    for label, rows in groups.items():
        for row in [row for row in rows if judge.t_max[row] >= 0.0][:MAX_REPRODUCERS_PER_CASE]:
            x, y = pixel_of(judge.scene, row)
            files.append(f"{name}.wrong.{first_ray + row}.toml" if is_list else f"{name}.{label}.{x}-{y}.toml")
            path = folder / files[-1]
            if is_list:
                place = (
                    f"{name}, ray {first_ray + row} of t_min {float(judge.t_min[row])!r}; below in float32, from t_min"
                )
                alone, notes = reproducer(judge, row)
                write_scene(path, alone, [*reproducer_header(judge, judgement, row, label, place), *notes])
            else:
                write_reproducer(path, judge, judgement, row, f"{source}, pixel ({x}, {y})")
    files = list(dict.fromkeys(files))  # a ray may have two causes
    left_out = len(set().union(*groups.values())) - len(files)
    for number, failure in enumerate(seen.wrong_rays):
        files.append(f"{name}.{failure.label}.{number}.toml")
        head = [f"A ray aimed at {source}, in float64.", f"Wrong:     {failure.what}"]
        write_scene(folder / files[-1], failure.scene, head)
    return tuple(files), left_out


def rows_by_case(judgement: Judgement) -> dict[str, list[int]]:
    """Pixels where the reference or ours is wrong by the label of their files, worst first."""
    found: dict[str, list[int]] = {}
    worst = np.max([judgement.excess(check) for check in judgement.ratios], axis=0)
    rows = np.flatnonzero(judgement.is_class(REFERENCE_WRONG, WRONG))
    for row in rows[np.argsort(-worst[rows], kind="stable")].tolist():
        case = judgement.cases.get(row)
        listed = UNLISTED if case is None else f"case-{case}"
        found.setdefault(listed if judgement.classes[row] == CLASS_CODE[REFERENCE_WRONG] else WRONG, []).append(row)
    return found


def write_reproducer(path: Path, judge: Judge, judgement: Judgement, row: int, source: str) -> bool:
    """Write the reproducer of one pixel; returns whether its primitives alone show the same.

    Raises OutputError, SceneError.
    """
    alone, notes = reproducer(judge, row, lit=has_other_light(judgement, row))
    same, words = reproduces(alone, judge, judgement, row)
    verdict = CLASSES[int(judgement.classes[row])]
    what = f"{verdict}, {format_defect(judgement.cases.get(row))}" if verdict == REFERENCE_WRONG else verdict
    write_scene(path, alone, [*reproducer_header(judge, judgement, row, what, source), words, *notes])
    return same


def reproduces(alone: Scene, judge: Judge, judgement: Judgement, row: int) -> tuple[bool, str]:
    """(whether the scene alone gives the same class and the same answer of Mitsuba, the result as text)."""
    again = judge_of(request_answer(OURS, alone))
    if isinstance(again, Crash):
        return False, f"Checked:   Mitsuba ended without an answer on this file ({again.exit})."
    verdict, before = (CLASSES[int(code)] for code in (again.judge().classes[0], judgement.classes[row]))
    t, t_before = float(again.result.t[0]), float(judge.result.t[row])
    if verdict == before and (t == t_before or (np.isnan(t) and np.isnan(t_before))):
        return True, "Checked:   this file alone gives the same class, and the same t of Mitsuba."
    differs = f"class {verdict}, t of Mitsuba {t!r}"
    return (False, f"Checked:   NOT THE SAME from this file alone, so what else is in the scene matters: {differs}.")


# ---- replay commands, which repeat the options of the run


def with_replay(scene: SceneVerdict) -> SceneVerdict:
    """Add the commands that show the scene and each of its failures again."""

    def shown(failure: Failure) -> Failure:
        return with_fields(failure, replay=replay(scene, failure.pixel or (failure.x, failure.y)))

    return with_fields(scene.with_failures(shown), replay=replay(scene))


def replay(scene: SceneVerdict, pixel: tuple[int, int] | None = None) -> str:
    """The command that shows one pixel, or else the scene, again."""
    if scene.command == "judge":
        ray = scene.ray_at(*pixel) if pixel else None
        return shlex.join(["mitsuba-ref", "judge", *scene.options, *([] if ray is None else ["--row", str(ray)])])
    if pixel is None:
        thorough = " --thorough" if scene.thorough else ""
        return f"mitsuba-ref validate {_path(scene)}{thorough}{_options(scene)}"
    before, after = replay_around(scene)
    return f"{before}{pixel[0]} {pixel[1]}{after}"


def replay_around(scene: SceneVerdict) -> tuple[str, str]:
    """The command that shows a pixel again: its parts before and after the column and row."""
    return f"mitsuba-ref probe {_path(scene)} ", _options(scene)


def _path(scene: SceneVerdict) -> str:
    return shlex.quote(shown_path(scene.path) or "SCENE")


def _options(scene: SceneVerdict) -> str:
    """The options of the run as the end of a command."""
    words = ["--size", *map(str, scene.size)] if scene.resized else []
    words += scene.options
    if scene.candidate and not any(word.startswith("--candidate") for word in scene.options):
        # Given in Python: only its name is known.
        as_typed = ":" in scene.candidate or "{" in scene.candidate
        words += ["--candidate", scene.candidate if as_typed else f"MODULE:{scene.candidate}"]
        words += ["--candidate-precision", scene.precision] if scene.precision else []
    return "".join(f" {shlex.quote(word)}" for word in words)
