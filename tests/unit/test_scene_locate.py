"""Every value of a scene file has a place in its text."""

import json
import tomllib

import pytest
from json_paths import paths_of

from caster.description.parsing import Positions, Span

TOML = """\
# a comment
top.level = 1
"quo ted" = [1, [2, 3], # two
   4]
[table] # three
a = { b = 1, "c d".e = [ { f = 2 } ] }
[table.below]
x = '''
many
lines'''
[[list]]
x = 1
[list.part]
y = 2
[[list.deep]]
z = 3
[[list.deep]]
z = 4
[[list]]
"é" = "ü"
x = 5
"""


def marked(text, span):
    return text.split("\n")[span.line - 1][span.column - 1 :][: span.length]


@pytest.mark.parametrize(
    ("path", "line", "mark"),
    [
        (("top", "level"), 2, "top.level"),
        (("top",), 2, "top.level"),
        (("quo ted",), 3, '"quo ted"'),
        (("quo ted", 1, 0), 3, "2"),
        (("quo ted", 2), 4, "4"),
        (("table",), 5, "[table]"),
        (("table", "a", "b"), 6, "b"),
        (("table", "a", "c d", "e", 0, "f"), 6, "f"),
        (("table", "below"), 7, "[table.below]"),
        (("table", "below", "missing"), 7, "[table.below]"),
        (("list", 0), 11, "[[list]]"),
        (("list", 0, "part"), 13, "[list.part]"),
        (("list", 0, "deep", 1, "z"), 18, "z"),
        (("list", 1), 19, "[[list]]"),
        (("list", 1, "é"), 20, '"é"'),
        (("list", 1, "x"), 21, "x"),
        (("list", 1, "x", 3, "nowhere"), 21, "x"),
    ],
)
def test_a_path_leads_to_its_key_header_or_item(path, line, mark):
    span = Positions(TOML, "toml").of(path)
    assert (span.line, marked(TOML, span)) == (line, mark)


def test_every_value_of_toml_has_a_place_of_its_own():
    positions = Positions(TOML, "toml")
    for path in list(paths_of(tomllib.loads(TOML)))[1:]:
        mark = marked(TOML, positions.of(path))
        assert str(path[-1]).strip("0123") in mark, path


def test_every_value_of_json_has_a_place_of_its_own():
    text = json.dumps(tomllib.loads(TOML), indent=2, ensure_ascii=False)
    positions = Positions(text, "json")
    spans = [positions.of(path) for path in list(paths_of(json.loads(text)))[1:]]
    assert len(set(spans)) == len(spans)


def test_columns_count_letters_not_bytes():
    assert Positions('{"é": {"ü": 1}}', "json").of(("é", "ü")) == Span(1, 8, 3)


def test_nowhere_is_the_beginning():
    assert Positions("", "toml").of(("camera",)) == Span(1, 1, 1)
    assert Positions('{"a": 1}', "json").of(("b", 1)) == Span(1, 1, 1)
