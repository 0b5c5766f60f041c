"""Faults of one public route alone: `validate` names route, AOV and pixel, or a test finds them.

Each is planted in a copy of both packages, and has to be found by `validate` or by the test that is named. All of them
by `make faults` (FAULTS=all); without it only those in QUICK.
"""

import os
import re
import subprocess
import sys
from typing import NamedTuple

import pytest
from edited_tree import DEADLINE, ROOT, copy_tree, edit, run

IMAGES, HITS = (f"caster/rendering/{name}.py" for name in ("images", "hits"))


class Fault(NamedTuple):
    """An edit of a copy, the scene or the test that finds it, and a pattern of what is said then."""

    family: str
    what: str
    found_by: str  # the name of a shipped scene, for `validate`, or the path of a test
    message: str
    file: str
    old: str
    new: str
    size: tuple[str, str] = ("12", "10")


RETURNED = "        return RenderResult(scene, arrays, Aovs(film.images, film.hit), planned, counts)"

ROUTE_FAULTS = (
    Fault(
        "routes",
        "hits lost with depth and normal alone, on wide films",
        "inside-sphere",
        r"routes: .*caster\.render\(scene\.with_film\(width=\d+, .*\('depth', 'normal'\)\): .* at \(\d+, \d+\) is ",
        IMAGES,
        RETURNED,
        "        if window.width + window.height > 120 and len(aovs) == 2:\n"
        f"            film.images['depth'][...] = np.inf\n{RETURNED}",
    ),
    Fault(
        "routes",
        "normal alone turned round",
        "one-sphere",
        r"routes: .*caster\.render\(.*\('normal',\).*: normal at ",
        IMAGES,
        RETURNED,
        "        if tuple(aovs) == ('normal',):\n            film.images['normal'] *= -1.0\n" + RETURNED,
    ),
    Fault(
        "routes",
        "the first limits taken for all rays",
        "one-sphere",
        r"routes: .*caster\.cast\(scene, o, d, t_min=np\.resize\(.*: t at ",
        HITS,
        "    return np.broadcast_to(numbers, (count,))",
        "    return np.broadcast_to(numbers.ravel()[0], (count,))",
    ),
    Fault(
        "routes",
        "a ray from elsewhere cast as of the common origin",
        "shared-edges-icosphere",
        r"routes: .*limited_rays\(scene, 2\), always_fans=True\): t at ",
        "caster/kernels/bvh/ray_sorting.py",
        "        return (o[0] == fan.origin[0]) & (o[1] == fan.origin[1]) & (o[2] == fan.origin[2])",
        "        return True",
        ("24", "20"),
    ),
    Fault(
        "routes",
        "t_min of occlusion from one point",
        "shared-edges-icosphere",
        r"routes: .*find_any\(packed\(scene\), limited_rays\(scene, 0\), always_fans=True\): t at ",
        "caster/kernels/bvh/fans.py",
        "pre, d, tile[T_MIN + i], tile[T_MAX + i])",
        "pre, d, 0.0 if any_hit else tile[T_MIN + i], tile[T_MAX + i])",
        ("24", "20"),
    ),
    Fault(
        "routes",
        "Hits.normal of another length",
        "one-sphere",
        r"routes: .*caster\.cast\(.*\.normal: normal at ",
        HITS,
        'return self.evaluate(("normal",))["normal"]',
        'return 1.5 * self.evaluate(("normal",))["normal"]',
    ),
    Fault(
        "routes",
        "float32 truncated",
        "one-sphere",
        r"routes: .*dtype=np\.float32.*: position at ",
        IMAGES,
        RETURNED,
        "        if dtype is np.float32:\n"
        "            film.images['position'] = np.nextafter(film.images['position'], np.float32(0))\n" + RETURNED,
    ),
    Fault(
        "routes",
        "occluded without t_max",
        "one-sphere",
        r"routes: .*caster\.occluded\(",
        HITS,
        "    given, plain = validated_rays_with_range(o, d, t_min, t_max)\n    return find_any",
        "    given, plain = validated_rays_with_range(o, d, t_min, np.inf)\n    return find_any",
    ),
    Fault(
        "routes",
        "one pixel cast with the rays of its neighbour",
        "one-sphere",
        r"routes: .*(caster probe|crop=)",
        IMAGES,
        "    prims, rays = packed(scene, rounded), camera_rays(scene, threads)\n",
        "    prims, rays = packed(scene, rounded), camera_rays(scene, threads)\n"
        "    if len(rays.o) == 1 and scene.film.crop[2] < scene.film.width:\n"
        "        x, y, _, _ = scene.film.crop\n"
        "        rays = camera_rays(scene.with_film(crop=(x + 1, y, x + 2, y + 1)), threads)\n",
    ),
    Fault(
        "routes",
        "occluded ignores t_min",
        "one-sphere",
        r"routes: .*caster\.occluded\(scene, o, d, \S+, t_min=",
        HITS,
        "    given, plain = validated_rays_with_range(o, d, t_min, t_max)\n    return find_any",
        "    given, plain = validated_rays_with_range(o, d, 0.0, t_max)\n    return find_any",
    ),
    Fault(
        "routes",
        "Hits.prim_id 0 everywhere",
        "cornell-box",
        r"routes: .*caster\.cast\(.*\.prim_id: prim_id at ",
        HITS,
        "        return self.view.prim_id\n",
        "        return self.view.prim_id.clip(-1, 0)\n",
    ),
    Fault(
        "routes",
        "uv exchanged by cast",
        "one-sphere",
        r"routes: .*caster\.cast\(.*\.surface\.uv: uv at ",
        HITS,
        "        return self.view.surfaces\n",
        "        return self.view.surfaces._replace(uv=self.view.surfaces.uv[:, ::-1])\n",
    ),
    Fault(
        "routes",
        "uv exchanged where one or two AOVs are rendered",
        "one-sphere",
        r"routes: .*caster\.render\(.*'uv'.*: uv at ",
        IMAGES,
        RETURNED,
        "        if 'uv' in film.images and len(film.images) < 3:\n"
        "            film.images['uv'] = film.images['uv'][..., ::-1].copy()\n" + RETURNED,
    ),
    Fault(
        "routes",
        "the last stripe of three threads lost",
        "one-sphere",
        r"routes: .*threads=3\): mask at ",
        "caster/rendering/threads.py",
        "    left = iter(pieces)  #",
        "    left = iter(pieces[:-1] if workers == 3 else pieces)  #",
    ),
    Fault(
        "routes",
        "uncertain pixels of a crop not decided",
        "shared-edges-cube",
        r"routes: .*crop=.*: mask at ",
        IMAGES,
        "        pixels = np.flatnonzero(self.uncertain)\n",
        "        pixels = np.flatnonzero(self.uncertain)\n"
        "        if self.scene.film.crop:\n            pixels = pixels[:0]\n",
        ("15", "15"),
    ),
)

