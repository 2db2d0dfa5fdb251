"""Configuration files: every mistake is one line that says where, what, in which unit and what is
allowed."""

from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import Field

from companion.config import Settings, dump, load, validate
from companion.config.fields import range_of, unit_of
from companion.errors import ConfigError, KollsmanError


class Sensor(Settings):
    rate_hz: float = Field(10.0, ge=0.1, le=100)
    window_s: float = Field(2.0, gt=0, le=60)
    count: int = Field(3, ge=1, le=255)
    drift_mps: float = Field(0.0, ge=0)
    variance_m2: Annotated[float, Field(gt=0, le=1e6)] | Literal["claimed"] = "claimed"
    id: int | None = Field(None, ge=1, le=9)
    mode: Literal["auto", "never"] = "auto"
    enabled: bool = True


class Model(Settings):
    sensor: Sensor = Sensor()
    name: str = "x"


def write(folder: Path, text: str) -> Path:
    path = folder / "companion.yaml"
    path.write_text(text, encoding="utf-8")
    return path


MISTAKES = {
    "unknown key, near": (
        "sensor:\n  rate: 3\n",
        2,
        "sensor.rate: unknown key; did you mean `rate_hz`?",
    ),
    "unknown key, far": ("zebra: 1\n", 1, "zebra: unknown key; known here: sensor, name"),
    "too large": (
        "\nsensor:\n  rate_hz: 500\n",
        3,
        "sensor.rate_hz: 500 is out of range; give a number from 0.1 to 100 (Hz)",
    ),
    "excluded bound": (
        "sensor: {window_s: 0}",
        1,
        "sensor.window_s: 0 is out of range; give a number above 0, at most 60 (s)",
    ),
    "open range": (
        "sensor: {drift_mps: -1}",
        1,
        "sensor.drift_mps: -1 is out of range; give a number of at least 0 (m/s)",
    ),
    "not a number": (
        "sensor:\n  rate_hz: 10 Hz\n",
        2,
        "sensor.rate_hz: '10 Hz' is not a number; give a number from 0.1 to 100 (Hz)",
    ),
    "a truth value": (
        "sensor:\n  rate_hz: yes\n",
        2,
        "sensor.rate_hz: 'yes' is not a number; give a number from 0.1 to 100 (Hz)",
    ),
    "a truth value as count": (
        "sensor:\n  count: on\n",
        2,
        "sensor.count: 'yes' is not a whole number",
    ),
    "a list": ("sensor:\n  rate_hz: [1]\n", 2, "sensor.rate_hz: [1] is not a number"),
    "NaN": ("sensor: {rate_hz: .nan}", 1, "sensor.rate_hz: nan is out of range"),
    "infinite": ("sensor: {drift_mps: .inf}", 1, "sensor.drift_mps: inf is out of range"),
    "a fraction": (
        "sensor: {count: 1.5}",
        1,
        "sensor.count: 1.5 is not a whole number; give a whole number from 1 to 255",
    ),
    "optional out of range": (
        "sensor: {id: 10}",
        1,
        "sensor.id: 10 is out of range; give a number from 1 to 9",
    ),
    "no such choice": (
        "sensor: {mode: always}",
        1,
        "sensor.mode: 'always': Input should be 'auto' or 'never'",
    ),
    "no switch": (
        "sensor: {enabled: perhaps}",
        1,
        "sensor.enabled: 'perhaps': Input should be a valid boolean",
    ),
    "neither of two types": (
        "sensor:\n  variance_m2: much\n",
        2,
        "sensor.variance_m2: 'much' is neither a number above 0, at most 1e+06 nor 'claimed' (m2)",
    ),
    "out of range of one of two types": (
        "sensor:\n  variance_m2: -4\n",
        2,
        "sensor.variance_m2: -4 is neither",
    ),
    "a section that is a list": (
        "sensor: [1]\n",
        1,
        "sensor: [1] is not a section; give `key: value` lines below it",
    ),
    "a key that is a number": ("name: x\n1: 2\n", 2, "1: a key must be text"),
    "given twice": ("name: x\nsensor:\n  count: 1\n  count: 2\n", 4, "count: given twice"),
    "several": (
        "sensor:\n  count: 0\n  rate_hz: 0\n",
        2,
        "sensor.count: 0 is out of range; give a number from 1 to 255 (and 1 more)",
    ),
    "unclosed": ("name: [\n", 2, "not valid YAML: while parsing a flow node"),
    "a tab": ("sensor:\n\tcount: 1\n", 2, "not valid YAML: while scanning"),
    "no such anchor": ("name: *a\n", 1, "not valid YAML: found undefined alias"),
    "code": (
        "name: x\nsensor: !!python/object/apply:os.system [ls]\n",
        2,
        "not valid YAML: could not determine a constructor",
    ),
    "a control character": (
        "name: x\n\nsensor: \x01\n",
        3,
        (
            "not valid YAML: control characters are not allowed"
            if yaml.__with_libyaml__
            else "not valid YAML: special characters are not allowed"
        ),
    ),
    "two documents": (
        "---\nname: a\n---\nname: b\n",
        3,
        "not valid YAML: expected a single document",
    ),
    "no such date": ("sensor:\n  count: 2001-99-99\n", 2, "not valid YAML: month must be in 1..12"),
    "thousands of digits": (
        "name: x\nsensor: " + "9" * 5000,
        2,
        "not valid YAML: Exceeds the limit",
    ),
    "a list as key": (
        "name: x\n? [1, 2]\n: 3\n",
        2,
        "not valid YAML: while constructing a mapping: found unhashable key",
    ),
    "an anchor inside itself": (
        "name: &a [*a]\n",
        1,
        "name: [",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line_with_file_line_key_unit_and_range(
    tmp_path: Path, mistake: str
) -> None:
    text, line, said = MISTAKES[mistake]
    path = write(tmp_path, text)
    with pytest.raises(ConfigError) as failure:
        load(path, Model)
    message = str(failure.value)
    assert message.startswith(f"{path}:{line}: {said}")
    assert "\n" not in message
    assert "pydantic" not in message


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[1, 2]\n", "must hold `key: value` lines, found a list"),
        ("word\n", "must hold `key: value` lines, found a str"),
        ("[" * 1500, "not valid YAML: (nested too deeply|.*maximum nesting depth)"),
    ],
)
def test_a_file_of_another_shape(tmp_path: Path, text: str, said: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigError, match=f"^{path}(:1)?: {said}$"):
        load(path, Model)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    missing = tmp_path / "none.yaml"
    with pytest.raises(ConfigError, match=f"^{missing}: no such file$"):
        load(missing, Model)
    with pytest.raises(ConfigError, match="cannot be read as text"):
        load(tmp_path, Model)
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"name: \xff\xfe")
    with pytest.raises(ConfigError, match="cannot be read as text"):
        load(binary, Model)


