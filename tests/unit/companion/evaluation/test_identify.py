"""Coefficients of a barometer, from synthetic data with known ones, from logs, and from a JSBSim
flight."""

import math
from pathlib import Path

import numpy as np
import pytest

from companion.config import validate
from companion.errors import LogFormatError
from companion.evaluation.coefficients import Coefficient, Flight, coefficients
from companion.evaluation.identify import Identified, identify, parameters
from companion.recorded import Throttle
from sim.flight import Flight as SimFlight
from sim.scenario import Scenario
from tests import logfiles

WEIGHT = 11.5
TRUTH = {"forward": -0.12, "thrust": -90.0, "thermal": 6.0}


def flight(seed: int, *, fast: float = 55.0, hot_k: float = 25.0, power: float = 1.0) -> Flight:
    """Nine minutes: a rest of three, then speeds and throttle in steps; weather and receiver
    wander."""
    random = np.random.default_rng(seed)
    n, step_s = 260, 2.0
    time_s = np.asarray(step_s * np.arange(n), np.float64)
    flies = time_s > 180.0
    speed = np.where(flies, 30.0 + (fast - 30.0) * (np.floor(time_s / 60.0) % 2), 0.0)
    throttle = np.where(flies, 0.4 + power * 0.5 * (np.floor(time_s / 45.0) % 2), 0.0)
    die_k = 288.0 + hot_k * (1.0 - np.exp(-time_s / 150.0))
    head_pa = 0.5 * 1.225 * speed**2
    keep = math.exp(-step_s / 250.0)
    wander = np.zeros(n)
    for k in range(1, n):
        wander[k] = keep * wander[k - 1] + math.sqrt(1 - keep**2) * random.normal()
    error_pa = TRUTH["forward"] * head_pa + TRUTH["thrust"] * throttle
    error_pa += TRUTH["thermal"] * (die_k - 298.15) + 40.0 + 3.0 * np.sin(time_s / 90.0)
    climb_mps = np.where(flies, np.sin(time_s / 70.0), 0.0)
    height_m = np.asarray(300.0 + np.cumsum(climb_mps) * step_s, np.float64)
    heads = np.full((4, n), np.nan)
    heads[0] = head_pa
    return Flight(
        time_s,
        np.asarray(height_m - error_pa / WEIGHT + random.normal(0.0, 0.05, n), np.float64),
        height_m + 1.5 * wander + random.normal(0.0, 0.5, n),
        np.full(n, 2.5),
        np.full(n, WEIGHT),
        np.gradient(height_m, step_s),
        heads,
        np.zeros((2, n)),
        throttle,
        die_k,
        [(0, 90)],
    )


def test_finds_known_coefficients_within_a_tenth() -> None:
    found = {each.name: each for each in coefficients([flight(1), flight(2)])}
    for name, truth in TRUTH.items():
        assert found[name].is_seen
        assert found[name].value == pytest.approx(truth, rel=0.1)
        assert abs(found[name].value - truth) < 4.0 * found[name].sd
    assert "backward" in found["backward"].refused


def test_what_a_flight_does_not_show_is_refused_with_the_reason() -> None:
    found = {each.name: each for each in coefficients([flight(1, fast=30.0, hot_k=1.0, power=0.0)])}
    assert "temperature moves by 1.0 K only" in found["thermal"].refused
    assert found["forward"].refused
    assert not found["forward"].is_seen
    still = flight(1)
    still.heads_pa[0] = 40.0
    found = {each.name: each for each in coefficients([still])}
    assert "too little flight forward" in found["forward"].refused


def test_parameters_have_the_autopilots_signs() -> None:
    """ArduPilot subtracts coefficient times dynamic pressure, and THST_SCALE times throttle; it
    adds (T - 25)^TCAL_BARO_EXP."""
    seen = [
        Coefficient("forward", -0.1, 0.005),
        Coefficient("thrust", -80.0, 4.0),
        Coefficient("thermal", -2.0, 0.1),
    ]
    lines = {line.parameter: line.value for line in parameters(Identified(seen, 1, (10.0, 45.0)))}
    assert lines["BARO1_WCF_FWD"] == lines["EKF2_PCOEF_XP"] == -0.1
    assert lines["BARO1_WCF_ENABLE"] == 1
    assert lines["BARO1_THST_SCALE"] == -80.0
    assert lines["TC_B0_X1"] == -2.0
    above = np.linspace(0.0, 20.0, 21)
    left = np.power(above, lines["TCAL_BARO_EXP"]) - 2.0 * above
    assert np.std(left) < 2.5  # of 12 without the correction
    warm = [Coefficient("thermal", 2.0, 0.1)]
    assert not [
        line
        for line in parameters(Identified(warm, 1, (10.0, 45.0)))
        if line.autopilot == "ArduPilot"
    ]  # it cannot correct a pressure that rises with temperature


def test_a_log_without_speed_steps_shows_no_port_error(tmp_path: Path) -> None:
    path, _ = logfiles.write("tlog", tmp_path, imu_hz=0.0)
    found = {each.name: each for each in identify([path]).coefficients}
    assert found["forward"].refused
    assert found["thrust"].refused == "no throttle in the log"
    short, _ = logfiles.write("tlog", tmp_path, duration_s=30.0, imu_hz=0.0)
    with pytest.raises(LogFormatError, match="no session of a minute"):
        identify([short])


def test_the_throttle_of_a_dataflash_log_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    lines = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns"]
    lines += ["FMT, 150, 23, CTUN, Qf, TimeUS,ThO", "FMT, 151, 23, BARO, Qff, TimeUS,Alt,Press"]
    lines += [f"CTUN, {t}, {40 if t > 2e6 else 0}" for t in range(1_000_000, 4_000_000, 500_000)]
    lines += [f"BARO, {t}, 0, 100000" for t in range(1_000_000, 4_000_000, 500_000)]
    path.write_text("\n".join(lines) + "\n")
    from companion.logs import open_log

    told = [item for _, item in open_log(path).items() if isinstance(item, Throttle)]
    assert {each.share for each in told} == {0.0, 0.4}


@pytest.mark.slow
def test_coefficients_of_a_simulated_flight_are_found_within_a_tenth(tmp_path: Path) -> None:
    barometer = {
        "static_port": 0.15, "thrust_pa": -150.0, "thermal_pa_per_k": -5.0,
        "thermal_sd_pa_per_k": 0.0, "warming_k": 35.0, "warming_time_s": 100.0,
    }  # fmt: skip
    profile = [{"leg": "wait", "duration_s": 200}, {"leg": "take_off"}]
    profile += [{"leg": "climb", "altitude_amsl_m": 700}]
    for speed in (38, 52, 38, 52):
        profile.append({"leg": "hold", "duration_s": 60, "airspeed_mps": speed})
    scenario = validate(
        {
            "name": "errors",
            "summary": "of a test",
            "sensors": {"barometer": barometer},
            "profile": profile,
        },
        Scenario,
        source="test",
    )
    path = tmp_path / "errors.tlog"
    SimFlight(scenario, tlog=path).run()
    found = identify([path])
    values = {each.name: each for each in found.coefficients}
    assert values["forward"].value == pytest.approx(-0.15, rel=0.1)
    assert values["thrust"].value == pytest.approx(-150.0, rel=0.1)
    assert values["thermal"].value == pytest.approx(-5.0, rel=0.1)
    named = {line.parameter for line in parameters(found)}
    assert {"BARO1_WCF_FWD", "BARO1_THST_SCALE", "TCAL_BARO_EXP", "EKF2_PCOEF_XP"} <= named