FAULTS = ROUTE_FAULTS
QUICK = ("normal alone turned round", "occluded without t_max", "Hits.normal of another length")
CHOSEN = [fault for fault in FAULTS if fault.what in QUICK or os.environ.get("FAULTS") == "all"]


def run_test(tree, path):
    """A test file with the packages of a copy, without the compiler."""
    words = [sys.executable, "-P", "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", path]
    environment = {**os.environ, "PYTHONPATH": str(tree), "CASTER_JIT": "0"}
    return subprocess.run(
        words, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=DEADLINE, check=False
    )


@pytest.mark.parametrize("fault", CHOSEN, ids=lambda fault: fault.what.replace(" ", "-"))
@pytest.mark.slow("each judges in plain Python", keep=1)
def test_a_planted_fault_is_found(tmp_path, fault):
    tree = copy_tree(tmp_path / "tree")
    edit(tree, fault.file, fault.old, fault.new)
    if fault.found_by.endswith(".py"):
        found = run_test(tree, fault.found_by)
    else:
        words = ["validate", f"scenes/{fault.found_by}.toml", "--thorough", "--size", *fault.size, "-j", "1"]
        found = run(tree, *words)
    print(found.stdout)
    assert found.returncode == 1, f"this passes: {fault.what}\n{found.stdout}{found.stderr}"
    assert re.search(fault.message, found.stdout), found.stdout


def test_every_fault_fits_the_source_of_today():
    for fault in FAULTS:
        assert (ROOT / fault.file).read_text(encoding="utf-8").count(fault.old) == 1, fault
    assert set(QUICK) <= {fault.what for fault in FAULTS}
