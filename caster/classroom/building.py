"""What is made of the blocks of a 6.837 scene: the data of a scene file of ours, faults, and what is left out."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

from caster.classroom.blocks import Fault, Node
from caster.classroom.tokens import Token

Path = tuple[str | int, ...]

WHITE, BLACK, GREY = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0), (0.5, 0.5, 0.5)


class Falloff(NamedTuple):
    """A point light at distance r has color / (constant + linear r + quadratic r^2) as its brightness."""

    constant: float
    linear: float
    quadratic: float

    @property
    def is_ours(self) -> bool:
        return self.constant == self.linear == 0.0


@dataclass
class Building:
    """What has been made of the blocks so far."""

    data: dict[str, Any] = field(default_factory=dict)  # as a scene file of ours
    places: dict[Path, Token] = field(default_factory=dict)  # where each of its values is in the text
    faults: list[Fault] = field(default_factory=list)
    left_out: list[Fault] = field(default_factory=list)
    background: tuple[float, ...] = GREY  # the course's, where a file says nothing
    colors: list[tuple[float, ...]] = field(default_factory=list)  # of point and directional lights
    falloffs: list[Falloff | None] = field(default_factory=list)  # None: directional
    material: str = ""  # of the objects to come

    def put(self, value: Any, at: Token, *path: str | int) -> Any:
        """Remember where a value comes from."""
        self.places[path] = at
        return value

    def omit(self, at: Token, text: str) -> None:
        self.left_out.append(Fault(at, text))

    def copy(self, into: dict[str, Any], ours: str, node: Node, theirs: str, *path: str | int) -> None:
        """Put the numbers of a field into the data, if it is there."""
        found = node.get(theirs)
        if found is not None:
            value = list(found.numbers) if len(found.numbers) > 1 else found.numbers[0]
            into[ours] = self.put(value, found.at, *path, ours)
