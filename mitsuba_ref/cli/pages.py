"""`mitsuba-ref docs`: a page of the documentation, in the terminal."""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import sys
from pathlib import Path

from caster.description.errors import SceneError, suggestion
from caster.system.process import OK

# In a clone a link to docs/, in a wheel a copy of its pages.
PAGES = Path(__file__).resolve().parents[1] / "pages"
MAP = "README"
LARGEST_WIDTH = 100  # columns of running text


def add_arguments(parser: argparse.ArgumentParser) -> None:
    help_ = "such as candidates, internals/jit or jit; default: the list of all pages"
    parser.add_argument("page", metavar="PAGE", nargs="?", type=str, default=MAP, help=help_)


def run(args: argparse.Namespace) -> int:
    show((PAGES / f"{full_name(args.page)}.md").read_text(encoding="utf-8"))
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
