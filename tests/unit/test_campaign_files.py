"""Campaign files and histories: errors of both, what the key of a unit covers, what is new and what is gone."""

import sqlite3
from pathlib import Path

import pytest
from outputs import unfolded

from caster.description.errors import FileMissing, SceneError
from caster.system.atomic_files import OutputError
from mitsuba_ref.campaign import report as reports
from mitsuba_ref.campaign import units as module
from mitsuba_ref.campaign.description import read_campaign
from mitsuba_ref.campaign.history import History
from mitsuba_ref.campaign.report import LISTED, as_html, as_text, keep_scenes
from mitsuba_ref.campaign.units import REFERENCE, SUBJECT, Failure, Result, SubjectError, run_unit, units_of
from mitsuba_ref.cli import campaign as command
from mitsuba_ref.report import builtin_scenes

FUZZ = '[[job]]\ntype = "fuzz"\nfamilies = ["edges", "ties"]\nexamples = 30\nrays = [10, 40]\n'
SCENES = '[[job]]\ntype = "scenes"\nscenes = ["{}"]\n'


@pytest.fixture
def units(here):
    """The units of the text of a campaign file."""

    def found(text):
        file = here / "campaign.toml"
        file.write_text(text)
        return units_of(read_campaign(str(file))[0])

    return found


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("sed = [1]\n" + FUZZ, "campaign.toml:1:1: campaign: sed is an unknown key, did you mean 'seeds'?"),
        (FUZZ.replace("edges", "edge"), "campaign.toml:3:13: job[0] (fuzz): families[0] must be "),
        (FUZZ.replace("fuzz", "fuz"), "unknown job type \"fuz\", did you mean 'fuzz'?"),
        (FUZZ.replace("30", "2_000_000"), "expected a campaign of at most 99 units"),
        (2 * "[[subject]]\n" + FUZZ, "needs subjects of different names, got 'ours' twice"),
        ('[[job]]\ntype = "films"\nscenes = 1\nsizes = [[70000, 9]]\n', "sizes[0][0] must be <= 65536"),
        ('[[job]]\ntype = "films"\nscenes = 1\nsizes = [[16]]\n', "sizes[0] must be 2 numbers [width, height], got 1"),
        ('[[job]]\ntype = "stress"\nvalues = []\n', ":3:1: job[0] (stress): values must be a list that is not empty"),
        ("seeds = []\n" + FUZZ, ":1:1: campaign: seeds must be a list that is not empty"),
        (FUZZ.replace("30", "2_000_000_000"), "campaign.toml:4:1: job[0] (fuzz): examples must be <= 10000000"),
        ('[[subject]]\nname = ""\n' + FUZZ, "campaign.toml:2:1: subject[0]: name may not be empty"),
        ("[[subject]]\nserve = true\n" + FUZZ, ":2:1: subject[0]: serve is an option of a candidate, and"),
        (SCENES.format("builtin:scna"), ":3:11: job[0] (scenes): scenes[0] names no scene: builtin:scna: expected"),
        (SCENES.format("builtin:triangle"), "did you mean 'triangles'?"),
        ('[[subject]]\nname = "s"\ncandidate = "python \'broken"\n' + FUZZ, "subject 's': candidate"),
        (SCENES.format("nothing"), "/nothing: expected scene files in this folder, found none"),
        (SCENES.format("no/such.toml"), "no/such.toml: expected a scene file or a folder of them, found nothing"),
    ],
)
def test_a_mistake_in_a_campaign_file_is_named_with_its_place(units, tmp_path, monkeypatch, text, says):
    (tmp_path / "nothing").mkdir()
    monkeypatch.setattr(module, "MAX_UNITS", 99)
    with pytest.raises(SceneError) as error:
        units(text)
    assert says in str(error.value) and isinstance(error.value, FileMissing) == ("no/such" in text)


