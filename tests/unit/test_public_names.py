"""The public names of caster: complete, typed and loaded on first use."""

from places import ROOT
from programs import printed_by

import caster
from caster.cameras import CAMERAS
from caster.scene.model import LIGHTS
from caster.shapes import SHAPES

REGISTERED = {entry.__name__: entry for entry in (*SHAPES, *CAMERAS, *LIGHTS)}


def test_all_names_what_there_is_and_nothing_else():
    assert set(caster.__all__) <= set(dir(caster)) and REGISTERED.keys() <= set(caster.__all__)
    assert all(getattr(caster, name) is entry for name, entry in REGISTERED.items())


def test_importing_caster_loads_no_package_but_itself():
    source = "import sys, caster; print(*{name.partition('.')[0] for name in sys.modules})"
    loaded = printed_by("-c", source).split()
    assert "caster" in loaded
    assert not {"numba", "llvmlite", "numpy", "pydantic", "OpenEXR"} & set(loaded)


def test_no_module_of_the_package_hides_a_public_name():
    """A module caster/render.py would take the place of the function caster.render once it is imported."""
    modules = {path.stem for path in (ROOT / "caster").iterdir() if path.suffix == ".py" or path.is_dir()}
    assert "rendering" in modules
    assert not modules & set(caster.__all__)
