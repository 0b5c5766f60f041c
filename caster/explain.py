"""What a render did, why so, and what it left out: read off the view that was rendered."""

from collections.abc import Iterator, Sequence

from caster.aovs import BY_NAME
from caster.casting import Culling, worth_a_tree
from caster.left_out import in_words
from caster.packing import Kind
from caster.plan import plan
from caster.view import View


def explain(view: View, aovs: Sequence[str]) -> str:
    """Lines for `caster render --explain`."""
    lines = (*_rays(view), *_primitives(view), *_surfaces(view), *_shadows(view, aovs), *_aovs(aovs))
    return "\n".join(f"{what:<12} {text}" for what, text in lines)


def _rays(view: View) -> Iterator[tuple[str, str]]:
    camera, film = view.scene.camera, view.scene.film
    x0, y0, x1, y1 = film.window
    start = "from one point" if camera.shares_origin else "from a point each"
    size = f"{x1 - x0} x {y1 - y0} of a film of {film.width} x {film.height}"
    yield "camera rays", f"{len(view.rays.t_min)} {start}: {camera.type}, {size}"
    chosen = plan(camera.pack(film.width, film.height))
    yield "culling", f"{chosen.culling}: {chosen.reason}"


def _primitives(view: View) -> Iterator[tuple[str, str]]:
    culling = plan(view.scene.camera.pack(1, 1)).culling
    for kind in view.packed.kinds:
        yield "primitives", f"{type(kind.prims).__name__.lower()}, {len(kind.ids)}: {_way(kind, culling)}"
    if not view.packed.kinds:
        yield "primitives", "none: every ray misses"
    if words := in_words(view.scene):
        yield "never hit", words


def _way(kind: Kind, culling: Culling) -> str:
    if not kind.bounded:
        return "tried by every ray, since they have no bounds"
    if culling == "screen":
        return "tried in the pixels around their pictures"
    return f"a tree of {len(kind.tree.links)} boxes" if worth_a_tree(kind) else "too few for a tree"


def _surfaces(view: View) -> Iterator[tuple[str, str]]:
    hits = int(view.hit.sum())
    done = f"worked out for {hits} hits: position, normals, uv"
    yield "surfaces", done if "surfaces" in vars(view) else "skipped: no AOV asked for needs them"


def _shadows(view: View, aovs: Sequence[str]) -> Iterator[tuple[str, str]]:
    casting = [light for light in view.scene.lights if light.type != "ambient"]
    if "diffuse" not in aovs:
        yield "shadow rays", "skipped: diffuse was not asked for"
    elif not casting:
        yield "shadow rays", "skipped: no light of the scene casts shadows"
    elif not view.scene.shading.shadows:
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
