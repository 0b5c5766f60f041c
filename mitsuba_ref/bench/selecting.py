"""Which scenes a run is about."""

from collections.abc import Sequence

from caster.wording import SceneError, suggestion
from mitsuba_ref.bench.scenes import SCENES, BenchScene
from mitsuba_ref.selection import matching


def selected(words: Sequence[str], expression: str | None = None) -> list[BenchScene]:
    """Scenes by name, all without words, that fit the expression; in the order of the registry.

    Raises SceneError for a name that is none.
    """
    known = [scene.name for scene in SCENES]
    for word in words:
        if word not in known:
            raise SceneError(f"scene '{word}': unknown{suggestion(word, known)} (known: {', '.join(known)})")
    fits = matching(expression)
    return [scene for scene in SCENES if (not words or scene.name in words) and fits(scene.name)]
