"""Writers of Mitsuba scene elements and PLY files, in the float32 values that both sides trace."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias
from xml.etree.ElementTree import Element, SubElement, tostring
from xml.sax.saxutils import escape

import numpy as np

from caster.description.errors import SceneError

if TYPE_CHECKING:  # the Mitsuba process imports this module for part ids, without descriptions
    from caster.description.fields import Shape


class MissingReferenceError(SceneError, LookupError):
    """The judge has no entry for a shape or camera of the scene."""


def missing_reference(name: str, kind: str) -> str:
    return (
        f"{name} has no reference: write mitsuba_ref/{kind}/{name.lower()}.py and add its line to "
        f"mitsuba_ref/{kind}/__init__.py (mitsuba-ref docs adding-a-shape)"
    )


# If a shape is exported as several Mitsuba shapes, their ids are NAME{0}, NAME{1} ...; no other id ends in a brace.


def part_id(name: str, part: object) -> str:
    """The id of one of several Mitsuba shapes that one shape of the scene is exported as."""
    return f"{name}{{{part}}}"


def shape_and_part(shape_id: str) -> tuple[str, int]:
    """The inverse of part_id: (name, part), or (shape_id, -1) for a shape that is exported as one."""
    name, brace, part = shape_id[:-1].rpartition("{")
    return (name, int(part)) if brace and shape_id[-1] == "}" and part.isdecimal() else (shape_id, -1)


def ply_bytes(part: Any, texture: Any = None) -> bytes:
    """Binary PLY file of packed triangles: vertices, with normals and uv if they are used, and colours of a texture.

    part: the caster's Triangles with float32 values, which are not rounded again.
    """
    of_vertices, of_faces = (getattr(texture, name, None) for name in ("vertices", "faces"))
    columns = {name: part.vertices[:, c] for c, name in enumerate("xyz")}
    if part.smooth.any():
        columns |= {f"n{name}": part.normals[:, c] for c, name in enumerate("xyz")}
    if part.textured.any():
        columns |= {name: part.uv[:, c] for c, name in enumerate("uv")}
    if of_vertices is not None:
        columns |= {name: np.asarray(of_vertices)[:, c] for c, name in enumerate("rgb")}
    rgb = [] if of_faces is None else [("colors", "<f4", 3)]
    faces = np.zeros(len(part.faces), [("count", "u1"), ("corners", "<i4", 3), *rgb])
    faces["count"], faces["corners"] = 3, part.faces
    more = f"element face {len(faces)}\nproperty list uchar int vertex_indices\n"
    if of_faces is not None:
        faces["colors"] = of_faces
        more += "".join(f"property float {name}\n" for name in "rgb")
    return float_columns(columns, more) + faces.tobytes()


def float_columns(columns: Mapping[str, np.ndarray], more: str = "") -> bytes:
    """Binary PLY file of vertices with these properties (n,) in float32. more: the header's lines of other elements."""
    vertices = np.stack([*columns.values()], axis=1).astype("<f4")
    properties = "".join(f"property float {name}\n" for name in columns)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n{properties}{more}end_header\n"
    return header.encode("ascii") + vertices.tobytes()


# In typeshed, elements and comments have tags of different types; a document contains both.
if TYPE_CHECKING:
    XmlElement: TypeAlias = Element[Any]
else:
    XmlElement = Element


