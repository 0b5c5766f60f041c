"""`mitsuba-ref init`: what it writes passes in every language of this machine, and nothing is overwritten."""

import re
import shutil
import subprocess

import pytest
import yaml

from mitsuba_ref.__main__ import main
from mitsuba_ref.cli.starter import LANGUAGES

TOOLS = {"python": "sh", "c": "cc", "rust": "rustc", "javascript": "node"}


@pytest.mark.parametrize("name", LANGUAGES)
@pytest.mark.slow("each compiles a program", keep=2)
@pytest.mark.usefixtures("remembered")
def test_it_passes_as_written(name, here, monkeypatch, capsys):
    if shutil.which(TOOLS[name]) is None:
        pytest.skip(f"not on this machine: {TOOLS[name]}")
    monkeypatch.syspath_prepend(here)
    assert main(["init", name]) == 0
    language, written = LANGUAGES[name], capsys.readouterr().out
    assert all((here / file).is_file() for file in re.findall("wrote (.*)", written))
    if language.build:
        subprocess.run(language.build, shell=True, check=True)
    option, _, command = language.candidate.partition(" ")
    assert main(["validate", "scene.toml", option, command.strip("'")]) == 0
    assert "PASS" in capsys.readouterr().out
    steps = yaml.safe_load((here / ".github/workflows/judge.yml").read_text())["jobs"]["judge"]["steps"]
    commands = [step["run"] for step in steps if "run" in step]
    _, first, _ = commands
    assert first.startswith(f"{language.build} && mitsuba-ref " if language.build else "mitsuba-ref ")
    readme = (here / "README.md").read_text()
    assert all(each.split(" --junit")[0] in readme for each in commands[1:])
    assert not re.search("BUILD|CANDIDATE|SOURCE", readme + " ".join(commands))


def test_the_next_command_can_be_typed(tmp_path, capsys):
    assert main(["init", "python", str(tmp_path / "of mine")]) == 0
    assert f"next: cd '{tmp_path / 'of mine'}' && mitsuba-ref validate" in capsys.readouterr().out


def test_an_existing_file_stays_and_nothing_is_written(tmp_path, capsys):
    (tmp_path / "README.md").write_text("mine")
    assert main(["init", "c", str(tmp_path)]) == 2
    assert "README.md: exists, and is not overwritten; name another folder" in capsys.readouterr().err
    assert [file.name for file in tmp_path.iterdir()] == ["README.md"]
