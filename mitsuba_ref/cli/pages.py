"""`mitsuba-ref docs`: a page of the documentation, in the terminal or of the built site in a browser."""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import sys
import webbrowser
from pathlib import Path

from caster.cli.shared_arguments import adder
from caster.description.errors import FileMissing, SceneError, suggestion
from caster.system.process import OK

# In a clone a link to docs/, in a wheel a copy of its pages.
PAGES = Path(__file__).resolve().parents[1] / "pages"
SITE = PAGES.resolve().parent / "build/site"  # where `make site` builds it
MAP = "README"
LARGEST_WIDTH = 100  # columns of running text


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = adder(parser)
    help_ = "such as candidates, internals/jit or jit; default: the list of all pages"
    add("page", str, help_, metavar="PAGE", nargs="?", default=MAP)
    add("--html", bool, "open the page of the site that `make site` has built")


def run(args: argparse.Namespace) -> int:
    name = full_name(args.page)
    if args.html:
        open_in_browser(name)
    else:
        show((PAGES / f"{name}.md").read_text(encoding="utf-8"))
    return OK


def full_name(page: str) -> str:
    """The name of a page below docs/. Raises SceneError if there is none."""
    names = {path.relative_to(PAGES).with_suffix("").as_posix() for path in PAGES.glob("**/*.md")}
    short = {name.rpartition("/")[2]: name for name in names}
    wanted = page.removesuffix(".md")
    if wanted in names:
        return wanted
    if wanted not in short:
        below = ", ".join(sorted(name for name in names if name.startswith(f"{wanted.strip('/')}/")))
        hint = f": in that folder are {below}" if below else suggestion(wanted, [*sorted(names - {MAP}), *short])
        raise SceneError(f"docs: there is no page {page!r} (mitsuba-ref docs lists all){hint}")
    return short[wanted]


def open_in_browser(name: str) -> None:
    """Raises FileMissing if the site has not been built."""
    page = SITE / ("index" if name == MAP else name)
    address = page.with_name(page.name + ".html")
    if not address.exists():
        way_out = "in a clone, `make site` builds the site; without --html the page is shown here"
        raise FileMissing(f"{address}: not found: {way_out}")
    print(address.as_uri())
    webbrowser.open(address.as_uri())


def show(text: str) -> None:
    """Formatted and through the pager on a terminal, as it is anywhere else."""
    if not sys.stdout.isatty():
        sys.stdout.write(text)
        return
    from rich.console import Console
    from rich.markdown import Markdown

    width = min(shutil.get_terminal_size().columns, LARGEST_WIDTH)
    os.environ.setdefault("LESS", "FRX")  # as git does: less ends by itself if the text fits
    console = Console(force_terminal=True, width=width)
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the pager's
    try:
        with console.pager(styles=True):
            console.print(Markdown(text, hyperlinks=False))
    finally:
        signal.signal(signal.SIGINT, before)
