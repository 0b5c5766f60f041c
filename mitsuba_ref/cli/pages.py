"""`mitsuba-ref docs`: a page of the documentation, in the terminal or of the built site in a browser."""

import shutil
import sys
import webbrowser
from argparse import Namespace
from pathlib import Path

from caster.cli.shared_arguments import Adder
from caster.description.errors import FileMissing, SceneError, suggestion
from caster.system.process import OK
from caster.system.terminal import unfiltered

# In a clone a link to docs/, in a wheel a copy of its pages.
PAGES = Path(__file__).resolve().parents[1] / "pages"
SITE = PAGES.resolve().parent / "build/site"  # where `make site` builds it
MAP = "README"
LARGEST_WIDTH = 100  # columns of running text


def add_arguments(add: Adder) -> None:
    add(
        "page",
        str,
        "such as candidates, internals/jit or jit; default: the list of all pages",
        metavar="PAGE",
        nargs="?",
        default=MAP,
    )
    add("--html", bool, "open the page of the site that `make site` has built")


def run(args: Namespace) -> int:
    """Show the page. Raises SceneError if there is none, FileMissing if the site has not been built."""
    name = full_name(args.page)
    if not args.html:
        show((PAGES / f"{name}.md").read_text(encoding="utf-8"))
        return OK
    page = SITE / f"{'index' if name == MAP else name}.html"
    if not page.exists():
        way_out = "in a clone, `make site` builds the site; without --html the page is shown here"
        raise FileMissing(f"{page}: not found: {way_out}")
    print(page.as_uri())
    webbrowser.open(page.as_uri())
    return OK


def full_name(page: str) -> str:
    """The name of a page below docs/. Raises SceneError if there is none."""
    names = {path.relative_to(PAGES).with_suffix("").as_posix() for path in PAGES.glob("**/*.md")}
    short = {name.rpartition("/")[2]: name for name in names}
    wanted = page.removesuffix(".md")
    if wanted in names:
        return wanted
    if wanted not in short:
        hint = suggestion(wanted, [*sorted(names - {MAP}), *short])
        raise SceneError(f"docs: there is no page {page!r} (mitsuba-ref docs lists all){hint}")
    return short[wanted]


def show(text: str) -> None:
    """Formatted on a terminal, as it is anywhere else."""
    if not sys.stdout.isatty():
        sys.stdout.write(text)
        return
    from rich.console import Console
    from rich.markdown import Markdown

    width = min(shutil.get_terminal_size().columns, LARGEST_WIDTH)
    Console(file=unfiltered(sys.stdout), force_terminal=True, width=width).print(Markdown(text, hyperlinks=False))
