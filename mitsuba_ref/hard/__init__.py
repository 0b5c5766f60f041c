"""The catalogue of numerically hard scenes and rays: `stress` sweeps its families, `fuzz` draws from all of them."""

from mitsuba_ref.hard.family import Family
from mitsuba_ref.hard.random_families import RANDOM
from mitsuba_ref.hard.swept_families import SPAWNED, SWEPT

FAMILIES: tuple[Family, ...] = (*RANDOM, *SWEPT, *SPAWNED)
BY_NAME = {family.name: family for family in FAMILIES}
