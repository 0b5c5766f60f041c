"""Textures against Mitsuba: what it evaluates at every pixel, and mistakes of ours and of its scene."""

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mitsuba_scenes import scene_judge
from PIL import Image
from places import scene_of

import caster
from caster.description.errors import SceneError
from caster.kernels.surface import texturing
from caster.kernels.surface.texturing import ROWS_PER_FACE
from caster.rendering import shading
from caster.scene.files import load_scene, scene_from_text
from caster.scene.model import Scene
from caster.scene.textures import FILTERS, WRAPS, Bitmap, Checkerboard, MeshColors, texture_arrays
from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.judge.diagnosis import diagnose
from mitsuba_ref.reference import shared_input
from mitsuba_ref.report.reproducers import reproducer

SWATCH = "scenes/pictures/swatch.png"
SMALL = {"scale": [2.6, 2.2, 1]}, {"translate": [-0.4, -0.7, 0]}


def wall(texture: Any) -> Scene:
    """A square that fills a film of 24 x 18 pixels, turned a little."""
    turned = [{"scale": 1.5}, {"rotate": {"axis": [0.3, 1, 0.2], "degrees": 17}}]
    return Scene(
        film=caster.Film(width=24, height=18),
        camera=caster.Pinhole(eye=(0.1, 0.2, 4), look_at=(0, 0, 0), fov=32),
        lights=[caster.Point(position=(1, 2, 3), intensity=(9, 9, 9)), caster.Ambient(radiance=(0.1, 0.2, 0.3))],
        materials={"m": {"reflectance": texture, "two_sided": True}},
        shapes=[caster.Rectangle(material="m", to_world=turned)],
    )


@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb"])
@pytest.mark.parametrize(
    "texture",
    [
        Checkerboard(color0=(0, 0, 0), color1=(1, 1, 1), to_uv={"scale": 9}),
        *(Bitmap(file=SWATCH, filter=f, wrap=w, to_uv=SMALL) for f in FILTERS for w in WRAPS),
        Bitmap(file=SWATCH, raw=True),
        Bitmap(data=[[[0.9, 0.1, 0], [0.2, 1, 0.3]], [[0, 0, 0], [1, 1, 1]]], wrap="clamp", filter="nearest"),
    ],
    ids=lambda texture: "-".join(map(str, (texture.type, texture.filter, texture.wrap))),
)
def test_every_pixel_agrees(texture, variant, monkeypatch):
    monkeypatch.setenv("MITSUBA_REF_VARIANT", variant)
    judge = scene_judge(wall(texture))
    found = judge.judge()
    assert judge.result.answer.versions["variant"] == variant
    assert found.is_class("agree", "explained").all() and found.is_class("agree").mean() > 0.98
    assert len(np.unique(aov_rows(judge.subject, "albedo"), axis=0)) > 1


CORNERS = np.array([[-1, -1, 0], [1, -1, 0.2], [1, 1, 0], [-1, 1, 0.1]])
FACES = [[0, 1, 2], [0, 2, 3]]
COLORS = [[0.9, 0.1, 0], [0.2, 1, 0.3], [0, 0, 0], [1, 1, 1]]


@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb"])
@pytest.mark.parametrize("colors", [MeshColors(vertices=COLORS), MeshColors(faces=COLORS[:2])])
@pytest.mark.parametrize("uv", [None, CORNERS[:, :2] * 3.0], ids=["", "uv"])
def test_colours_of_meshes_agree_at_every_pixel(colors, uv, variant, monkeypatch):
    """Of a mirrored mesh with reversed normals, whose primitives are not the scene's first."""
    monkeypatch.setenv("MITSUBA_REF_VARIANT", variant)
    ball = caster.Sphere(radius=0.2)
    mesh = {"material": "m", "flip_normals": True, "to_world": [{"scale": [-1.5, 1.5, 1.5]}]}
    judge = scene_judge(wall(colors).model_copy(update={"shapes": (ball, caster.Mesh(CORNERS, FACES, uv=uv, **mesh))}))
    found = judge.judge()
    assert found.is_class("agree", "explained").all() and found.is_class("agree").mean() > 0.98
    albedo, prim = (aov_rows(judge.subject, name) for name in ("albedo", "prim_id"))
    assert len(np.unique(albedo, axis=0)) > (100 if colors.faces is None else 2)
    if colors.faces is not None:
        seen = aov_rows(judge.subject, "shape_id") == 1
        assert np.array_equal(albedo[seen], np.array(COLORS)[prim[seen]])


@pytest.mark.parametrize("needle", [1e-3, 1e-5])
def test_colours_of_slivers_have_bounds_that_follow_mitsubas_barycentrics(needle):
    """Gradients of a thin face are large; Mitsuba solves for the barycentrics with the square of its slenderness."""
    thin = CORNERS * [1.0, needle, 1.0]
    scene = wall(MeshColors(vertices=COLORS)).model_copy(
        update={
            "shapes": (caster.Mesh(thin, FACES, material="m"),),
            "camera": caster.Orthographic(eye=(0, 0, 4), look_at=(0, 0, 0), width=2.5 * needle),
        }
    )
    found = scene_judge(scene).judge()
    assert found.is_class("agree", "explained").all()


