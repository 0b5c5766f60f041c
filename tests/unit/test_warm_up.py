"""`caster doctor --warm` compiles the kernels of everything registered, and reports its work."""

import json
import os
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import pytest
from marks import compiled_only
from programs import printed_by

from caster.__main__ import main
from caster.cameras import CAMERAS
from caster.cli import application
from caster.geometry.packing import pack
from caster.jit import decorators
from caster.kernels.protocol import intersect
from caster.rendering import warm_up
from caster.scene.model import LIGHTS
from caster.system.terminal import compilation_reported
from mitsuba_ref.runner.workers import Workers

SCENE = "scenes/one-sphere.toml"


def test_every_kind_of_primitive_and_every_camera_is_warmed():
    scenes = list(warm_up.warm_up_scenes())
    assert [type(scene.camera) for scene in scenes] == list(CAMERAS)
    # other tests of this process may have added plug-ins; the caster's own kinds are those of its own modules
    own = {kind for kind in decorators._GENERICS[intersect].bodies if kind.__module__.startswith("caster.")}
    assert all({type(kind.prims) for kind in pack(scene).kinds} == own for scene in scenes)


def test_every_kind_of_light_is_warmed():
    assert {type(lamp) for lamp in warm_up.LAMPS} == set(LIGHTS)


@pytest.fixture
def little(monkeypatch):
    """Warm one AOV by one culling, to save time."""
    monkeypatch.setattr(warm_up, "WARM_UP_AOV_SETS", (("depth",),))
    monkeypatch.setattr(warm_up, "get_args", lambda culling: ("raster",))
    monkeypatch.setattr(warm_up, "warm_decisions", lambda *given: None)
    monkeypatch.setattr(warm_up, "_warm_rays", lambda packed: None)
    monkeypatch.setattr(decorators.COMPILATION_LOG, "compiling", decorators.COMPILATION_LOG.compiling)


@compiled_only
def test_what_was_done_is_reported(little, capsys):
    assert main(["doctor", "--warm", SCENE]) == 0
    told = capsys.readouterr()
    assert told.out.startswith("kernels: ")
    assert main(["doctor", "--warm", SCENE, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"compiled": 0, "loaded": 0}  # this process has them by now


def test_a_scene_that_is_not_there_is_reported_before_anything_is_compiled(capsys):
    assert main(["doctor", "--warm", "nowhere.toml"]) == 4
    assert "nowhere.toml" in capsys.readouterr().err


def test_a_command_reports_once_that_it_compiles_and_nothing_is_reported_after_it(capsys):
    with compilation_reported():
        for _ in range(3):
            decorators.COMPILATION_LOG.compiling("a kernel")
    decorators.COMPILATION_LOG.compiling("later")
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("compiling kernels, once, ") and "doctor --warm" in line


def compiling(name):
    decorators.COMPILATION_LOG.compiling(name)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no forks")
def test_forks_report_together(capfd):
    """`validate` compiles in one worker for each scene at a time."""
    with compilation_reported(), Workers() as pool, ThreadPoolExecutor(2) as threads:
        list(threads.map(partial(pool.call, compiling), "abcd"))
        decorators.COMPILATION_LOG.compiling("e")
    assert capfd.readouterr().err.count("\n") == 1


def test_every_command_reports_it(capsys, monkeypatch):
    def load(self, parser):
        parser.set_defaults(run=lambda args: decorators.COMPILATION_LOG.compiling("a kernel") or 0)

    monkeypatch.setattr(application.Command, "load", load)
    assert application.main("program", "about", [application.Command("go", "", "")], {}, ["go"]) == 0
    assert capsys.readouterr().err.startswith("compiling kernels, once")


WARMED = """
import importlib, pkgutil
import caster.rendering
from caster.jit.decorators import Kernel
from caster.rendering import warm_up

warm_up.warm_up(warm_up.warm_up_scenes())
found = pkgutil.iter_modules(caster.rendering.__path__)
modules = [importlib.import_module(f"caster.rendering.{module.name}") for module in found]
kernels = {k for module in modules for k in vars(module).values() if isinstance(k, Kernel)}
print(len(kernels), *sorted(k.__name__ for k in kernels if not k._codes))
"""
# Of rays that are looked at one by one, where the first of several hits is in doubt.
ONE_BY_ONE = {"hit_precedes"}


@compiled_only
@pytest.mark.slow("every kernel is loaded")
def test_every_kernel_that_rendering_calls_is_warmed():
    """Whatever is imported by a module of caster/rendering, in a process of its own."""
    count, *left = printed_by("-P", "-c", WARMED).split()
    assert int(count) > 30 and set(left) == ONE_BY_ONE
