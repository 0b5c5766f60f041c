"""`mitsuba-ref judge` on hits of any rays and on EXR files: correct ones pass, and each planted fault is found."""

import io
import zipfile

import numpy as np
import pytest
from outputs import json_of, unfolded

import caster
from caster.image.channels import write_render
from caster.image.exr import read_exr, write_exr
from mitsuba_ref.__main__ import main

pytestmark = pytest.mark.usefixtures("remembered")

# Numbers are float32 ones, so that what our caster casts is what is judged.
SCENE = """
[film]
width = 24
height = 20
[camera]
type = "pinhole"
eye = [0.5, 0.75, 4]
look_at = [0, 0, 0]
[[light]]
type = "point"
position = [2, 3, 2]
intensity = [10, 10, 10]
[[shape]]
type = "sphere"
name = "ball"
center = [-0.5, 0.25, 0]
radius = 0.5
[[shape]]
type = "mesh"
name = "roof"
file = "roof.obj"
"""

ROOF = """v -1 -0.5 -1
v 1.5 -0.5 -1
v 1.5 -0.25 1
v -1 -0.25 1
f 1 2 3
f 1 3 4
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rays")
    (folder / "scene.toml").write_text(SCENE)
    (folder / "roof.obj").write_text(ROOF)
    return folder


def hits_of(scene, rows):
    """Right answers by our caster, each ray with limits of its own."""
    t = np.full(len(rows), np.inf)
    n, shape, prim = np.zeros((len(rows), 3)), np.full(len(rows), -1), np.full(len(rows), -1)
    limits, which = np.unique(rows[:, 6:], axis=0, return_inverse=True)
    for k, (t_min, t_max) in enumerate(limits):
        some = np.flatnonzero(which.ravel() == k)
        hits = caster.cast(scene, rows[some, :3], rows[some, 3:6], t_min=t_min, t_max=t_max)
        t[some], n[some], shape[some], prim[some] = hits.t, hits.normal, hits.shape_id, hits.prim_id
    return {"t": t, "n": n, "shape_id": shape, "prim_id": prim, "any_hit": np.isfinite(t)}


@pytest.fixture(scope="module")
def given(folder):
    """Rays of several kinds in one list, with limits of all sorts, and right answers."""
    path = str(folder / "scene.toml")
    kinds = ("camera", "random", "features", "silhouettes", "surface")
    rows = []
    for kind in kinds:
        count = [] if kind == "camera" else ["--count", "60"]
        assert main(["rays", path, "--kind", kind, *count, "-o", str(folder / "r.npz")]) == 0
        rows.append(np.load(folder / "r.npz")["rays"])
    rows = np.concatenate(rows)
    first = caster.cast(caster.load_scene(path), rows[:, :3], rows[:, 3:6]).t
    again = rows[np.isfinite(first)]
    t = first[np.isfinite(first)]
    behind, before = again.copy(), again.copy()  # begins beyond the first hit; ends before it
    behind[:, 6], before[:, 7] = 1.25 * t, 0.75 * t
    rows = np.concatenate([rows, behind, before]).astype(np.float32)
    rows = rows[rows[:, 7] >= rows[:, 6]]
    np.savez(folder / "rays.npz", rays=rows)
    return rows, hits_of(caster.load_scene(path), rows.astype(np.float64))


def judge(folder, hits, *more, rays="rays.npz"):
    np.savez(folder / "hits.npz", **hits)
    out = folder / "verdict.json"
    words = ["--scene", str(folder / "scene.toml"), "--rays", str(folder / rays), "--hits", str(folder / "hits.npz")]
    code = main(["judge", *words, "--json", str(out), *more])
    return code, json_of(out)["scenes"]


def test_right_answers_pass_with_ids_limits_and_any_hits(folder, given):
    """t, normals, ids and occlusion of camera and aimed rays, t_min and t_max of each ray's own."""
    rows, hits = given
    assert (rows[:, 6] > 0).sum() > 100 and np.isfinite(rows[:, 7]).sum() > 100
    code, scenes = judge(folder, hits)
    assert code == 0, scenes
    assert [scene["name"] for scene in scenes] == ["scene", "scene any-hit"]
    assert scenes[0]["rays"] == [0, len(rows)] and scenes[0]["precision"] == "float64"
    assert scenes[0]["counts"]["agree"] > 0.7 * scenes[0]["hit_pixels"]
    assert scenes[0]["adjudicated"] > 100 and "shape_id" not in scenes[0]["unjudged"]


