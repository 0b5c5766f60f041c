"""docs/tutorial.ipynb: its cells run, and what they print is what it shows."""

import notebook
import pytest

from mitsuba_ref.reference.variants import usable_variants


def printed(pages):
    """What all cells print."""
    outputs = [output for cell in pages["cells"] for output in cell.get("outputs", ())]
    return "".join(line for output in outputs for line in output.get("text", ()))


@pytest.mark.slow("a page of docs: three runs of a caster in NumPy")
def test_the_cells_print_what_the_notebook_shows():
    pytest.importorskip("matplotlib")
    if usable_variants().libllvm is None:
        pytest.skip("the notebook shows the answers of Mitsuba's LLVM variant: install libLLVM 17 or newer")
    shown = notebook.read()
    today = printed(notebook.executed(shown)).splitlines()
    stable = [line for line in today if not line.strip().startswith(("FAIL", "reference"))]
    assert [line for line in stable if line not in printed(shown)] == []
