"""Pages whose commands are run by docs/console.py are of today's program."""

import importlib.util
import re
import shutil

import console
import pytest
from places import ROOT

from mitsuba_ref.reference.variants import usable_variants

# Page -> programs and modules that its commands need beside the product.
PAGES = {"quick-start": (), "debugging": (), "recipes/embree": ("cc", "embreex"), "recipes/open3d": ("open3d",)}


def essence(page):
    """The first three words of each line, without numbers and spaces: what Mitsuba answers differs between CPUs."""
    page = re.sub(r"processor\s+\w+\s+family\s+\d+\s+model\s+\d+\s+\([^)]*\)", "processor", page)
    lines = [line for line in page.splitlines() if "mitsuba llvm" not in line]
    return [re.sub(r"[-+]?\d[\d.]*(e[-+]?\d+)?|0x\S+", "#", line).split()[:3] for line in lines]


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.slow("a page of docs: a caster in NumPy, a minute")
def test_the_outputs_on_a_page_are_those_of_today(tmp_path, name):
    if missing := [each for each in PAGES[name] if not (shutil.which(each) or importlib.util.find_spec(each))]:
        pytest.skip(f"not on this machine: {', '.join(missing)}")
    if usable_variants().libllvm is None:
        pytest.skip("pages show the answers of Mitsuba's LLVM variant: install libLLVM 17 or newer")
    page = (ROOT / f"docs/{name}.md").read_text(encoding="utf-8")
    assert essence(console.renewed(page, tmp_path)) == essence(page)


PAGE = """```python
# greet.py
print("good morning\\n" * 3)
```

```console
$ python greet.py
good evening
...
$ echo a; exit 3  # exit 3
```
"""


def test_an_output_of_another_time_is_replaced(tmp_path):
    found = console.renewed(PAGE, tmp_path)
    assert found.endswith("$ python greet.py\ngood morning\n...\n$ echo a; exit 3  # exit 3\na\n```\n")
    assert essence(found) != essence(PAGE)
    assert console.renewed(found, tmp_path) == found


def test_an_exit_code_that_the_page_does_not_state_is_an_error(tmp_path):
    with pytest.raises(AssertionError, match="exit 3: exit code 3, expected 0"):
        console.renewed(PAGE.replace("  # exit 3", ""), tmp_path)
