"""The programs accept every command of the documentation, and the YAML of docs/ci.md parses."""

import re
import shlex

import pytest
import yaml
from places import ROOT

from caster.cli import COMMANDS as CASTER
from caster.cli import application
from caster.system import process
from mitsuba_ref.cli import COMMANDS as JUDGE

PAGE = (ROOT / "docs/ci.md").read_text(encoding="utf-8")
PAGES = [ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("docs/recipes/*.md")]
PARSERS = {
    "caster": application.build_parser("caster", "", CASTER, {}),
    "mitsuba-ref": application.build_parser("mitsuba-ref", "", JUDGE, {}),
}
SECRET = re.compile(r"\$\{\{ *([\w.]+)[^}]*\}\}")  # an expression of GitHub's


def workflows():
    """That of one job, and that of four shards."""
    return [yaml.safe_load(text) for text in re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)]


def runs(workflow):
    return [step["run"] for job in workflow["jobs"].values() for step in job["steps"] if "run" in step]


def commands():
    """Every line of code of the pages, and of the workflows, that begins with one of the programs."""
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    lines = re.findall(r"^(?:    |\$ )((?:caster|mitsuba-ref) [\w-].*?)(?: > .*)?$", text, re.MULTILINE)
    lines += [command for workflow in workflows() for command in runs(workflow)]
    lines += re.findall(r"`((?:caster|mitsuba-ref) [a-z]+ [^`]*)`", PAGE)
    found = dict.fromkeys(line for line in lines if line.split(" ")[0] in PARSERS)
    return [SECRET.sub("1", line) for line in found]


@pytest.mark.parametrize("command", commands())
def test_every_command_is_accepted(command, capsys):
    program, *words = shlex.split(command, comments=True)
    if "COMMAND" in words or "--help" in words:
        return
    try:
        PARSERS[program].parse_args(words)
    except SystemExit:
        pytest.fail(f"{command}: {capsys.readouterr().err}")


def test_the_workflow_hangs_together():
    one, four = workflows()
    jobs = four["jobs"]
    assert jobs["verdict"]["needs"] == "validate" and jobs["verdict"]["if"] == "always()"
    shards = jobs["validate"]["strategy"]["matrix"]["shard"]
    assert shards == list(range(1, len(shards) + 1))
    assert any(f"--shard ${{{{ matrix.shard }}}}/{len(shards)} " in run for run in runs(four))
    assert len([run for run in runs(one) if run.startswith("mitsuba-ref validate ")]) == 1


def test_every_exit_code_is_explained():
    told = {int(code) for code in re.findall(r"^\| (\d+) \|", PAGE, re.MULTILINE)}
    assert told == set(process.MEANINGS) - {process.PIPE_CLOSED}
