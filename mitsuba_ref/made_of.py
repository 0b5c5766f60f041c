"""What a scene is made of, in a few words and numbers, for those who compare verdicts."""

from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field

from caster.packing import packed
from caster.scene import Scene
from caster.wording import SceneError


@dataclass(frozen=True)
class MadeOf:
    """camera: its type, "" where nobody told; shapes: type -> how many; primitives: 0 where nobody counted."""

    camera: str = ""
    shapes: dict[str, int] = field(default_factory=dict)
    primitives: int = 0

    @classmethod
    def of(cls, scene: Scene) -> "MadeOf":
        """What a scene says of itself; primitives are counted where they can be packed."""
        count = 0
        with suppress(SceneError):
            count = int(packed(scene).first[-1])
        return cls(str(scene.camera.type), dict(Counter(str(shape.type) for shape in scene.shapes)), count)
