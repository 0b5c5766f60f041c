"""What commands wrote and said, as tests read it."""

import json
from pathlib import Path
from typing import Any


def json_of(file: str | Path) -> Any:
    return json.loads(Path(file).read_text(encoding="utf-8"))


def unfolded(text: str) -> str:
    """In one line, with single spaces."""
    return " ".join(text.split())
