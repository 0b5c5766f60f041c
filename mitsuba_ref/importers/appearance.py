"""<bsdf> -> a diffuse material of ours, or the nearest there is to it."""

from itertools import count
from typing import Any

import numpy as np

from mitsuba_ref.importers.scene_builder import SceneBuilder, composed_matrix, transform_steps
from mitsuba_ref.importers.xml_document import Node, resolve_reference

WRAPPERS = ("twosided", "mask", "bumpmap", "normalmap")  # of one bsdf inside
DIFFUSE_COLOR_NAMES = (
    "reflectance",
    "diffuse_reflectance",
    "base_color",
)  # what a bsdf calls its diffuse colour
DEFAULT_REFLECTANCE = [0.5, 0.5, 0.5]  # Mitsuba's diffuse reflectance, where a scene says nothing


def material_of(out: SceneBuilder, shape: Node) -> str:
    """The name of the material of a shape; "" for none of its own: grey on both sides of the import."""
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
        out.places["material", name] = node.position
    return out.materials[id(node)]


def _new_name(out: SceneBuilder) -> str:
    """One that no material has, and no element that may become one."""
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
            out.omit(node, f"{node.words()}: what is inside it is kept")
        out.omit_unread(node)
        return made
    color = next((name for name in DIFFUSE_COLOR_NAMES if node.named(name) is not None), "")
    made = {"reflectance": _color(out, node, color)} if color else {}
    if node.kind != "diffuse":
        kept = f"its {color} is" if color else "grey is"
        out.omit(node, f"{node.words()}: our materials are diffuse; {kept} kept")
    out.omit_unread(node)
    return made


def _color(out: SceneBuilder, node: Node, name: str) -> list[float]:
    child = node.named(name)
    assert child is not None
    out.consumed.add(id(child))
    found = color_of(out, child)
    if found is None:
        out.omit(child, f"{child.words()} of {node.words()}: grey stands for it")
    return DEFAULT_REFLECTANCE if found is None else found


def color_of(out: SceneBuilder, node: Node) -> list[float] | None:
    """r, g, b of an <rgb>, or of a <spectrum> or <float> that is one number; None for anything else."""
    value = node.attributes.get("value", "")
    if node.tag == "rgb" or (node.tag in ("spectrum", "float") and ":" not in value and value):
        found = out.numbers(node, "value", 3)
        return found * 3 if len(found) == 1 else found
    return None


# <emitter> -> a light of ours.


DEFAULT_RADIANCE = [1.0, 1.0, 1.0]  # what an emitter sends, where it says nothing
RADIANCE_NAMES = ("radiance", "intensity", "irradiance")  # what emitters call it
EXACT_KINDS = ("point", "directional")  # ours are the same, also if they send nothing


def is_dark(out: SceneBuilder, node: Node) -> bool:
    """Whether an emitter says that it sends nothing: without it the picture is the same."""
    said = next((child for child in map(node.named, RADIANCE_NAMES) if child is not None), None)
    color = None if said is None else color_of(out, said)
    return color is not None and not any(color)


def add_emitter(out: SceneBuilder, node: Node) -> None:
    """A point, directional or constant emitter; others are told to be left out."""
    makers = {"point": _point, "directional": _directional, "constant": _constant}
    if node.kind not in EXACT_KINDS and is_dark(out, node):
        out.consumed.add(id(node))
        return
    if node.kind not in makers:
        out.omit(node, f"{node.words()}: our lights are point, directional and ambient")
        return
    light = makers[node.kind](out, node)
    out.consumed.add(id(node))
    if light is not None:
        out.places["light", len(out.data["light"])] = node.position
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
    out.note(node, "what shapes keep from each other of its light: ours is the same everywhere")
    return _with_color(out, node, "radiance", {"type": "ambient"})


def _with_color(out: SceneBuilder, node: Node, name: str, light: dict[str, Any]) -> dict[str, Any] | None:
    """The light with its colour; None, and told, where that is none of ours."""
    child = node.named(name)
    color = DEFAULT_RADIANCE if child is None else color_of(out, child)
    if child is not None:
        out.consumed.add(id(child))
    if color is None:
        out.omit(node, f"{node.words()}: its {name} is no colour of three numbers")
        return None
    return light | {name: color}
