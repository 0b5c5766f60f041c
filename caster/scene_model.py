"""The scene: what its author wrote, checked as a whole."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, TypeAlias, Union

from pydantic import Field, PrivateAttr, model_validator
from pydantic_core import PydanticCustomError

from caster.cameras import CAMERAS
from caster.description import Description
from caster.fields import Camera, Name, Shape
from caster.film import Check, Film, Shading
from caster.findings import ACROSS
from caster.lights import LIGHTS, Light
from caster.materials import DEFAULT, Diffuse
from caster.problems import PLURAL, SINGULAR, Problem, speak
from caster.scene_export import canonical_json, fingerprint, to_toml
from caster.scene_fit import find_misfits
from caster.shapes import SHAPES


def one_of(registry: Sequence[type[Description]]) -> Any:
    """The type of a field that holds one of these descriptions, told apart by `type`."""
    return Annotated[Union[tuple(registry)], Field(discriminator="type")]  # noqa: UP007 - a tuple has no |


if TYPE_CHECKING:
    AnyShape: TypeAlias = Shape
    AnyCamera: TypeAlias = Camera
    AnyLight: TypeAlias = Light
else:
    AnyShape, AnyCamera, AnyLight = one_of(SHAPES), one_of(CAMERAS), one_of(LIGHTS)


class Scene(Description):
    """A film, a camera, lights, and shapes with their materials.

    Scene files say `light`, `material`, `shape` and `check`; Python may also say `lights`, `materials`,
    `shapes` and `checks`. Raises SceneError with all that is wrong.
    """

    ELEMENTS: ClassVar[Mapping[str, int]] = {
        **dict.fromkeys(("film", "camera", "shading"), 1),
        **dict.fromkeys((*PLURAL, *SINGULAR), 2),
    }

    film: Film = Film()
    camera: AnyCamera
    lights: tuple[AnyLight, ...] = Field(default=(), alias="light")
    materials: dict[Name, Diffuse] = Field(default={}, alias="material")
    shapes: tuple[AnyShape, ...] = Field(default=(), alias="shape")
    shading: Shading = Shading()
    checks: dict[str, Check] = Field(default={}, alias="check")

    _folder: Path | None = PrivateAttr(None)
    _kept: dict[str, Any] = PrivateAttr(default_factory=dict)

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        found = self.problems_across(self)
        if found:
            text = "\n".join(problem.text for problem in found)
            raise PydanticCustomError(ACROSS, "{text}", {"text": text})
        return self

    @classmethod
    def problems_across(cls, data: Any) -> list[Problem]:
        """How the elements do not fit together, in a Scene or in what one is to be made of."""
        return [speak(path, text, data, cls) for path, text in find_misfits(data)]

    @property
    def kept(self) -> dict[str, Any]:
        """A place for what has been computed from this scene; it is not part of the scene."""
        return self._kept

    def material_of(self, shape: Shape) -> Diffuse:
        """The material of one of the shapes."""
        return self.materials[shape.material] if shape.material else DEFAULT

    def shape_names(self) -> list[str]:
        """One name per shape: its own, or shape-<index>."""
        return [shape.name or f"shape-{i}" for i, shape in enumerate(self.shapes)]

    def with_film(
        self, *, width: int | None = None, height: int | None = None, crop: Sequence[int] | None = None
    ) -> Self:
        """A copy with another film. A crop that is not given keeps its share of the picture."""
        film = self.film.resized(
            self.film.width if width is None else width, self.film.height if height is None else height
        )
        copy = self.model_copy(update={"film": film if crop is None else film.cropped(crop)})
        copy._kept = self._kept  # the shapes, packed: they do not know of the film
        return copy

    def canonical_json(self) -> str:
        """The scene with all defaults, keys sorted, numbers exact: equal scenes, equal text. It loads again.

        Mesh files in the scene's folder are named relative to it.
        """
        return canonical_json(self, self._folder)

    def sha256(self) -> str:
        """A fingerprint of the scene and of the bytes of its mesh files. Raises FileMissing."""
        return fingerprint(self)

    def to_toml(self) -> str:
        """A scene file that loads as this very scene: numbers exact, defaults left out.

        Mesh files in the scene's folder are named relative to it, others by their whole path.
        """
        return to_toml(self, self._folder)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """A copy with other values, checked like the first ones; mesh files stay where they are."""
        copy = super().model_copy(update=update, deep=deep)
        copy._folder = self._folder
        return copy

    def __eq__(self, other: object) -> bool:
        """Whether all that was described is equal; where it was read and what was computed does not count."""
        if not isinstance(other, Scene):
            return NotImplemented
        return all(getattr(self, name) == getattr(other, name) for name in type(self).model_fields)

    __hash__ = None  # type: ignore[assignment]  # materials are a dict; sha256() tells scenes apart

    def __getstate__(self) -> dict[Any, Any]:
        """What goes to another process: not what has been computed from the scene."""
        return super().__getstate__() | {"__pydantic_private__": {"_folder": self._folder, "_kept": {}}}
