"""Validation of one scene: a subject and Mitsuba along the same rays, to its verdict."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from caster.description.errors import SceneError
from caster.geometry.packing import forget_packed
from caster.geometry.world_space import as_given
from caster.rendering.warm_up import compile_for, warm_decisions
from caster.scene.files import load_scene
from caster.scene.model import Scene
from mitsuba_ref.judge import CANDIDATE, check_names
from mitsuba_ref.judge import OURS as OUR_CHECKS
from mitsuba_ref.judge.aggregate import (
    NEVER_GIVEN,
    PixelErrors,
    check_bias,
    class_counts,
    defect_counts,
    error_statistics,
    failing_by_check,
    failure_at,
    failure_hints,
    findings,
    largest_ratios,
    listed_failures,
    merge_windows,
    pixel_errors,
    quantities_not_given,
)
from mitsuba_ref.judge.classification import Judge, judge_of
from mitsuba_ref.judge.diagnosis import diagnose
from mitsuba_ref.judge.independent_checks.knife_edges import AimedFailure, knife_edges
from mitsuba_ref.judge.independent_checks.mesh_files import check_mesh_files
from mitsuba_ref.judge.independent_checks.public_routes import check_routes
from mitsuba_ref.judge.independent_checks.ray_conventions import check_ray_conventions
from mitsuba_ref.judge.independent_checks.scaling import check_scaling
from mitsuba_ref.judge.scene_checks import (
    check_brute_force,
    check_camera,
    check_culling,
    check_geometry,
    check_materials,
    check_placement,
    check_render,
    check_sensor,
)
from mitsuba_ref.judge.verdict import FAILING, SceneCheck, SceneVerdict, Verdict
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT, SendRequest, send_stored
from mitsuba_ref.reference.shared_input import SharedRays
from mitsuba_ref.report.evidence import Evidence, write_images
from mitsuba_ref.report.html_report import write_report
from mitsuba_ref.report.reproducers import (
    StoredReproducers,
    with_replay,
    write_aimed_reproducers,
    write_answer_reproducers,
    write_reproducers,
)
from mitsuba_ref.subjects.function import function_subject
from mitsuba_ref.subjects.requests import parse_candidate, request_answer
from mitsuba_ref.subjects.subject import OURS, NoAnswer, Subject, Unsupported


class Validation(Verdict):
    """A verdict with the images and the evidence it rests on."""

    def write_html(self, path: str | Path) -> Path:
        """A report into a folder, or into one file if `path` ends in .html; returns the file to open.

        Raises OutputError.
        """
        return write_report(path, self.scenes, self.scene_count)


def validate(
    scene: Scene | str | Path,
    *,
    candidate: str | Callable[..., Any] | None = None,
    timeout: float = DEFAULT_TIMEOUT,
    thorough: bool = False,
) -> Validation:
    """Compare our caster with Mitsuba on one scene, given as a Scene or as the path of its file.

    candidate: another ray caster in place of ours: a function(scene, o, d) -> (t, n), or what --candidate takes
    (docs/candidates.md). thorough: also test our caster beyond the judged film, as --thorough does. Raises SceneError
    for a scene that is not valid, FileMissing where there is none, MissingReferenceError for a shape without a
    reference. A crash of Mitsuba is a verdict that does not pass. The verdict keeps both images, for its write_html.
    """
    subject: Subject = OURS
    if candidate is not None:
        subject = parse_candidate(candidate) if isinstance(candidate, str) else function_subject(candidate)
    options: dict[str, Any] = {"subject": subject, "timeout": timeout, "keep": True, "thorough": thorough}
    if isinstance(scene, Scene):
        found = validate_scene(scene, "scene", **options)
    else:
        found = validate_scene(load_scene(scene), Path(scene).stem, str(scene), **options)
    return Validation((with_replay(found),))


def validate_scene(
    scene: Scene,
    name: str,
    path: str = "",
    *,
    subject: Subject = OURS,
    rays: SharedRays | None = None,
    first_ray: int = 0,
    folder: Path | None = None,
    timeout: float = DEFAULT_TIMEOUT,
    send: SendRequest = send_stored,
    keep: bool = False,
    thorough: bool = False,
) -> SceneVerdict:
    """The verdict of one scene that is loaded; what a candidate does wrong is in the verdict.

    rays: of a list, laid out as the film, in place of the camera's, and the number of the first;
    folder: where the images of both sides go; send: the way to Mitsuba; keep: keep what the verdict rests on;
    thorough: make every check of judge/__init__.py.
    """
    start = time.perf_counter()
    options: dict[str, Any] = {
        "subject": subject,
        "folder": folder,
        "timeout": timeout,
        "send": send,
        "thorough": thorough,
    }
    bands = bands_of(scene) if subject.takes_rays and rays is None else [scene]
    check_memory(bands[0])
    if subject is OURS:
        compile_for(scene, "validate", _cast_as_judged)
    if len(bands) == 1:
        verdict, errors = _judge_window(
            scene, name, path, rays=rays, first_ray=first_ray, keep=keep, whole_film=True, **options
        )
        found = [errors] if errors else []
    else:
        verdict, found = _judge_bands(bands, name, path, keep=keep, **options)
    if found and not verdict.problem:
        statistics = error_statistics(found)
        checks = (*verdict.checks, check_bias(statistics))
        verdict = replace(verdict, checks=checks, statistics=statistics)
    return replace(verdict, seconds=time.perf_counter() - start)


def _cast_as_judged(scene: Scene) -> None:
    """Call the kernels by which our caster is judged on a scene."""
    request_answer(OURS, scene)
    check_culling(scene)
    warm_decisions(scene)


# ---- a film in bands ----

# A film of more pixels than this is judged as several, so that memory stays what one band needs; of so many pixels a
# band that what is done once for each (its own scene in Mitsuba, samples of every check) costs less than its pixels.
LARGEST_WHOLE_FILM, BAND_PIXELS = 1 << 20, 1 << 19

LARGE_SCENE = 1 << 20  # primitives; such a scene is packed again sooner than kept beside its float32 numbers


def bands_of(scene: Scene) -> list[Scene]:
    """The scene with windows of whole rows that make up its film; itself alone where that is small."""
    x0, y0, x1, y1 = scene.film.window
    if (x1 - x0) * (y1 - y0) <= LARGEST_WHOLE_FILM:
        return [scene]
    rows = max(1, BAND_PIXELS // (x1 - x0))
    return [scene.with_film(crop=(x0, y, x1, min(y + rows, y1))) for y in range(y0, y1, rows)]


def _judge_bands(
    bands: Sequence[Scene], name: str, path: str, *, keep: bool, **options: Any
) -> tuple[SceneVerdict, list[PixelErrors]]:
    """The verdict of all bands, with the evidence of one: the first of those that fail most, or the middle one."""
    verdicts, errors = [], []
    best, shown, seen = (-1, False, False), 0, None
    for number, band in enumerate(bands):
        _, first, _, end = band.film.window
        middle = number == len(bands) // 2
        images = f"{name}.rows-{first:05}-{end - 1:05}"
        found, of_band = _judge_window(band, name, path, keep=keep, whole_scene=middle, images=images, **options)
        rank = found.failing, not found.checks_pass, middle
        if rank > best:
            best, shown, seen = rank, number, found.seen
        verdicts.append(replace(found, seen=None))
        if found.problem:
            verdicts[-1] = replace(found, problem=f"rows {first} to {end - 1}: {found.problem}")
            break
        errors += [of_band] if of_band else []
    notes = [f"judged in {len(bands)} bands of at most {BAND_PIXELS} pixels"]
    _, first, _, end = bands[shown].film.window
    notes += [] if seen is None else [f"pixels of the report: rows {first} to {end - 1}"]
    merged = merge_windows([verdicts[shown], *verdicts[:shown], *verdicts[shown + 1 :]])
    return replace(merged, seen=seen, notes=(*notes, *merged.notes)), errors


def _judge_window(
    scene: Scene,
    name: str,
    path: str,
    *,
    subject: Subject,
    folder: Path | None,
    timeout: float,
    send: SendRequest,
    thorough: bool,
    rays: SharedRays | None = None,
    first_ray: int = 0,
    keep: bool = False,
    whole_scene: bool = True,
    whole_film: bool = False,
    images: str = "",
) -> tuple[SceneVerdict, PixelErrors | None]:
    """The verdict of the film's window, without statistics and bias, and the errors that those are made of.

    whole_scene: with the checks in which the window has no part; whole_film: no other window follows;
    images: name of EXR files, if not the scene's.
    """
    ours = subject is OURS
    names = check_names(
        OUR_CHECKS if ours else CANDIDATE, thorough=thorough, whole_scene=whole_scene, camera=rays is None
    )
    stored = StoredReproducers((), 0)
    checks, wrong_rays = checks_of_scene(names, scene, path) if ours else ((), ())
    if folder:
        stored = write_aimed_reproducers(folder, name, wrong_rays, path or name)
    if whole_film:  # what follows is in float32; of ten million triangles, both together take a gigabyte more
        forget_packed(scene, as_given, LARGE_SCENE)

    def without_comparison(problem: str, unsupported: bool = False) -> tuple[SceneVerdict, None]:
        x0, y0, x1, y1 = scene.film.window
        verdict = SceneVerdict(
            name,
            path,
            (x1 - x0) * (y1 - y0),
            checks=checks,
            problem=problem,
            unsupported=unsupported,
            size=(scene.film.width, scene.film.height),
            candidate=subject.name,
            thorough=thorough,
            unjudged=() if ours else NEVER_GIVEN,
            reproducers=stored.files,
        )
        return verdict, None

    try:
        response = request_answer(subject, scene, rays=rays)
    except NoAnswer as error:
        return without_comparison(str(error), isinstance(error, Unsupported))
    judge = judge_of(response, timeout=timeout, send=send, with_files=whole_scene)
    if isinstance(judge, Crash):
        return without_comparison(judge.message)
    judgement, pair, answer = judge.judge(), judge.pair, judge.answer
    diagnosis = diagnose(judge, judgement)
    files = (write_images(folder, images or name, judge, judgement),) if folder else ()
    if folder and ours:
        of_pixels = write_reproducers(folder, name, judge, judgement, path or name)
        stored = StoredReproducers((*of_pixels.files, *stored.files), of_pixels.left_out)
    if folder and rays is not None:
        stored = write_answer_reproducers(folder, name, judge, judgement, diagnosis.rows_of, first_ray)
    if not ours:
        checks, _ = checks_of_scene(names, response.scene, path)
        if "ray_conventions" in names and subject.takes_rays and not judgement.is_class(*FAILING).any():
            checks = (check_ray_conventions(subject, response.scene), *checks)
    checks = (*checks, *files)
    if "mesh_files" in names:
        checks = (*checks, check_mesh_files(response.scene, pair.result.answer.meshes))
    if "sensor" in names:
        checks = (*checks, check_sensor(response.scene, pair.result))
    by_check, by_row = failing_by_check(judgement), diagnosis.by_row()
    verdict = SceneVerdict(
        name,
        path,
        len(pair.t),
        hit_pixels=int(pair.any_hit.sum()),
        counts=class_counts(judgement, pair.any_hit),
        ratios=largest_ratios(judgement),
        checks=checks,
        failures=listed_failures(judge, judgement, diagnosis),
        versions=pair.result.answer.versions,
        reference_seconds=pair.result.answer.seconds,
        reference_stored=pair.result.answer.stored,
        size=(scene.film.width, scene.film.height),
        allowed={name: check.ratio for name, check in scene.checks.items()} if ours else {},
        adjudicated=len(judgement.exact.rows),
        not_adjudicated=len(judgement.not_adjudicated),
        exact_seconds=judgement.exact_seconds,
        cases=defect_counts(judgement),
        reproducers=stored.files,
        not_stored=stored.left_out,
        failing_by={check: len(rows) for check, rows in by_check.items()},
        worst_by={check: failure_at(judge, judgement, by_row, int(rows[0]), check) for check, rows in by_check.items()},
        candidate=subject.name,
        thorough=thorough,
        precision="" if ours else answer.precision,
        unjudged=quantities_not_given(answer),
        findings=findings(judge, diagnosis),
        notes=(
            *notes_on_misses(judge),
            *(() if ours else (*answer.notes, *response.limits, *failure_hints(answer, judgement))),
        ),
        seen=Evidence(judge, judgement, diagnosis) if keep else None,
    )
    return verdict, pixel_errors(judge.model.packed, pair, judge.bounds) if ours else None


# Checks that need the scene alone.
MADE_OF_SCENE: dict[str, Callable[[Scene], SceneCheck]] = {
    "placement": check_placement,
    "geometry": check_geometry,
    "materials": check_materials,
    "camera": check_camera,
    "render": check_render,
    "culling": check_culling,
    "brute_force": check_brute_force,
    "scaling": check_scaling,
}


def checks_of_scene(
    names: Sequence[str], scene: Scene, path: str
) -> tuple[tuple[SceneCheck, ...], tuple[AimedFailure, ...]]:
    """The checks among these names that need no answer, in their order; and aimed rays that fail."""
    checks: list[SceneCheck] = []
    wrong_rays: tuple[AimedFailure, ...] = ()
    for name in names:
        if name == "knife_edges":
            check, wrong_rays = knife_edges(scene)
            checks.append(check)
        elif name == "routes":
            checks.append(check_routes(scene, path))
        elif name in MADE_OF_SCENE:
            checks.append(MADE_OF_SCENE[name](scene))
    return tuple(checks), wrong_rays


def notes_on_misses(judge: Judge) -> tuple[str, ...]:
    """Where the shapes are, and how the rays go, where nothing is hit; () where something is."""
    low, high = judge.model.boxes
    if judge.pair.any_hit.any() or not len(low) or not len(judge.o):
        return ()
    middle = len(judge.o) // 2
    box, ray = (low.min(axis=0), high.max(axis=0)), (judge.o[middle], judge.d[middle])
    low_words, high_words, o_words, d_words = (", ".join(f"{v:.4g}" for v in each) for each in (*box, *ray))
    return (
        f"the shapes lie between ({low_words}) and ({high_words}); the ray in the middle starts at ({o_words}) "
        f"along ({d_words})",
    )


# ---- memory that judging a film needs ----

# Growth of the largest resident size of `validate` from 512 x 512 to 1024 x 1024 pixels, by the pixels: rays, answers
# of both sides, bounds and classes, in float64. 1040 bytes (parabolic), 1280 (cornell-box), 1430 (every-shape) and 1440
# (one-sphere) with one or two lights, 2020 with four (lights-and-shadows).
BYTES_PER_PIXEL, BYTES_PER_PIXEL_AND_LIGHT, LIGHTS_WITHIN = 1450, 290, 2
CGROUP_LIMITS = (
    (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory.current")),
    (Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"), Path("/sys/fs/cgroup/memory/memory.usage_in_bytes")),
)


def check_memory(scene: Scene) -> None:
    """Raise SceneError with the numbers for a window that cannot be judged in the memory that is left."""
    x0, y0, x1, y1 = scene.film.window
    bytes_each = BYTES_PER_PIXEL + BYTES_PER_PIXEL_AND_LIGHT * max(0, len(scene.lights) - LIGHTS_WITHIN)
    needed, left = (x1 - x0) * (y1 - y0) * bytes_each, available_bytes()
    if needed > left:
        raise SceneError(
            f"film: {x1 - x0} x {y1 - y0} pixels need some {needed / 1e9:.1f} GB ({bytes_each} bytes each), and "
            f"{left / 1e9:.1f} GB are left: judge a crop or a smaller film, or fewer scenes at a time"
        )


def available_bytes() -> float:
    """The least of free memory, the limit of the control group and that of the process; inf where none is known."""
    return min(_limits(), default=float("inf"))


def _limits() -> Iterator[float]:
    for line in _text(Path("/proc/meminfo")).splitlines():
        if line.startswith("MemAvailable:"):
            yield int(line.split()[1]) * 1024.0
    for limit, used in CGROUP_LIMITS:
        numbers = _text(limit).strip(), _text(used).strip()
        if all(number.isdecimal() for number in numbers):
            yield max(float(numbers[0]) - float(numbers[1]), 0.0)
    import resource  # POSIX alone

    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    pages = _text(Path("/proc/self/statm")).split()
    if soft != resource.RLIM_INFINITY and pages:
        yield max(soft - int(pages[0]) * float(resource.getpagesize()), 0.0)


def _text(path: Path) -> str:
    try:
        return path.read_text()
    except OSError:
        return ""
