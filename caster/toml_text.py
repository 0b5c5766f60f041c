"""Writes tables as TOML, one key a line."""

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def toml_of(data: Mapping[str, Any], order: Iterable[str]) -> str:
    """TOML of the tables named in `order`; floats are written so that they read back to the bit."""
    return "\n".join(line for name in order if name in data for line in _tables(name, data[name]))


def _tables(name: str, value: Any) -> Iterator[str]:
    if not isinstance(value, Mapping):
        for part in value:
            yield from _section(f"[[{name}]]", part)
    elif value and all(isinstance(part, Mapping) for part in value.values()):
        for key, part in value.items():
            yield from _section(f"[{name}.{_key(key)}]", part)
    else:
        yield from _section(f"[{name}]", value)


def _section(header: str, values: Mapping[str, Any]) -> Iterator[str]:
    yield header
    type_first = sorted(values.items(), key=lambda pair: pair[0] != "type")
    yield from (f"{_key(key)} = {_value(value)}" for key, value in type_first)
    yield ""


def _key(key: str) -> str:
    return key if BARE_KEY.fullmatch(key) else _string(key)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _string(value)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(key)} = {_value(item)}" for key, item in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_value, value)) + "]"
    return repr(value)  # of a float: the shortest digits that read back as this very one


def _string(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