def planted(fault, rows, hits):
    """Answers with one fault, and the words that have to name it."""
    t, n = hits["t"].copy(), hits["n"].copy()
    hit = np.flatnonzero(np.isfinite(t))
    nearest = {"t": t, "n": n}
    match fault:
        case "flipped normal":
            n[hit[7]] *= -1
            return nearest, "the normal is turned"
        case "t_min ignored":
            late = np.flatnonzero(rows[:, 6] > 1e-3)
            t[late] = rows[late, 6] / 1.25
            return nearest, "a hit before t_min"
        case "t_max ignored":
            early = np.flatnonzero(np.isfinite(rows[:, 7]) & (rows[:, 7] < 0.9))
            t[early] = rows[early, 7] / 0.75
            return {"t": t}, "a hit beyond t_max"
        case "another primitive":
            ids = hits["prim_id"].copy()
            ids[hit[5]] += 1
            return nearest | {"prim_id": ids, "shape_id": hits["shape_id"]}, "another primitive"
        case "shadow missed":
            blocked = hits["any_hit"].copy()
            blocked[hit[2]] = False
            return {"any_hit": blocked}, "missed; exact arithmetic hits"
        case "shadow of nothing":
            blocked = hits["any_hit"].copy()
            blocked[~blocked] = np.arange((~blocked).sum()) == 4
            return {"any_hit": blocked}, "a hit; exact arithmetic misses"


FAULTS = (
    *("flipped normal", "t_min ignored", "t_max ignored"),
    *("another primitive", "shadow missed", "shadow of nothing"),
)


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.slow("each judges a list of rays", keep=5)
def test_each_planted_fault_fails_and_is_named(folder, given, fault):
    hits, words = planted(fault, *given)
    code, (scene,) = judge(folder, hits)
    assert code == 1 and scene["counts"]["wrong"] > 0
    assert any(words in finding["what"] for finding in scene["findings"]), scene["findings"]


def test_float64_rays_are_judged_along_their_own_numbers(folder, given):
    """Rays that float32 does not hold: Mitsuba traces them rounded, and exact arithmetic as they are."""
    rows = given[0][:500].astype(np.float64)
    rows[:, :6] *= 1.0 + 1e-9
    np.savez(folder / "fine.npz", rays=rows)
    hits = hits_of(caster.load_scene(folder / "scene.toml"), rows)
    code, scenes = judge(folder, {"t": hits["t"], "n": hits["n"]}, rays="fine.npz")
    assert code == 0 and scenes[0]["counts"]["agree"] > 50
    code, scenes = judge(folder, {"t": hits["t"] * (1.0 + 1e-9)}, rays="fine.npz")
    assert code == 1
    code, scenes = judge(folder, {"t": hits["t"] * (1.0 + 1e-9)}, "--precision", "float32", rays="fine.npz")
    assert code == 0 and scenes[0]["precision"] == "float32"


def test_hits_of_the_scene_files_own_numbers_are_named_and_those_of_the_traced_scene_pass(given, here):
    """No float32 number is 0.3: the ball is traced 1e-8 beside the described one."""
    (here / "roof.obj").write_text(ROOF)
    (here / "scene.toml").write_text(SCENE.replace("[-0.5, 0.25, 0]", "[-0.53, 0.27, 0.01]"))
    np.savez(here / "rays.npz", rays=given[0][:120])
    rows = given[0][:120].astype(np.float64)
    for scene, expected in (("scene.toml", 1), ("traced/scene.toml", 0)):
        if expected == 0:
            assert main(["export", "scene.toml", "--toml", "-o", "traced"]) == 0  # its meshes are beside it
        hits = hits_of(caster.load_scene(here / scene), rows)
        code, (found,) = judge(here, {"t": hits["t"]})
        assert code == expected, found
        if expected:
            assert found["findings"][0]["what"].startswith("hits of the scene file's own numbers")


