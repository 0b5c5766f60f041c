"""Run the cells of docs/tutorial.ipynb and keep what they print and plot: python docs/notebook.py

Jupyter is not needed: the cells are plain Python.
"""

import base64
import contextlib
import io
import json
from pathlib import Path
from typing import Any

NOTEBOOK = Path(__file__).with_name("tutorial.ipynb")
Notebook = dict[str, Any]


def executed(notebook: Notebook) -> Notebook:
    """The notebook with the outputs of today. Whatever a cell raises is raised."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    names: dict[str, Any] = {}
    cells, count = [], 0
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            count += 1
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                exec(compile("".join(cell["source"]), f"cell {count}", "exec"), names)
            outputs = [] if not printed.getvalue() else [text_output(printed.getvalue())]
            outputs += [picture_output(plt.figure(number)) for number in plt.get_fignums()]
            plt.close("all")
            cell = {**cell, "execution_count": count, "outputs": outputs}
        cells.append(cell)
    return {**notebook, "cells": cells}


def text_output(text: str) -> dict[str, Any]:
    return {"name": "stdout", "output_type": "stream", "text": text.splitlines(keepends=True)}


def picture_output(figure: Any) -> dict[str, Any]:
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=60, bbox_inches="tight", metadata={"Software": None})
    png = base64.b64encode(file.getvalue()).decode()
    return {"data": {"image/png": png}, "metadata": {}, "output_type": "display_data"}


def as_page(notebook: Notebook, pictures: Path) -> str:
    """The notebook as Markdown, for the site; its pictures go into a folder beside the page."""
    parts = []
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", ()):
            if "text" in output:
                parts.append(f"```\n{''.join(output['text']).rstrip()}\n```")
            else:
                pictures.mkdir(exist_ok=True)
                file = pictures / f"{len(parts)}.png"
                file.write_bytes(base64.b64decode(output["data"]["image/png"]))
                parts.append(f"![What this cell plots]({pictures.name}/{file.name})")
    return "\n\n".join(parts) + "\n"


def read() -> Notebook:
    return dict(json.loads(NOTEBOOK.read_text(encoding="utf-8")))


def main() -> None:
    text = json.dumps(executed(read()), indent=1, ensure_ascii=False)
    NOTEBOOK.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
