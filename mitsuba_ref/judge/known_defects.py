"""Known defects of the reference: those that every kind of primitive declares, and which of them explains a pixel."""

from mitsuba_ref.error_model.defect_conditions import NAN_T, DefectFeatures, KnownDefect
from mitsuba_ref.shapes import KINDS


def known_defects() -> tuple[KnownDefect, ...]:
    """All that are declared, each once, in the order of their priority."""
    declared = {defect for kind in KINDS.values() for defect in kind.known_defects} | {NAN_T}
    return tuple(sorted(declared, key=lambda defect: (defect.priority, defect.number)))


def defect_name(number: int) -> str:
    """What the defect of this number is, in words."""
    return next(defect.name for defect in known_defects() if defect.number == number)


def defect_of(features: DefectFeatures) -> int | None:
    """The number of the first defect whose condition holds; None: wrong in a way that is not listed."""
    involved = [kind for kind in KINDS.values() if kind.name in features.kinds]
    found = [
        defect for kind in involved for defect in kind.known_defects if defect.applies(kind.name, features)
    ]
    if NAN_T.condition(features):
        found.append(NAN_T)
    return min(found, key=lambda defect: defect.priority).number if found else None
