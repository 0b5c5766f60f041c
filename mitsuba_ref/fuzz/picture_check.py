"""Camera rays: the pictures of all cullings to the bit, and what they show held to the oracle."""

from collections.abc import Iterator

import numpy as np

from caster.casting import Culling
from caster.plan import culling_for
from caster.rendering import Aovs, camera_rays, render
from mitsuba_ref.exact import OutsideDomain
from mitsuba_ref.fuzz.aims import Shots
from mitsuba_ref.fuzz.finding import Finding, Tally
from mitsuba_ref.fuzz.rays_check import Subject, count_exact, disagreement
from mitsuba_ref.fuzz.routes import Found
from mitsuba_ref.fuzz.t_bound import t_bounds
from mitsuba_ref.verdict import pixel_of

NAMES = ("depth", "normal", "shading_normal", "position", "shape_id", "prim_id")

# depth = t |d|: the length passes at most 4 roundings, the product one, and t is found again by a division.
DEPTH_ULPS = 4.0


def cullings_of(subject: Subject) -> tuple[Culling, ...]:
    """Those that the scene's camera allows."""
    film = subject.scene.film
    planned = culling_for(subject.scene.camera.pack(film.width, film.height))[0]
    return ("everything", "bvh", "screen") if planned == "screen" else ("everything", "bvh")


def check_picture(subject: Subject, tally: Tally) -> list[Finding]:
    """All that is wrong with the scene's own picture."""
    pictures = {
        culling: render(subject.scene, NAMES, culling=culling, threads=1) for culling in cullings_of(subject)
    }
    obvious = pictures["everything"]
    findings = [f for name in pictures for f in _differences(subject, obvious, pictures[name], name)]
    return findings + _adjudicate(subject, obvious, tally)


def _differences(subject: Subject, obvious: Aovs, other: Aovs, name: str) -> Iterator[Finding]:
    for aov in NAMES:
        a, b = (np.ascontiguousarray(images[aov]).view(np.uint8) for images in (obvious, other))
        size = len(obvious.hit.ravel())
        for i in np.flatnonzero((a.reshape(size, -1) != b.reshape(size, -1)).any(axis=1)):
            values = (images[aov].reshape(size, -1)[i].tolist() for images in (obvious, other))
            what = f"{aov}: everything: {next(values)}; {name}: {next(values)}"
            yield Finding("culling", what, pixel=pixel_of(subject.scene, int(i)))


def _adjudicate(subject: Subject, picture: Aovs, tally: Tally) -> list[Finding]:
    scene, packed = subject.scene, subject.packed
    rays = camera_rays(scene, threads=1)
    shots = Shots(rays.o, rays.d, rays.t_min, rays.t_max)
    try:
        answers = subject.oracle.ask_all(*shots)
    except OutsideDomain:
        tally.outside += len(rays.t_min)
        return []
    shape, prim = picture["shape_id"].ravel(), picture["prim_id"].ravel()
    length = np.sqrt((rays.d * rays.d).sum(axis=1))
    depth = picture["depth"].ravel()
    number = np.where(shape < 0, -1, packed.first[np.maximum(shape, 0)] + prim)
    found = Found(depth / length, number)
    bounds = t_bounds(scene, packed, found, rays.o, rays.d) + DEPTH_ULPS * np.spacing(np.abs(found.t))
    count_exact(tally, answers, bounds)
    rows = zip(answers, found.t.tolist(), found.prim.tolist(), bounds.tolist(), strict=True)
    wrong = ((i, disagreement(answer, *rest)) for i, (answer, *rest) in enumerate(rows))
    return [
        Finding(kind, what, shots.taken(slice(i, i + 1)), pixel_of(scene, i))
        for i, (kind, what) in wrong
        if kind
    ]
