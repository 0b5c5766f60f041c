"""Rectangle: Mitsuba's rectangle."""

from caster.shapes.rectangle import Rectangle
from mitsuba_ref.shapes.baked import native

REFERENCE = native(Rectangle, "rectangle")