def test_files_of_a_failing_run_and_the_replay_of_one_ray(folder, given, tmp_path, capsys):
    """verdict.json, JUnit, report, images and reproducers name rays; a replay judges the one ray to the same class."""
    rows, hits = given
    wrong, _ = planted("flipped normal", rows, hits)
    out = ["--out", str(tmp_path / "out"), "--html", str(tmp_path / "r"), "--junit", str(tmp_path / "j.xml")]
    code, (scene,) = judge(folder, wrong, *out)
    text = unfolded(capsys.readouterr().out)
    row = int(np.flatnonzero(np.isfinite(hits["t"]))[7])
    assert code == 1 and f"at ray {row}" in text and f"--row {row}" in scene["failures"][0]["replay"]
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"scene.candidate.exr", "scene.verdict.exr", "verdict.json", f"scene.wrong.{row}.toml"} <= files
    assert set(scene["files"]) == files - {"verdict.json"}
    assert (tmp_path / "r/index.html").stat().st_size > 10000 and "<failure" in (tmp_path / "j.xml").read_text()
    kept = caster.load_scene(tmp_path / "out" / f"scene.wrong.{row}.toml")
    expected = caster.cast(kept, [kept.camera.origin], [kept.camera.direction]).t[0]
    assert np.isfinite(expected)
    code, (again,) = judge(folder, wrong, "--row", str(row))
    assert code == 1 and again["counts"]["wrong"] == 1 and again["rays"] == [row, row + 1]


def test_a_mesh_stands_for_a_scene(folder):
    rows = np.array([[0.25, 1.0, 0.125, 0.0, -1.0, 0.0, 0.0, np.inf]], np.float32)
    np.savez(folder / "one.npz", rays=rows)
    camera = {"type": "ray", "origin": (0, 0, 9), "direction": (0, 0, -1)}
    mesh = caster.Scene(shapes=[{"type": "mesh", "file": str(folder / "roof.obj")}], camera=camera)
    t = hits_of(mesh, rows.astype(np.float64))["t"]
    words = ["judge", "--scene", str(folder / "roof.obj"), "--rays", str(folder / "one.npz"), "--hits"]
    for name, code, values in (("right", 0, t), ("wrong", 1, t * 1.001)):
        np.savez(folder / f"{name}.npz", t=values)
        assert main([*words, str(folder / f"{name}.npz")]) == code


class Bomb:
    """An object that leaves a trace if it is unpickled."""

    def __reduce__(self):
        return exec, ("raise SystemExit('unpickled')",)


def npy_of(shape, dtype="<f8", data=b""):
    """A .npy file whose header may claim anything."""
    header = repr({"descr": dtype, "fortran_order": False, "shape": shape}).encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + data


