"""Everything that a scene file can say is in a shipped scene or drawn by the fuzzer, so that a judge looks at it."""

import functools
from pathlib import Path
from typing import Literal

import pytest
from pydantic import Field
from scene_options import aspects, demanded, demanded_aspects, exercised

from caster.cameras import Pinhole
from caster.description.fields import Description
from caster.scene.files import load_scene
from caster.scene.model import Scene
from mitsuba_ref.fuzz.campaign import example
from mitsuba_ref.hard import FAMILIES
from mitsuba_ref.hard.family import scene_of

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
    scenes = (scene_of(example(0, number, [family]).data) for family in families for number in range(EXAMPLES))
    return {option for scene in scenes for option in options_of(scene)}.union(*(each for _, each in of_family()))


@functools.cache
def of_family():
    """What `options` draws, with the options of each."""
    (family,) = (each for each in FAMILIES if each.name == "options")
    scenes = [scene_of(example(0, number, [family]).data) for number in range(EXAMPLES_OF_OPTIONS)]
    return [(scene, options_of(scene)) for scene in scenes]


@functools.cache
def of_folder():
    """Shipped scenes, with the options of each."""
    scenes = [load_scene(path) for path in sorted(Path("scenes").glob("*.toml"))]
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


class Wider(Pinhole):
    """A pinhole with options that no scene has."""

    fov_axis: Literal["x", "y", "diagonal", "smaller", "larger", "widest"] = "x"
    mirrored: bool = False


class Holder(Description):
    camera: Wider
    several: tuple[Wider, ...] = Field(default=(), alias="more")
    shutter: float | None = None
    gain: float = 1.0


@pytest.mark.parametrize(
    "option",
    [
        "Wider 'pinhole'.fov_axis: 'widest'",
        "Wider 'pinhole'.mirrored: True",
        "Holder.several: two or more",
        "Holder.shutter: given",
        "Holder.gain: another than the default",
    ],
)
def test_a_new_option_is_demanded_by_its_name(option):
    """Of one that uses none of them, each is missing; of one that uses it, it is not."""
    view = {"eye": (0.0, 0.0, 5.0), "direction": (0.0, 0.0, -1.0)}
    plain, wide = Wider(**view), Wider(**view, fov_axis="widest", mirrored=True)
    assert option in missing(demanded(Holder), exercised(Holder(camera=plain)))
    rich = Holder(camera=wide, more=(plain, wide), shutter=0.5, gain=2.0)
    assert option not in missing(demanded(Holder), exercised(rich))