@pytest.mark.parametrize(
    "text", ["", "# nothing but a comment\n", "---\n", "sensor:\n", "sensor: {}\n", "\ufeff"]
)
def test_every_key_and_section_is_optional(tmp_path: Path, text: str) -> None:
    assert load(write(tmp_path, text), Model) == Model()


def test_values_arrive_with_their_types(tmp_path: Path) -> None:
    text = "name: a b\nsensor:\n  rate_hz: 5\n  id: 3\n  variance_m2: 4\n  enabled: no\n"
    assert load(write(tmp_path, text), Model) == Model(
        name="a b", sensor=Sensor(rate_hz=5.0, id=3, variance_m2=4.0, enabled=False)
    )


def test_values_do_not_change_after_loading() -> None:
    with pytest.raises(ValueError, match="frozen"):
        Model().name = "y"  # type: ignore[misc]


def test_errors_are_of_the_tree_that_the_command_line_catches() -> None:
    assert issubclass(ConfigError, KollsmanError)
    with pytest.raises(ConfigError, match=r"^options: sensor\.count: 0 is out of range"):
        validate({"sensor": {"count": 0}}, Model, source="options")


@settings(deadline=None, max_examples=50)
@given(
    rate_hz=st.floats(0.1, 100),
    window_s=st.floats(0, 60, exclude_min=True),
    count=st.integers(1, 255),
    variance_m2=st.just("claimed") | st.floats(1e-6, 1e6),
    number=st.none() | st.integers(1, 9),
    name=st.text(st.characters(codec="utf-8", categories=["L", "N", "P"]), max_size=8),
)
def test_the_resolved_dump_reads_back_as_itself(
    tmp_path_factory: pytest.TempPathFactory,
    rate_hz: float,
    window_s: float,
    count: int,
    variance_m2: float | Literal["claimed"],
    number: int | None,
    name: str,
) -> None:
    sensor = Sensor(
        rate_hz=rate_hz, window_s=window_s, count=count, variance_m2=variance_m2, id=number
    )
    model = Model(sensor=sensor, name=name)
    assert load(write(tmp_path_factory.mktemp("dump"), dump(model)), Model) == model


@settings(deadline=None, max_examples=200)
@given(text=st.text(st.sampled_from("sensor:rate_hz 0.5\n\t[]{}&*!-?'\"%#|>x,~"), max_size=60))
def test_no_text_raises_anything_but_a_config_error(
    tmp_path_factory: pytest.TempPathFactory, text: str
) -> None:
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    path.write_text(text, encoding="utf-8")
    said = ""
    try:
        load(path, Model)
    except ConfigError as error:
        said = str(error)
    assert "\n" not in said


@pytest.mark.parametrize(
    ("key", "unit"),
    [
        ("latency_s", "s"),
        ("drift_mps", "m/s"),
        ("sd_mps2", "m/s2"),
        ("qnh_hpa", "hPa"),
        ("ramp_hpa_per_h", "hPa/h"),
        ("variance_m2", "m2"),
        ("altitude_hz", "Hz"),
        ("tilt_deg", "degrees"),
        ("count", ""),
    ],
)
def test_the_suffix_is_the_unit(key: str, unit: str) -> None:
    assert unit_of(key) == unit


@pytest.mark.parametrize(
    ("bounds", "words"),
    [
        ({"ge": 0, "le": 5}, "from 0 to 5"),
        ({"gt": 0, "le": 5}, "above 0, at most 5"),
        ({"gt": 0, "lt": 5}, "above 0, below 5"),
        ({"ge": 0, "lt": 5}, "from 0 to below 5"),
        ({"ge": 2}, "of at least 2"),
        ({"gt": 2}, "above 2"),
        ({"le": 2}, "of at most 2"),
        ({"lt": 2}, "below 2"),
        ({}, ""),
    ],
)
def test_ranges_in_words(bounds: dict[str, Any], words: str) -> None:
    class Bounded(Settings):
        value: float = Field(1.0, **bounds)

    assert range_of(Bounded.model_fields["value"]) == words
