"""What a render did, why so, and what it left out."""

from collections.abc import Iterator, Sequence

from caster.aovs import BY_NAME
from caster.casting import Culling, worth_a_tree
from caster.left_out import in_words
from caster.packing import Kind
from caster.plan import plan
from caster.rendering import Rendered
from caster.scene import Scene


def explain(rendered: Rendered, aovs: Sequence[str]) -> str:
    """Lines for `caster render --explain`."""
    lines = (
        *_rays(rendered),
        *_primitives(rendered),
        *_doubts(rendered),
        *_surfaces(rendered),
        *_shadows(rendered.scene, aovs),
        *_aovs(aovs),
    )
    return "\n".join(f"{what:<12} {text}" for what, text in lines)


def _rays(rendered: Rendered) -> Iterator[tuple[str, str]]:
    camera, film = rendered.scene.camera, rendered.scene.film
    x0, y0, x1, y1 = film.window
    start = "from one point" if camera.shares_origin else "from a point each"
    size = f"{x1 - x0} x {y1 - y0} of a film of {film.width} x {film.height}"
    yield "camera rays", f"{(x1 - x0) * (y1 - y0)} {start}: {camera.type}, {size}"
    chosen = plan(camera.pack(film.width, film.height))
    yield "culling", f"{chosen.culling}: {chosen.reason}"


def _primitives(rendered: Rendered) -> Iterator[tuple[str, str]]:
    for kind in rendered.packed.kinds:
        way = _way(kind, rendered.culling)
        yield "primitives", f"{type(kind.prims).__name__.lower()}, {len(kind.ids)}: {way}"
    if not rendered.packed.kinds:
        yield "primitives", "none: every ray misses"
    if words := in_words(rendered.scene):
        yield "never hit", words


def _doubts(rendered: Rendered) -> Iterator[tuple[str, str]]:
    if rendered.doubtful is not None:
        yield "decided", f"{rendered.doubtful} pixels exactly, where float64 could not tell"


def _way(kind: Kind, culling: Culling) -> str:
    if not kind.bounded:
        return "tried by every ray, since they have no bounds"
    if culling == "screen":
        return "tried in the pixels around their pictures"
    return f"a tree of {len(kind.tree.links)} boxes" if worth_a_tree(kind) else "too few for a tree"


def _surfaces(rendered: Rendered) -> Iterator[tuple[str, str]]:
    hits, what = int(rendered.aovs.hit.sum()), ", ".join(rendered.surfaces)
    done = f"worked out for {hits} hits: {what}"
    yield "surfaces", done if rendered.surfaces else "skipped: no AOV asked for needs them"


def _shadows(scene: Scene, aovs: Sequence[str]) -> Iterator[tuple[str, str]]:
    casting = [light for light in scene.lights if light.type != "ambient"]
    if "diffuse" not in aovs:
        yield "shadow rays", "skipped: diffuse was not asked for"
    elif not casting:
        yield "shadow rays", "skipped: no light of the scene casts shadows"
    elif not scene.shading.shadows:
        yield "shadow rays", "skipped: the scene switches shadows off"
    else:
        yield (
            "shadow rays",
            f"from each hit to the lights it faces (of {len(casting)}), through trees of boxes",
        )


def _aovs(aovs: Sequence[str]) -> Iterator[tuple[str, str]]:
    yield "AOVs", ", ".join(aovs)
    left_out = [name for name in BY_NAME if name not in aovs]
    yield "skipped", ", ".join(left_out) if left_out else "no AOV"
