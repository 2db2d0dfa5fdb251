"""Every scenario that comes with the simulator flies to its end, in the air, on its profile, and
shows what it says.

What it shows is read from its log, as any client would: the barometer's height by the standard
atmosphere's law and the receiver's, against the truth of SIM_STATE.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.config import validate
from companion.logs.tlog import TlogReader
from companion.mavlink.codec import decode, mavlink, scan
from companion.mavlink.framing import Frame
from sim import BOOT_UNIX_US
from sim.faults.editing import header
from sim.flight import Flight, Progress, Summary
from sim.pilot.profile import Hold
from sim.scenario import Scenario, load_scenario, scenario_paths

Series = NDArray[np.float64]
IDS = {
    mavlink.MAVLINK_MSG_ID_SIM_STATE: "truth",
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: "baro",
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: "gnss",
}
STALL_MPS = {"c172p": 25.0, "737": 62.0, "f16": 65.0, "sgs126": 15.0}
"""calibrated, with the flaps of the landing"""


@dataclass
class Flown:
    """One flight: times (s since boot) with the errors of barometer and receiver (m), and the truth
    at 1 Hz."""

    scenario: Scenario
    summary: Summary
    level_error_m: Series
    airspeed_mps: Series
    truth: Series
    baro: Series
    gnss: Series
    fix: Series
    """(time, altitude), (time, error), (time, error), (time, fix type, v_acc m)"""

    def error(self, name: str, start_s: float, end_s: float) -> Series:
        series: Series = getattr(self, name)
        found: Series = series[1][(series[0] >= start_s) & (series[0] < end_s)]
        assert found.size > 0
        return found

    @property
    def end_s(self) -> float:
        return float(self.truth[0][-1])


def fly(name: str, path: Path) -> Flown:
    scenario = load_scenario(name)
    flight = Flight(scenario, tlog=path)
    level: list[float] = []
    speeds: list[float] = []
    held_s, leg = 0.0, flight.profile.leg

    def watch(progress: Progress) -> None:
        nonlocal held_s, leg
        if flight.profile.leg is not leg:
            leg, held_s = flight.profile.leg, progress.time_s
        if (
            not progress.truth.on_ground
            and progress.truth.altitude_amsl_m > scenario.runway.elevation_m + 30.0
        ):
            speeds.append(progress.truth.airspeed_mps)
        target_m = flight.vehicle.state.truth
        if isinstance(leg, Hold) and progress.time_s - held_s > 30.0 and target_m is not None:
            level.append(
                progress.truth.altitude_amsl_m
                - flight.profile.update(progress.truth).altitude_amsl_m
            )

    summary = flight.run(watch)
    return Flown(scenario, summary, np.array(level), np.array(speeds), *read(path))


def read(path: Path) -> tuple[Series, Series, Series, Series]:
    rows: dict[str, list[tuple[float, ...]]] = {"truth": [], "baro": [], "gnss": [], "fix": []}
    for packet in TlogReader(path):
        kind = IDS.get(header(packet.data).message_id)
        if kind is None:
            continue
        frame = scan(packet.data)
        assert isinstance(frame, Frame)
        message: Any = decode(frame)
        time_s = (packet.time_us - BOOT_UNIX_US) * 1e-6
        if kind == "truth":
            rows["truth"].append((time_s, message.alt))
        elif kind == "baro":
            rows["baro"].append(
                (time_s, 44_330.77 * (1.0 - (message.press_abs / 1013.25) ** 0.190263))
            )
        else:
            rows["fix"].append((time_s, message.fix_type, message.v_acc * 1e-3))
            if message.fix_type >= 3:
                rows["gnss"].append((time_s, message.alt * 1e-3))
    truth, baro, gnss, fix = (
        np.array(rows[name], float).T for name in ("truth", "baro", "gnss", "fix")
    )
    for series in (baro, gnss):
        series[1] -= np.interp(series[0], truth[0], truth[1])
    return truth, baro, gnss, fix


def drift(flown: Flown, first_s: float, last_s: float) -> float:
    """How much the barometer's error changed from one minute to another; the second counts from the
    end if negative."""
    last_s = flown.end_s + last_s if last_s < 0 else last_s
    return float(
        flown.error("baro", last_s - 60, last_s).mean()
        - flown.error("baro", first_s, first_s + 60).mean()
    )


def spread(flown: Flown, name: str, start_s: float, end_s: float) -> float:
    return float(flown.error(name, start_s, end_s).std())


def widest(flown: Flown) -> float:
    """Of the barometer's error, minute means."""
    minutes = [
        flown.error("baro", s, s + 30).mean() for s in np.arange(60.0, flown.end_s - 30.0, 30.0)
    ]
    return float(np.ptp(minutes))


