"""The registry of contestants, one per row of the tables, and their environments."""

import importlib.util
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from mitsuba_ref.bench.entries import ANY, AOVS, DEFAULT, FILM, NEAREST, PROCESS, ROBUST, SHADING, VALIDATION, Work
from mitsuba_ref.reference import variants

OURS, MITSUBA, PEER, MACHINE = "ours", "mitsuba", "peer", "machine"
CANDIDATE = "candidate"  # key of its row
ALL_TASKS = (FILM, NEAREST, ANY)


@dataclass(frozen=True)
class Contestant:
    """A row of the tables.

    first: pixels a side of its first cast, for contestants that may be too slow for the whole film; 0: none.
    most: primitives of a scene beyond which it is left out; 0: any number.
    every_aov: whether it gives more than depth and normal.
    """

    key: str
    title: str
    side: str
    entry: str  # as in Work
    workloads: tuple[str, ...]
    options: Mapping[str, Any] = field(default_factory=dict)
    variant: str = ""  # of Mitsuba
    package: str = ""  # that has to be installed
    threads: int | None = None  # instead of those of the run
    first: int = 0
    most: int = 0
    environment: Mapping[str, str] = field(default_factory=dict)
    every_aov: bool = False

    def missing(self) -> str:
        """Why it cannot run on this machine; "" if nothing is known to be missing."""
        if self.variant and self.variant not in variants.usable_variants().names:
            return f"{self.variant} does not work here: {variants.usable_variants().why}"
        if self.package and importlib.util.find_spec(self.package) is None:
            return f"{self.package} is not installed: pip install 'ray-reference[peers]'"
        return ""

    def work(self, folder: str, workload: str, threads: int) -> Work:
        return Work(folder, workload, self.threads or threads, self.entry, dict(self.options))

    def settings(self) -> dict[str, str]:
        """Its environment variables."""
        found = variants.environment_for(self.variant) if self.variant else {}
        return found | dict(self.environment)


def of_mitsuba(
    key: str, title: str, entry: str, workloads: tuple[str, ...], *, every_aov: bool = False, **options: Any
) -> Contestant:
    return Contestant(key, title, MITSUBA, entry, workloads, options, variant=variants.LLVM, every_aov=every_aov)


def of_shading(key: str, title: str, *aovs: str, shadows: bool = True) -> Contestant:
    options = {"aovs": aovs, "shadows": shadows}
    return Contestant(key, title, OURS, OWN, (SHADING,), options)


def of_process(key: str, title: str, side: str, workload: str, variant: str = "", **options: Any) -> Contestant:
    more = options | ({"variant": variant} if variant else {})
    return Contestant(key, title, side, COMMAND, (workload,), more, variant=variant, every_aov=True)


RAW, INTEGRATOR, OWN = "mitsuba_entries:RayIntersect", "mitsuba_entries:Integrator", "entries:Ours"
COMMAND = "entries:WholeProcess"

