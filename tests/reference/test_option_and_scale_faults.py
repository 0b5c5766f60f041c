"""Faults of options that no shipped scene has, and thresholds in scene units, where ratios of lengths alone may decide.

Each is planted in a copy of both packages, and has to be found by `validate` of a scene or by `fuzz`. All of them by
`make faults` (FAULTS=all); without it only those in QUICK.
"""

import os
import re
from typing import NamedTuple

import pytest
from edited_tree import ROOT, copy_tree, edit, run

PINHOLE, TILES = "caster/cameras/pinhole.py", "caster/rendering/shading.py"
LIGHTING, WORLD = "caster/kernels/surface/lighting.py", "caster/geometry/world_space.py"
SPHERE, MODEL = "caster/shapes/sphere.py", "caster/scene/model.py"
SUN = "(0.0 - x, 0.0 - y, 0.0 - z), self.irradiance)"
SHINING = '        for light in (each.pack() for each in scene.lights if each.type != "ambient"):\n'
SIZE = ("--size", "20", "16")
JUDGED, UNJUDGED = ("--judge-every", "1"), ("--judge-every", "0")


class Fault(NamedTuple):
    """An edit of a copy, the scene or the examples of fuzz that find it, and a pattern of what is said then."""

    family: str
    what: str
    found_by: str  # the name of a shipped scene, for `validate`, or a family of fuzz and its examples A..B
    message: str
    file: str
    old: str
    new: str


OPTION_FAULTS = (
    ("fov_axis larger of a portrait film is x", "options 41..41", "judged", PINHOLE, 'else "larger")', 'else "none")'),
    ("second ambient light", "options 9..10", "judged", TILES, '== "ambient"]).reshape', '== "ambient"][:1]).reshape'),
    (
        "principal point where primitives are projected",
        "options 9..9",
        "culling",
        PINHOLE,
        "y = (0.5 - camera.shift[1]) * camera.size[1]",
        "y = (0.5 + camera.shift[1]) * camera.size[1]",
    ),
    (
        "channels of a directional light exchanged",
        "options 3..3",
        "judged",
        MODEL,
        SUN,
        "(0.0 - x, 0.0 - y, 0.0 - z), self.irradiance[::-1])",
    ),
    (
        "blue of a directional light halved",
        "lights-and-shadows",
        "diffuse: ",
        MODEL,
        SUN,
        "(0.0 - x, 0.0 - y, 0.0 - z), (*self.irradiance[:2], 0.5 * self.irradiance[2]))",
    ),
    (
        "the second light of a kind dropped",
        "options 3..3",
        "judged",
        TILES,
        SHINING,
        "        for light in (each.pack() for i, each in enumerate(scene.lights)\n"
        '            if each.type not in ("ambient", *(one.type for one in scene.lights[:i]))):\n',
    ),
    (
        "a point light as blue as it is red",
        "options 6..6",
        "judged",
        MODEL,
        "PointLight(self.position, self.intensity)",
        "PointLight(self.position, (*self.intensity[:2], self.intensity[0]))",
    ),
    (
        "two_sided of the first material for all",
        "two-sided",
        "diffuse: ",
        TILES,
        "[material.two_sided for material in materials]",
        "[materials[0].two_sided for material in materials]",
    ),
    (
        "far plane of orthographic cameras ignored",
        "orthographic-clip",
        "camera: ",
        "caster/cameras/orthographic.py",
        "far = math.inf if self.far is None else self.far",
        "far = math.inf",
    ),
)
CROP_FAULTS = tuple(
    (what, "crop-window", "camera: ", MODEL, old, new)
    for what, old, new in (
        (
            "a scaled crop loses its last column",
            "-(-self.crop[2] * width // self.width),",
            "self.crop[2] * width // self.width,",
        ),
        (
            "a scaled crop loses its last row, of larger films alone",
            "-(-self.crop[3] * height // self.height),",
            "-(-self.crop[3] * height // self.height) - (height > self.height),",
        ),
        (
            "a scaled crop is rounded to the nearest pixels",
            "            self.crop[0] * width // self.width,",
            "            round(self.crop[0] * width / self.width),",
        ),
        (
            "a scaled crop by the other side",
            "self.crop[1] * height // self.height",
            "self.crop[1] * width // self.width",
        ),
        ("a crop lost where a film is resized", "crop = self.crop and (", "crop = None and ("),
        ("the height of a resized film ignored", "self.film.height if height is None else height", "self.film.height"),
        (
            "a window without the last column",
            "return self.crop or (0,",
            "return self.crop and (*self.crop[:2], max(self.crop[2] - 1, self.crop[0] + 1), self.crop[3]) or (0,",
        ),
        (
            "a crop one pixel off",
            "height=self.height, crop=tuple(crop))",
            "height=self.height, crop=(crop[0], *crop[1:3], max(crop[3] - 1, crop[1] + 1)))",
        ),
    )
)
SCALE_FAULTS = (
    (
        "similar within 1e-4",
        "similarities 0..9",
        "judged|culling|t",
        WORLD,
        "SIMILARITY_RTOL = 128 * 2.0**-53",
        "SIMILARITY_RTOL = 1e-4",
    ),
    (
        "similar within 1e-12",
        "similarities 0..19",
        "judged|culling|t",
        WORLD,
        "SIMILARITY_RTOL = 128 * 2.0**-53",
        "SIMILARITY_RTOL = 1e-12",
    ),
    (
        "a stretch of 1.0005 taken for a sphere",
        "similarities 8..8",
        "judged|culling|t",
        WORLD,
        "SIMILARITY_RTOL = 128 * 2.0**-53",
        "SIMILARITY_RTOL = 2e-3",
    ),
    (
        "directions below 1e-170 are none",
        "magnitudes 21..21",
        "error",
        "caster/kernels/nearest.py",
        "if not (length > 0.0 and",
        "if not (length > 1e-170 and",
    ),
    (
        "no hit nearer than 1e-6",
        "one-sphere",
        "scaling: ",
        SPHERE,
        "first_root(quadric_roots(pre, d, 0.0), t_min, t_max)",
        "first_root(quadric_roots(pre, d, 0.0), max(t_min, 1e-6), t_max)",
    ),
    (
        "shadow rays start 1e-6 off",
        "lights-and-shadows",
        "scaling: ",
        LIGHTING,
        " + max_norm(p), extent)\n",
        " + max_norm(p), extent) + 1e-6\n",
    ),
)
FAULTS = tuple(
    Fault(family, *fault)
    for family, faults in (("options", OPTION_FAULTS), ("crop", CROP_FAULTS), ("scale", SCALE_FAULTS))
    for fault in faults
)
QUICK = ("second ambient light", "no hit nearer than 1e-6")
CHOSEN = [fault for fault in FAULTS if fault.what in QUICK or os.environ.get("FAULTS") == "all"]


