"""`mitsuba-ref init`: a ray caster to begin with, which passes as written, and what judges it."""

import re
import shlex
from argparse import Namespace
from pathlib import Path
from typing import NamedTuple

from caster.cli.shared_arguments import Adder, OutputFolder
from caster.description.errors import SceneError
from caster.system.atomic_files import check_folder, write_text
from caster.system.process import OK

STARTERS = Path(__file__).resolve().parents[1] / "starters"
# What each language gets, and where: text in which BUILD, CANDIDATE and SOURCE stand for those of the language.
SHARED = {"README.md": "README.md", "scene.toml": "scene.toml", "judge.yml": ".github/workflows/judge.yml"}


class Language(NamedTuple):
    """source: the file to edit; build: a command, or nothing; candidate: options that name the caster."""

    source: str
    build: str
    candidate: str


LANGUAGES = {
    "python": Language("mine.py", "", "--candidate mine:trace"),
    "c": Language("mine.c", "cc -O2 -std=c99 -o mine mine.c -lm", "--candidate-serve ./mine"),
    "rust": Language("mine.rs", "rustc -O mine.rs", "--candidate-serve ./mine"),
    "javascript": Language("mine.js", "", "--candidate-serve 'node mine.js'"),
}


def add_arguments(add: Adder) -> None:
    add("language", str, ", ".join(LANGUAGES), metavar="LANGUAGE", choices=LANGUAGES)
    add(
        "folder",
        OutputFolder,
        "created if it does not exist; default: the current one",
        metavar="FOLDER",
        nargs="?",
        default=OutputFolder("."),
    )


def run(args: Namespace) -> int:
    """Write the files of a language, and print how to go on. Raises SceneError, and writes nothing, if one exists."""
    language, folder = LANGUAGES[args.language], check_folder(Path(args.folder))
    texts = {file.name: file.read_text(encoding="utf-8") for file in sorted((STARTERS / args.language).glob("*.*"))}
    build = f"{language.build} && " if language.build else ""
    words = {"BUILD": build, "CANDIDATE": language.candidate, "SOURCE": language.source}
    for name, place in SHARED.items():
        text = (STARTERS / "any" / name).read_text(encoding="utf-8")
        texts[place] = re.sub("|".join(words), lambda found: words[found[0]], text)
    if existing := [name for name in texts if (folder / name).exists()]:
        raise SceneError(f"{folder / existing[0]}: exists, and is not overwritten; name another folder")
    for name, text in texts.items():
        check_folder((folder / name).parent)
        write_text(folder / name, text)
        print(f"wrote {folder / name}")
    go = f"cd {shlex.quote(str(folder))} && " if args.folder != "." else ""
    print(f"next: {go}{build}mitsuba-ref validate scene.toml {language.candidate}")
    return OK
