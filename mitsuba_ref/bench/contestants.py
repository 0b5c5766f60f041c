"""The registry of contestants, one per row of the tables, and their environments."""

import importlib.util
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mitsuba_ref.bench.entries import ANY, AOVS, DEFAULT, FILM, NEAREST, ROBUST, Work
from mitsuba_ref.reference import variants

OURS, MITSUBA, PEER = "ours", "mitsuba", "peer"
CANDIDATE = "candidate"  # key of its row
ALL_WORKLOADS = (FILM, NEAREST, ANY)


@dataclass(frozen=True)
class Contestant:
    """A row of the tables."""

    key: str
    title: str
    side: str
    entry: str  # as in Work
    workloads: tuple[str, ...] = ALL_WORKLOADS
    options: Mapping[str, Any] = field(default_factory=dict)
    package: str = ""  # that has to be installed
    threads: int | None = None  # instead of those of the run
    first: int = 0  # pixels a side of the first cast, where the whole film may take too long; 0: the whole film
    every_aov: bool = False  # whether it gives more than depth and normal

    @property
    def variant(self) -> str:
        """Of Mitsuba; "" for others."""
        return str(self.options.get("variant", ""))

    def missing(self) -> str:
        """Why it cannot run on this machine; "" if nothing is known to be missing."""
        if self.variant and self.variant not in variants.usable_variants().names:
            return f"{self.variant} does not work here: {variants.usable_variants().why}"
        if self.package and importlib.util.find_spec(self.package) is None:
            return f"{self.package} is not installed: pip install 'ray-reference[peers]'"
        return ""

    def work(self, folder: str, workload: str, threads: int, aovs: Sequence[str]) -> Work:
        return Work(folder, workload, self.threads or threads, self.entry, tuple(aovs), dict(self.options))

    def environment(self) -> dict[str, str]:
        return variants.environment_for(self.variant) if self.variant else {}


def of_mitsuba(key: str, title: str, entry: str, mode: str, variant: str = variants.LLVM, **more: Any) -> Contestant:
    options = {"mode": mode, "variant": variant}
    return Contestant(key, f"Mitsuba {title}", MITSUBA, f"mitsuba_entries:{entry}", options=options, **more)


OWN, SCALAR = "entries:Ours", variants.SCALAR

# Ratios are to the first contestant.
CONTESTANTS = (
    Contestant("ours", "ours, as planned", OURS, OWN, every_aov=True),
    Contestant("ours-bvh", "ours, by BVH", OURS, OWN, (FILM,), {"culling": "bvh"}),
    Contestant("ours-1-thread", "ours, one thread", OURS, OWN, threads=1, every_aov=True),
    of_mitsuba("raw-robust", "LLVM, robust, ray_intersect", "RayIntersect", ROBUST, every_aov=True),
    of_mitsuba("raw-default", "LLVM, default, ray_intersect", "RayIntersect", DEFAULT),
    of_mitsuba("aov-robust", "LLVM, robust, AOV integrator", "Integrator", ROBUST, every_aov=True, workloads=(FILM,)),
    of_mitsuba(
        "scalar-aov",
        "scalar, robust, AOV integrator",
        "Integrator",
        ROBUST,
        variants.SCALAR,
        first=32,
        workloads=(FILM,),
    ),
    Contestant("open3d", "Open3D", PEER, "entries:Open3D", package="open3d"),
    Contestant("trimesh", "trimesh + embreex", PEER, "entries:Trimesh", package="trimesh"),
)
BY_KEY = {contestant.key: contestant for contestant in CONTESTANTS}


def contestants_for(workload: str, *, peers: bool, aovs: Sequence[str] = AOVS) -> list[Contestant]:
    """The contestants of a workload; other AOVs than depth and normal by those that give them."""
    plain = set(aovs) <= set(AOVS)
    found = [each for each in CONTESTANTS if workload in each.workloads and (peers or each.side != PEER)]
    return [each for each in found if plain or each.every_aov]


def candidate_contestant(text: str, precision: str | None, *, served: bool) -> Contestant:
    """A candidate that takes rays: as many as it casts in MAX_CAST_S."""
    options = {"text": text, "precision": precision, "served": served, "folder": os.getcwd()}
    return Contestant(CANDIDATE, text, PEER, "entries:Candidate", options=options, first=32)


def processors() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