@pytest.mark.parametrize("fault", CHOSEN, ids=lambda fault: fault.what)
@pytest.mark.slow("each judges in plain Python")
def test_a_planted_fault_is_found(tmp_path, fault):
    tree = copy_tree(tmp_path / "tree")
    edit(tree, fault.file, fault.old, fault.new)
    out = ("--out", str(tmp_path / "out"))
    if " " in fault.found_by:
        family, examples = fault.found_by.split()
        judged = JUDGED if "judged" in fault.message else UNJUDGED
        words = ["fuzz", "--family", family, "--examples", examples, "--time", "60s", "--keep", "0", *judged]
        pattern = rf"^\d+ findings: .*\d+ (?:{fault.message})\b"
    else:
        words = ["validate", f"scenes/{fault.found_by}.toml", "--thorough", *SIZE, "-j", "1"]
        pattern = rf"^FAIL  {fault.found_by}  (.*\n +)?.*{fault.message}"
    found = run(tree, *words, *out)
    print(f"{fault.what}: {found.stdout}")
    assert found.returncode == 1, f"this passes: {fault.what}\n{found.stdout}{found.stderr}"
    assert re.search(pattern, found.stdout, re.MULTILINE), found.stdout


def test_every_fault_fits_the_source_of_today():
    for fault in FAULTS:
        assert (ROOT / fault.file).read_text(encoding="utf-8").count(fault.old) == 1, fault.what
    assert set(QUICK) <= {fault.what for fault in FAULTS}
