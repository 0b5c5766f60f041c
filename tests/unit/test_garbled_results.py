"""Result files with any one value garbled give an error that names the file and field, never a traceback."""

import copy
import json

import pytest
from json_paths import holder, paths_of
from outputs import json_of
from pages import read_result
from places import ROOT
from verdict_factory import scene, verdict

from caster.description.errors import SceneError
from mitsuba_ref.__main__ import main
from mitsuba_ref.bench.result import Run
from mitsuba_ref.runner.verdict_files import UnreadableVerdict, read_verdict

INTERNAL = 70
NESTED = "[" * 100_000

# What may stand in place of any value: JSON text, some of it no JSON.
GARBLED = [
    "null", "true", "-1", "1e999", "NaN", "-Infinity", "1" * 5000, '"\\ud800"', '"\\u0000"', '"x"', "[]", "[[[]]]",
    "{}", '{"": null}', NESTED,
]  # fmt: skip
MARK = "@@garbled@@"


def garbled(data, path, text):
    """The JSON with one value replaced."""
    if not path:
        return text
    changed = copy.deepcopy(data)
    holder(changed, path)[path[-1]] = MARK
    return json.dumps(changed).replace(json.dumps(MARK), text)


def places(data, texts):
    """Each value, garbled in two ways, which change from value to value; all ways in the end."""
    for i, path in enumerate(paths_of(data)):
        for k in (2 * i, 2 * i + 1):
            yield garbled(data, path, texts[k % len(texts)])


@pytest.fixture(scope="module")
def record():
    return verdict(scene("a"), scene("b", ok=False)).to_dict()


def test_a_garbled_verdict_is_an_error_of_the_file(tmp_path, capsys, record):
    file, refused, read = tmp_path / "v.json", 0, 0
    for content in places(record, GARBLED):
        file.write_text(content, encoding="utf-8")
        try:
            read_verdict(file)
        except UnreadableVerdict as error:
            refused += 1
            assert str(error).startswith(f"{file}: ") and len(str(error)) < 2000
            continue
        read += 1
        assert main(["merge", str(file), "--json", str(tmp_path / "merged.json")]) != INTERNAL
        said = capsys.readouterr()
        assert "Traceback" not in said.out + said.err
    assert refused > 100 < read + refused


def test_a_garbled_benchmark_is_an_error_of_the_file(tmp_path):
    data = json_of(ROOT / "docs/internals/performance/run.json")
    data["scenes"] = data["scenes"][:1]
    file, refused = tmp_path / "run.json", 0
    for content in places(data, GARBLED):
        file.write_text(content, encoding="utf-8")
        try:
            read_result(Run, str(file), "mitsuba-ref bench")
        except SceneError as error:
            refused += 1
            assert str(error).startswith(f"{file}: ")
    assert refused > 100


def test_the_message_names_the_field_and_what_was_got(tmp_path, record):
    file = tmp_path / "v.json"
    file.write_text(garbled(record, ("scenes", 0, "pixels"), '"many"'), encoding="utf-8")
    with pytest.raises(UnreadableVerdict, match=r"scenes\.0\.pixels: .*integer.*, got 'many'"):
        read_verdict(file)
