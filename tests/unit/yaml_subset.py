"""As much of YAML as workflows are made of: mappings, lists, scalars plain and quoted, folded text, lists in a line.

Everything else is an error, and so is an indentation that fits nothing.
"""

import re
from typing import Any

KEY = re.compile(r"([A-Za-z_][\w-]*):(?: +(.*))?$")


def parse(text: str) -> Any:
    """Raises ValueError with the number of the line."""
    lines = [
        (number, len(line) - len(line.lstrip(" ")), line.strip())
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    value, rest = block(lines, 0)
    if rest:
        raise ValueError(f"line {rest[0][0]}: an indentation that fits nothing")
    return value


def block(lines: list, indent: int) -> tuple[Any, list]:
    """What begins at this indentation, and the lines that are left."""
    if not lines or lines[0][1] != indent:
        raise ValueError(f"line {lines[0][0] if lines else 'last'}: expected something at column {indent}")
    return sequence(lines, indent) if lines[0][2].startswith("- ") else mapping(lines, indent)


def sequence(lines: list, indent: int) -> tuple[list, list]:
    items = []
    while lines and lines[0][1] == indent and lines[0][2].startswith("- "):
        number, _, text = lines[0]
        inner = [(number, indent + 2, text[2:].strip()), *lines[1:]]
        if KEY.match(inner[0][2]):
            item, lines = mapping(inner, indent + 2)
        else:
            item, lines = scalar(number, inner[0][2]), lines[1:]
        items.append(item)
    return items, lines


def mapping(lines: list, indent: int) -> tuple[dict, list]:
    found: dict[str, Any] = {}
    while lines and lines[0][1] == indent and not lines[0][2].startswith("- "):
        number, _, text = lines[0]
        match = KEY.match(text)
        if not match or match[1] in found:
            raise ValueError(f"line {number}: expected a new key and a colon: {text}")
        key, value = match[1], match[2] or ""
        lines = lines[1:]
        if value in (">-", ">", "|", "|-"):
            folded = []
            while lines and lines[0][1] > indent:
                folded.append(lines[0][2])
                lines = lines[1:]
            found[key] = (" " if value[0] == ">" else "\n").join(folded)
        elif value:
            found[key] = scalar(number, value)
        elif lines and lines[0][1] > indent:
            found[key], lines = block(lines, lines[0][1])
        else:
            found[key] = None
    return found, lines


def scalar(number: int, text: str) -> Any:
    if text.startswith("["):
        if not text.endswith("]"):
            raise ValueError(f"line {number}: a ] is missing: {text}")
        return [scalar(number, each.strip()) for each in text[1:-1].split(",")]
    if text[0] in "\"'":
        if len(text) < 2 or text[-1] != text[0]:
            raise ValueError(f"line {number}: a quote is missing: {text}")
        return text[1:-1]
    if text[0] in "{}&*!|>%@`" or ": " in text or " #" in text:
        raise ValueError(f"line {number}: to be quoted: {text}")
    return {"true": True, "false": False}.get(text, int(text) if text.isdecimal() else text)