def aloft_and_low(flown: Flown) -> float:
    """The barometer's error at the greatest height less that on the ground."""
    top_s = float(flown.truth[0][int(np.argmax(flown.truth[1]))])
    return float(
        flown.error("baro", top_s - 30, top_s + 30).mean() - flown.error("baro", 15, 40).mean()
    )


def blind_s(flown: Flown) -> float:
    """Without a fix after the first one."""
    blind = (flown.fix[1] < 3) & (flown.fix[0] > 60.0)
    return float(blind.sum()) * 0.2


def lossy(flown: Flown) -> bool:
    """What arrives: 70 % of 20 Hz, and 5 % of it twice."""
    return abs(flown.error("baro", 100, 400).size / (300 * 20 * 0.7 * 1.05) - 1.0) < 0.05


def late_speed_error(flown: Flown) -> bool:
    """It follows the square of the airspeed: 9 m less 5 m, above noise."""
    return 3.0 < widest(flown) < 12.0


def landings(flown: Flown) -> int:
    """How often it came down to the runway."""
    low = flown.truth[1] < flown.scenario.runway.elevation_m + 2.0
    return int(np.count_nonzero(np.diff(low.astype(int)) == 1))


def climbs_mps(flown: Flown) -> Series:
    """True vertical speed, means of five seconds."""
    times = np.arange(flown.truth[0][0], flown.end_s, 5.0)
    climbs: Series = np.diff(np.interp(times, flown.truth[0], flown.truth[1])) / 5.0
    return climbs


CLAIMS: Mapping[str, Callable[[Flown], bool]] = {
    "airliner-descent": lambda f: -30.0 < aloft_and_low(f) < -5.0 and landings(f) == 1,
    "airliner-emergency": lambda f: float(np.percentile(climbs_mps(f), 20)) < -34.0,
    "airliner-front": lambda f: widest(f) > 60.0 and landings(f) == 1,
    "circuit-landing": lambda f: landings(f) == 2,
    "fighter-low-level": lambda f: (
        climbs_mps(f).max() > 24.0 and climbs_mps(f).min() < -24.0 and landings(f) == 1
    ),
    "glider-spiral": lambda f: (
        abs(float(np.median(climbs_mps(f))) + 1.4) < 0.2 and landings(f) == 1
    ),
    "best-sensors": lambda f: float(np.abs(f.error("gnss", f.end_s - 80, f.end_s)).max()) < 0.2,
    "calm-circuit": lambda f: widest(f) < 6.0 and 2.0 < spread(f, "gnss", 60, 1200) < 7.0,
    "cheap-sensors": lambda f: (
        spread(f, "gnss", 100, 800) > 4.0 and set(f.fix[2][f.fix[1] >= 3]) == {1.2}
    ),
    "cold-front-descent": lambda f: widest(f) > 40.0,
    "cold-start": lambda f: aloft_and_low(f) > 80.0,
    "failing-barometer": lambda f: (
        np.abs(f.error("baro", 200, 260)).max() > 25.0
        and f.error("baro", 310, 380).mean() < -20.0
        and spread(f, "baro", 435, 485) > 4.0
        and f.error("baro", 720, 760).mean() > 300.0
    ),
    "gnss-outage-in-cloud": lambda f: (
        abs(blind_s(f) - 480.0) < 5.0 and 4.0 < drift(f, 740, 1310) < 11.0
    ),
    "gusty-shake": lambda f: f.airspeed_mps.std() > 2.0,
    "half-pressure": lambda f: f.error("baro", 20, 400).min() > 4500.0,
    "hot-and-high": lambda f: -90.0 < aloft_and_low(f) < -50.0,
    "hour-long-cruise": lambda f: drift(f, 60, 4200) > 18.0,
    "iced-static-port": lambda f: (
        f.error("baro", 480, 780).max() > 150.0 and abs(f.error("baro", 850, 950)).max() < 20.0
    ),
    "inversion-approach": lambda f: aloft_and_low(f) > 12.0,
    "jammed-approach": lambda f: 80.0 < blind_s(f) < 160.0 and f.fix[2].max() > 20.0,
    "lossy-radio": lossy,
    "low-level-qnh-drift": lambda f: 15.0 < drift(f, 0, -5) < 27.0,
    "metar-day": lambda f: 55.0 < widest(f) < 95.0,
    "mountain-wave": lambda f: 8.0 < widest(f) < 30.0,
    "reboot-in-flight": lambda f: float(np.diff(f.baro[0]).max()) > 2.9,
    "short-hop": lambda f: widest(f) < 3.0,
    "sliding-first-fix": lambda f: (
        f.error("gnss", 8, 15).mean() > 500.0 and abs(f.error("gnss", 70, 200)).max() < 25.0
    ),
    "spoofed-approach": lambda f: (
        f.error("gnss", 800, 900).mean() > 100.0 and f.fix[2][f.fix[1] >= 3].max() < 5.0
    ),
    "static-port-error": late_speed_error,
    "warm-front-cruise": lambda f: widest(f) > 15.0,
    "weather-change": lambda f: widest(f) > 50.0,
}
"""What each scenario says that it shows."""


