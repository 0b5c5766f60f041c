"""Grammar of 6.837 scene files: tokens, fields and blocks, and the rules of every block."""

import math
import re
from dataclasses import dataclass, field
from typing import NamedTuple

from caster.description.parsing import Span


class ValueFormat(NamedTuple):
    """The format of a field's value: a count of numbers, in braces or not, or one word such as a file name."""

    numbers: int = 0
    braced: bool = False

    @property
    def text(self) -> str:
        if not self.numbers:
            return "a word"
        many = "a number" if self.numbers == 1 else f"{self.numbers} numbers"
        return f"{many} in braces" if self.braced else many


class BlockRule(NamedTuple):
    """The rule of a block in braces. Fields and children may come in any order."""

    fields: dict[str, ValueFormat]
    children: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()  # fields; the others are required
    repeated: tuple[str, ...] = ()  # fields; the others occur once
    counted_by: str = ""  # the field with the number of children


WORD, NUMBER, VECTOR = ValueFormat(), ValueFormat(1), ValueFormat(3)

CAMERAS = ("PerspectiveCamera", "OrthographicCamera")
LIGHTS = ("DirectionalLight", "PointLight")
MATERIALS = ("Material", "PhongMaterial")
OBJECTS = ("Group", "Transform", "Sphere", "Plane", "Triangle", "TriangleMesh")
SECTIONS = (*CAMERAS, "Background", "Lights", "Materials", "Group")

# Blocks of later assignments; they are skipped and reported.
TEXTURES = ("Checkerboard", "Noise", "Marble", "Wood")

_VIEW = {"center": VECTOR, "direction": VECTOR, "up": VECTOR}
_SURFACE = {
    "diffuseColor": VECTOR,
    "specularColor": VECTOR,
    "reflectiveColor": VECTOR,
    "transparentColor": VECTOR,
    "exponent": NUMBER,
    "shininess": NUMBER,
    "indexOfRefraction": NUMBER,
    "texture": WORD,
    "bump": WORD,
}
_MATERIAL = BlockRule(_SURFACE, optional=tuple(_SURFACE))

TRANSFORM_FIELDS = {
    "Scale": VECTOR,
    "UniformScale": NUMBER,
    "Translate": VECTOR,
    "XRotate": NUMBER,
    "YRotate": NUMBER,
    "ZRotate": NUMBER,
    "Rotate": ValueFormat(4, braced=True),
    "Matrix": ValueFormat(16, braced=True),
    "Matrix4f": ValueFormat(16, braced=True),
}
_BACKGROUND = {"color": VECTOR, "ambientLight": VECTOR, "cubeMap": WORD}
_POINT_LIGHT = {"position": VECTOR, "color": VECTOR, "attenuation": VECTOR, "falloff": NUMBER}

BLOCK_RULES = {
    "PerspectiveCamera": BlockRule(_VIEW | {"angle": NUMBER}),
    "OrthographicCamera": BlockRule(_VIEW | {"size": NUMBER}),
    "Background": BlockRule(_BACKGROUND, optional=tuple(_BACKGROUND)),
    "Lights": BlockRule({"numLights": NUMBER}, LIGHTS, counted_by="numLights"),
    "DirectionalLight": BlockRule({"direction": VECTOR, "color": VECTOR}),
    "PointLight": BlockRule(_POINT_LIGHT, optional=("attenuation", "falloff")),
    "Materials": BlockRule({"numMaterials": NUMBER}, MATERIALS + TEXTURES, counted_by="numMaterials"),
    "Material": _MATERIAL,
    "PhongMaterial": _MATERIAL,
    "Group": BlockRule(
        {"numObjects": NUMBER, "MaterialIndex": NUMBER},
        OBJECTS,
        optional=("MaterialIndex",),
        repeated=("MaterialIndex",),
        counted_by="numObjects",
    ),
    "Transform": BlockRule(
        TRANSFORM_FIELDS, OBJECTS, optional=tuple(TRANSFORM_FIELDS), repeated=tuple(TRANSFORM_FIELDS)
    ),
    "Sphere": BlockRule({"center": VECTOR, "radius": NUMBER}),
    "Plane": BlockRule({"normal": VECTOR, "offset": NUMBER}),
    "Triangle": BlockRule({"vertex0": VECTOR, "vertex1": VECTOR, "vertex2": VECTOR}),
    "TriangleMesh": BlockRule({"obj_file": WORD}),
}


# ---- tokens ----


class Token(NamedTuple):
    """A word, a number or a brace; line and column count from 1."""

    text: str
    line: int
    column: int

    @property
    def span(self) -> Span:
        return Span(self.line, self.column, len(self.text))

    @property
    def number(self) -> float | None:
        """The value as a finite number, else None."""
        try:
            value = float(self.text)
        except ValueError:
            return None
        return value if math.isfinite(value) and "_" not in self.text else None


def tokens_of(text: str) -> list[Token]:
    """Split a text into tokens. A brace is a token also without a space beside it."""
    return [
        Token(found[0], number, found.start() + 1)
        for number, line in enumerate(text.split("\n"), 1)
        for found in re.finditer(r"[{}]|[^\s{}]+", line)
    ]


# ---- parsed blocks ----

FILE_START = Token("", 1, 1)


class SourceMessage(NamedTuple):
    """An error or an omission, and its token."""

    at: Token
    text: str


class Field(NamedTuple):
    """A field: its name and its value."""

    name: str
    at: Token
    numbers: tuple[float, ...]
    word: Token | None  # the value, if it is a word

    @property
    def words(self) -> str:
        """The field as in the file."""
        return " ".join([self.name, *(f"{x:g}" for x in self.numbers), *([self.word.text] if self.word else [])])


@dataclass
class Node:
    """A block: its fields and blocks in the order of the file."""

    kind: str
    at: Token
    items: list["Field | Node"] = field(default_factory=list)
    mentioned: set[str] = field(default_factory=set)  # names of fields that occur, also with an invalid value
    unknown: int = 0  # blocks of an unknown kind

    def get(self, name: str) -> Field | None:
        """The first field of that name."""
        return next((item for item in self.items if isinstance(item, Field) and item.name == name), None)

    def numbers(self, name: str, default: tuple[float, ...] = ()) -> tuple[float, ...]:
        found = self.get(name)
        return default if found is None else found.numbers

    @property
    def children(self) -> list["Node"]:
        return [item for item in self.items if isinstance(item, Node)]
