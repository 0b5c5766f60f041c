"""From Pydantic's findings to problems in the words of the field."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, get_args

from pydantic import BaseModel, ValidationError

from caster.problems import SINGULAR, Model, Path, Problem, item_of, remark, speak
from caster.wording import listed, show, suggestion

ACROSS = "across"  # the finding of a check of how elements fit together


def problems_of(error: ValidationError, data: Any, model: Model) -> list[Problem]:
    """Every finding as a sentence, and how the elements of the data do not fit together."""
    found: dict[Any, Problem] = {}
    for finding in error.errors(include_url=False):
        if finding["type"] != ACROSS:  # those are found again below, in the data as it was written
            problem = _problem(finding, _place(finding["loc"], data, model), data, model)
            found[problem.path, finding["type"]] = problem  # a list too short by two is found twice
    return [*found.values(), *getattr(model, "problems_across", lambda _: [])(data)]


class _Place(NamedTuple):
    path: Path
    around: tuple[Model, ...]  # the descriptions that the last step leads out of
    models: tuple[Model, ...]  # the descriptions that may stand at the end


def _place(loc: Path, data: Any, model: Model) -> _Place:
    """Follow Pydantic's location through the data. It also holds the `type` of each description it passes."""
    path: Path = ()
    around: tuple[Model, ...] = (model,)
    models, here = around, data
    for step in loc:
        if isinstance(step, str) and len(models) > 1:
            models = tuple(m for m in models if m.model_fields["type"].default == step)
        elif isinstance(step, int) and isinstance(here, Mapping):
            continue  # a single table where a list of them may stand
        elif isinstance(here, (Mapping, list, tuple, BaseModel)):
            path, here = (*path, step), item_of(here, step)
            around, models = models, _below(models, step)
        else:  # a number that stands for three: the rest is not in the file
            break
    return _Place(path, around, models)


def _below(models: tuple[Model, ...], step: str | int) -> tuple[Model, ...]:
    fields = (field for m in models for name, field in m.model_fields.items() if step in (name, field.alias))
    annotations = [field.annotation for field in fields]
    if not annotations:
        return models  # an index, or a name the user gave
    return tuple(found for annotation in annotations for found in _models_in(annotation))


def _models_in(annotation: Any) -> tuple[Model, ...]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return (annotation,)
    return tuple(found for part in get_args(annotation) for found in _models_in(part))


def _problem(finding: Any, place: _Place, data: Any, model: Model) -> Problem:
    path, around, models = place
    kind, got = finding["type"], finding["input"]
    if kind == "missing" and isinstance(path[-1], int):
        text = f"must be {path[-1] + 1} items, got {len(got)}: {show(got)}"
        return speak(path[:-1], text, data, model)
    if kind == "missing":
        return remark(path, f"needs the key '{path[-1]}'", data, model)
    if kind == "extra_forbidden":
        return speak(path, _unknown_key(str(path[-1]), around), data, model)
    if kind.startswith("union_tag"):
        noun = SINGULAR.get(str(path[0]), str(path[0]))
        return remark((*path, "type"), _unknown_type(got, noun, models), data, model)
    return speak(path, _text(kind, got, finding.get("ctx", {})), data, model)


def _unknown_key(key: str, around: Sequence[Model]) -> str:
    known = [field.alias or name for model in around for name, field in model.model_fields.items()]
    if SINGULAR.get(key) in known:  # both spellings are understood, but not at once
        return f"is a second '{SINGULAR[key]}': write one of them only"
    return f"is an unknown key{suggestion(key, known)}"


def _unknown_type(got: Any, noun: str, models: Sequence[Model]) -> str:
    known = [model.model_fields["type"].default for model in models]
    kind = item_of(got, "type")
    if kind is None:
        return f"needs the key 'type': {listed(known)}"
    return f"unknown {noun} type {show(kind)}{suggestion(str(kind), known)} (known: {', '.join(known)})"


def _text(kind: str, got: Any, ctx: Mapping[str, Any]) -> str:
    """What goes on after the name of the value."""
    if kind == "field":
        return str(ctx["text"])
    if kind == "value_error":  # raised by a check of the whole description
        return str(ctx["error"])
    if kind == "too_long":
        return f"must be {ctx['max_length']} items, got {ctx['actual_length']}: {show(got)}"
    if kind == "literal_error":
        words = str(ctx["expected"]).replace(" or ", ", ").replace("'", "").split(", ")
        return f"must be {listed(show(word) for word in words)}, got {show(got)}{suggestion(str(got), words)}"
    if kind in LIMITS:
        sign, key = LIMITS[kind]
        return f"must be {sign} {show(ctx[key])}, got {show(got)}"
    return f"must be {KINDS.get(kind, 'something else')}, got {show(got)}"


LIMITS = {
    "greater_than": (">", "gt"),
    "greater_than_equal": (">=", "ge"),
    "less_than": ("<", "lt"),
    "less_than_equal": ("<=", "le"),
}
KINDS = {
    "int_type": "a whole number",
    "bool_type": "true or false",
    "string_type": "a string",
    "string_unicode": "a string of Unicode characters",
    "tuple_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
}
