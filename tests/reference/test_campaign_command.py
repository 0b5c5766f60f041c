"""The command `mitsuba-ref campaign`: continuing after a kill, crashes, new failures, budgets and exit codes."""

import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest
from outputs import json_of, unfolded

from mitsuba_ref.__main__ import main

FUZZ = '[[job]]\ntype = "fuzz"\nfamilies = ["edges", "ties"]\nexamples = {}\njudge_every = 0\n'
EVERY_KIND = """
[[job]]
type = "scenes"
scenes = ["builtin:scan"]
sizes = [[9, 6]]

[[job]]
type = "films"
scenes = 1
sizes = [[6, 6]]
bounces = 1

[[job]]
type = "fuzz"
families = ["edges"]
examples = 2

[[job]]
type = "stress"
families = ["tangency"]
values = [0.001]
rays = [30]
"""
CANDIDATE = """
import os
import numpy as np
import caster

def trace(scene, o, d):
    hits = caster.cast(scene, o, d)
    return hits.t.astype(np.float32){fault}, hits.normal.astype(np.float32)

def kill(scene, o, d):
    if scene.film.width == 9:
        os.kill(os.getpid(), 9)
    return trace(scene, o, d)
"""


@pytest.fixture
def campaign(here, monkeypatch, capsys, warm, remembered):
    """Run a campaign of a text; (exit code, stdout, the report's JSON or None)."""
    monkeypatch.delitem(sys.modules, "mine", raising=False)  # another test's, which workers would inherit

    def run(text, *more, name="c.toml"):
        Path(name).write_text(text)
        Path("told.json").unlink(missing_ok=True)
        code = main(["campaign", name, "--json", "told.json", *more])
        out = unfolded(capsys.readouterr().out)
        return code, out, json_of("told.json") if Path("told.json").exists() else None

    yield run
    sys.modules.pop("mine", None)


def rows(file, query):
    with sqlite3.connect(file) as database:
        return database.execute(query).fetchall()


def without_times(file):
    """All that a history says, but for times and the numbers of rows."""
    units = "key, name, kind, subject, grouped, parameters, rays, hits, agree, counts, failing, processor, computed_by"
    return [
        rows(file, "SELECT id, identity, state, code, git, machine, campaign, units FROM runs ORDER BY id"),
        rows(file, f"SELECT {units} FROM units ORDER BY key"),
        rows(file, "SELECT * FROM failures ORDER BY key, side, cause, what"),
        rows(file, "SELECT * FROM run_units ORDER BY run, key"),
    ]


def test_every_kind_of_unit_is_judged_and_kept_and_nothing_is_computed_twice(campaign, capsys):
    code, out, told = campaign(EVERY_KIND)
    assert code == 0 and "5 units: 0 in the history, 5 to compute computed 5, 0 left" in out, out
    assert told["ok"] and [run["state"] for run in told["runs"]] == ["complete"]
    assert set(told["trends"]) == {"ours scenes", "ours films furnished", "ours fuzz edges", "ours stress tangency"}
    found = rows("c.history.sqlite", "SELECT kind, rays, hits, agree, failing FROM units")
    assert all(0 < hits <= rays and 0 < agree <= rays and not failing for _, rays, hits, agree, failing in found), found
    before = without_times("c.history.sqlite")
    code, out, told = campaign(EVERY_KIND)
    assert code == 0 and "5 in the history, 0 to compute computed 0, 0 left" in out and len(told["runs"]) == 1
    assert without_times("c.history.sqlite") == before
    assert main(["campaign", "c.history.sqlite", "--html", "page.html"]) == 0
    assert "run 1, complete: 5 of 5 units" in capsys.readouterr().out and "<svg" in Path("page.html").read_text()


@pytest.mark.slow("four runs")
def test_a_run_that_is_killed_goes_on_and_its_history_is_that_of_an_undisturbed_one(campaign):
    text = FUZZ.format(80)
    assert campaign(text, "-j", "1", name="whole.toml")[0] == 0
    Path("killed.toml").write_text(text)
    command = [sys.executable, "-m", "mitsuba_ref", "campaign", "killed.toml", "-j", "1"]
    running = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    history, end = Path("killed.history.sqlite"), time.monotonic() + 120.0
    while time.monotonic() < end and running.poll() is None:
        time.sleep(0.02)
        made = history.exists() and len(rows(history, "SELECT name FROM sqlite_master")) > 3
        if made and len(rows(history, "SELECT key FROM units")) >= 3:
            break
    running.send_signal(signal.SIGKILL)
    assert running.wait() == -signal.SIGKILL, "it was not killed in the middle"
    finished = rows(history, "SELECT key, finished, seconds FROM units ORDER BY key")
    assert 3 <= len(finished) < 16 and rows(history, "SELECT state FROM runs") == [("running",)]
    code, out, told = campaign(text, "-j", "1", name="killed.toml")
    assert code == 0 and f"{len(finished)} in the history, {16 - len(finished)} to compute" in out
    assert f"computed {16 - len(finished)}, 0 left" in out and len(told["runs"]) == 1
    assert set(finished) <= set(rows(history, "SELECT key, finished, seconds FROM units"))
    assert without_times(history) == without_times("whole.history.sqlite")