def test_units_are_every_combination_and_each_has_a_key_of_its_own(units):
    text = f'seeds = [0, 1]\n[[subject]]\n[[subject]]\nname = "mine"\ncandidate = "mine:trace"\n{FUZZ}'
    films = '[[job]]\ntype = "films"\nscenes = 3\nsizes = [[8, 8], [4, 4]]\nbounces = 2\n'
    stress = '[[job]]\ntype = "stress"\nfamilies = ["tangency"]\nvalues = [0.1, 0.01]\nrays = [5, 6]\n'
    found = units(text + films + stress)
    assert len(found) == 2 * 2 * (3 * 2 * 2 + 3 * 2 * 3 + 2 * 2)
    assert len({unit.key for unit in found}) == len({unit.name for unit in found}) == len(found)
    assert {unit.kind for unit in found[:6]} == {"fuzz", "films", "stress"}, "a budget cuts all jobs alike"
    assert sum(unit.parameters["examples"] for unit in found if unit.kind == "fuzz") == 2 * 2 * 2 * 2 * 30


def test_keys_change_with_code_settings_subject_and_scene(units, tmp_path, monkeypatch):
    scene = (builtin_scenes.ROOT / "triangles" / "scan.toml").read_text()
    (tmp_path / "scan.toml").write_text(scene)
    (tmp_path / "mine.py").write_text("def trace(scene, o, d): ...")
    text = '[[subject]]\nname = "mine"\ncandidate = "mine:trace"\n' + SCENES.format("scan.toml")

    def key(changed=text):
        (unit,) = units(changed)
        return unit.key

    first = key()
    assert key() == first
    (tmp_path / "mine.py").write_text("def trace(scene, o, d): return None")
    edited = key()
    (tmp_path / "scan.toml").write_text(scene + "\n# later\n")
    other_scene = key()
    monkeypatch.setenv("MITSUBA_ANYTHING", "1")
    other_settings = key()
    monkeypatch.setattr(module, "worker_identity", lambda: {"source code": "of tomorrow"})
    assert len({first, edited, other_scene, other_settings, key()}) == 5


def test_a_worker_with_other_files_than_the_run_judges_nothing(units, tmp_path):
    ball = '[camera]\ntype = "pinhole"\neye = [0, 0, 5]\nlook_at = [0, 0, 0]\n[[shape]]\ntype = "sphere"\n'
    (tmp_path / "x.toml").write_text(ball)
    (tmp_path / "mine.py").write_text("def trace(scene, o, d): ...")
    ours, mine = units('[[subject]]\n[[subject]]\nname = "mine"\ncandidate = "mine:trace"\n' + SCENES.format("x.toml"))
    (tmp_path / "mine.py").write_text("def trace(scene, o, d): return None")
    with pytest.raises(SubjectError, match=r"the worker on .* has another version of mine:trace"):
        run_unit(mine)
    (tmp_path / "x.toml").write_text(ball + "radius = 2\n")
    with pytest.raises(SceneError, match=r"x\.toml: the worker on .* has another version of the scene or a mesh"):
        run_unit(ours)


def test_a_unit_alone_prints_the_scene_of_its_replay(units, monkeypatch, capsys):
    (unit, *_) = units(FUZZ)
    failure = Failure(SUBJECT, "missed", "ours: miss", 2, "mitsuba-ref probe @scene 0 0", "# one ray\n[film]\n")
    monkeypatch.setattr(command, "run_unit", lambda _: Result("", 9, 4, 7, failures=(failure,)))
    assert command.run_one([unit], unit.name) == 1
    assert capsys.readouterr().out.endswith("replay: mitsuba-ref probe scene.toml 0 0\n# one ray\n[film]\n")


def test_units_by_name_number_and_working_folder(units, tmp_path, monkeypatch):
    scene = (builtin_scenes.ROOT / "triangles" / "scan.toml").read_text()
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "x.toml").write_text(f"# {folder}\n{scene}")
    job = SCENES.replace("{}", "{}/x.toml")
    with pytest.raises(SceneError, match="two units are called 'ours scenes scene=x bounce=0'"):
        units(job.format("a") + job.format("b"))
    (unit,) = units(job.format("a"))
    monkeypatch.chdir(tmp_path / "b")
    assert units_of(read_campaign("../campaign.toml")[0]) == [unit]  # in every working folder
    assert len(units('[[job]]\ntype = "stress"\nfamilies = ["sliver"]\nvalues = [1e-3, 1.0000001e-3]\n')) == 2