def test_there_are_at_least_fifteen_and_each_makes_a_claim() -> None:
    names = scenario_paths().keys()
    assert len(names) >= 15
    assert CLAIMS.keys() <= names
    for name in names:
        scenario = load_scenario(name)
        assert len(scenario.about) > 60
        assert scenario.summary.endswith(".")
    summaries = {load_scenario(name).summary for name in names}
    assert len(summaries) == len(names)


@pytest.mark.long
@pytest.mark.parametrize("name", scenario_paths())
def test_it_flies_to_the_end_and_shows_what_it_says(name: str, tmp_path: Path) -> None:
    flown = fly(name, tmp_path / "log.tlog")
    assert flown.summary.completed
    assert flown.airspeed_mps.min() > STALL_MPS[flown.scenario.aircraft]
    if flown.level_error_m.size:
        assert math.sqrt(np.mean(flown.level_error_m**2)) < 10.0
    if name in CLAIMS:
        assert CLAIMS[name](flown), f"{name} does not show what it says"


def test_everything_at_once_repeats_to_the_byte(tmp_path: Path) -> None:
    """Layers, humidity, fields, turbulence, presets and faults; and another seed is another
    flight."""
    values = {
        "name": "everything", "summary": "of a test.",
        "profile": [{"leg": "wait", "duration_s": 4}, {"leg": "take_off", "height_m": 60}],
        "weather": {
            "profile": [
                {"altitude_amsl_m": 320, "offset_k": -5}, {"altitude_amsl_m": 360, "offset_k": 3},
            ],
            "relative_humidity": 0.7, "front": {"distance_m": 500},
            "gradient": {"hpa_per_100km": 0.5}, "diurnal": {}, "mountain_wave": {"distance_m": 0},
            "gusts": [{"time_s": 10}], "turbulence": {"severity": 3, "wind_at_6m_mps": 4},
        },
        "sensors": {
            "barometer": {"preset": "MS5611", "static_port": 0.05},
            "gnss": {"preset": "cheap", "first_fix_s": 2},
            "imu": {"preset": "ICM-20602", "vibration_mps2": 10},
        },
        "faults": [{"fault": "noise", "sd": 5}, {"fault": "drop", "probability": 0.1},
                   {"fault": "delay"}],
    }  # fmt: skip
    scenario = validate(values, Scenario, "a test")
    logs = []
    for number, seed in enumerate((1, 1, 2)):
        path = tmp_path / f"{number}.tlog"
        Flight(scenario, tlog=path, seed=seed).run()
        logs.append(path.read_bytes())
    assert logs[0] == logs[1]
    assert logs[0] != logs[2]
