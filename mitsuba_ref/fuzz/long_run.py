"""Rays by the million, shape by shape: scenes of a few shapes of one type, and a thousand rays aimed at each."""

import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mitsuba_ref.fuzz import kinds
from mitsuba_ref.fuzz.aims import Targets, aimed_rays
from mitsuba_ref.fuzz.campaign import KEPT_PER_KIND_AND_FAMILY, Failure, case_of
from mitsuba_ref.fuzz.cases import SCENE_ERRORS, findings_of, write_kept
from mitsuba_ref.fuzz.checks import adjudicate, cast_by_culling, concatenated, prepared_scene, with_limits
from mitsuba_ref.fuzz.families import scene_of, seed_of_name
from mitsuba_ref.fuzz.findings import Finding, Tally, first_of_each_kind
from mitsuba_ref.fuzz.groups import nearly_equal_spheres
from mitsuba_ref.fuzz.kinds import random_shape
from mitsuba_ref.fuzz.settings import Setting, random_setting
from mitsuba_ref.fuzz.shrink import smallest_case
from mitsuba_ref.shapes.targets import Rng

RAYS_PER_SCENE = 2048
LIMITED_RAYS_PER_SCENE = RAYS_PER_SCENE // 8  # cast again with other limits
MAX_SHAPES_PER_SCENE = 3


class LongRun:
    """So many rays a shape; what has been done so far is there at any moment."""

    def __init__(
        self, seed: int, rays: int, shapes: Sequence[str], folder: Path, keep: int = KEPT_PER_KIND_AND_FAMILY
    ) -> None:
        self.seed, self.rays, self.shapes, self.folder, self.keep = seed, rays, shapes, folder, keep
        self.tallies = {shape: Tally() for shape in shapes}
        self.seconds = dict.fromkeys(shapes, 0.0)
        self.failures: list[Failure] = []

    @property
    def ok(self) -> bool:
        """Every shape has had its rays, and nothing was found."""
        done = all(tally.rays >= self.rays for tally in self.tallies.values())
        return done and not any(tally.findings for tally in self.tallies.values())

    def run(self) -> Iterator[None]:
        """One scene after another."""
        for shape in self.shapes:
            number = 0
            while self.tallies[shape].rays < self.rays:
                start = time.monotonic()
                self._try(shape, number)
                self.seconds[shape] += time.monotonic() - start
                number += 1
                yield

    def _try(self, shape: str, number: int) -> None:
        rng = np.random.default_rng([self.seed, number, seed_of_name(shape)])
        setting, shapes = random_scene_of(rng, shape)
        film, camera = kinds.random_camera(rng, setting)
        data = {"film": film, "camera": camera, "shape": shapes}
        tally = self.tallies[shape]
        try:
            subject = prepared_scene(scene_of(data))
        except SCENE_ERRORS:
            tally.outside += 1
            return
        tally.examples += 1
        wanted = min(RAYS_PER_SCENE, self.rays - tally.rays)
        shots = aimed_rays(rng, Targets(subject.packed), setting, wanted)
        ours = cast_by_culling(subject.packed, shots, "bvh")
        limited = with_limits(rng, shots, ours, LIMITED_RAYS_PER_SCENE)
        shots = concatenated(
            shots.taken(slice(max(wanted - len(limited.t_min), 1))), limited.taken(slice(wanted - 1))
        )
        ours = cast_by_culling(subject.packed, shots, "bvh")
        findings = adjudicate(subject, shots, ours, tally)
        for finding in findings:
            tally.found(finding)
        for finding in first_of_each_kind(findings):
            self._keep(shape, number, data, finding)

    def _keep(self, shape: str, number: int, data: dict[str, Any], finding: Finding) -> None:
        sort = [
            failure for failure in self.failures if (failure.kind, failure.family) == (finding.kind, shape)
        ]
        if len(sort) >= self.keep:
            return
        small = smallest_case(case_of(data, finding.ray), finding)
        again = next((f for f in findings_of(small) if f.kind == finding.kind), finding)
        options = f"--seed {self.seed} --shape {shape} --rays {self.rays}"
        name = f"{finding.kind}-{shape}-rays-{self.seed}-{number}"
        file = write_kept(self.folder, name, finding.kind, again.what, options, small)
        self.failures.append(Failure(finding.kind, again.what, shape, options, str(file)))

    def line(self) -> str:
        """For a terminal."""
        shape = next((s for s in reversed(self.shapes) if self.tallies[s].rays), self.shapes[0])
        tally = self.tallies[shape]
        return f"{shape}: {tally.rays} of {self.rays} rays, {tally.findings} wrong"

    def text(self) -> str:
        """A row a shape, the failures, and the sum."""
        rows = [
            f"{'shape':<12}  {'rays':>10}  {'hits':>10}  {'edges':>10}  {'ties':>10}  {'worst t':>7}  {'wrong':>7}"
            "   rays/s"
        ]
        for shape, t in self.tallies.items():
            speed = t.rays / max(self.seconds[shape], 1e-9)
            rows.append(
                f"{shape:<12}  {t.rays:>10}  {t.hits:>10}  {t.edges:>10}  {t.ties:>10}  {t.worst:>7.3f}  "
                f"{t.findings:>7}  {speed:>7.0f}"
            )
        for failure in self.failures:
            rows += [
                f"FAIL  {failure.kind}: {failure.what}",
                f"      replay: mitsuba-ref fuzz --replay {failure.file}",
            ]
        total = self.total
        wrong = "".join(f", {n} {kind}" for kind, n in sorted(total.kinds.items()))
        rows.append(
            f"seed {self.seed}: {total.rays} rays in {total.examples} scenes, {total.findings} wrong{wrong}, "
            f"t off by at most {total.worst:.3f} of its bound, "
            f"in {sum(self.seconds.values()):.1f} s"
        )
        return "\n".join(rows)

    @property
    def total(self) -> Tally:
        total = Tally()
        for tally in self.tallies.values():
            total.add(tally)
        return total

    def to_dict(self, *, interrupted: bool) -> dict[str, Any]:
        """As --json has it."""
        return {
            "ok": self.ok,
            "interrupted": interrupted,
            "seed": self.seed,
            "rays_a_shape": self.rays,
            "seconds": {shape: round(s, 3) for shape, s in self.seconds.items()},
            "total": self.total.to_dict(),
            "shapes": {shape: tally.to_dict() for shape, tally in self.tallies.items()},
            "failures": [dict(vars(failure)) for failure in self.failures],
        }


def random_scene_of(rng: Rng, shape: str) -> tuple[Setting, list[dict[str, Any]]]:
    """One to three shapes of a type; a third of the time two of them in one place."""
    setting = random_setting(rng)
    if shape == "sphere" and rng.random() < 0.2:
        return setting, nearly_equal_spheres(rng, setting)
    shapes = [
        random_shape(rng, shape, setting) for _ in range(int(rng.integers(1, MAX_SHAPES_PER_SCENE + 1)))
    ]
    if rng.random() < 1.0 / 3.0:
        shapes.append(dict(shapes[0]))
    return setting, shapes
