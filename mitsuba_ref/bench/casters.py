"""The registry of timed ray casters, one for each row of the tables."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mitsuba_ref.bench.drivers import DEFAULT, FILM, NEAREST, ROBUST
from mitsuba_ref.bench.result import REFERENCE_ROW
from mitsuba_ref.reference import variants


@dataclass(frozen=True)
class TimedCaster:
    """A row of the tables."""

    key: str
    title: str
    driver: str  # as in Work
    workloads: tuple[str, ...] = (FILM, NEAREST)
    options: Mapping[str, Any] = field(default_factory=dict)
    first: int = 0  # pixels a side of the first cast, where the whole film may take too long; 0: the whole film

    @property
    def variant(self) -> str:
        """The Mitsuba variant; "" for others."""
        return str(self.options.get("variant", ""))

    def missing(self) -> str:
        """The reason why it cannot run on this machine; "" if there is none."""
        works = not self.variant or self.variant in variants.usable_variants().names
        return "" if works else f"{self.variant} does not work here"


def of_mitsuba(key: str, title: str, driver: str, mode: str, variant: str = variants.LLVM, **more: Any) -> TimedCaster:
    options = {"mode": mode, "variant": variant}
    return TimedCaster(key, f"Mitsuba {title}", f"mitsuba_drivers:{driver}", options=options, **more)


RAW, INTEGRATOR = "RayIntersect", "Integrator"

# Ratios are to the first caster.
CASTERS = (
    TimedCaster(REFERENCE_ROW, "ours", "drivers:Ours"),
    of_mitsuba("raw-robust", "LLVM, robust, ray_intersect", RAW, ROBUST),
    of_mitsuba("raw-default", "LLVM, default, ray_intersect", RAW, DEFAULT),
    of_mitsuba("aov-robust", "LLVM, robust, AOV integrator", INTEGRATOR, ROBUST, workloads=(FILM,)),
    of_mitsuba(
        "scalar-aov", "scalar, robust, AOV integrator", INTEGRATOR, ROBUST, variants.SCALAR, first=32, workloads=(FILM,)
    ),
)
BY_KEY = {caster.key: caster for caster in CASTERS}
