"""What a verdict about a Mitsuba file covers."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Coverage:
    """What of a Mitsuba file is judged."""

    shapes: int  # in the file, copies by instances included
    judged: int
    left_out: tuple[str, ...] = ()  # shapes by name, each with its place and the reason
    hidden: int = 0  # pixels that are not judged, since Mitsuba hits a shape that is left out
    unlit: tuple[str, ...] = ()  # lights and materials for which diffuse is not compared
    dropped: dict[str, int] = field(default_factory=dict)  # left out before loading, since no geometry depends on it
    notes: tuple[str, ...] = ()
    strict: bool = False  # a scene that is judged in part fails

    @property
    def partial(self) -> bool:
        return self.judged < self.shapes

    @property
    def brief(self) -> str:
        """`3 of 4 shapes`; "" where all are judged."""
        return f"{self.judged} of {self.shapes} shapes" if self.partial else ""

    def lines(self) -> list[str]:
        """What is not judged, a line each."""
        found = [f"left out: {each}" for each in self.left_out]
        if self.hidden:
            found.append(f"not judged: {self.hidden} pixels, where Mitsuba hits a shape that is left out")
        if self.unlit:
            more = f" and {len(self.unlit) - 1} more" if len(self.unlit) > 1 else ""
            found.append(f"diffuse is not compared: {self.unlit[0]}{more}")
        if self.dropped:
            words = (f"{count} {name}" if count > 1 else name for name, count in self.dropped.items())
            found.append(f"geometry does not depend on, and not loaded: {', '.join(words)}")
        return [*found, *self.notes]
