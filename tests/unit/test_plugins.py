"""Plug-ins: shapes with their own primitive kind, and cameras."""

import os
import shutil
import subprocess
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from coin_scenes import COINS, LAMP, PINHOLE, PLACES
from programs import install, python

import caster
from caster.cameras import CAMERAS
from caster.description.registry import Registry
from caster.geometry.packing import pack
from caster.image.exr import read_exr
from caster.rendering.casting import Culling
from caster.scene.files import scene_from_text, scene_schema
from caster.shapes import SHAPES

PLUGIN = Path(__file__).parent / "coin_plugin.py"
FILM = "[film]\nwidth = 24\nheight = 17\n"
SCANNER = '[camera]\ntype = "scanner"\neye = [0.3, 0.4, 4]\ndirection = [0, 0, -1]\nspacing = 0.25\n'
ORTHOGRAPHIC = '[camera]\ntype = "orthographic"\neye = [0.3, 0.4, 4]\ndirection = [0, 0, -1]\nwidth = 6\n'
DISKS = "".join(
    f'[[shape]]\ntype = "disk"\nto_world = [{{ scale = {r} }}, {{ translate = [{x}, 0.25, {z}] }}]\n'
    for x, z, r in PLACES
)
AOVS = ("hit", "depth", "normal", "position", "shape_id", "diffuse")


@pytest.fixture
def plugin():
    """The plug-in's module, as a program imports it; what it registers is removed afterwards."""
    import coin_plugin

    for registry, entry in ((SHAPES, coin_plugin.Coin), (CAMERAS, coin_plugin.Scanner)):
        if entry not in registry:
            registry.register(entry)
    yield coin_plugin
    for registry, entry in ((SHAPES, coin_plugin.Coin), (CAMERAS, coin_plugin.Scanner)):
        registry.remove(entry)
        registry.changed()


@pytest.mark.parametrize("culling", get_args(Culling))
@pytest.mark.slow("compiles the kernels of a foreign kind")
def test_a_foreign_kind_renders_like_a_disk_of_the_tree(plugin, culling):
    found = caster.render(scene_from_text(FILM + PINHOLE + LAMP + COINS), AOVS, culling=culling)
    expected = caster.render(scene_from_text(FILM + PINHOLE + LAMP + DISKS), AOVS)
    assert len(np.unique(found["shape_id"])) == 4  # all three, and misses
    for name in ("hit", "shape_id", "normal"):
        assert np.array_equal(found[name], expected[name]), name
    for name in ("depth", "position", "diffuse"):
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-12, atol=1e-12, err_msg=name)


@pytest.mark.slow("compiles the kernels of a foreign camera")
def test_a_foreign_camera_renders_like_an_orthographic_one(plugin):
    found, expected = (
        caster.render(scene_from_text(FILM + camera + LAMP + COINS), AOVS) for camera in (SCANNER, ORTHOGRAPHIC)
    )
    assert found.hit.any() and not found.hit.all()
    for name in AOVS:
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-12, atol=1e-12, err_msg=name)


def test_foreign_descriptions_are_written_packed_and_refused_like_others(plugin):
    scene = scene_from_text(SCANNER + COINS)
    assert scene_from_text(scene.to_toml()) == scene
    assert [type(part).__name__ for part in pack(scene).parts] == ["Coins"] * 3
    assert {"coin", "scanner"} <= {entry.model_fields["type"].default for entry in (*SHAPES, *CAMERAS)}
    assert "Coin" in scene_schema()["$defs"] and caster.Coin is plugin.Coin
    with pytest.raises(caster.SceneError, match=r"shapes\[0\] \(coin\): radius must be > 0, got -1"):
        scene_from_text(SCANNER + '[[shape]]\ntype = "coin"\nradius = -1\n')


def test_a_registry_refuses_a_second_class_of_a_type_and_one_without(plugin):
    with pytest.raises(ValueError, match="the type 'sphere' is registered already"):
        SHAPES.register(caster.Sphere)
    with pytest.raises(ValueError, match="needs a field `type"):
        Registry(caster.Film)


def command(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """The command `caster`, with `folder` among the places where distributions are installed."""
    paths = os.pathsep.join([str(folder), str(PLUGIN.parents[2])])
    return python("-P", "-m", "caster", *words, cwd=folder, PYTHONPATH=paths, CASTER_JIT="0")


def test_the_commands_load_the_plugins_of_installed_distributions(tmp_path):
    scene = "[film]\nwidth = 6\nheight = 5\n" + SCANNER.replace("0.25", "1") + COINS
    (tmp_path / "coins.toml").write_text(scene)
    unknown = command(tmp_path, "check", "coins.toml")
    assert unknown.returncode == 2 and 'unknown camera type "scanner"' in unknown.stdout
    shutil.copy(PLUGIN, tmp_path)
    install(tmp_path, "coins", caster="coin_plugin")
    rendered = command(tmp_path, "render", "coins.toml", "-o", "out.exr")
    assert (rendered.returncode, rendered.stderr) == (0, "")
    assert np.unique(read_exr(tmp_path / "out.exr").channels["A"]).tolist() == [0.0, 1.0]


def test_a_plugin_that_cannot_be_loaded_is_named(tmp_path):
    (tmp_path / "scene.toml").write_text(PINHOLE)
    install(tmp_path, "coins", caster="no_such_module")
    failed = command(tmp_path, "check", "scene.toml")
    assert failed.returncode != 0
    assert "plug-in coins of coins (no_such_module): No module named 'no_such_module'" in failed.stderr
