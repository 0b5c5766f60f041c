"""Conversion of <bsdf> to diffuse materials and of <emitter> to lights."""

from itertools import count
from typing import Any

import numpy as np

from mitsuba_ref.importers.scene_builder import SceneBuilder, composed_matrix, transform_steps
from mitsuba_ref.importers.xml_document import Node, resolve_reference

WRAPPERS = ("twosided", "mask", "bumpmap", "normalmap")  # around one bsdf
DIFFUSE_COLOR_NAMES = (
    "reflectance",
    "diffuse_reflectance",
    "base_color",
)  # names of the diffuse colour of bsdfs
DEFAULT_REFLECTANCE = [0.5, 0.5, 0.5]  # Mitsuba's default of diffuse


def material_of(out: SceneBuilder, shape: Node) -> str:
    """The name of the material of a shape; "" for the default, which is the same grey in both formats."""
    for child in shape.all("bsdf", "ref"):
        target = resolve_reference(out.document, child)
        if target is not None and target.tag == "bsdf":
            out.consumed.add(id(child))
            return _material_name(out, target)
        if target is None:
            out.consumed.add(id(child))
    return ""


def _material_name(out: SceneBuilder, node: Node) -> str:
    if id(node) not in out.materials:
        materials = out.data["material"]
        name = node.id if node.id.isprintable() and node.id else _new_name(out)
        out.materials[id(node)] = name
        materials[name] = _build_material(out, node)
        out.positions["material", name] = node.position
    return out.materials[id(node)]


def _new_name(out: SceneBuilder) -> str:
    """A name used by no material and no id."""
    made, ids = out.data["material"], out.document.by_id
    names = map("material-{}".format, count(len(made)))
    return next(name for name in names if name not in made and name not in ids)


def _build_material(out: SceneBuilder, node: Node) -> dict[str, Any]:
    out.consumed.add(id(node))
    if id(node) in out.in_progress:
        out.error(node, f"{node.words()}: refers to itself")
        return {}
    if node.kind in WRAPPERS:
        out.in_progress.add(id(node))
        inner = [resolve_reference(out.document, child) for child in node.all("bsdf", "ref")]
        made = next(
            (_build_material(out, each) for each in inner if each is not None and each.tag == "bsdf"), {}
        )
        out.in_progress.remove(id(node))
        out.consumed.update(id(child) for child in node.all("bsdf", "ref"))
        if node.kind == "twosided":
            made["two_sided"] = True
        else:
            out.omit(node, f"{node.words()}: the inner bsdf is kept")
        out.omit_unread(node)
        return made
    color = next((name for name in DIFFUSE_COLOR_NAMES if node.named(name) is not None), "")
    made = {"reflectance": _color(out, node, color)} if color else {}
    if node.kind != "diffuse":
        kept = f"its {color} is" if color else "grey is"
        out.omit(node, f"{node.words()}: materials are diffuse here; {kept} kept")
    out.omit_unread(node)
    return made


def _color(out: SceneBuilder, node: Node, name: str) -> list[float]:
    child = node.named(name)
    assert child is not None
    out.consumed.add(id(child))
    found = color_of(out, child)
    if found is None:
        out.omit(child, f"{child.words()} of {node.words()}: replaced by grey")
    return DEFAULT_REFLECTANCE if found is None else found


def color_of(out: SceneBuilder, node: Node) -> list[float] | None:
    """r, g, b of an <rgb>, or of a <spectrum> or <float> of one number; else None."""
    value = node.attributes.get("value", "")
    if node.tag == "rgb" or (node.tag in ("spectrum", "float") and ":" not in value and value):
        found = out.numbers(node, "value", 3)
        return found * 3 if len(found) == 1 else found
    return None


# ---- emitters ----

DEFAULT_RADIANCE = [1.0, 1.0, 1.0]  # Mitsuba's default of every emitter
RADIANCE_NAMES = ("radiance", "intensity", "irradiance")  # names of the radiometric quantity of emitters
EXACT_KINDS = ("point", "directional")  # converted exactly, even if they emit nothing


def is_dark(out: SceneBuilder, node: Node) -> bool:
    """Whether an emitter explicitly emits nothing, so that the image is the same without it."""
    given = next((child for child in map(node.named, RADIANCE_NAMES) if child is not None), None)
    color = None if given is None else color_of(out, given)
    return color is not None and not any(color)


def add_emitter(out: SceneBuilder, node: Node) -> None:
    """Add a point, directional or constant emitter; report any other."""
    makers = {"point": _point, "directional": _directional, "constant": _constant}
    if node.kind not in EXACT_KINDS and is_dark(out, node):
        out.consumed.add(id(node))
        return
    if node.kind not in makers:
        out.omit(node, f"{node.words()}: lights are point, directional or ambient here")
        return
    light = makers[node.kind](out, node)
    out.consumed.add(id(node))
    if light is not None:
        out.positions["light", len(out.data["light"])] = node.position
        out.data["light"].append(light)
    out.omit_unread(node)


def _point(out: SceneBuilder, node: Node) -> dict[str, Any] | None:
    matrix = composed_matrix(transform_steps(out, node))
    start = (0.0, 0.0, 0.0) if matrix is None else tuple(matrix[:3, 3].tolist())
    return _with_color(
        out, node, "intensity", {"type": "point", "position": out.vector(node, "position", start)}
    )


def _directional(out: SceneBuilder, node: Node) -> dict[str, Any] | None:
    matrix = composed_matrix(transform_steps(out, node))
    along = np.array([0.0, 0.0, 1.0]) if matrix is None else matrix[:3, 2]
    return _with_color(
        out,
        node,
        "irradiance",
        {"type": "directional", "direction": out.vector(node, "direction", tuple(along.tolist()))},
    )


def _constant(out: SceneBuilder, node: Node) -> dict[str, Any] | None:
    out.note(node, "the occlusion of its light by shapes: ambient light is the same everywhere")
    return _with_color(out, node, "radiance", {"type": "ambient"})


def _with_color(out: SceneBuilder, node: Node, name: str, light: dict[str, Any]) -> dict[str, Any] | None:
    """The light with its colour; None, and reported, if that is not an RGB colour."""
    child = node.named(name)
    color = DEFAULT_RADIANCE if child is None else color_of(out, child)
    if child is not None:
        out.consumed.add(id(child))
    if color is None:
        out.omit(node, f"{node.words()}: its {name} is no colour of three numbers")
        return None
    return light | {name: color}
