"""Approved images: written after the differences were shown, and refused when altered or stale."""

import json

import numpy as np
import pytest

from caster.image.exr import read_exr, write_exr
from caster.system import processor
from mitsuba_ref.__main__ import main
from mitsuba_ref.exr_compare.approved import AOVS, CLASS_CHANNEL, PROCESSOR, load_approved, write_approved
from mitsuba_ref.judge.verdict import CLASSES

pytestmark = pytest.mark.usefixtures("remembered")
BALL = """# A ball.
[film]
width = 12
height = 10
[camera]
type = "pinhole"
eye = [0.1, 0.2, 5.3]
look_at = [0, 0, 0]
[[light]]
type = "point"
position = [2, 3, 4]
intensity = [20, 20, 20]
[[shape]]
type = "sphere"
name = "ball"
radius = 1.3
"""
MESH = BALL.partition("[[shape]]")[0] + '[[shape]]\ntype = "mesh"\nfile = "tile.obj"\n'
TILE = "v -1 -1 0\nv 1 -1 {z}\nv 0 1 0\nf 1 2 3\n"


@pytest.fixture(scope="module")
def approved(tmp_path_factory):
    """A folder with scenes/ball.toml, scenes/mesh.toml and approved refs/; tests take copies."""
    folder = tmp_path_factory.mktemp("approved")
    (folder / "scenes").mkdir()
    (folder / "scenes/ball.toml").write_text(BALL)
    (folder / "scenes/mesh.toml").write_text(MESH)
    (folder / "scenes/tile.obj").write_text(TILE.format(z=0))
    words = ["approve", str(folder / "scenes"), "--references", str(folder / "refs"), "--yes"]
    assert main(words) == 0
    return folder


@pytest.fixture
def here(approved, tmp_path, monkeypatch):
    import shutil

    shutil.copytree(approved, tmp_path / "copy")
    monkeypatch.chdir(tmp_path / "copy")
    return tmp_path / "copy"


def said(capsys, *words):
    """(exit code, stdout, stderr) of `mitsuba-ref` with these words, about refs/."""
    capsys.readouterr()
    code = main([*words, "--references", "refs"])
    found = capsys.readouterr()
    return code, found.out, found.err


def replaced(here, name, **planes):
    """Replace pixels of an approved image, with a valid digest."""
    path = here / f"refs/{name}.exr"
    before = load_approved(path)
    write_approved(path, before._replace(channels=before.channels | planes))
    return before


# ---- approve ----


def test_a_reference_states_where_it_comes_from_and_names_no_folder(here):
    found = load_approved(here / "refs/ball.exr")
    assert {"A", "depth.Z", "normal.X", "shading_normal.Z", "position.Y", "R", "id.shape", CLASS_CHANNEL} <= set(
        found.channels
    )
    about = found.provenance
    assert about["caster/reference/mitsuba"] == "3.9.1" and about["caster/reference/variant"] == "scalar_rgb"
    assert about["caster/scene"] == "ball.toml"
    assert {"caster/scene_sha256", "caster/version", "caster/reference/drjit"} <= set(about) and "uv" not in AOVS
    assert about["caster/reference/processor"] == processor.description()
    assert not any(str(here) in words or "/usr/" in words for words in about.values())


def test_approving_twice_changes_no_byte_and_writes_no_file(here, capsys):
    files = {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in here.glob("refs/*.exr")}
    code, out, _ = said(capsys, "approve", "scenes", "--yes")
    assert code == 0 and "2 scenes: 0 images to write" in out
    assert {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in files} == files
    (here / "refs/ball.exr").unlink()
    assert said(capsys, "approve", "scenes", "-k", "ball", "--yes")[0] == 0
    assert (here / "refs/ball.exr").read_bytes() == files[here / "refs/ball.exr"][0]


def test_what_is_missing_is_written_only_when_approved(here, capsys):
    (here / "refs/ball.exr").unlink()
    code, out, err = said(capsys, "approve", "scenes")
    assert code == 1 and "missing  -> ball  " in out and "same        mesh" in out
    assert "add --yes" in err and not (here / "refs/ball.exr").exists()


def test_a_change_is_shown_by_channel_before_it_is_written(here, capsys):
    before = load_approved(here / "refs/ball.exr")
    depth, hit = (before.channels[name].copy() for name in ("depth.Z", "A"))
    y, x = np.argwhere(hit != 0)[7]
    depth[y, x] += 0.25
    y1, x1 = np.argwhere(hit != 0)[9]
    hit[y1, x1] = 0
    replaced(here, "ball", **{"depth.Z": depth, "A": hit})
    code, out, _ = said(capsys, "approve", "scenes")
    assert code == 1 and "changed  -> ball" in out and "same        mesh" in out
    assert f"A: 1 pixels differ, by at most 1, at ({x1}, {y1})" in out
    assert f"depth.Z: 1 pixels differ, by at most 0.25, at ({x}, {y})" in out
    assert said(capsys, "approve", "scenes", "--yes")[0] == 0
    now = load_approved(here / "refs/ball.exr").channels
    assert all(np.array_equal(now[name], before.channels[name]) for name in before.channels)


