"""Validation of one scene: judgement by the pipeline, and the files of its verdict."""

import time
from dataclasses import replace
from pathlib import Path
from textwrap import shorten

from caster.description.errors import SceneError
from caster.rendering.warm_up import compile_for, warm_decisions
from caster.scene.model import Scene
from caster.system.processor import available_bytes
from mitsuba_ref.judge.aggregate import JudgedFilm, joined, judged_film
from mitsuba_ref.judge.checks.render import check_render
from mitsuba_ref.judge.pipeline import Seen, Task, judge_film
from mitsuba_ref.judge.verdict import SceneVerdict, Verdict
from mitsuba_ref.report.evidence import write_images
from mitsuba_ref.report.html_report import HtmlReport
from mitsuba_ref.report.reproducers import write_reproducers
from mitsuba_ref.report.verdict_text import failing_scenes, failure_text, outcome_text, short_text
from mitsuba_ref.subjects.bounce_films import bounce_films
from mitsuba_ref.subjects.requests import request_answer
from mitsuba_ref.subjects.subject import OURS

PYTEST_CHARACTERS, WHOLE = 240, " ...; print() shows all"  # to which pytest cuts the repr of a message


class Validation(Verdict):
    """A verdict with the images and the evidence it rests on."""

    def write_html(self, path: str | Path) -> Path:
        """Write a report into a folder; returns the file to open. Raises OutputError."""
        report = HtmlReport(path, self.scene_count)
        for verdict in self.scenes:
            report.add(report.keep(verdict))
        report.write()
        return report.index

    def __str__(self) -> str:
        """The outcome; of a run that fails, the cause and one pixel in some ten lines."""
        return short_text(self)

    def __repr__(self) -> str:
        """One line of at most PYTEST_CHARACTERS: `assert verdict.ok, str(verdict)` is whole."""
        first = [failure_text(scene).partition("\n")[0] for scene in failing_scenes(self.scenes)[:1]]
        text = "; ".join([f"Validation: {outcome_text(self)}", *first])
        return f"<{shorten(text, PYTEST_CHARACTERS - 2, placeholder=WHOLE)}>"


def validate_scene(
    task: Task,
    *,
    first_ray: int = 0,
    folder: Path | None = None,
    keep: bool = False,
    film: bool = False,
    bounce: int = 0,
) -> SceneVerdict:
    """The verdict of a loaded scene; faults of a candidate are in the verdict.

    first_ray: the number of the first ray of a list. folder: for the images of both sides. keep: keep the evidence in
    the verdict. film: keep the classes and images of the whole film.
    bounce: judge the secondary rays of this bounce, in place of the camera's.
    """
    start = time.perf_counter()
    scene, name, path = task[:3]
    if bounce:
        secondary = next((film for film in bounce_films(scene, bounce) if film.bounce.number == bounce), None)
        if secondary is None:
            return SceneVerdict(name, path, bounce=bounce, candidate=task.subject.name, notes=("no rays are left",))
        task = task._replace(scene=secondary.scene, rays=secondary.rays, bounce=secondary)
    check_memory(task.windows()[0])
    if task.ours:
        compile_for(scene, "validate", _cast_as_judged)

    def finish(verdict: SceneVerdict, images: str) -> SceneVerdict:
        seen = verdict.seen
        if film and isinstance(seen, Seen):
            bands.append(judged_film(seen.judge, seen.judgement))
        if folder is None or not isinstance(seen, Seen):
            return verdict
        files.extend(write_images(folder, images, seen.judge, seen.judgement))
        reproducers, left_out = write_reproducers(folder, name, path or name, seen, first_ray)
        files.extend(reproducers)
        return replace(verdict, reproducers=reproducers, not_stored=left_out)

    bands, files = list[JudgedFilm](), list[str]()
    verdict = judge_film(task, finish)
    if film_of_bounce := task.bounce:
        verdict = verdict.with_failures(lambda each: replace(each, pixel=film_of_bounce.pixel(each.x, each.y)))
    whole = joined(bands) if bands and not verdict.problem else None
    seen, seconds = verdict.seen if keep else None, time.perf_counter() - start
    return replace(verdict, film=whole, files=tuple(files), seen=seen, seconds=seconds)


def _cast_as_judged(scene: Scene) -> None:
    """Call all kernels that judging our caster on a scene needs."""
    request_answer(OURS, scene)
    check_render(scene)
    warm_decisions(scene)


# ---- memory that judging a film needs ----

# Growth of the largest resident size of `validate` from 512 x 512 to 1024 x 1024 pixels, by the pixels: rays, answers
# of both sides, bounds and classes, in float64. 1280 bytes (cornell-box), 1430 (every-shape) and 1440
# (one-sphere) with one or two lights, 2020 with four (lights-and-shadows).
BYTES_PER_PIXEL, BYTES_PER_PIXEL_AND_LIGHT, LIGHTS_WITHIN = 1450, 290, 2


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