def test_colours_of_a_mesh_from_a_thousandth_of_an_edge_beside_the_corner_are_found(monkeypatch):
    def beside(textures: Any, packed: Any) -> Any:
        made = texture_arrays(textures, packed)
        made.texels[::ROWS_PER_FACE] += 0.001
        return made

    monkeypatch.setattr(shading, "texture_arrays", beside)
    scene = wall(MeshColors(vertices=COLORS)).model_copy(
        update={"shapes": (caster.Mesh(2.0 * CORNERS, FACES, material="m"),)}
    )
    judge = scene_judge(scene)
    judgement = judge.judge()
    assert judgement.is_class("undecided", "wrong").mean() > 0.9
    assert all("contradicts our own hit: diffuse" in cause.what for cause in diagnose(judge, judgement))
    small, _ = reproducer(judge, int(np.flatnonzero(judgement.is_class("undecided", "wrong"))[0]), lit=True)
    assert [len(each.reflectance.vertices) for each in small.materials.values()] == [4], "of the whole mesh"


@pytest.mark.parametrize(
    ("fields", "shape", "expected"),
    [
        ({}, caster.Cube(material="m"), "needs either vertices or faces, got neither"),
        ({"vertices": COLORS, "faces": COLORS}, caster.Cube(material="m"), "needs either vertices or faces, got both"),
        ({"faces": COLORS}, caster.Cube(material="m"), "has 4 colours, and the mesh 12 faces"),
        ({"faces": COLORS}, caster.Sphere(material="m"), "a sphere has no vertices to be coloured"),
        ({"vertices": [[0, 2, 0]]}, caster.Cube(material="m"), "2"),
    ],
)
def test_colours_that_fit_no_mesh(fields, shape, expected):
    with pytest.raises(SceneError, match=expected):
        scene_of(shape, materials={"m": {"reflectance": {"type": "mesh_colors", **fields}}})


def test_a_shift_by_a_thousandth_of_a_texel_in_mitsubas_scene_is_found(monkeypatch):
    export = shared_input.texture_element

    def off(texture: Any, files: Any) -> Any:
        return export(texture.model_copy(update={"to_uv": [*texture.to_uv, {"translate": [0.001 / 16, 0, 0]}]}), files)

    monkeypatch.setattr(shared_input, "texture_element", off)
    judgement = scene_judge(wall(Bitmap(file=SWATCH, to_uv=SMALL))).judge()
    assert judgement.is_class("reference_wrong").mean() > 0.9


def test_lookups_compiled_and_at_numbers_beyond_any_picture():
    """Whole numbers in place of infinite ones; cells begin at their upper left corner."""
    made = texture_arrays([Checkerboard(color0=(0, 0, 0), color1=(1, 1, 1))], None)
    at = [texturing.color_at(made, 0, u, v)[0] for u, v in ((0, 0), (0.5, 0), (0.75, 0.75), (-1e-9, 0), (1e300, 0))]
    assert at[:4] == [0.0, 1.0, 0.0, 1.0] and at[4] in (0.0, 1.0)


def test_a_textured_scene_round_trips(tmp_path):
    scene = load_scene("scenes/textures.toml")
    (tmp_path / "again.toml").write_text(scene.to_toml())
    again = load_scene(tmp_path / "again.toml", mesh_dirs=["scenes"])
    assert again == scene and again.sha256() == scene.sha256()
    changed = scene.model_copy(update={"materials": scene.materials | {"floor": caster.Diffuse()}})
    assert changed.sha256() != scene.sha256()


def png_of_16_bits() -> bytes:
    """One red pixel; Pillow reads such files with 8 bits a channel."""
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", 1, 1, 16, 2, 0, 0, 0)), (b"IEND", b"")]
    chunks.insert(1, (b"IDAT", zlib.compress(b"\0\xff\xff\0\0\0\0")))
    parts = (
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)) for name, data in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("none.png", None, "reflectance.file cannot be used: cannot read this picture: No such file or directory"),
        ("word.png", b"P6 1 1 255", "expected a PNG picture that is complete"),
        ("cut.png", Path(SWATCH).read_bytes()[:70], "expected a PNG picture that is complete"),
        ("rgb.png", png_of_16_bits(), "8 bits a channel, got 1 x 1 of 16 bits"),
        ("deep.png", np.zeros((3, 4), np.uint16), "expected at most 16,777,216 pixels, of 8 bits a channel, got 4 x 3"),
        ("large.png", np.zeros((4097, 4096), np.uint8), "expected at most 16,777,216 pixels, .* got 4096 x 4097"),
    ],
)
def test_unusable_pictures(name, content, expected, tmp_path):
    if isinstance(content, np.ndarray):
        Image.fromarray(content).save(tmp_path / name)
    elif content is not None:
        (tmp_path / name).write_bytes(content)
    camera = '[camera]\ntype = "pinhole"\neye = [0, 0, 5]\nlook_at = [0, 0, 0]\n'
    text = f'{camera}[material.m]\nreflectance = {{ type = "bitmap", file = "{name}" }}\n'
    with pytest.raises(SceneError, match=expected) as caught:
        scene_from_text(text, folder=tmp_path)
    assert caught.value.exit_code == (4 if content is None else 2)
