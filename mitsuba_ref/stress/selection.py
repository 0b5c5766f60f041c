"""Which families a run is about."""

from collections.abc import Sequence

from caster.description.errors import SceneError, suggestion
from mitsuba_ref.runner.scene_selection import matching
from mitsuba_ref.stress.family import Family


def select_families(families: Sequence[Family], words: Sequence[str], expression: str | None) -> list[Family]:
    """Families by name, or by the part of it before a dash; all of them without words. In the registry's order.

    Raises SceneError for a word that is neither, or an expression that does not read.
    """
    known = [family.name for family in families]
    groups = [name.partition("-")[0] for name in known]
    for word in words:
        if word not in (*known, *groups):
            names = ", ".join(known)
            raise SceneError(
                f"family '{word}': unknown{suggestion(word, [*known, *groups])} (known: {names})"
            )
    fits = matching(expression)
    named = (
        family
        for family in families
        if not words or {family.name, family.name.partition("-")[0]} & set(words)
    )
    return [family for family in named if fits(family.name)]
