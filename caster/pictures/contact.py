"""A small picture of each of many scenes."""

import numpy as np

from caster.pictures.views import Picture, view
from caster.rendering import render
from caster.scene import Scene

UNLIT = "normal"  # what is shown of a scene without lights, which would be black


def thumbnail(
    scene: Scene, name: str, side: int, aov: str = "diffuse", threads: int | None = None
) -> Picture:
    """The scene rendered so that its longer side is `side` pixels, or a whole part of that if it has fewer."""
    film = scene.film
    share = min(1.0, side / max(film.width, film.height))
    small = scene.with_film(
        width=max(1, round(share * film.width)), height=max(1, round(share * film.height))
    )
    aov = aov if aov != "diffuse" or scene.lights else UNLIT
    aovs = render(small, (aov,), threads=threads)
    picture = view(aov, aovs[aov].astype(np.float64) if aov == "hit" else aovs[aov], aovs.hit)
    times = max(1, side // max(picture.pixels.shape[:2]))
    return Picture(name, picture.pixels.repeat(times, axis=0).repeat(times, axis=1), picture.words)


def columns_for(count: int, ratio: float = 1.5) -> int:
    """So many that a sheet of square cells is about `ratio` times as wide as high."""
    return max(1, round(float(np.sqrt(ratio * count))))
