"""<bsdf> -> a diffuse material of ours, or the nearest there is to it."""

from itertools import count
from typing import Any

from mitsuba_ref.importers.building import Building
from mitsuba_ref.importers.expanding import followed
from mitsuba_ref.importers.xml_nodes import Node

WRAPPERS = ("twosided", "mask", "bumpmap", "normalmap")  # of one bsdf inside
COLORS = ("reflectance", "diffuse_reflectance", "base_color")  # what a bsdf calls its diffuse colour
GREY = [0.5, 0.5, 0.5]  # Mitsuba's diffuse reflectance, where a scene says nothing


def material_of(out: Building, shape: Node) -> str:
    """The name of the material of a shape; "" for none of its own: grey on both sides of the import."""
    for child in shape.all("bsdf", "ref"):
        target = followed(out.document, child)
        if target is not None and target.tag == "bsdf":
            out.used.add(id(child))
            return _added(out, target)
        if target is None:
            out.used.add(id(child))
    return ""


def _added(out: Building, node: Node) -> str:
    if id(node) not in out.materials:
        materials = out.data["material"]
        name = node.id if node.id.isprintable() and node.id else _new_name(out)
        out.materials[id(node)] = name
        materials[name] = _made(out, node)
        out.places["material", name] = node.place
    return out.materials[id(node)]


def _new_name(out: Building) -> str:
    """One that no material has, and no element that may become one."""
    made, ids = out.data["material"], out.document.by_id
    names = map("material-{}".format, count(len(made)))
    return next(name for name in names if name not in made and name not in ids)


def _made(out: Building, node: Node) -> dict[str, Any]:
    out.used.add(id(node))
    if id(node) in out.open:
        out.error(node, f"{node.words()}: refers to itself")
        return {}
    if node.kind in WRAPPERS:
        out.open.add(id(node))
        inner = [followed(out.document, child) for child in node.all("bsdf", "ref")]
        made = next((_made(out, each) for each in inner if each is not None and each.tag == "bsdf"), {})
        out.open.remove(id(node))
        out.used.update(id(child) for child in node.all("bsdf", "ref"))
        if node.kind == "twosided":
            made["two_sided"] = True
        else:
            out.omit(node, f"{node.words()}: what is inside it is kept")
        out.omit_rest(node)
        return made
    color = next((name for name in COLORS if node.named(name) is not None), "")
    made = {"reflectance": _color(out, node, color)} if color else {}
    if node.kind != "diffuse":
        kept = f"its {color} is" if color else "grey is"
        out.omit(node, f"{node.words()}: our materials are diffuse; {kept} kept")
    out.omit_rest(node)
    return made


def _color(out: Building, node: Node, name: str) -> list[float]:
    child = node.named(name)
    assert child is not None
    out.used.add(id(child))
    found = color_of(out, child)
    if found is None:
        out.omit(child, f"{child.words()} of {node.words()}: grey stands for it")
    return GREY if found is None else found


def color_of(out: Building, node: Node) -> list[float] | None:
    """r, g, b of an <rgb>, or of a <spectrum> or <float> that is one number; None for anything else."""
    value = node.attributes.get("value", "")
    if node.tag == "rgb" or (node.tag in ("spectrum", "float") and ":" not in value and value):
        found = out.numbers(node, "value", 3)
        return found * 3 if len(found) == 1 else found
    return None
