"""Expectations: their form, what meets them, and the JUnit file."""

import math
from pathlib import Path
from xml.etree import ElementTree

import pytest

from companion.errors import ConfigError
from companion.replay.expect import hold, parse, write_junit

FIGURES = {"max_m": 8.0, "rmse_m": 2.0, "bias_m": -1.5, "nees": None}


def test_meets_and_does_not_meet() -> None:
    outcomes = hold("a", parse(["max<10", "rmse <= 2", "bias<1", "nees<2", "p95>0"]), FIGURES)
    assert [each.met for each in outcomes] == [True, True, False, False, False]
    assert outcomes[2].value == 1.5  # the size of the bias
    assert math.isnan(outcomes[3].value)  # unknown is not met
    assert "NOT met" in str(outcomes[3])
    assert not any(each.met for each in hold("a", parse(["max<10"]), None))


@pytest.mark.parametrize("text", ["max", "max=3", "height<3", "max<three", "max<1.2.3", ""])
def test_other_forms_are_one_clear_line(text: str) -> None:
    with pytest.raises(ConfigError, match="--expect"):
        parse([text])


def test_junit(tmp_path: Path) -> None:
    path = tmp_path / "result.xml"
    write_junit(path, "replay", hold("flight session 1", parse(["max<10", "nees<2"]), FIGURES))
    suite = ElementTree.parse(path).getroot()
    assert (suite.get("tests"), suite.get("failures")) == ("2", "1")
    assert [len(case) for case in suite] == [0, 1]
    with pytest.raises(ConfigError, match="cannot be written"):
        write_junit(tmp_path / "none" / "a.xml", "replay", [])
