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
from pathlib import Path

import caster.__main__
import mitsuba_ref.__main__
from caster.cli.application import build_parser

ROOT = Path(__file__).resolve().parents[1]
DOCS, PAGES, SITE = ROOT / "docs", ROOT / "build/site-pages", ROOT / "build/site"
PROGRAMS = {"mitsuba-ref": mitsuba_ref.__main__, "caster": caster.__main__}
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

COMMAND_PAGE = """# {name}

```
{help}```
"""


def write_command_pages(folder: Path) -> list[str]:
    """A page for each command of both programs, and a list of them; the names of the pages."""
    folder.mkdir()
    names = []
    rows = ["# Commands", ""]
    for program, module in PROGRAMS.items():
        rows += [f"## {program}", "", "| command | what it does |", "|---|---|"]
        parsers = parsers_of(program)
        for command in module.COMMANDS:
            name = f"{program}-{command.name}"
            text = COMMAND_PAGE.format(name=f"{program} {command.name}", help=parsers[command.name].format_help())
            (folder / f"{name}.md").write_text(text, encoding="utf-8")
            rows.append(f"| [`{program} {command.name}`]({name}.md) | {command.help} |")
            names.append(name)
        rows.append("")
    (folder / "README.md").write_text("\n".join(rows), encoding="utf-8")
    return names


def parsers_of(program: str) -> dict[str, argparse.ArgumentParser]:
    module = PROGRAMS[program]
    top = build_parser(program, module.ABOUT, module.COMMANDS, module.CODES)
    (subparsers,) = [each for each in top._actions if isinstance(each, argparse._SubParsersAction)]
    return dict(subparsers.choices)


if __name__ == "__main__":
    main()
