"""The YAML of docs/ci.md and the pages beside it parses, and the programs accept their commands."""

import re
import shlex
from pathlib import Path

import pytest
import yaml

from caster.cli import COMMANDS as CASTER
from caster.cli import application
from caster.system import process
from mitsuba_ref.cli import COMMANDS as JUDGE

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/ci.md").read_text(encoding="utf-8")
YOURS = "".join((ROOT / f"docs/your-{name}.md").read_text(encoding="utf-8") for name in ("renderer", "ci"))
STORY = (ROOT / "docs/debugging-an-edge-case.md").read_text(encoding="utf-8")
PARSERS = {
    "caster": application.build_parser("caster", "", CASTER, ()),
    "mitsuba-ref": application.build_parser("mitsuba-ref", "", JUDGE, ()),
}
SECRET = re.compile(r"\$\{\{ *([\w.]+)[^}]*\}\}")  # an expression of GitHub's


def workflow():
    (text,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    return yaml.safe_load(text)


def steps():
    return [step for job in workflow()["jobs"].values() for step in job["steps"]]


def your_steps():
    (text,) = re.findall(r"```yaml\n(.*?)```", YOURS, re.DOTALL)
    return yaml.safe_load(text)["jobs"]["judge"]["steps"]


def commands():
    """Every line of the pages, and of the workflow, that begins with one of the programs."""
    lines = [line.removeprefix("    ").removeprefix("$ ") for line in (PAGE + STORY + YOURS).splitlines()]
    lines += [step["run"] for step in steps() if "run" in step]
    lines += re.findall(r"`((?:caster|mitsuba-ref) [a-z]+ [^`]*)`", PAGE + YOURS)
    lines += [step["run"] for step in your_steps() if "run" in step]
    found = dict.fromkeys(line for line in lines if line.split(" ")[0] in PARSERS)
    return [SECRET.sub("1", line) for line in found]


@pytest.mark.parametrize("command", commands())
def test_every_command_is_accepted(command, capsys):
    program, *words = shlex.split(command)
    if "COMMAND" in words or "--help" in words:
        return
    try:
        PARSERS[program].parse_args(words)
    except SystemExit:
        pytest.fail(f"{command}: {capsys.readouterr().err}")


def test_the_workflow_hangs_together():
    jobs = workflow()["jobs"]
    assert jobs["verdict"]["needs"] == "validate" and jobs["verdict"]["if"] == "always()"
    shards = jobs["validate"]["strategy"]["matrix"]["shard"]
    runs = [step["run"] for step in steps() if "run" in step]
    assert shards == list(range(1, len(shards) + 1))
    assert any(f"--shard ${{{{ matrix.shard }}}}/{len(shards)} " in run for run in runs)


def test_every_exit_code_is_explained():
    told = {int(code) for code in re.findall(r"^\| (\d+) \|", PAGE, re.MULTILINE)}
    assert told == set(process.MEANINGS) - {process.PIPE_CLOSED}
