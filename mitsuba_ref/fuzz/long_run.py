"""The long run: millions of rays per shape type against exact arithmetic, in scenes of a few shapes of that type."""

import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mitsuba_ref.fuzz.campaign import KEPT_PER_KIND_AND_FAMILY, case_of
from mitsuba_ref.fuzz.cases import SCENE_ERRORS, findings_of, write_kept
from mitsuba_ref.fuzz.checks import adjudicate
from mitsuba_ref.fuzz.families import scene_of, seed_of_name
from mitsuba_ref.fuzz.findings import Failure, Finding, Outcome, Tally, first_of_each_kind
from mitsuba_ref.fuzz.groups import nearly_equal_spheres
from mitsuba_ref.fuzz.settings import Fields, random_camera, random_setting, random_shape
from mitsuba_ref.fuzz.shrink import smallest_case
from mitsuba_ref.judge.independent_checks.aims import Setting, Targets, aimed_rays
from mitsuba_ref.judge.independent_checks.exact_rays import (
    cast_by_culling,
    concatenated,
    prepared_scene,
    with_limits,
)
from mitsuba_ref.report.results import aligned
from mitsuba_ref.shapes.targets import Rng

RAYS_PER_SCENE = 2048
LIMITED_RAYS_PER_SCENE = RAYS_PER_SCENE // 8  # cast again with other limits
MAX_SHAPES_PER_SCENE = 3
COLUMNS = ("shape", "rays", "hits", "edges", "ties", "worst t", "wrong", "rays/s")


class LongRun:
    """A number of rays per shape type; the outcome is complete at any moment."""

    def __init__(
        self, seed: int, rays: int, shapes: Sequence[str], folder: Path, keep: int = KEPT_PER_KIND_AND_FAMILY
    ) -> None:
        self.rays, self.folder, self.keep = rays, folder, keep
        self.outcome = Outcome(seed, {shape: Tally() for shape in shapes})
        self.seconds = dict.fromkeys(shapes, 0.0)

    @property
    def ok(self) -> bool:
        """Whether every shape type has had its rays, without a finding."""
        done = all(tally.rays >= self.rays for tally in self.outcome.families.values())
        return done and self.outcome.ok

    def run(self) -> Iterator[str]:
        """One scene after another; a line of progress after each."""
        for shape, tally in self.outcome.families.items():
            number = 0
            while tally.rays < self.rays:
                start = time.monotonic()
                self._check_scene(shape, number, tally)
                self.seconds[shape] += time.monotonic() - start
                number += 1
                yield f"{shape}: {tally.rays} of {self.rays} rays, {tally.findings} wrong"

    def _check_scene(self, shape: str, number: int, tally: Tally) -> None:
        rng = np.random.default_rng([self.outcome.seed, number, seed_of_name(shape)])
        setting, shapes = random_scene_of(rng, shape)
        film, camera = random_camera(rng, setting)
        data = {"film": film, "camera": camera, "shape": shapes}
        try:
            scene = prepared_scene(scene_of(data))
        except SCENE_ERRORS:
            tally.outside += 1
            return
        tally.examples += 1
        wanted = min(RAYS_PER_SCENE, self.rays - tally.rays)
        rays = aimed_rays(rng, Targets(scene.packed), setting, wanted)
        ours = cast_by_culling(scene.packed, rays, "bvh")
        limited = with_limits(rng, rays, ours, LIMITED_RAYS_PER_SCENE)
        unlimited = rays.taken(slice(max(wanted - len(limited.t_min), 1)))
        rays = concatenated(unlimited, limited.taken(slice(wanted - 1)))
        findings = adjudicate(scene, rays, cast_by_culling(scene.packed, rays, "bvh"), tally)
        for finding in findings:
            tally.count_finding(finding)
        for finding in first_of_each_kind(findings):
            if self.outcome.keeps(finding, shape, self.keep):
                self._keep(shape, number, data, finding)

    def _keep(self, shape: str, number: int, data: dict[str, Any], finding: Finding) -> None:
        small = smallest_case(case_of(data, finding.ray), finding)
        again = next((f for f in findings_of(small) if f.kind == finding.kind), finding)
        seed = self.outcome.seed
        options = f"--seed {seed} --shape {shape} --rays {self.rays}"
        name = f"{finding.kind}-{shape}-rays-{seed}-{number}"
        file = write_kept(self.folder, name, finding.kind, again.what, options, small)
        self.outcome.failures.append(Failure(finding.kind, again.what, shape, options, str(file)))

    def text(self) -> str:
        """A table with a row per shape type, the failures, and the sum."""
        lines = aligned([COLUMNS, *(self._cells(shape) for shape in self.outcome.families)], left=1)
        for failure in self.outcome.failures:
            lines.append(f"FAIL  {failure.kind}: {failure.what}")
            lines.append(f"      replay: mitsuba-ref fuzz --replay {failure.file}")
        total = self.outcome.total
        wrong = f", {total.kinds_text}" if total.kinds else ""
        lines.append(
            f"seed {self.outcome.seed}: {total.rays} rays in {total.examples} scenes, {total.findings} wrong{wrong}, "
            f"t off by at most {total.worst:.3f} of its bound, "
            f"in {sum(self.seconds.values()):.1f} s"
        )
        return "\n".join(lines)

    def _cells(self, shape: str) -> list[str]:
        tally = self.outcome.families[shape]
        speed = tally.rays / max(self.seconds[shape], 1e-9)
        counts = [str(count) for count in (tally.rays, tally.hits, tally.edges, tally.ties)]
        return [shape, *counts, f"{tally.worst:.3f}", str(tally.findings), f"{speed:.0f}"]

    def to_dict(self, *, interrupted: bool) -> dict[str, Any]:
        """The JSON of a long run."""
        return {
            "ok": self.ok,
            "interrupted": interrupted,
            "seed": self.outcome.seed,
            "rays_a_shape": self.rays,
            "seconds": {shape: round(s, 3) for shape, s in self.seconds.items()},
            "total": self.outcome.total.to_dict(),
            "shapes": {shape: tally.to_dict() for shape, tally in self.outcome.families.items()},
            "failures": [dict(vars(failure)) for failure in self.outcome.failures],
        }


def random_scene_of(rng: Rng, shape: str) -> tuple[Setting, list[Fields]]:
    """One to three shapes of a type; a third of the time two of them coincide."""
    setting = random_setting(rng)
    if shape == "sphere" and rng.random() < 0.2:
        return setting, nearly_equal_spheres(rng, setting)
    count = int(rng.integers(1, MAX_SHAPES_PER_SCENE + 1))
    shapes = [random_shape(rng, shape, setting) for _ in range(count)]
    if rng.random() < 1.0 / 3.0:
        shapes.append(dict(shapes[0]))
    return setting, shapes
