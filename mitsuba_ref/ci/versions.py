"""What a verdict hangs on beside sources and scenes: Mitsuba, its variant and libLLVM, libraries, the machine."""

import importlib.metadata
import platform
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from mitsuba_ref import variants
from mitsuba_ref.verdict import Verdict

# Python, OpenEXR and pydantic read and write; these compute.
LIBRARIES = ("mitsuba", "drjit", "numpy", "numba", "llvmlite")
OF_SCENES = (
    "mitsuba",
    "drjit",
)  # what each answer of Mitsuba says of itself; the variant may be another by scene
NONE = "none"


def judged_with() -> dict[str, str]:
    """Of the run that is going on. Raises VariantError."""
    flat, quadrics = (variants.variant_for(has_quadrics=each) for each in (False, True))
    library = variants.usable().libllvm if variants.LLVM in (flat, quadrics) else None
    return {
        "machine": platform.machine(),
        **{name: _installed(name) for name in LIBRARIES},
        "variant of triangles": flat,
        "variant of quadrics": quadrics,
        "libLLVM": version_in(library or NONE),
    }


def _installed(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return NONE


def version_in(library: str) -> str:
    """libLLVM's, by the name of its file: folders differ between systems. 19.1 of /usr/lib/libLLVM.so.19.1."""
    return ".".join(re.findall(r"\d+", Path(library).name)) or library


def other_versions(parts: Sequence[tuple[str, Verdict]]) -> list[str]:
    """What parts were judged with that others were not, a sentence each; parts: (where it is from, verdict)."""
    known: dict[str, tuple[str, str]] = {}
    found: dict[str, None] = {}
    for place, part in parts:
        for what, version in _told(part):
            first, before = known.setdefault(what, (place, version))
            if version != before:
                found[f"{place} was judged with {what} {version}, {first} with {before}"] = None
    return list(found)


def _told(part: Verdict) -> Iterator[tuple[str, str]]:
    yield from part.judged_with.items()
    for scene in part.scenes:
        yield from ((name, scene.versions[name]) for name in OF_SCENES if name in scene.versions)
        library = scene.versions.get("libllvm", NONE)
        if library != NONE:
            yield "libLLVM", version_in(library)


def together(parts: Sequence[Verdict]) -> dict[str, str]:
    """What all of them were judged with; several of a kind beside each other."""
    kinds = dict.fromkeys(what for part in parts for what in part.judged_with)
    return {
        what: " and ".join(dict.fromkeys(part.judged_with.get(what, "?") for part in parts)) for what in kinds
    }
