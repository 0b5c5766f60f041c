"""pytest --mitsuba-ref scenes/: every scene and check a test. Without the option nothing happens and nothing is loaded.

Entry point `mitsuba-ref` of the group pytest11; what runs then is in mitsuba_ref/runner/pytest_scenes.py.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pytest

OPTION = "--mitsuba-ref"


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("mitsuba-ref", "scenes judged against Mitsuba")
    group.addoption(
        OPTION,
        action="store_true",
        default=False,
        dest="mitsuba_ref",
        help="collect scene files, .toml and .json: a test for each check of each scene",
    )
    group.addoption(
        "--mitsuba-ref-size",
        nargs=2,
        type=int,
        metavar=("W", "H"),
        default=None,
        help="film in pixels, instead of the scenes' own; also the ini option mitsuba_ref_size",
    )
    parser.addini("mitsuba_ref_size", "film of the scenes in pixels: W H", type="args", default=[])
    folders = "folders beyond a scene's own whose meshes it may use"
    parser.addini("mitsuba_ref_mesh_dirs", folders, type="paths", default=[])


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("mitsuba_ref"):
        from mitsuba_ref.runner.pytest_scenes import ScenePlugin

        config.pluginmanager.register(ScenePlugin(config), "mitsuba-ref-scenes")
