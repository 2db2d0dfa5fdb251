"""A flight in falling pressure that loses GNSS, with a ground barometer in its log: the altitude
stays, and without the ground barometer it goes with the weather."""

from pathlib import Path

import numpy as np
import pytest

from companion.logs.tlog import TlogReader
from companion.mavlink.codec import Decoder, mavlink
from companion.pipeline import Pipeline
from companion.samples import Kind, Packet, Rows, Verdict
from companion.settings import CompanionSettings
from sim.flight import Flight
from sim.scenario import Scenario
from tests.vehicle import Vehicle

ELEVATION_M, OUTAGE_S, FALL_PA = 300.0, 240.0, 62.0
"""of ten minutes: the largest change of a year is 31 m an hour"""
SCENARIO = Scenario.model_validate(
    {
        "name": "falling",
        "summary": "Sea-level pressure falls by 5 m of air in ten minutes, without GNSS.",
        "aloft": {"altitude_amsl_m": 800},
        "weather": {
            "pressure": [
                {"time_s": OUTAGE_S, "sea_level_hpa": 1004.0},
                {"time_s": OUTAGE_S + 600.0, "sea_level_hpa": 1004.0 - FALL_PA * 0.01},
            ]
        },
        "faults": [{"fault": "outage", "start_s": OUTAGE_S, "duration_s": 700.0}],
        "streams_hz": {"RAW_IMU": 10.0, "SIM_STATE": 5.0, "ATTITUDE": 0.0},
        "profile": [{"leg": "hold", "duration_s": OUTAGE_S + 600.0, "bank_deg": 5.0}],
    }
)


class Heights:
    """Errors of the estimate, by time of the vehicle's clock."""

    def __init__(self) -> None:
        self.truth: list[tuple[float, float]] = []
        self.found: list[tuple[float, float]] = []

    def sample(self, kind: Kind, row: Rows, verdict: Verdict, estimate: Rows) -> None:
        if kind is Kind.PRESSURE:
            value = estimate[0]
            self.found.append((value["time_us"] * 1e-6, float(value["altitude_amsl_m"])))

    def on_truth(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        self.truth.append((time_us * 1e-6, altitude_amsl_m))

    def autopilot(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        """Not kept."""

    def published(self, message: object) -> None:
        """Not kept."""


def error_m(log: Path, settings: CompanionSettings) -> tuple[np.ndarray, np.ndarray]:
    """Time (s) and error (m) of the estimate, beside a ground barometer, system 9, whose pressure
    is that of the true QNH at its elevation, 0.8 hPa too high, with 2 Pa of noise."""
    heights = Heights()
    observer = type("Seen", (), {})()
    observer.sample, observer.truth = heights.sample, heights.on_truth
    observer.autopilot, observer.published = heights.autopilot, heights.published
    pipeline = Pipeline(settings, datagrams=True, observer=observer, sends=False)
    decoder, station = Decoder(datagrams=True), Vehicle(9, 1)
    noise = np.random.default_rng(1)
    exponent = 9.80665 / (287.05287 * 0.0065)
    for packet in TlogReader(log):
        pipeline.feed(packet)
        for frame in decoder.feed(packet.data):
            if frame.message_id != mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY:
                continue
            told = decoder.decode(frame)
            assert told is not None
            qnh_hpa = told.data[0]
            level = (qnh_hpa / 1013.25) ** (1.0 / exponent) - 0.0065 * ELEVATION_M / 288.15
            hpa = 1013.25 * level**exponent + 0.8 + 0.02 * noise.normal()
            pressure = mavlink.MAVLink_scaled_pressure_message(0, hpa, 0.0, 2000)
            pipeline.feed(Packet(packet.time_us, station.pack(pressure)))
    found, truth = np.array(heights.found), np.array(heights.truth)
    return found[:, 0], found[:, 1] - np.interp(found[:, 0], truth[:, 0], truth[:, 1])


@pytest.mark.slow
def test_the_weather_is_measured_on_the_ground(tmp_path: Path) -> None:
    log = tmp_path / "falling.tlog"
    Flight(SCENARIO, tlog=log, seed=1).run()
    here = {"reference_system_id": 9, "reference_elevation_m": ELEVATION_M}
    drift_m = {}
    for name, air in (("with", here), ("without", {})):
        time_s, error = error_m(log, CompanionSettings().with_changes(air=air))
        before = error[(time_s > OUTAGE_S - 20.0) & (time_s < OUTAGE_S)].mean()
        drift_m[name] = error[time_s > OUTAGE_S] - before
    assert np.sqrt(np.mean(drift_m["with"] ** 2)) < 1.0
    assert np.abs(drift_m["without"][-200:].mean()) > 3.0
