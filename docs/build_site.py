"""The documentation as a site that can be searched: python -P docs/build_site.py

Pages are copied to build/site-pages, with a page for each command from its own parser, and a report of the quick
start's ray caster as a demonstration; MkDocs makes build/site of them. A link that leads nowhere is an error.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from caster.cli import COMMANDS as CASTER
from caster.cli.application import Command, build_parser
from mitsuba_ref.cli import COMMANDS as JUDGE

ROOT = Path(__file__).resolve().parents[1]
DOCS, PAGES, SITE = ROOT / "docs", ROOT / "build/site-pages", ROOT / "build/site"
PROGRAMS = {"mitsuba-ref": JUDGE, "caster": CASTER}
sys.path.append(str(DOCS))

import api  # noqa: E402 - docs/api.py
import notebook  # noqa: E402 - docs/notebook.py

LINK = re.compile(r"(?<=\]\()([^)#\s:]+)(?=[)#])")
FILE = re.compile(r"^```python\n(# mine\.py\n.*?)^```$", re.MULTILINE | re.DOTALL)
DEMO = "validate --builtin triangles --size 64 64 --candidate mine:trace --html report"


def main() -> None:
    shutil.rmtree(PAGES, ignore_errors=True)
    copy_pages()
    names = write_command_pages(PAGES / "commands")
    write_demo(PAGES / "demo")
    config = ROOT / "build/mkdocs.yml"
    config.write_text(configuration(names), encoding="utf-8")
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}  # Material's advertisement
    words = [sys.executable, "-m", "mkdocs", "build", "--clean", "--strict", "-f", config]
    if code := subprocess.run(words, env=environment, cwd=config.parent).returncode:
        sys.exit(code)
    print(f"open {(SITE / 'index.html').as_uri()}")


def configuration(commands: list[str]) -> str:
    """docs/mkdocs.yml with the pages of the commands, as seen from build/."""
    text = (DOCS / "mkdocs.yml").read_text(encoding="utf-8").replace("../build/", "")
    pages = "".join(f"\n      - commands/{name}.md" for name in ["README", *commands])
    return text.replace(" COMMANDS", pages)


# --- pages


def copy_pages() -> None:
    """docs/ without its programs, and the notebook as a page.

    What a page names outside of docs/ is copied into the folder sources.
    """
    shutil.copytree(DOCS, PAGES, ignore=shutil.ignore_patterns("__pycache__"))
    for unwanted in (*PAGES.glob("*.py"), PAGES / "mkdocs.yml"):
        unwanted.unlink()
    tutorial = notebook.as_page(notebook.read(), PAGES / "tutorial")
    (PAGES / "tutorial.md").write_text(tutorial, encoding="utf-8")
    (PAGES / "api.md").write_text(api.reference(), encoding="utf-8")
    for page in sorted(PAGES.rglob("*.md")):
        text = page.read_text(encoding="utf-8").replace("<details>", '<details markdown="1">')
        page.write_text(LINK.sub(lambda found, page=page: within(found[1], page), text), encoding="utf-8")


def within(link: str, page: Path) -> str:
    """A link of a copied page to a file of the copy, to which a file outside of docs/ is added."""
    target = Path(os.path.normpath(DOCS / page.relative_to(PAGES).parent / link))
    if link == "tutorial.ipynb":
        return "tutorial.md"
    if target.is_dir() or (target.suffix == ".md" and not target.is_relative_to(DOCS)):
        raise ValueError(f"{page.relative_to(PAGES)}: {link}: expected a file, or a page of docs/")
    if target.is_relative_to(DOCS) or not target.exists():
        return link
    copy = PAGES / "sources" / target.relative_to(ROOT)
    copy.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(target, copy)
    return os.path.relpath(copy, page.parent)


def write_demo(folder: Path) -> None:
    """The report of the quick start's first run, which has wrong pixels."""
    (mine,) = FILE.findall((DOCS / "quick-start.md").read_text(encoding="utf-8"))
    work = ROOT / "build/site-demo"
    work.mkdir(parents=True, exist_ok=True)
    (work / "mine.py").write_text(mine, encoding="utf-8")
    words = [sys.executable, "-m", "mitsuba_ref", *DEMO.split()]
    found = subprocess.run(words, cwd=work, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
    if found.returncode != 1:
        raise RuntimeError(f"{DEMO}: exit code {found.returncode}, expected 1\n{found.stdout}{found.stderr}")
    shutil.copytree(work / "report", folder)


# --- commands


def write_command_pages(folder: Path) -> list[str]:
    """A page for each command of both programs, and a list of them; the names of the pages."""
    folder.mkdir()
    names = []
    rows = ["# Commands", ""]
    for program, commands in PROGRAMS.items():
        rows += [f"## {program}", "", "| command | what it does |", "|---|---|"]
        parsers = parsers_of(program, commands)
        for command in commands:
            name = f"{program}-{command.name}"
            text = "\n".join(command_page(command, parsers[command.name])) + "\n"
            (folder / f"{name}.md").write_text(text, encoding="utf-8")
            rows.append(f"| [`{program} {command.name}`]({name}.md) | {cell(command.help)} |")
            names.append(name)
        rows.append("")
    (folder / "README.md").write_text("\n".join(rows), encoding="utf-8")
    return names


def parsers_of(program: str, commands: tuple[Command, ...]) -> dict[str, argparse.ArgumentParser]:
    top = build_parser(program, "", commands, {})
    (subparsers,) = [each for each in top._actions if isinstance(each, argparse._SubParsersAction)]
    return dict(subparsers.choices)


def command_page(command: Command, parser: argparse.ArgumentParser) -> Iterator[str]:
    """What --help says, as Markdown."""
    yield from [f"# {parser.prog}", "", f"{command.help[0].upper()}{command.help[1:]}.", ""]
    yield from ["```console", *(f"$ {line}" for line in command.example.splitlines()), "```", ""]
    yield from ["```", parser.format_usage().strip(), "```", ""]
    for group in parser._action_groups:
        actions = [each for each in group._group_actions if each.help != argparse.SUPPRESS]
        if actions:
            yield from ["", f"## {(group.title or 'options').capitalize()}", ""]
            yield from [f"{group.description}\n"] if group.description else []
            yield from [
                "| name | meaning |",
                "|---|---|",
                *(f"| {called(each)} | {about(each, parser)} |" for each in actions),
            ]
    yield from ["", "Exit codes: [continuous integration](../ci.md#exit-codes)."]


def called(action: argparse.Action) -> str:
    """As it is typed."""
    value = "" if action.nargs == 0 else argparse.HelpFormatter("")._format_args(action, placeholder(action))
    return ", ".join(f"`{f'{name} {value}'.strip()}`" for name in action.option_strings or [""])


def placeholder(action: argparse.Action) -> str:
    return action.dest.upper() if action.option_strings else action.dest


def about(action: argparse.Action, parser: argparse.ArgumentParser) -> str:
    return cell(parser._get_formatter()._expand_help(action) if action.help else "")


def cell(text: str) -> str:
    """Text in a table of Markdown; what looks like a tag stays text."""
    return text.replace("|", "\\|").replace("\n", " ").replace("<", "&lt;").replace("*", "\\*")


if __name__ == "__main__":
    main()