@dataclass
class ShapeWriter:
    """Writer of the scene's shapes: makes elements and collects the files that they name."""

    material: Callable[[Shape], XmlElement]  # makes the <bsdf> of a shape
    texture: Callable[[Shape], Any]  # of a shape, or None
    name: str = ""  # id of the current shape
    meshes: dict[str, bytes] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def native(self, shape: Shape, plugin: str, centers: np.ndarray, linear: np.ndarray) -> list[XmlElement]:
        """Mitsuba shape plugins with one matrix each: for each row of centers (n, 3) and linear (n, 3, 3)."""
        bsdf = self.material(shape)
        if len(centers) > 1:
            bsdf.set("id", part_id(self.name, "material"))
            return self._include(bsdf, plugin, centers, linear)
        element = Element("shape", type=plugin, id=self.name)
        element.extend([matrix_element(centers[0], linear[0]), bsdf, *_flips(shape)])
        return [element]

    def instances(self, shape: Shape, plugin: str, part: Any) -> list[XmlElement]:
        """Instances of a one-shape group, for stretched shapes whose plugin does not support scaling."""
        group = Element("shape", type="shapegroup", id=f"{self.name}.group")
        SubElement(group, "shape", type=plugin, id=f"{self.name}.unit").extend([self.material(shape), *_flips(shape)])
        self.notes.append(f"{self.name}: an instance of a {plugin}, as Mitsuba's {plugin} cannot be stretched")
        if len(part.center) > 1:
            return self._include(group, "instance", part.center, part.to_world)
        element = Element("shape", type="instance", id=self.name)
        SubElement(element, "ref", id=f"{self.name}.group")
        element.append(matrix_element(part.center[0], part.to_world[0]))
        return [group, element]

    def _include(self, shared: XmlElement, plugin: str, centers: np.ndarray, linear: np.ndarray) -> list[XmlElement]:
        """An <include> of a file of many shapes that refer to a shared element.

        They are written as text: an element tree of a million shapes takes a minute and 2 GB.
        """
        name, shared_id = (escape(each, {'"': "&quot;", "%": "%%"}) for each in (self.name, shared.attrib["id"]))
        shape = f'<shape type="{plugin}" id="{part_id(name, "%d")}"><ref id="{shared_id}"/>'
        matrix = " ".join(["%r"] * 12)
        row = f'{shape}<transform name="to_world"><matrix value="{matrix} 0 0 0 1"/></transform></shape>'
        rows = np.concatenate([linear, centers[:, :, None]], axis=2).reshape(-1, 12).tolist()
        text = "\n".join([row % (i, *numbers) for i, numbers in enumerate(rows)])
        first = tostring(shared, encoding="unicode")
        file = self.file("xml", f'<scene version="3.0.0">\n{first}\n{text}\n</scene>\n'.encode())
        return [Element("include", filename=file)]

    def file(self, suffix: str, content: bytes) -> str:
        """Add a file of the current shape; returns its path, relative to the XML."""
        file = f"meshes/{len(self.meshes):04d}-{safe_name(self.name)}.{suffix}"
        self.meshes[file] = content
        return file

    def from_file(
        self, shape: Shape, plugin: str, suffix: str, content: bytes, more: Sequence[XmlElement] = ()
    ) -> XmlElement:
        """A Mitsuba shape plugin that reads a file of its own. more: its other parameters."""
        element = Element("shape", type=plugin, id=self.name)
        SubElement(element, "string", name="filename", value=self.file(suffix, content))
        element.extend([*more, self.material(shape), *_flips(shape)])
        return element

    def mesh(self, shape: Shape, part: Any) -> XmlElement:
        """Triangles as a PLY file in world space."""
        flat = [] if part.smooth.any() else [Element("boolean", name="face_normals", value="true")]
        return self.from_file(shape, "ply", "ply", ply_bytes(part, self.texture(shape)), flat)


def _flips(shape: Shape) -> list[XmlElement]:
    return [Element("boolean", name="flip_normals", value="true")] if getattr(shape, "flip_normals", False) else []


def format_floats(values: Sequence[float] | np.ndarray) -> str:
    """The shortest decimals that read back as the same float64 values."""
    return " ".join(repr(float(value)) for value in values)


def safe_name(name: str) -> str:
    """A shape's name as part of a file name."""
    return "".join(c if c.isascii() and c.isalnum() else "-" for c in name)[:40]


def matrix_element(center: np.ndarray, linear: np.ndarray) -> XmlElement:
    transform = Element("transform", name="to_world")
    SubElement(transform, "matrix", value=f"{format_floats(np.column_stack([linear, center]).ravel())} 0 0 0 1")
    return transform
