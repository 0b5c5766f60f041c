"""The scene model: lights, materials, film, shading, checks, and validation across elements."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, TypeAlias, Union

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PrivateAttr,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from caster.cameras import CAMERAS, Ray
from caster.description.errors import (
    CROSS_ELEMENT_ERROR,
    PLURAL,
    SINGULAR,
    DataPath,
    Diagnostic,
    SceneError,
    child_of,
    field_error,
    format_value,
    suggestion,
    value_message,
)
from caster.description.fields import (
    RGB,
    Camera,
    Description,
    Flag,
    Index,
    Name,
    Positive,
    RefractiveIndex,
    RowOf,
    Shape,
    UnitVec3,
    Vec3,
)
from caster.description.registry import load_plugins
from caster.kernels.surface.lighting import DirectionalLight, PointLight
from caster.scene.export import canonical_json, fingerprint, to_toml
from caster.scene.textures import AnyReflectance, Texture
from caster.shapes import SHAPES

__all__ = ["MAX_FILM_SIDE", "Check", "Diffuse", "Film", "Material", "Pixels", "Scene"]

# ---- lights and materials ----


class Point(Description):
    """An isotropic point light. `intensity` in power per solid angle (W/sr)."""

    type: Literal["point"] = "point"
    position: Vec3  # scene units
    intensity: RGB  # W/sr

    def pack(self) -> PointLight:
        return PointLight(self.position, self.intensity)


class Directional(Description):
    """Parallel light along `direction`; a perpendicular surface receives `irradiance` (W/m^2)."""

    type: Literal["directional"] = "directional"
    direction: UnitVec3
    irradiance: RGB  # W/m^2

    def pack(self) -> DirectionalLight:
        x, y, z = self.direction
        return DirectionalLight((0.0 - x, 0.0 - y, 0.0 - z), self.irradiance)


class Ambient(Description):
    """Constant `radiance` from all directions (W/(m^2 sr)), without shadows."""

    type: Literal["ambient"] = "ambient"
    radiance: RGB  # W/(m^2 sr)


Light = Point | Directional | Ambient
LIGHTS = (Point, Directional, Ambient)


class Diffuse(Description):
    """A Lambertian surface that reflects the fraction `reflectance` of incident light: a colour, or a texture.

    A one-sided surface is black where its shading normal points away from the viewer.
    """

    type: Literal["diffuse"] = "diffuse"
    reflectance: AnyReflectance = (0.5, 0.5, 0.5)
    two_sided: Flag = False

    @property
    def texture(self) -> Texture | None:
        return self.reflectance if isinstance(self.reflectance, Texture) else None

    @property
    def color(self) -> tuple[float, float, float]:
        """The reflectance; black in place of a texture."""
        return (0.0, 0.0, 0.0) if isinstance(self.reflectance, Texture) else self.reflectance


class Specular(Description, json_schema_extra={"required": ["type"]}):
    """A surface that reflects or refracts every ray in one direction, and so has no diffuse light: it is black."""

    color: ClassVar[tuple[float, float, float]] = (0.0, 0.0, 0.0)
    texture: ClassVar[None] = None
    two_sided: ClassVar[bool] = False


class Mirror(Specular):
    """A perfect mirror on both sides."""

    type: Literal["mirror"] = "mirror"


class Glass(Specular):
    """The border of a body with refractive index `ior`, which the normals point out of; outside the index is 1."""

    type: Literal["glass"] = "glass"
    ior: RefractiveIndex = 1.5


Material = Diffuse | Mirror | Glass
DEFAULT_MATERIAL = Diffuse()


# ---- the scene ----

MAX_FILM_SIDE = 65536  # pixels; one float32 channel of such a square takes 16 GiB

Pixels = Annotated[int, Field(strict=True, ge=1, le=MAX_FILM_SIDE)]  # a whole number from 1 to 65536
Window = Annotated[Any, RowOf(Index, 4, "4 pixel indices [x0, y0, x1, y1]")]  # 4 whole numbers


class Film(Description):
    """Size of the image in pixels. `crop` = [x0, y0, x1, y1] is the window to render, x1 and y1 exclusive."""

    width: Pixels = 256  # pixels
    height: Pixels = 256  # pixels
    crop: Window | None = None  # pixels: x0, y0, x1, y1

    @field_validator("crop")
    @classmethod
    def _is_inside(cls, crop: Any, info: Any) -> Any:
        if crop is None:
            return crop
        x0, y0, x1, y1 = crop
        if not (x0 < x1 and y0 < y1):
            raise field_error(f"must hold at least one pixel, x0 < x1 and y0 < y1, got {format_value(crop)}")
        width, height = info.data.get("width", x1), info.data.get("height", y1)
        if x1 > width or y1 > height:
            raise field_error(f"must lie inside the film, x1 <= {width} and y1 <= {height}, got {format_value(crop)}")
        return crop

    @property
    def window(self) -> tuple[int, int, int, int]:
        """The window to render, x0, y0, x1, y1: the crop, or the whole film."""
        return self.crop or (0, 0, self.width, self.height)


class Shading(Description):
    """Options of the AOV `diffuse`."""

    shadows: Flag = True


class Check(Description):
    """Tolerance of one AOV in comparisons with the reference, in multiples of the derived bound."""

    ratio: Positive = 1.0  # multiples of the bound


def _is_aov(name: str) -> str:
    from caster.aovs import BY_NAME  # deferred: most scenes have no checks

    if name not in BY_NAME:
        raise field_error(f"unknown AOV{suggestion(name, BY_NAME)} (known: {', '.join(BY_NAME)})")
    return name


AovName = Annotated[str, AfterValidator(_is_aov)]


def _elements(data: Any, key: str) -> tuple[str, Any]:
    """(the spelling of the key in the data, its value)"""
    spelled = key if child_of(data, key) is not None else PLURAL[key]
    return spelled, child_of(data, spelled)


def _unknown_material(path: DataPath, material: str, known: Iterable[str], data: Any, model: type[Description]) -> str:
    hint = suggestion(material, known) or f"; add a table [material.{material}]"
    text = f"must be one of the materials of this scene, got {format_value(material)}{hint}"
    return value_message(path, text, data, model)


def one_of(registry: Sequence[type[Description]]) -> Any:
    """Field type for one of these descriptions, discriminated by `type`."""
    return Annotated[Union[tuple(registry)], Field(discriminator="type")]  # noqa: UP007 - a tuple has no |


if TYPE_CHECKING:
    AnyShape: TypeAlias = Shape
    AnyCamera: TypeAlias = Camera
    AnyLight: TypeAlias = Light
    AnyMaterial: TypeAlias = Material
else:
    AnyShape, AnyCamera, AnyLight = one_of(SHAPES), one_of(CAMERAS), one_of(LIGHTS)
    AnyMaterial = Annotated[
        Annotated[Material, Field(discriminator="type")],
        BeforeValidator(lambda value: {"type": "diffuse", **value} if isinstance(value, Mapping) else value),
    ]


class Scene(Description):
    """A film, a camera, lights, and shapes with their materials.

    Keys in scene files are `light`, `material`, `shape` and `check`; Python also accepts the plural field names.
    Raises SceneError with all validation errors.
    """

    ELEMENTS: ClassVar[Mapping[str, int]] = {
        **dict.fromkeys(("film", "camera", "shading"), 1),
        **dict.fromkeys((*PLURAL, *SINGULAR), 2),
    }

    film: Film = Film()
    camera: AnyCamera
    lights: tuple[AnyLight, ...] = Field(default=(), alias="light")
    materials: dict[Name, AnyMaterial] = Field(default={}, alias="material")
    shapes: tuple[AnyShape, ...] = Field(default=(), alias="shape")
    shading: Shading = Shading()
    checks: dict[AovName, Check] = Field(default={}, alias="check")

    _folder: Path | None = PrivateAttr(None)
    _derived: dict[str, Any] = PrivateAttr(default_factory=dict)

    if TYPE_CHECKING:  # type checkers know one spelling of a field

        def __init__(
            self,
            *,
            camera: Camera | Ray,
            film: Film = ...,
            shapes: Iterable[Shape | dict[str, Any]] = (),
            lights: Iterable[Light] = (),
            materials: Mapping[str, Material] = ...,
            shading: Shading = ...,
            checks: Mapping[str, Check] = ...,
        ) -> None: ...

    @model_validator(mode="after")
    def _fits_together(self, info: ValidationInfo) -> Self:
        if info.context is not None:  # its MeshFolders
            self._folder = info.context.folder.resolve()
        if found := self.problems_across(self):
            raise PydanticCustomError(CROSS_ELEMENT_ERROR, "{text}", {"text": found[0].message()})
        for i, (shape, texture) in enumerate(zip(self.shapes, self.textures, strict=True)):
            if texture is not None and (reason := texture.misfit(shape)):
                text = f"names a material with a texture, but {reason}: give it a colour, or use another shape"
                raise field_error(text, "shape", i, "material")
        return self

    @classmethod
    def problems_across(cls, data: Any) -> list[Diagnostic]:
        """Errors across elements of a Scene, or of the input data of one, which may have other errors."""
        spelled, shapes = _elements(data, "shape")
        _, table = _elements(data, "material")
        known = {str(name) for name in table} if isinstance(table, Mapping) else set[str]()
        first: dict[str, int] = {}
        unknown, repeated = [], []
        for i, shape in enumerate(shapes if isinstance(shapes, (list, tuple)) else ()):
            material, name = child_of(shape, "material"), child_of(shape, "name")
            if isinstance(material, str) and material and material not in known:
                path: DataPath = (spelled, i, "material")
                unknown.append(Diagnostic(path, partial(_unknown_material, path, material, known, data, cls)))
            name = name if isinstance(name, str) and name else f"shape-{i}"
            if first.setdefault(name, i) != i:
                text = f"must differ from that of shapes[{first[name]}], got {format_value(name)} again"
                path = (spelled, i, "name")
                repeated.append(Diagnostic(path, partial(value_message, path, text, data, cls)))
        return [*unknown, *repeated]

    @property
    def derived(self) -> dict[str, Any]:
        """Cache of data computed from the scene, such as packed arrays; not part of the scene."""
        return self._derived

    def material_of(self, shape: Shape) -> Material:
        """The material of a shape; the default material if it names none."""
        return self.materials[shape.material] if shape.material else DEFAULT_MATERIAL

    @property
    def textures(self) -> list[Texture | None]:
        """The texture of each shape, None if it has none."""
        return [self.material_of(shape).texture for shape in self.shapes]

    def shape_names(self) -> list[str]:
        """The name of each shape, shape-<index> if it has none."""
        return [shape.name or f"shape-{i}" for i, shape in enumerate(self.shapes)]

    def triangles(self) -> NDArray[np.float64]:
        """Corners of all triangles in world space, (n, 3, 3) float64: [triangle, corner, axis], shape after shape.

        They are counter-clockwise seen from the side of the normal.
        Raises NotImplementedError for a shape that is not made of triangles, SceneError for numbers that overflow.
        """
        from caster.geometry.packing import Triangles, packed

        corners = [np.empty((0, 3, 3))]
        for shape, part in zip(self.shapes, packed(self).parts, strict=True):
            if not isinstance(part, Triangles):
                raise NotImplementedError(f"a {shape.type} is not made of triangles")
            faces = part.faces[:, [0, 2, 1]] if getattr(shape, "flip_normals", False) else part.faces
            corners.append(part.vertices[faces])
        return np.concatenate(corners)

    def with_film(
        self, *, width: int | None = None, height: int | None = None, crop: Sequence[int] | None = None
    ) -> Self:
        """A copy with another film. Unless a crop is given, that of the film is scaled, to whole pixels around it."""
        old = self.film
        width, height = old.width if width is None else width, old.height if height is None else height
        if crop is None and old.crop:
            x0, y0, x1, y1 = old.crop
            crop = (
                x0 * width // old.width,
                y0 * height // old.height,
                -(-x1 * width // old.width),
                -(-y1 * height // old.height),
            )
        return self._seen_anew(film=Film(width=width, height=height, crop=crop))

    def with_pixel(self, x: int, y: int) -> Self:
        """A copy whose window is one pixel. Raises SceneError for a pixel outside the film."""
        if not (0 <= x < self.film.width and 0 <= y < self.film.height):
            inside = f"0 <= x < {self.film.width} and 0 <= y < {self.film.height}"
            raise SceneError(f"pixel ({x}, {y}): outside the film, expected {inside}")
        return self.with_film(crop=(x, y, x + 1, y + 1))

    def bands(self, pixels: int, step: int = 1) -> Iterator[Self]:
        """The scene with each band of its film: a multiple of `step` rows, about `pixels` pixels."""
        x0, y0, x1, y1 = self.film.window
        rows = max(1, pixels // ((x1 - x0) * step)) * step
        for y in range(y0, y1, rows):
            yield self.with_film(crop=(x0, y, x1, min(y + rows, y1)))

    def with_camera(self, camera: Camera | Ray | None = None, **changes: Any) -> Self:
        """A copy with another camera, or with other fields of its own one: `scene.with_camera(eye=(0, 0, 9))`."""
        view: Any = self.camera if camera is None else camera
        return self._seen_anew(camera=view.model_copy(update=changes))

    def _seen_anew(self, **update: Any) -> Self:
        copy = self.model_copy(update=update)
        copy._derived = self._derived  # packed shapes, which depend on neither film nor camera
        return copy

    def __repr__(self) -> str:
        film, lights, shapes = self.film, len(self.lights), len(self.shapes)
        counts = f"{shapes} shape{'s' * (shapes != 1)}, {lights} light{'s' * (lights != 1)}"
        return f"Scene({film.width} x {film.height} pixels, {self.camera.type} camera, {counts})"

    __str__ = __repr__

    def canonical_json(self) -> str:
        """JSON with defaults, sorted keys and exact numbers: equal scenes have equal text. It can be loaded again.

        Mesh files in the scene's folder are named relative to it.
        """
        return canonical_json(self, self._folder)

    def sha256(self) -> str:
        """SHA-256 of the scene and of the bytes of its mesh files. Raises FileMissing."""
        return fingerprint(self)

    def to_toml(self) -> str:
        """TOML that loads as an equal scene: exact numbers, defaults omitted.

        Mesh files in the scene's folder are named relative to it, others by their whole path.
        """
        return to_toml(self, self._folder)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """A validated copy with other values; relative mesh paths keep their folder."""
        copy = super().model_copy(update=update, deep=deep)
        copy._folder = self._folder
        return copy

    __hash__ = None  # type: ignore[assignment]  # materials are a dict; sha256() identifies scenes

    def __getstate__(self) -> dict[Any, Any]:
        """State for pickling, without cached data."""
        return super().__getstate__() | {"__pydantic_private__": {"_folder": self._folder, "_derived": {}}}


def _accept_registered() -> None:
    """Rebuild the model, so that scenes may hold what is registered now."""
    fields: dict[str, Any] = Scene.model_fields
    fields["camera"].annotation = Union[tuple(CAMERAS)]  # noqa: UP007 - a tuple has no |
    fields["shapes"].annotation = tuple.__class_getitem__((one_of(SHAPES), ...))
    Scene.model_rebuild(force=True)


SHAPES.changed = CAMERAS.changed = _accept_registered
load_plugins("caster.plugins")
