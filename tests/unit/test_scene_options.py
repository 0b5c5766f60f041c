"""Every option of scene files is used by a shipped scene or drawn by the fuzzer, so that it is judged."""

import functools

import pytest
from places import SHIPPED
from scene_options import aspects, demanded, demanded_aspects, exercised

from caster.scene.files import load_scene
from caster.scene.model import Scene
from mitsuba_ref.fuzz.fuzz_run import Example
from mitsuba_ref.hard import FAMILIES

# Examples of each family, from the first of seed 0 on. Of `options` as many as `mitsuba-ref fuzz` checks within some
# minutes; the rarest (two conditions at once) are met by one in a hundred.
EXAMPLES, EXAMPLES_OF_OPTIONS = 8, 400

# What no judge can look at, and why.
NOT_EXERCISED = {"Scene.shapes: none": "no ray hits, and a comparison without hits does not pass"}


def options_of(scene):
    return {*exercised(scene), *aspects(scene)}


@pytest.fixture(scope="module")
def shipped():
    return set().union(*(options for _, options in of_folder()))


@pytest.fixture(scope="module")
def drawn():
    families = [family for family in FAMILIES if family.name != "options"]
    scenes = (Example(0, number, family).made.scene() for family in families for number in range(EXAMPLES))
    return {option for scene in scenes for option in options_of(scene)}.union(*(each for _, each in of_family()))


@functools.cache
def of_family():
    """What `options` draws, with the options of each."""
    (family,) = (each for each in FAMILIES if each.name == "options")
    scenes = [Example(0, number, family).made.scene() for number in range(EXAMPLES_OF_OPTIONS)]
    return [(scene, options_of(scene)) for scene in scenes]


@functools.cache
def of_folder():
    """Shipped scenes, with the options of each."""
    scenes = [load_scene(path) for path in SHIPPED]
    return [(scene, options_of(scene)) for scene in scenes]


def missing(wanted, found):
    return sorted(set(wanted) - set(found))


def test_every_option_is_exercised_by_a_scene_or_by_fuzz(shipped, drawn):
    wanted = {*demanded(Scene), *demanded_aspects(Scene)}
    assert len(wanted) > 400
    assert missing(wanted, shipped | drawn) == sorted(NOT_EXERCISED), "no scene and no fuzz family has this"


def test_every_enumerated_value_is_drawn_by_fuzz(drawn):
    """Those of enumerations, kinds and bools: shipped scenes may change."""
    enumerated = [each for each in demanded(Scene) if each.endswith("'") or each.endswith(("True", "False"))]
    assert enumerated and not missing(enumerated, drawn)