def test_keys_change_with_a_candidate_that_is_installed(units, tmp_path, monkeypatch):
    text = '[[subject]]\nname = "mine"\n{}\n[[job]]\ntype = "fuzz"\nfamilies = ["edges"]\nexamples = 1\n'
    for folder in ("library/deep", "bin"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "library/deep/__init__.py").touch()
    monkeypatch.syspath_prepend(str(tmp_path / "library"))
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    named = {
        "library/deep/inner.py": 'candidate = "deep.inner:trace"',
        "bin/mine": 'candidate = "mine --fast"\nserve = true',
    }
    for file, candidate in named.items():
        keys = set()
        for content in ("one", "two"):
            (tmp_path / file).write_text(content)
            (tmp_path / file).chmod(0o755)
            (unit,) = units(text.format(candidate))
            keys.add(unit.key)
        assert len(keys) == 2, file


ABOUT = dict.fromkeys(("code", "git", "campaign"), "x") | {"machine": "{}"}


@pytest.fixture
def history(tmp_path):
    with History(tmp_path / "h.sqlite", create=True) as history:
        yield history


def finish(history, units, failures=lambda unit: ()):
    """A run of these units, those that are not in the history with these failures; its number, and how many are new."""
    run, found = history.begin(units, ABOUT)
    for unit in units:
        if unit.key not in found:
            history.record(run, unit, Result(unit.key, 10, 5, 10, {}, failures(unit), 2.0))
    history.end(run, "complete")
    return run, len(units) - len(found)


def report_of(history):
    """The report, with its scenes kept."""
    found, scenes = reports.report_of(history)
    keep_scenes(history, scenes)
    return found


def with_keys(units, ending):
    """The units as another version of the code has them."""
    return [unit._replace(key=unit.key + ending) for unit in units]


def test_a_failure_is_new_once_then_stands_and_is_gone_with_its_fix(units, history):
    made = units(FUZZ)
    scene = Failure(SUBJECT, "missed", "ours: miss\nexact: hit", 2, "mitsuba-ref probe @scene 0 0", "# one ray")
    assert finish(history, made) == (1, len(made))
    assert report_of(history).ok
    fault = lambda unit: (scene,) if unit is broken[3] else ()  # noqa: E731
    broken = with_keys(made, "-broken")
    assert finish(history, broken, fault) == (2, len(made))
    found = report_of(history)
    assert not found.ok and [each.unit for each in found.new] == [made[3].name] and not found.gone
    file = found.new[0].replay.split()[2]
    assert Path(file).read_text() == "# one ray"
    text = as_text(found)
    assert text.index("new failures: 1") < text.index("rays/s") and ", 1 new failure, 0 gone" in text
    assert "missed (2 in 1 unit): " + made[3].name in unfolded(text)

    worse = with_keys(made, "-worse")
    finish(history, worse, lambda unit: (scene,) if unit in (worse[3], worse[4]) else ())
    found = report_of(history)
    assert [each.unit for each in found.new] == [made[4].name] and [each.unit for each in found.standing] == [
        made[3].name
    ]
    assert finish(history, made) == (4, 0), "the results of the first run are found again"
    found = report_of(history)
    assert found.ok and {each.unit for each in found.gone} == {made[3].name, made[4].name}
    assert [point.failing for point in found.trends["ours fuzz edges"]] == [
        0,
        *[sum(unit.group == "ours fuzz edges" for unit in each) for each in ([made[3]], made[3:5])],
        0,
    ]
    assert found.runs[-1].computed == 0 and finish(history, made) == (4, 0), "the same run goes on"


def test_a_unit_that_the_last_run_did_not_reach_is_compared_with_the_one_before(units, history):
    made = units(FUZZ)
    failing = lambda unit: (Failure(SUBJECT, "t", "off"),)  # noqa: E731
    finish(history, made, failing)
    later = with_keys(made, "-later")
    run, _ = history.begin(later, ABOUT)
    history.record(run, later[0], Result(later[0].key, 1))
    history.end(run, "budget")
    finish(history, with_keys(made, "-last"), failing)
    assert [each.unit for each in report_of(history).new] == [made[0].name]


