"""Make the pictures of docs/report.md and docs/candidates.md: python docs/report/screenshots.py [INDEX.html NAME PLACE]

For report.md all scenes are judged, one with a fault that is planted; for candidates.md the textbook caster inside a
sphere. INDEX.html NAME PLACE: one picture of a report, such as quick-start '#s=scan-size-1e-3&x=21&y=2&v=class'.
"""

import shutil
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import Browser, sync_playwright

from caster import load_scene
from caster.rendering.hits import RayHits
from mitsuba_ref.__main__ import main
from mitsuba_ref.judge.pipeline import Task
from mitsuba_ref.reference.messages import TraceRequest, TraceResponse
from mitsuba_ref.reference.mitsuba_process import send_stored
from mitsuba_ref.reference.shared_input import pixel_of
from mitsuba_ref.report.reproducers import with_replay
from mitsuba_ref.report.validation import Validation, validate_scene
from mitsuba_ref.subjects import subject
from mitsuba_ref.subjects.subject import cast_ours

HERE = Path(__file__).parent
SCENES = HERE.parents[1] / "scenes"
BIASED = "biased-reference"  # one-sphere, with t of the reference too large by a last place at three of ten pixels
FAULTY, PIXEL = "every-shape", (192, 174)  # there, t of the primitive at this pixel is off by 2^-20 of itself
ONE_FILE_LIMIT_BYTES = 300_000  # of a picture
WIDE, NARROW = {"width": 1440, "height": 900}, {"width": 390, "height": 844}

Shot = tuple[str, str, dict[str, int], str, str]
# Name, place in the report, screen, theme and keys.
SHOTS = (
    ("index", "", WIDE, "light", ""),
    ("scene", f"#s={FAULTY}&x=192&y=174&a=normal", {"width": 1240, "height": 775}, "light", ""),
    ("pixel", f"#s={FAULTY}&x=192&y=174&a=depth&v=class&z=24&cx=194&cy=174", WIDE, "dark", ""),
    ("wipe", "#s=cornell-box&a=diffuse&v=wipe&x=96&y=120", WIDE, "dark", ""),
    ("narrow", f"#s={FAULTY}&x=192&y=174&a=normal", NARROW, "light", ""),
)
OF_BIAS = (("bias", f"#s={BIASED}", {"width": 1240, "height": 775}, "light", "n"),)
CANDIDATE, INSIDE = "docs.candidates.textbook:trace", "inside-sphere"
OF_CANDIDATE = (
    ("../candidates/report", f"#s={INSIDE}&x=60&y=128&a=depth", {"width": 1240, "height": 800}, "dark", ""),
)


def shoot_all() -> None:
    folder = Path(tempfile.mkdtemp())
    shoot(report_of_bias(folder / "bias"), OF_BIAS)
    shoot(report_of(folder / "candidate", f"scenes/{INSIDE}.toml", "--candidate", CANDIDATE), OF_CANDIDATE)
    subject.cast_ours = faulty_view
    shoot(report_of(folder / "scenes", "scenes"), SHOTS)


def report_of(folder: Path, *words: str) -> Path:
    """The report of a command, which is run from the top of the tree. Its head shows the words without the folder."""
    sys.argv = ["mitsuba-ref", "validate", *words, "--html", "report"]
    main(["validate", *words, "--no-store", "--html", str(folder)])
    return folder / "index.html"


def report_of_bias(folder: Path) -> Path:
    path = "scenes/one-sphere.toml"
    verdict = validate_scene(Task(load_scene(path), BIASED, path, send=biased_answer), keep=True)
    return Validation((with_replay(verdict),)).write_html(folder)


def biased_answer(request: TraceRequest, timeout: float) -> TraceResponse:
    answer = send_stored(request, timeout)
    some = np.random.default_rng(0).random(answer.t.shape) < 0.3
    answer.t[some] = np.nextafter(answer.t[some], np.float32(np.inf))
    return answer


def faulty_view(scene: object, rays: object) -> RayHits:
    view = cast_ours(scene, rays)
    if (scene.film.width, scene.film.height, len(scene.shapes)) != FAULTY_SCENE:
        return view
    row = next(i for i in range(len(view.hit)) if pixel_of(scene, i) == PIXEL)
    t = np.where(view.nearest.prim == view.nearest.prim[row], view.nearest.t * (1.0 + 2.0**-20), view.nearest.t)
    return replace(view, nearest=view.nearest._replace(t=t))


_faulty = load_scene(SCENES / f"{FAULTY}.toml")
FAULTY_SCENE = (_faulty.film.width, _faulty.film.height, len(_faulty.shapes))


def shoot(index: Path, shots: Sequence[Shot]) -> None:
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        for shot in shots:
            picture(browser, index, *shot)
        browser.close()


def picture(browser: Browser, index: Path, name: str, place: str, size: dict[str, int], theme: str, keys: str) -> None:
    page = browser.new_page(viewport=size, color_scheme=theme)
    page.goto(f"{index.resolve().as_uri()}{place}")
    page.wait_for_selector(".pane canvas" if place else ".row")
    page.wait_for_timeout(1000)
    for key in keys:
        page.keyboard.press(key)
    page.wait_for_timeout(500)
    path = HERE / f"{name}.png"
    page.screenshot(path=path)
    Image.open(path).convert("RGB").quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)
    assert path.stat().st_size <= ONE_FILE_LIMIT_BYTES, f"{path}: {path.stat().st_size} bytes"
    page.close()


if __name__ == "__main__":
    if len(sys.argv) > 1:
        index, name, place = sys.argv[1:]
        shoot(Path(index), [(name, place, WIDE, "light", "")])
    else:
        shoot_all()