def test_a_crash_of_mitsuba_writes_nothing_and_fails(here, capsys, monkeypatch):
    from mitsuba_ref.reference.messages import Crash

    crash = Crash(-6, "LLVM ERROR: no", 0.1)
    monkeypatch.setattr("mitsuba_ref.reference.mitsuba_process.ask_resident", lambda *_: crash)
    files = {path: path.read_bytes() for path in here.glob("refs/*.exr")}
    code, out, _ = said(capsys, "approve", "scenes", "--yes")
    assert code == 1 and "failed      ball  Mitsuba ended without an answer (SIGABRT): LLVM ERROR: no" in out
    assert {path: path.read_bytes() for path in files} == files


# ---- check ----


def test_ours_passes_against_its_references_without_mitsuba(here, capsys, monkeypatch):
    monkeypatch.setattr("mitsuba_ref.reference.mitsuba_process.ask_resident", None)
    code, out, _ = said(capsys, "check", "scenes")
    assert code == 0 and "PASS  ball  " in out and "PASS  mesh  " in out and "2 scenes: 2 pass, 0 fail" in out
    code, out, _ = said(capsys, "check", "scenes", "--json")
    record = json.loads(out)
    assert record["ok"] and [scene["ours"] for scene in record["scenes"]] == ["ball", "mesh"]


@pytest.mark.parametrize(
    ("channel", "factor", "says"),
    [
        ("depth.Z", 1 + 2.0**-16, "depth"),
        ("normal.X", 1 + 2.0**-9, "normal"),
        ("R", 1 + 2.0**-9, "diffuse"),
        ("depth.Z", np.nan, "depth"),
        ("A", 0.0, "hit"),
    ],
)
def test_what_is_beyond_its_bound_fails(here, capsys, channel, factor, says):
    """The approved value is altered, which looks as if ours were off in the other direction."""
    before = load_approved(here / "refs/ball.exr")
    plane = before.channels[channel].copy()
    y, x = np.argwhere((before.channels["A"] != 0) & (plane != 0))[5]
    plane[y, x] *= factor
    replaced(here, "ball", **{channel: plane})
    code, out, _ = said(capsys, "check", "scenes")
    assert code == 1 and f"FAIL  ball  {says}: " in out and f"({x}, {y})" in out and "PASS  mesh" in out
    assert f"replay: mitsuba-ref probe scenes/ball.toml {x} {y}\n" in out


def test_a_reference_with_no_pixel_to_compare_is_no_pass(here, capsys):
    """A single comparable pixel is enough to compare."""
    before = load_approved(here / "refs/ball.exr")
    explained = np.full_like(before.channels[CLASS_CHANNEL], CLASSES.index("explained"))
    replaced(here, "ball", **{CLASS_CHANNEL: explained})
    code, out, _ = said(capsys, "check", "scenes", "-k", "ball")
    assert code == 1 and "FAIL  ball  nothing to compare: more than one answer is right at all " in out
    y, x = np.argwhere(before.channels["A"] != 0)[5]
    explained[y, x] = CLASSES.index("agree")
    replaced(here, "ball", **{CLASS_CHANNEL: explained})
    assert said(capsys, "check", "scenes", "-k", "ball")[0] == 0


def test_a_reference_that_is_missing_is_a_missing_file_and_no_pass(here, capsys):
    """The exit code is that of a missing file; of a difference only where one was found."""
    (here / "refs/mesh.exr").unlink()
    code, out, _ = said(capsys, "check", "scenes")
    assert code == 4 and "FAIL  mesh  refs/mesh.exr: there is no approved image; nothing was checked" in out
    assert "2 scenes: 1 pass, 0 fail, 1 not checked: no image that can be read" in out
    assert "approve them:\nmitsuba-ref approve scenes --references refs\n" in out
    found = json.loads(said(capsys, "check", "scenes", "--json")[1])
    assert not found["ok"] and [scene["exit_code"] for scene in found["scenes"]] == [0, 4]
    (here / "scenes/ball.toml").write_text(BALL.replace("radius = 1.3", "radius = 1.31"))
    code, out, _ = said(capsys, "check", "scenes")
    assert code == 1 and "2 scenes: 0 pass, 1 fail, 1 not checked" in out
    (here / "refs/ball.exr").unlink()
    assert said(capsys, "check", "scenes")[0] == 4


@pytest.mark.parametrize(
    ("file", "old", "new", "says"),
    [
        ("ball.toml", "radius = 1.3", "radius = 1.31", "stale: shape of the scene changed since it was approved"),
        ("ball.toml", "width = 12", "width = 13", "stale: film of the scene changed"),
        ("ball.toml", "# A ball", "# The same ball", None),
        ("tile.obj", "v 1 -1 0", "v 1 -1 0.001", "stale: a mesh file of the scene changed"),
    ],
)
def test_a_stale_reference_is_refused_and_a_comment_makes_none_stale(here, capsys, file, old, new, says):
    path = here / "scenes" / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    code, out, _ = said(capsys, "check", "scenes")
    assert code == (1 if says else 0) and (not says or says in " ".join(out.split()))
    code, out, _ = said(capsys, "approve", "scenes", "--yes")
    assert ("stale    -> " in out) == bool(says)
    assert said(capsys, "check", "scenes")[0] == 0  # the way out works


