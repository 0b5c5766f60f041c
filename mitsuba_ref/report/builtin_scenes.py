"""Scenes that are installed with the program, and their names on a command line: builtin:NAME."""

from collections.abc import Sequence
from pathlib import Path

from caster.description.errors import SceneError, suggestion

SETS = ("triangles", "spheres", "others")
ALL_SETS = "all"
ROOT = Path(__file__).resolve().parents[1] / "runner" / "builtin"  # a folder for each set
PREFIX = "builtin:"


def scene_path(name: str, sets: Sequence[str] = ()) -> str:
    """The path of a scene named builtin:NAME; any other name is a path already. Raises SceneError.

    sets: names that may stand there as well.
    """
    if not name.startswith(PREFIX):
        return name
    wanted = name.removeprefix(PREFIX)
    files = {file.stem: str(file) for file in sorted(ROOT.glob("*/*.toml"))}
    if wanted not in files:
        hint = suggestion(wanted, [*files, *sets]) or f"; they are {', '.join([*files, *sets])}"
        raise SceneError(f"{name}: expected a built-in scene{hint}")
    return files[wanted]


def folders_of(name: str | None) -> list[str]:
    """Folders of a set of built-in scenes, or of all; none for None. Raises SceneError for an unknown set."""
    if name not in (None, ALL_SETS, *SETS):
        known = (*SETS, ALL_SETS)
        raise SceneError(f"builtin {name!r}: unknown{suggestion(str(name), known)} (known: {', '.join(known)})")
    return [str(ROOT / each) for each in SETS if name in (each, ALL_SETS)]


def shown_path(path: str) -> str:
    """The path of a scene as a command names it: the reverse of `scene_path`."""
    return PREFIX + Path(path).stem if Path(path).is_relative_to(ROOT) else path