# Ratios are to the first contestant of a scene.
CONTESTANTS = (
    Contestant("ours", "ours, as planned", OURS, OWN, ALL_TASKS, every_aov=True),
    Contestant("ours-bvh", "ours, by BVH", OURS, OWN, (FILM,), {"culling": "bvh"}),
    Contestant("ours-1-thread", "ours, one thread", OURS, OWN, ALL_TASKS, threads=1, every_aov=True),
    Contestant(
        "ours-python",
        "ours, plain Python",
        OURS,
        OWN,
        ALL_TASKS,
        threads=1,
        first=4,
        most=300,
        environment={"CASTER_JIT": "0"},
    ),
    of_shading("shade-depth", "depth alone", "depth"),
    of_shading("shade-normal", "depth and normal", "depth", "normal"),
    of_shading("shade-smooth", "depth, normal, shading normal", "depth", "normal", "shading_normal"),
    of_shading(
        "shade-unshadowed", "depth, normal, diffuse without shadows", "depth", "normal", "diffuse", shadows=False
    ),
    of_shading("shade-shadowed", "depth, normal, diffuse with shadows", "depth", "normal", "diffuse"),
    of_mitsuba("raw-robust", "Mitsuba LLVM, robust, ray_intersect", RAW, ALL_TASKS, every_aov=True, mode=ROBUST),
    of_mitsuba("raw-default", "Mitsuba LLVM, default, ray_intersect", RAW, ALL_TASKS, mode=DEFAULT),
    of_mitsuba(
        "raw-robust-incoherent",
        "Mitsuba LLVM, robust, ray_intersect without `coherent`",
        RAW,
        ALL_TASKS,
        every_aov=True,
        mode=ROBUST,
        coherent=False,
    ),
    of_mitsuba(
        "aov-robust",
        "Mitsuba LLVM, robust, AOV integrator",
        INTEGRATOR,
        (FILM,),
        every_aov=True,
        mode=ROBUST,
        variant=variants.LLVM,
    ),
    of_mitsuba(
        "aov-default", "Mitsuba LLVM, default, AOV integrator", INTEGRATOR, (FILM,), mode=DEFAULT, variant=variants.LLVM
    ),
    Contestant(
        "scalar-aov",
        "Mitsuba scalar, robust, AOV integrator",
        MITSUBA,
        INTEGRATOR,
        (FILM,),
        {"mode": ROBUST, "variant": variants.SCALAR},
        variant=variants.SCALAR,
        first=32,
        every_aov=True,
    ),
    Contestant(
        "scalar-loop",
        "Mitsuba scalar, robust, loop in Python",
        MITSUBA,
        "mitsuba_entries:ScalarLoop",
        ALL_TASKS,
        {"mode": ROBUST},
        variant=variants.SCALAR,
        first=32,
    ),
    Contestant("open3d", "Open3D", PEER, "entries:Open3D", ALL_TASKS, package="open3d"),
    Contestant("embreex", "embreex", PEER, "entries:Embreex", ALL_TASKS, package="embreex"),
    Contestant("trimesh", "trimesh + embreex", PEER, "entries:Trimesh", ALL_TASKS, package="trimesh"),
    Contestant("copy", "copying the images", MACHINE, "entries:Copying", (FILM,)),
    of_process("ours-process", "caster render", OURS, PROCESS, program="caster"),
    of_process("llvm-process", "mitsuba, LLVM", MITSUBA, PROCESS, variants.LLVM, program="mitsuba"),
    of_process("scalar-process", "mitsuba, scalar", MITSUBA, PROCESS, variants.SCALAR, program="mitsuba"),
    of_process("validate", "validate, no store of answers", OURS, VALIDATION, program="validate"),
    of_process("validate-store", "validate, answers stored", OURS, VALIDATION, program="validate", store=True),
)
BY_KEY = {contestant.key: contestant for contestant in CONTESTANTS}


def contestants_for(workload: str, *, peers: bool, aovs: Sequence[str] = AOVS) -> list[Contestant]:
    """The contestants of a task; other AOVs than depth and normal by those that give them."""
    found = [each for each in CONTESTANTS if workload in each.workloads and (peers or each.side != PEER)]
    if workload == SHADING or tuple(aovs) == AOVS:
        return found
    return [
        replace(each, options={**each.options, "aovs": tuple(aovs)})
        for each in found
        if each.every_aov or (set(aovs) <= set(AOVS) and each.key != "copy")
    ]


def candidate_contestant(text: str, precision: str | None, *, served: bool) -> Contestant:
    """A candidate that takes rays; they are as few as it casts in MAX_CAST_S."""
    options = {"text": text, "precision": precision, "served": served, "folder": os.getcwd()}
    return Contestant(CANDIDATE, text, PEER, "entries:Candidate", ALL_TASKS, options, first=32)


def processors() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
