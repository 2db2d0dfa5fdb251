"""Scenarios: those that come with the simulator can be flown, and every mistake in one is one
line."""

from pathlib import Path

import pytest

from companion.errors import ConfigError, KollsmanError, SimulationError
from sim.scenario import load_scenario, scenario_paths

HEAD = "name: mine\nsummary: of a test\n"
WAIT = "profile:\n  - {leg: wait, duration_s: 5}\n"
HOLD = "profile:\n  - {leg: hold, duration_s: 5}\n"
FLIGHT = WAIT + "  - {leg: take_off}\n"


def test_all_scenarios_load_and_are_named_like_their_file() -> None:
    paths = scenario_paths()
    assert {"calm-circuit", "weather-change", "short-hop"} <= paths.keys()
    for name in paths:
        scenario = load_scenario(name)
        assert scenario.name == name
        assert scenario.about
        assert scenario.aloft or "take_off" in [leg.leg for leg in scenario.profile]


def test_an_unknown_scenario_lists_those_that_exist() -> None:
    with pytest.raises(
        SimulationError, match=r"no scenario 'calm': there are .*calm-circuit.*short-hop"
    ):
        load_scenario("calm")


def test_a_file_is_loaded_by_its_path(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(HEAD + FLIGHT)
    assert load_scenario(path).name == "mine"
    assert load_scenario(str(path)).runway.elevation_m == 300.0


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (HEAD, "profile: this key is required"),
        (HEAD + "profile: []\n", "profile"),
        (HEAD + FLIGHT + "sed: 3\n", "sed: unknown key; did you mean `seed`?"),
        (
            HEAD + FLIGHT + "runway: {elevation_m: 9000}\n",
            "runway.elevation_m: 9000 is out of range; .*5000 .m.",
        ),
        (
            HEAD + WAIT + "  - {leg: climb, altitude_amsl_m: 900}\n",
            "a climb begins in the air: after a take_off",
        ),
        (
            HEAD + FLIGHT + "  - {leg: wait, duration_s: 5}\n",
            "a wait begins on the ground: after the start or a",
        ),
        (HEAD + "aircraft: sgs126\n" + FLIGHT, "no engine: give it an altitude to start at"),
        (
            HEAD + "aircraft: sgs126\naloft: {altitude_amsl_m: 900}\n" + HOLD,
            "no engine for a hold: it can glide and land",
        ),
        (
            HEAD + "aloft: {altitude_amsl_m: 900, airspeed_mps: 20}\n" + HOLD,
            "airspeed_mps 20 is too slow for c172p",
        ),
        (HEAD + "aloft: {altitude_amsl_m: 310}\n" + HOLD, "altitude_amsl_m 310 is not 50 m above"),
        (
            HEAD + FLIGHT + "  - {leg: land}\n  - {leg: hold, duration_s: 5}\n",
            "a hold begins in the air",
        ),
        (
            HEAD + FLIGHT + "  - {leg: land, touch_and_go: true}\n",
            "a touch-and-go is followed by a take_off",
        ),
        (
            HEAD + FLIGHT + "  - {leg: climb, altitude_amsl_m: 320}\n",
            "altitude_amsl_m 320 is not 50 m above",
        ),
        (
            HEAD + FLIGHT + "  - {leg: loop}\n",
            "profile.2.leg: no 'loop'; give one of wait, take_off, climb",
        ),
        (HEAD + FLIGHT + "faults: [{start_s: 5}]\n", "faults.0.fault: this key is required"),
        (HEAD + FLIGHT + "faults: {fault: drop}\n", "faults: {'fault': 'drop'} is not a list"),
        (
            HEAD + FLIGHT + "aircraft: concorde\n",
            "yaml: aircraft: no 'concorde'; give one of c172p, 737",
        ),
        (
            HEAD + FLIGHT + "streams_hz: {BATTERY_STATUS: 5}\n",
            "'BATTERY_STATUS' is not streamed: use HEARTBEAT",
        ),
        (HEAD + FLIGHT + "sensors: {imu: {rate_hz: 30}}\n", "sensors.imu.rate_hz"),
        (
            HEAD + FLIGHT + "sensors: {gnss: {latency_s: -1}}\n",
            r"sensors.gnss.latency_s: -1 is out of range.*\(s\)",
        ),
        (
            HEAD
            + FLIGHT
            + "weather: {pressure: [{time_s: 5, sea_level_hpa: 1000}, {time_s: 5, sea_level_hpa: "
            "990}]}\n",
            "the times of the pressure ramp must increase",
        ),
        (
            HEAD + FLIGHT + "weather: {pressure: [{time_s: 5, sea_level_hpa: 101325}]}\n",
            r"sea_level_hpa.*\(hPa\)",
        ),
        ("name: Not A Name\nsummary: x\n" + FLIGHT, "name"),
        ("{", "not valid YAML"),
    ],
)
def test_a_mistake_is_one_line_that_names_file_and_key(
    text: str, complaint: str, tmp_path: Path
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=complaint) as failure:
        load_scenario(path)
    message = str(failure.value)
    assert message.startswith(str(path))
    assert "\n" not in message


def test_a_missing_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(KollsmanError, match="no such file"):
        load_scenario(tmp_path / "none.yaml")
