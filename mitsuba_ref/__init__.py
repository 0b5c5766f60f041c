"""The judge: the same scene and the same rays given to Mitsuba 3, every pixel compared within a derived bound.

The names below are imported when they are first used, so that `import mitsuba_ref` loads no compiler.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from caster.system import NOT_HERE as _NOT_HERE

if TYPE_CHECKING:
    from caster.description.errors import SceneError
    from mitsuba_ref.exr_compare.two_files import Reading, Tolerances, compare_exr
    from mitsuba_ref.judge.aggregate import FailingPixel
    from mitsuba_ref.judge.verdict import CLASSES, SceneVerdict, Verdict
    from mitsuba_ref.python_api import export_xml, judge_hits, probe_pixel, validate
    from mitsuba_ref.reference.messages import MitsubaError
    from mitsuba_ref.reference.original_files import import_xml
    from mitsuba_ref.reference.rendering import render_reference
    from mitsuba_ref.report.validation import Validation

_HOMES = {
    "CLASSES": ".judge.verdict",
    "FailingPixel": ".judge.aggregate",
    "MitsubaError": ".reference.messages",
    "Reading": ".exr_compare.two_files",
    "SceneError": "caster.description.errors",
    "SceneVerdict": ".judge.verdict",
    "Tolerances": ".exr_compare.two_files",
    "Validation": ".report.validation",
    "Verdict": ".judge.verdict",
    "compare_exr": ".exr_compare.two_files",
    "export_xml": ".python_api",
    "import_xml": ".reference.original_files",
    "judge_hits": ".python_api",
    "probe_pixel": ".python_api",
    "render_reference": ".reference.rendering",
    "validate": ".python_api",
}

__all__ = [
    "CLASSES",
    "FailingPixel",
    "MitsubaError",
    "Reading",
    "SceneError",
    "SceneVerdict",
    "Tolerances",
    "Validation",
    "Verdict",
    "compare_exr",
    "export_xml",
    "import_xml",
    "judge_hits",
    "probe_pixel",
    "render_reference",
    "validate",
]


if not TYPE_CHECKING:  # a type checker has to find misspelt names

    def __getattr__(name: str) -> Any:
        if name not in _HOMES:
            raise AttributeError(f"module 'mitsuba_ref' has no attribute '{name}'")
        if _NOT_HERE:
            raise ImportError(_NOT_HERE)
        value = globals()[name] = getattr(import_module(_HOMES[name], "mitsuba_ref"), name)
        return value


def __dir__() -> list[str]:
    return sorted(__all__)