def test_an_altered_file_is_refused(here, capsys):
    path = here / "refs/ball.exr"
    good = path.read_bytes()
    exr = read_exr(path)
    depth = exr.channels["depth.Z"].copy()
    depth[5, 6] = np.nextafter(depth[5, 6], np.float32(0))
    write_exr(path, exr.channels | {"depth.Z": depth}, exr.provenance)  # a careful editor: one bit, a whole file
    code, out, _ = said(capsys, "check", "scenes")
    assert code == 1 and "FAIL  ball  refs/ball.exr: altered after it was approved" in out
    assert "damaged  -> ball" in said(capsys, "approve", "scenes")[1]
    write_exr(path, exr.channels, exr.provenance | {"caster/reference/variant": "llvm_ad_rgb"})
    assert "altered after it was approved" in said(capsys, "check", "scenes")[1]
    write_exr(path, exr.channels, {k: v for k, v in exr.provenance.items() if "sha256" not in k})
    assert "no image of `mitsuba-ref approve`" in said(capsys, "check", "scenes")[1]
    for broken in (good[: len(good) // 2], b"", b"not an image", good[:2000] + bytes([good[2000] ^ 64]) + good[2001:]):
        path.write_bytes(broken)
        code, out, _ = said(capsys, "check", "scenes")
        assert code == 4 and "FAIL  ball  " in out and "PASS  mesh" in out and "nothing was checked" in out


def test_another_bit_passes_check_and_is_shown_by_approve(here, capsys):
    before = load_approved(here / "refs/ball.exr")
    depth = before.channels["depth.Z"].copy()
    y, x = np.argwhere(before.channels["A"] != 0)[3]
    depth[y, x] = np.nextafter(depth[y, x], np.float32(0))
    replaced(here, "ball", **{"depth.Z": depth})
    assert said(capsys, "check", "scenes", "-k", "ball")[0] == 0
    code, out, _ = said(capsys, "approve", "scenes", "-k", "ball")
    assert code == 1 and f"depth.Z: 1 pixels differ, by at most 4.76837158e-07, at ({x}, {y})" in out


def one_bit_off(plane, hit):
    return np.where(hit, np.nextafter(plane, np.float32(0)), plane)


OTHER = "GenuineIntel family 6 model 142 (x86-64-v3)"


@pytest.mark.parametrize("recorded", [OTHER, None])
def test_last_bits_of_another_processor_are_named_and_no_change(here, capsys, recorded):
    """Also where the approved image names no processor."""
    before = load_approved(here / "refs/ball.exr")
    about = {key: words for key, words in before.provenance.items() if key != PROCESSOR}
    about |= {PROCESSOR: recorded} if recorded else {}
    depth = one_bit_off(before.channels["depth.Z"], before.channels["A"] != 0)
    write_approved(
        here / "refs/ball.exr", before._replace(provenance=about, channels=before.channels | {"depth.Z": depth})
    )
    code, out, _ = said(capsys, "approve", "scenes", "-k", "ball")
    assert code == 0 and "same        ball  but for last bits" in out and "0 images to write" in out
    assert f"processor: {recorded or 'none'} -> {processor.description()}" in out and "depth.Z: " in out


@pytest.mark.parametrize(
    ("channel", "change", "more"),
    [
        ("depth.Z", lambda plane, hit: np.where(hit, plane * (1 + 2.0**-16), plane), {}),
        ("normal.X", lambda plane, hit: np.where(hit, plane * (1 + 2.0**-9), plane), {}),
        ("R", lambda plane, hit: np.where(hit, plane * (1 + 2.0**-9), plane), {}),
        ("A", lambda plane, hit: np.zeros_like(plane), {}),
        ("id.shape", lambda plane, hit: plane + 1, {}),
        ("depth.Z", one_bit_off, {"caster/reference/mitsuba": "3.9.0"}),
        ("depth.Z", one_bit_off, {PROCESSOR: processor.description()}),
    ],
)
def test_more_than_another_processor_explains_is_a_change(here, capsys, channel, change, more):
    before = load_approved(here / "refs/ball.exr")
    plane = before.channels[channel]
    plane = change(plane, before.channels["A"] != 0).astype(plane.dtype)
    about = before.provenance | {PROCESSOR: OTHER} | more
    write_approved(
        here / "refs/ball.exr", before._replace(provenance=about, channels=before.channels | {channel: plane})
    )
    code, out, _ = said(capsys, "approve", "scenes", "-k", "ball")
    assert code == 1 and "changed  -> ball" in out