def test_a_unit_that_kills_its_process_is_one_row_and_the_others_finish(campaign):
    Path("mine.py").write_text(CANDIDATE.format(fault=""))
    text = '[[subject]]\nname = "mine"\ncandidate = "mine:kill"\n[[job]]\ntype = "scenes"\n'
    text += 'scenes = ["builtin:scan"]\nsizes = [[8, 7], [9, 7], [7, 8]]\n'
    code, out, told = campaign(text)
    assert code == 1 and "3 to compute computed 3, 0 left" in out
    failures = rows("c.history.sqlite", "SELECT name, cause, what, replay FROM failures JOIN units USING (key)")
    ((name, cause, what, replay),) = failures
    assert (name, cause) == ("mine scenes scene=scan size=9x7 bounce=0", "crash") and what.endswith("ended: SIGKILL")
    assert replay == f"mitsuba-ref campaign c.toml --unit '{name}'" and [each["unit"] for each in told["new"]] == [name]
    assert campaign(text)[1].count("computed 0") == 1, "it is not tried again"
    again = [sys.executable, "-m", "mitsuba_ref", "campaign", "c.toml", "--unit", name]
    assert subprocess.run(again, capture_output=True, check=False).returncode == -signal.SIGKILL


def test_a_fault_of_a_candidate_is_new_then_as_before_and_gone_when_it_is_fixed(campaign, capsys):
    text = '[[subject]]\nname = "mine"\ncandidate = "mine:trace"\n' + EVERY_KIND.replace("bounces = 1", "")

    def run(fault, *more):
        Path("mine.py").write_text(CANDIDATE.format(fault=fault))
        return campaign(text, *more)

    assert run("")[0] == 0
    code, out, told = run(" * np.float32(1.01)")
    assert code == 1 and {each["group"] for each in told["new"]} == set(told["trends"])
    assert "t is 1.01 times what it should be" in out
    file = next(each["replay"] for each in told["new"] if "films" in each["unit"]).split()[2]
    assert Path(file).is_file()
    count = len(told["new"])
    shutil.rmtree("c.history.failures")
    Path("c.history.failures").touch()  # where nothing can be written
    assert main(["campaign", "c.history.sqlite"]) == 4
    told = capsys.readouterr()
    assert f"new failures: {count}" in told.out and "c.history.failures" in told.err
    Path("c.history.failures").unlink()
    code, out, told = run(" * np.float32(1.010)")
    assert code == 0 and not told["new"] and len(told["standing"]) == count
    assert run(" * np.float32(1.010)", "--strict")[0] == 1
    assert main(["campaign", "c.toml", "--unit", told["standing"][0]["unit"]]) == 1
    assert re.search(r"\nsubject: .+ \(\d+\): ", capsys.readouterr().out)
    code, out, told = run("")
    assert code == 0 and "0 to compute" in out and len(told["gone"]) == count and len(told["runs"]) == 4


def test_a_budget_ends_the_run_and_the_next_call_goes_on(campaign):
    text, end = FUZZ.format(40), "[budget]\nrays = 1\n"
    code, out, told = campaign(text + end, "-j", "1")
    assert code == 0 and told["runs"][0]["state"] == "budget" and "computed 1, 7 left" in out
    some = told["runs"][0]["units"]
    assert 1 <= some < 8, "others may have finished meanwhile"
    code, out, told = campaign(text, "-j", "1")
    assert f"{some} in the history, {8 - some} to compute" in out
    assert [(run["state"], run["units"]) for run in told["runs"]] == [("complete", 8)]


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["no.sqlite"], 4, "no.sqlite: expected the history of a campaign, found no such file"),
        (
            ["c.toml", "--unit", "ours fuzz"],
            2,
            "the campaign has no such unit; the first of 2 is 'ours fuzz seed=0 family=",
        ),
        (["no.sqlite", "--unit", "x"], 2, "no.sqlite: expected the campaign file with --unit or --history"),
        (["empty.toml"], 2, "seeds must be a list that is not empty"),
        (["vacuous.toml"], 5, "nothing judged"),
    ],
)
def test_mistakes_have_their_exit_codes(campaign, capsys, words, code, says):
    Path("c.toml").write_text(FUZZ.format(1))
    Path("empty.toml").write_text("seeds = []\n" + FUZZ.format(1))
    Path("decline.py").write_text("def trace(scene, o, d):\n    raise NotImplementedError\n")
    job = '[[job]]\ntype = "scenes"\nscenes = ["builtin:scan"]\nsizes = [[4, 4]]\n'
    Path("vacuous.toml").write_text('[[subject]]\nname = "mine"\ncandidate = "decline:trace"\n' + job)
    assert main(["campaign", *words]) == code
    assert says in capsys.readouterr().err


def test_no_output_replaces_the_history(here, capsys):
    Path("c.toml").write_text(FUZZ.format(1))
    Path("c.history.sqlite").write_bytes(b"kept")
    for option in ("--json", "--html"):
        assert main(["campaign", "c.toml", option, "c.history.sqlite"]) == 2
        assert "expected another file than the history" in capsys.readouterr().err
    assert Path("c.history.sqlite").read_bytes() == b"kept"


def test_a_mistake_is_told_last_and_unit_stands_alone(here, capsys):
    job = FUZZ.format(1)
    Path("c.toml").write_text(f'[[subject]]\nname = "s"\ncandidate = "nowhere:trace"\n{job}')
    assert main(["campaign", "c.toml", "-j", "1", "--json", "told"]) == 2
    told = capsys.readouterr()
    assert "nothing judged" not in told.err
    assert "subject 's': --candidate 'nowhere:trace': there is no module nowhere" in unfolded(told.err)
    assert "run 1" not in told.out and not Path("told").exists()
    assert rows("c.history.sqlite", "SELECT * FROM run_units") == []
    Path("d.toml").write_text(job)
    assert main(["campaign", "d.toml", "--unit", "x", "--json", "told"]) == 2
    assert "--json: not together with --unit" in capsys.readouterr().err
