"""All options of scene files, derived from the schema, and the options that given scenes use.

An option is a line of text: a field with a default, and with something else; each value of an enumeration; both of a
bool; none, one and two of a list or table; each kind of element, and two of it in one scene; each key of a step.
"""

import itertools
import types
import typing
from collections.abc import Iterator
from typing import Annotated, Any, Literal, Union

import numpy as np
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from caster.scene.model import Scene

COUNTS = {0: "none", 1: "one", 2: "two or more"}


def stripped(annotation: Any) -> Any:
    """The type without what is annotated."""
    while typing.get_origin(annotation) is Annotated:
        annotation = typing.get_args(annotation)[0]
    return annotation


def members(annotation: Any) -> tuple[Any, ...]:
    """The types of a union, or the one."""
    plain = stripped(annotation)
    if typing.get_origin(plain) in (Union, types.UnionType):
        return tuple(member for each in typing.get_args(plain) for member in members(each))
    return (plain,)


def models_of(annotation: Any) -> tuple[type[BaseModel], ...]:
    return tuple(each for each in members(annotation) if isinstance(each, type) and issubclass(each, BaseModel))


def label(model: type[BaseModel]) -> str:
    """The element's kind, as a scene file names it."""
    kind = model.model_fields.get("type")
    return f"{model.__name__} {kind.default!r}" if kind is not None else model.__name__


def element_types(annotation: Any) -> tuple[str, Any] | None:
    """("list" or "table", type of its elements) for lists of any length and for tables."""
    plain = stripped(annotation)
    args = typing.get_args(plain)
    if typing.get_origin(plain) is tuple and len(args) == 2 and args[1] is Ellipsis:
        return "list", args[0]
    return ("table", args[1]) if typing.get_origin(plain) is dict else None


def demanded(model: type[BaseModel], seen: tuple[type[BaseModel], ...] = ()) -> Iterator[str]:
    """Every option of an element and of what it holds."""
    for name, field in model.model_fields.items():
        if name == "type":
            continue
        where = f"{label(model)}.{name}"
        several = element_types(field.annotation)
        inner = models_of(several[1] if several else field.annotation)
        if several:
            yield from (f"{where}: {count}" for count in COUNTS.values())
        elif None in members(field.annotation) or type(None) in members(field.annotation):
            yield from (f"{where}: left out", f"{where}: given")
        else:
            yield from (f"{where}: {value}" for value in values_of(field))
        for each in inner:
            if len(inner) > 1:
                yield f"{where}: {label(each)}"
                if several:
                    yield f"{where}: two of {label(each)}"
            if each not in seen:
                yield from demanded(each, (*seen, model))


def values_of(field: FieldInfo) -> tuple[str, ...]:
    """Those that differ in kind: all of an enumeration; else the default, if there is one, and another."""
    plain = stripped(field.annotation)
    if typing.get_origin(plain) is Literal:
        return tuple(repr(value) for value in typing.get_args(plain))
    if plain is bool:
        return "True", "False"
    return ("given",) if field.is_required() else ("default", "another than the default")


def exercised(element: BaseModel) -> Iterator[str]:
    """The options that an element and what it holds make use of."""
    model = type(element)
    for name, field in model.model_fields.items():
        if name == "type":
            continue
        where, value = f"{label(model)}.{name}", getattr(element, name)
        several = element_types(field.annotation)
        inner = models_of(several[1] if several else field.annotation)
        held = list(value.values()) if isinstance(value, dict) else list(value) if several else [value]
        if several:
            yield f"{where}: {COUNTS[min(len(held), 2)]}"
        elif type(None) in members(field.annotation):
            yield f"{where}: {'left out' if value is None else 'given'}"
        else:
            yield f"{where}: {value_text(field, value)}"
        for kind, group in itertools.groupby(sorted(held, key=kind_of), key=kind_of):
            count = len(list(group))
            if len(inner) > 1:
                yield f"{where}: {kind}"
            if len(inner) > 1 and several and count > 1:
                yield f"{where}: two of {kind}"
        for each in held:
            if isinstance(each, BaseModel):
                yield from exercised(each)


def kind_of(value: Any) -> str:
    return label(type(value)) if isinstance(value, BaseModel) else ""


def value_text(field: FieldInfo, value: Any) -> str:
    plain = stripped(field.annotation)
    if typing.get_origin(plain) is Literal or plain is bool:
        return repr(value)
    if field.is_required():
        return "given"
    return "default" if value == field.default else "another than the default"


# Conditions that code branches on and that no single field shows: name -> whether a scene meets it.


def aspects(scene: Scene) -> Iterator[str]:
    """Conditions across fields that this scene meets."""
    film, camera = scene.film, scene.camera
    aspect = "square" if film.width == film.height else "portrait" if film.width < film.height else "landscape"
    yield f"{aspect} film"
    yield f"{aspect} film of {label(type(camera))}"
    for name, field in type(camera).model_fields.items():
        if typing.get_origin(stripped(field.annotation)) is Literal and name != "type":
            yield f"{aspect} film, {name} {getattr(camera, name)!r}"
    if film.crop:
        x0, y0, x1, y1 = film.crop
        yield f"crop of {label(type(camera))}"
        for edge, cut in (("left", x0 > 0), ("top", y0 > 0), ("right", x1 < film.width), ("bottom", y1 < film.height)):
            yield f"crop {'cuts' if cut else 'keeps'} the {edge} edge"
    for light in scene.lights:
        colours = [value for value in vars(light).values() if isinstance(value, tuple) and len(set(value)) == 3]
        yield from (f"three channels of {label(type(light))}" for _ in colours[-1:])
    for shape in scene.shapes:
        yield from (f"{each} of {label(type(shape))}" for each in matrix_kinds(shape.matrix[:3, :3]))
        material = scene.material_of(shape)
        if scene.lights:
            yield f"{'two' if material.two_sided else 'one'}-sided {label(type(shape))} in light"


def matrix_kinds(linear: np.ndarray) -> Iterator[str]:
    """To what a transform is told apart: mirrored or not, similar or not."""
    yield "a mirrored transform" if np.linalg.det(linear) < 0.0 else "an upright transform"
    sizes = np.linalg.svd(linear, compute_uv=False)
    yield "a similarity" if sizes[0] <= sizes[2] * 1.001 else "a stretching transform"


def demanded_aspects(scene: type[Scene]) -> Iterator[str]:
    """Conditions across fields that have to be met by some scene, for each registered kind."""
    cameras = models_of(scene.model_fields["camera"].annotation)
    shapes, lights = (models_of(element_types(scene.model_fields[name].annotation)[1]) for name in ("shapes", "lights"))
    for aspect in ("square", "portrait", "landscape"):
        yield f"{aspect} film"
        for camera in cameras:
            yield f"{aspect} film of {label(camera)}"
            for name, field in camera.model_fields.items():
                plain = stripped(field.annotation)
                if typing.get_origin(plain) is Literal and name != "type":
                    yield from (f"{aspect} film, {name} {value!r}" for value in typing.get_args(plain))
    yield from (f"crop of {label(camera)}" for camera in cameras)
    yield from (
        f"crop {how} the {edge} edge" for how in ("cuts", "keeps") for edge in ("left", "top", "right", "bottom")
    )
    yield from (f"three channels of {label(light)}" for light in lights)
    kinds = ("a mirrored transform", "an upright transform", "a similarity", "a stretching transform")
    for shape in shapes:
        yield from (f"{kind} of {label(shape)}" for kind in kinds)
        yield from (f"{sides}-sided {label(shape)} in light" for sides in ("one", "two"))
