"""Results of experiments as JSON files: written from pydantic dataclasses, and read back into them.

Derived values (`computed_field`) are written as well, so that a reader of the file need not work them out; reading
ignores them.
"""

import importlib.metadata
import json
import math
import sys
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from caster.description.errors import FileMissing, SceneError
from caster.image.atomic_files import write_text
from mitsuba_ref.reference.variants import usable_variants

T = TypeVar("T")
STANDARD_OUTPUT = "-"


def as_json(result: Any) -> dict[str, Any]:
    """The result as plain data, derived values included."""
    data: dict[str, Any] = TypeAdapter(type(result)).dump_python(result, mode="json")
    return data


def write_result(result: Any, file: str) -> None:
    """Write the JSON of a result. Raises OutputError."""
    text = json.dumps(as_json(result), indent=1, allow_nan=False) + "\n"
    if file == STANDARD_OUTPUT:
        sys.stdout.write(text)
    else:
        write_text(file, text)


def read_result(kind: type[T], file: str, written_by: str) -> T:
    """The result in a file that `written_by` wrote. Raises FileMissing or SceneError."""
    try:
        return TypeAdapter(kind).validate_json(Path(file).read_bytes())
    except OSError as error:
        raise FileMissing(f"{file}: {error.strerror}") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        text = f"{file}: expected what `{written_by} --json` writes: {where}: {first['msg']}"
        raise SceneError(text) from error


def schema(kind: type) -> dict[str, Any]:
    """JSON Schema of a result file."""
    return TypeAdapter(kind).json_schema(mode="serialization")


def versions(*packages: str) -> dict[str, str]:
    """Installed versions of packages; "none" where there is none."""
    return {name: package_version(name) for name in packages}


def libllvm() -> str:
    """File name of the libLLVM that Mitsuba loads, or "none"."""
    library = usable_variants().libllvm
    return Path(library).name if library else "none"


def package_version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "none"


def largest(values: np.ndarray) -> float | None:
    """The largest finite value; None where there is none, since JSON has no word for it."""
    finite = [value for value in values.tolist() if math.isfinite(value)]
    return max(finite, default=None)
