"""Campaign files: what is judged, over which parameters and seeds, whose answers, and for how long."""

import os
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar

from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from caster.cli.shared_arguments import scene_files
from caster.description.errors import FileMissing, SceneError, field_error
from caster.description.fields import Count, Description, Index, Positive, RowOf
from caster.description.input_files import read_text
from caster.description.parsing import model_of_text
from caster.scene.model import Pixels
from mitsuba_ref.fuzz.fuzz_run import RAYS_PER_EXAMPLE
from mitsuba_ref.hard import BY_NAME, FAMILIES
from mitsuba_ref.hard.random_families import FILMS
from mitsuba_ref.hard.swept_families import SWEPT
from mitsuba_ref.report import builtin_scenes
from mitsuba_ref.subjects.subject import DEFAULT_SECONDS

Item = TypeVar("Item")


def _not_empty(items: tuple[Item, ...]) -> tuple[Item, ...]:
    if not items:
        raise field_error("must be a list that is not empty")
    return items


Some = Annotated[tuple[Item, ...], AfterValidator(_not_empty)]
Size = Annotated[Any, RowOf(Pixels, 2, "2 numbers [width, height]")]  # of a film, pixels
Many = Annotated[Count, Field(le=10_000_000)]  # lists of so many numbers fit into memory
Depth = Annotated[Index, Field(le=1000)]
FILM_FAMILIES = (FILMS.name, *(family.name for family in FAMILIES if family.fits_float32))
FUZZ_FAMILIES, STRESS_FAMILIES = tuple(BY_NAME), tuple(family.name for family in SWEPT)


class Budget(Description):
    """Limits of a run; what is finished is kept, and the next run goes on."""

    seconds: Positive | None = None  # of one call of the command
    rays: Positive | None = None  # of the whole run, those found in the history included


class Contender(Description):
    """A subject: our caster, or a candidate as --candidate names it."""

    name: str = "ours"
    candidate: str | None = None
    serve: bool = False  # the candidate is a program as for --candidate-serve
    precision: Literal["float32", "float64"] | None = None
    timeout: Positive = DEFAULT_SECONDS  # of a program, seconds
    files: tuple[str, ...] = ()  # further files that its answers depend on

    @model_validator(mode="after")
    def _is_named_and_has_a_candidate(self) -> Self:
        if not self.name:
            raise field_error("may not be empty", "name")
        if self.candidate is None and (without := self.model_fields_set - {"name"}):
            raise field_error("is an option of a candidate, and none is given", min(without))
        return self

    def words(self) -> tuple[str, ...]:
        """Its options on a command line."""
        if self.candidate is None:
            return ()
        precision = ("--candidate-precision", self.precision) if self.precision else ()
        timeout = ("--candidate-timeout", f"{self.timeout:g}s") if self.timeout != DEFAULT_SECONDS else ()
        return ("--candidate-serve" if self.serve else "--candidate", self.candidate, *precision, *timeout)


# Jobs: units of one kind. Each is every combination of the job's lists, for each seed and subject.


class SceneJob(Description):
    """Scene files, judged as `validate` does; seeds play no part."""

    type: Literal["scenes"] = "scenes"
    scenes: Some[str]  # files, folders, builtin:NAME, and builtin:SET or builtin:all
    sizes: Some[Size] | None = None  # of films; none: the scenes' own
    bounces: Depth = 0

    @field_validator("scenes")
    @classmethod
    def _are_files(cls, words: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
        """The files; absolute, so that keys and replays hold in every folder. info: the folder of the campaign file."""
        found: list[str] = []
        for i, word in enumerate(words):
            try:
                name, sets = word.removeprefix(builtin_scenes.PREFIX), (*builtin_scenes.SETS, builtin_scenes.ALL_SETS)
                if name == word:
                    places = [os.path.abspath(Path(info.context or "") / word)]
                else:
                    known = name in sets
                    places = builtin_scenes.folders_of(name) if known else [builtin_scenes.scene_path(word, sets)]
                files = scene_files(places)
                if not files:
                    raise SceneError(f"{places[0]}: expected scene files in this folder, found none")
                found += files
            except SceneError as error:
                missing = isinstance(error, FileMissing)
                raise field_error(f"names no scene: {error}", "scenes", i, missing_file=missing) from error
        return tuple(scene_files(found))


class FilmJob(Description):
    """Films of random scenes, judged as `validate` does."""

    type: Literal["films"] = "films"
    families: Some[Literal[FILM_FAMILIES]] = (FILMS.name,)  # type: ignore[valid-type]  # names known at run time
    scenes: Many  # of each family and seed
    sizes: Some[Size] = ((224, 224),)
    bounces: Depth = 0


class FuzzJob(Description):
    """Examples, checked as `fuzz` does."""

    type: Literal["fuzz"] = "fuzz"
    families: Some[Literal[FUZZ_FAMILIES]] = FUZZ_FAMILIES  # type: ignore[valid-type]  # names known at run time
    examples: Many  # of each family and seed
    rays: Some[Count] = (RAYS_PER_EXAMPLE,)  # of an example
    judge_every: Index = 16


class StressJob(Description):
    """Settings of sweeps, scored as `stress` does."""

    type: Literal["stress"] = "stress"
    families: Some[Literal[STRESS_FAMILIES]] = STRESS_FAMILIES  # type: ignore[valid-type]  # names known at run time
    values: Some[Positive] | None = None  # of the swept quantity; none: those of the family
    rays: Some[Count | None] = (None,)  # of a setting; none: as `stress`


AnyJob = Annotated[SceneJob | FilmJob | FuzzJob | StressJob, Field(discriminator="type")]


class Campaign(Description):
    """A campaign file."""

    ELEMENTS: ClassVar[dict[str, int]] = {"job": 2, "subject": 2, "budget": 1}

    seeds: Some[Index] = (0,)
    budget: Budget = Budget()
    subjects: Some[Contender] = Field(default=(Contender(),), alias="subject")
    jobs: Some[AnyJob] = Field(alias="job")

    @model_validator(mode="after")
    def _has_subjects_of_different_names(self) -> Self:
        names = [subject.name for subject in self.subjects]
        if twice := [name for name in names if names.count(name) > 1]:
            raise ValueError(f"needs subjects of different names, got '{twice[0]}' twice")
        return self


def read_campaign(path: str) -> tuple[Campaign, str]:
    """A campaign file and its text. Raises FileMissing, or SceneError with every error and its line."""
    kind = Path(path).suffix.lower().removeprefix(".")
    if kind not in ("toml", "json"):
        raise SceneError(f"{path}: expected a campaign file, .toml or .json")
    text = read_text(path, "campaign file")
    return model_of_text(Campaign, text, kind, path, Path(path).parent), text
