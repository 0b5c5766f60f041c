"""Results of the commands fit the schemas of `mitsuba-ref schema NAME`."""

import json
from dataclasses import replace

import jsonschema
import pytest
from verdict_factory import scene, verdict

from mitsuba_ref.__main__ import main
from mitsuba_ref.cli.doctor import RESULTS, result_schema
from mitsuba_ref.exr_compare.comparison_result import FileComparison, GroupResult, Worst
from mitsuba_ref.judge.verdict import Failure

NAN = float("nan")


def fits(name, record):
    """Through text, as a reader of the file gets it."""
    jsonschema.validate(json.loads(json.dumps(record, allow_nan=False)), result_schema(name))


@pytest.mark.parametrize("name", RESULTS)
def test_every_result_has_a_schema_that_is_one(name, capsys):
    assert main(["schema", name]) == 0
    printed = json.loads(capsys.readouterr().out)
    jsonschema.Draft202012Validator.check_schema(printed)
    assert printed == result_schema(name) and printed["properties"]


def test_verdicts_fit_also_where_a_ratio_is_infinite():
    far = Failure(1, 2, "wrong", "mask", float("inf"), "a", "b", "c", "d")
    bad = replace(scene("bad", ok=False), failures=(far,), ratios={"mask": float("inf")})
    crashed = scene("crashed", problem="it ended")
    whole = verdict(scene("good"), bad, crashed, names=("left",))
    fits("verdict", whole.to_dict())
    broken = whole.to_dict() | {"scenes": [{"name": "good"}]}
    with pytest.raises(jsonschema.ValidationError):
        fits("verdict", broken)


def test_a_comparison_fits_also_where_a_value_is_not_a_number():
    worst = Worst(channel="A", x=1, y=2, ours=NAN, reference=1.0, error=NAN, bound=0.0, ratio=float("inf"))
    group = GroupResult(name="hit", channels=("A",), bound="exact", agree=1, differ=0, non_finite=1, worst=worst)
    result = FileComparison(ours="a.exr", reference="b.exr", groups=(group,), exit_code=1)
    record = result.model_dump(mode="json")
    fits("compare", record)
    assert record["groups"][0]["worst"]["ours"] == "nan" and record["groups"][0]["worst"]["ratio"] == "inf"
