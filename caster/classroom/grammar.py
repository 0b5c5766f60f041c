"""What may stand in which block of a 6.837 scene, as tables."""

from typing import NamedTuple


class Form(NamedTuple):
    """What follows a word: so many numbers, in braces or not, or one word such as a file name."""

    numbers: int = 0
    braced: bool = False

    @property
    def text(self) -> str:
        if not self.numbers:
            return "a word"
        many = "a number" if self.numbers == 1 else f"{self.numbers} numbers"
        return f"{many} in braces" if self.braced else many


class Block(NamedTuple):
    """A word with braces. Its fields and children may come in any order."""

    fields: dict[str, Form]
    children: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()  # of the fields; the others are required
    repeated: tuple[str, ...] = ()  # of the fields; the others come once
    counted_by: str = ""  # the field that says how many children there are


WORD, NUMBER, VECTOR = Form(), Form(1), Form(3)

CAMERAS = ("PerspectiveCamera", "OrthographicCamera")
LIGHTS = ("DirectionalLight", "PointLight")
MATERIALS = ("Material", "PhongMaterial")
OBJECTS = ("Group", "Transform", "Sphere", "Plane", "Triangle", "TriangleMesh")
SECTIONS = (*CAMERAS, "Background", "Lights", "Materials", "Group")

# Blocks of later assignments; they are read over, and told to be left out.
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
_MATERIAL = Block(_SURFACE, optional=tuple(_SURFACE))

STEPS = {
    "Scale": VECTOR,
    "UniformScale": NUMBER,
    "Translate": VECTOR,
    "XRotate": NUMBER,
    "YRotate": NUMBER,
    "ZRotate": NUMBER,
    "Rotate": Form(4, braced=True),
    "Matrix": Form(16, braced=True),
    "Matrix4f": Form(16, braced=True),
}
_BACKGROUND = {"color": VECTOR, "ambientLight": VECTOR, "cubeMap": WORD}
_POINT_LIGHT = {"position": VECTOR, "color": VECTOR, "attenuation": VECTOR, "falloff": NUMBER}

BLOCKS = {
    "PerspectiveCamera": Block(_VIEW | {"angle": NUMBER}),
    "OrthographicCamera": Block(_VIEW | {"size": NUMBER}),
    "Background": Block(_BACKGROUND, optional=tuple(_BACKGROUND)),
    "Lights": Block({"numLights": NUMBER}, LIGHTS, counted_by="numLights"),
    "DirectionalLight": Block({"direction": VECTOR, "color": VECTOR}),
    "PointLight": Block(_POINT_LIGHT, optional=("attenuation", "falloff")),
    "Materials": Block({"numMaterials": NUMBER}, MATERIALS + TEXTURES, counted_by="numMaterials"),
    "Material": _MATERIAL,
    "PhongMaterial": _MATERIAL,
    "Group": Block(
        {"numObjects": NUMBER, "MaterialIndex": NUMBER},
        OBJECTS,
        optional=("MaterialIndex",),
        repeated=("MaterialIndex",),
        counted_by="numObjects",
    ),
    "Transform": Block(STEPS, OBJECTS, optional=tuple(STEPS), repeated=tuple(STEPS)),
    "Sphere": Block({"center": VECTOR, "radius": NUMBER}),
    "Plane": Block({"normal": VECTOR, "offset": NUMBER}),
    "Triangle": Block({"vertex0": VECTOR, "vertex1": VECTOR, "vertex2": VECTOR}),
    "TriangleMesh": Block({"obj_file": WORD}),
}
