"""What a mutant is held against beside the tests: `fuzz` without Mitsuba and `validate`, on small films."""

from pathlib import Path

import pytest

from caster.jit.kernel_cache import COMPILED
from caster.scene.files import load_scene
from mitsuba_ref.fuzz.findings import Tally
from mitsuba_ref.fuzz.fuzz_run import Example, check_example
from mitsuba_ref.hard.random_families import RANDOM as FAMILIES
from mitsuba_ref.judge.pipeline import Task
from mitsuba_ref.report.validation import validate_scene

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")  # NumPy's scalars warn where machine code does not
ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = 2  # of each family and group
GROUPS = 6 if COMPILED else 2
FILM = (9, 7)
SEED = 11
LARGE = ("hills-131072-triangles", "every-shape", "torus-smooth", "teapot", "two-thousand-spheres", "transforms")
SCENES = sorted(
    path for path in (ROOT / "scenes").glob("*.toml") if COMPILED or path.stem not in LARGE
)  # the large ones are slow without the compiler


@pytest.mark.parametrize("group", range(GROUPS))
@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.name)
def test_fuzz_finds_nothing(family, group):
    for number in range(group * EXAMPLES, (group + 1) * EXAMPLES):
        found = check_example(Example(SEED, number, family), Tally())
        assert not found, found[0].what


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_validate_passes(path):
    scene = load_scene(path)
    width, height = FILM
    film = {"width": width, "height": height, **({"crop": (2, 1, 8, 6)} if scene.film.crop else {})}
    verdict = validate_scene(Task(scene.with_film(**film), path.stem, str(path)))
    assert verdict.ok, (verdict.problem, verdict.failing_by, [c for c in verdict.checks if not c.ok])