def test_wrong_answers_of_the_reference_come_once_a_case_with_the_smallest_scene(units, history):
    made = units(FUZZ)
    sizes = {unit.key: 99 - i for i, unit in enumerate(made)}

    def failures(unit):
        text = "#" * sizes[unit.key]
        return (Failure(REFERENCE, "case 3: a cap", "Mitsuba is wrong", 4, "mitsuba-ref probe @scene 0 0", text),)

    finish(history, made, failures)
    found = report_of(history)
    (case,) = found.defects
    assert found.ok and (case.units, case.times) == (len(made), 4 * len(made))
    assert Path(case.replay.split()[2]).read_text() == "#" * min(sizes.values())


def test_the_page_needs_no_other_file_and_no_text_ends_it(units, history):
    made = units(FUZZ.replace("30", "300"))
    finish(history, made, lambda unit: (Failure(SUBJECT, unit.key, "</pre><script>"),))
    page = as_html(report_of(history))
    assert "<svg" in page and "<polyline" in page and "</pre><script>" not in page and "&lt;script&gt;" in page
    assert "http" not in page and "src=" not in page and f"and {len(made) - LISTED} more" in page


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (
            b"no database at all, but a text" * 99,
            "not a history of a campaign, or a damaged one: file is not a database",
        ),
        (b"", "expected the history of a campaign, of version 1; this is another database"),
        (None, "expected the history of a campaign, found no such file"),
    ],
)
def test_a_file_that_is_no_history_is_named(tmp_path, content, says):
    file = tmp_path / "h.sqlite"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(OutputError, match=rf"h\.sqlite: {says}"):
        History(file)


def test_a_history_whose_making_was_cut_off_is_made_again(units, tmp_path):
    (tmp_path / "h.sqlite").write_bytes(b"")
    with History(tmp_path / "h.sqlite", create=True) as history:
        assert finish(history, units(FUZZ))[0] == 1


def test_another_database_is_left_alone(tmp_path):
    file = tmp_path / "h.sqlite"
    with sqlite3.connect(file) as other:
        other.execute("CREATE TABLE mine (a)")
    before = file.read_bytes()
    with pytest.raises(OutputError, match="this is another database"):
        History(file, create=True)
    assert file.read_bytes() == before


def test_a_damaged_page_of_a_history_is_named_when_it_is_read(units, tmp_path):
    file = tmp_path / "h.sqlite"
    with History(file, create=True) as history:
        finish(history, units(FUZZ.replace("30", "900")))
    content = bytearray(file.read_bytes())
    for page in range(4096, len(content), 4096):
        content[page : page + 64] = b"\xff" * 64
    file.write_bytes(content)
    with History(file) as history, pytest.raises(OutputError, match="damaged one"):
        history.units(1)


def test_a_history_that_another_process_locks_is_an_error_in_time(units, tmp_path, monkeypatch):
    monkeypatch.setattr("mitsuba_ref.campaign.history.WAIT_SECONDS", 0.1)
    made, file = units(FUZZ), tmp_path / "h.sqlite"
    with History(file, create=True) as history:
        other = sqlite3.connect(file, isolation_level=None)
        other.execute("BEGIN EXCLUSIVE")
        with pytest.raises(OutputError, match="cannot be used: database is locked"):
            history.begin(made, ABOUT)
        other.execute("ROLLBACK")
        assert history.begin(made, ABOUT) == (1, set())


def test_a_full_disk_is_an_error_and_what_was_finished_is_kept(units, tmp_path):
    made, file = units(FUZZ.replace("30", "900")), tmp_path / "h.sqlite"
    with History(file, create=True) as history:
        history.database.execute("PRAGMA max_page_count = 20")
        with pytest.raises(OutputError, match="database or disk is full; what was finished before is kept"):
            finish(history, made, lambda unit: (Failure(SUBJECT, "t", "off" * 999),))
        kept = len(history.rows("SELECT * FROM units"))
        assert 0 < kept < len(made)
    with History(file) as history:
        assert finish(history, made)[1] == len(made) - kept