def npz_of(member):
    """A .npz file of these rays."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("rays.npy", member)
    return out.getvalue()


RAY = (0.0, 0.0, 4.0, 0.0, 0.0, -1.0, 0.0, np.inf)


def changed_ray(**columns):
    row = np.array([RAY, RAY])
    for column, value in columns.items():
        row[1, int(column[1:])] = value
    return row


HOSTILE_RAYS = {
    "no rows": (np.zeros((0, 8)), "at least one ray"),
    "columns": (np.zeros((2, 6)), "shape (n, 8)"),
    "integers": (np.ones((2, 8), np.int64), "float32 or float64 rays"),
    "NaN": (changed_ray(c0=np.nan), "rays[1]: expected finite numbers"),
    "zero d": (changed_ray(c5=0.0), "rays[1]: expected a direction"),
    "too large": (changed_ray(c0=1e39), "within float32"),
    "vanishes": (changed_ray(c5=1e-60), "not zero, also as float32"),
    "t_min": (changed_ray(c6=-1.0), "t_min >= 0"),
    "t_min inf": (changed_ray(c6=np.inf), "finite t_min"),
    "t_max": (changed_ray(c7=np.nan), "t_max >= t_min"),
    "start": (changed_ray(c6=1e38, c5=-1e38), "beyond float32"),
    "objects": (np.array([[Bomb()]], object), "allow_pickle=False"),
    "text": (np.array(["a"]), "expected numbers"),
    "no .npz": (npy_of((0, 8)), "expected a .npz file"),
    "claims terabytes": (npz_of(npy_of((10**12, 8))), "cannot be read"),
    "no zip": (b"PK\x03\x04 nothing", "cannot be read"),
}


def judge_files(folder, given, capsys):
    """The exit code, and what is said of the rays and hits in `given`, which is no traceback."""
    files = ["--rays", str(given / "rays.npz"), "--hits", str(given / "hits.npz")]
    code = main(["judge", "--scene", str(folder / "scene.toml"), *files])
    said = unfolded(capsys.readouterr().err)
    assert "Traceback" not in said
    return code, said


@pytest.mark.parametrize("which", HOSTILE_RAYS)
def test_rays_that_are_none_give_a_clear_error(folder, tmp_path, capsys, which):
    content, words = HOSTILE_RAYS[which]
    path = tmp_path / "rays.npz"
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        np.savez(path, rays=content)
    np.savez(tmp_path / "hits.npz", t=np.ones(2))
    code, said = judge_files(folder, tmp_path, capsys)
    assert code in (2, 4) and words in said and str(path) in said


HOSTILE_HITS = {
    "too few": ({"t": np.ones(1)}, 2, "one row for each of the 2 rays"),
    "nothing known": ({"distance": np.ones(2)}, 2, "expected arrays of t"),
    "misspelt": ({"t": np.ones(2), "normal": np.ones((2, 3))}, 2, "prim_id, any_hit, got 'normal'"),
    "normals alone": ({"n": np.ones((2, 3))}, 2, "an array t, or any_hit"),
    "ids of floats": ({"t": np.ones(2), "prim_id": np.ones(2)}, 2, "expected whole numbers"),
    "t of one column": ({"t": np.ones((2, 1))}, 2, "t: expected shape (n,) = (2,), got (2, 1)"),
    "any_hit of three": ({"any_hit": np.array([0, 3])}, 2, "expected 0 or 1"),
}


@pytest.mark.parametrize("which", HOSTILE_HITS)
def test_hits_that_are_none_give_a_clear_error(folder, tmp_path, capsys, which):
    arrays, expected, words = HOSTILE_HITS[which]
    np.savez(tmp_path / "hits.npz", **arrays)
    np.savez(tmp_path / "rays.npz", rays=np.array([RAY, RAY]))
    code, said = judge_files(folder, tmp_path, capsys)
    assert code == expected and words in said


def judged_exr(folder, exr, change=None, *more):
    """The verdict on an image, changed. more: options."""
    channels = {name: values.copy() for name, values in exr.channels.items()}
    if change:
        change(channels)
    write_exr(folder / "e.exr", channels, {})
    words = [str(folder / "scene.toml"), "--candidate", str(folder / "e.exr"), *more]
    code = main(["validate", *words, "--json", str(folder / "v.json")])
    return code, json_of(folder / "v.json")["scenes"]


def scaled(name, factor):
    def change(channels):
        where = np.argwhere(channels["A"] != 0)[20]
        channels[name][tuple(where)] *= factor

    return change


def lost(channels):
    where = tuple(np.argwhere(channels["A"] != 0)[20])
    channels["A"][where], channels["depth.Z"][where] = 0.0, np.inf


TORUS = """
[film]
width = 24
height = 20
[camera]
type = "pinhole"
eye = [0.5, -3.1, 2.3]
look_at = [0, 0, 0]
up = [0, 0, 1]
[[shape]]
type = "torus"
to_world = [{rotate = {axis = [0.3, 0.2, 1], degrees = 17}}, {scale = 0.7}]
"""


def tilted(share):
    def change(channels):
        where = tuple(np.argwhere(channels["A"] != 0)[50])
        n = np.array([channels[f"normal.{c}"][where] for c in "XYZ"])
        across = np.cross(n, np.roll(n, 1))
        for c, x in zip("XYZ", n + share * across / np.linalg.norm(across), strict=True):
            channels[f"normal.{c}"][where] = x

    return change


@pytest.mark.parametrize(
    ("change", "passes"),
    [(None, True), (tilted(1e-4), False), (scaled("depth.Z", 1.0001), False), (lost, False)],
    ids=["none", "tilted", "depth", "lost"],
)
def test_an_image_of_geometry_that_float32_rounds_is_judged_by_both(tmp_path, change, passes):
    """Its file has the float64 vertices, what is traced beside it those that are rounded: normals differ by 3e-6."""
    path = tmp_path / "scene.toml"
    path.write_text(TORUS)
    scene = caster.load_scene(path)
    write_render(str(tmp_path / "out.exr"), scene, [caster.render(scene, ("hit", "depth", "normal"))], "scene.toml")
    image = read_exr(tmp_path / "out.exr")
    code, scenes = judged_exr(tmp_path, image, change)
    assert code == (0 if passes else 1) and scenes[0]["hit_pixels"] > 75
    counts = scenes[0]["counts"]
    assert counts["wrong"] + counts["undecided"] == (0 if passes else 1), counts
    if passes:  # the same with names of another program, which options state

        def renamed(channels):
            channels["range"] = channels.pop("depth.Z")

        assert judged_exr(tmp_path, image, renamed)[0] == 1
        assert judged_exr(tmp_path, image, renamed, "--map", "depth=range")[0] == 0


def test_an_image_that_is_not_there_is_a_missing_file(folder, capsys):
    assert main(["validate", str(folder / "scene.toml"), "--candidate", "gone.exr"]) == 4
    assert "gone.exr: " in capsys.readouterr().err
