"""A ground barometer: the QNH that it tells, and what is no weather."""

import numpy as np
import pytest

from companion.clock import ManualClock
from companion.errors import ConfigError
from companion.known_air import AirSettings
from companion.links.memory import pair
from companion.mavlink.codec import Decoder, Frame, mavlink
from companion.reference import ReferenceBarometer, ReferenceReject
from companion.reference_link import ReferenceLink
from companion.samples import ESTIMATE, Kind, Rows, rows
from companion.settings import CompanionSettings
from tests.vehicle import ALTITUDE_M, Vehicle, feed, heartbeat, merged, pressure, standing

SECOND_US = 1_000_000
HERE = {"reference_system_id": 9, "reference_elevation_m": ALTITUDE_M}


def unknown() -> Rows:
    return rows(ESTIMATE)


def told(reference: ReferenceBarometer, pressures_pa: list[float], start_s: int = 0) -> list[float]:
    """The QNH (Pa) told while the station sends one pressure a second."""
    found = []
    for number, pressure_pa in enumerate(pressures_pa):
        now_us = (start_s + number) * SECOND_US
        reference.hear(pressure_pa, now_us)
        found.append(reference.tell(now_us, unknown()))
    return [value for value in found if value is not None]


def test_the_qnh_at_its_elevation_once_a_minute() -> None:
    """95,461 Pa at 500 m is a QNH of 1013.25 hPa."""
    reference = ReferenceBarometer(500.0, 100.0)
    values = told(reference, [95_461.0] * 200)
    assert values == pytest.approx([101_325.0] * 4, abs=2.0)
    assert reference.problem == ""


def test_weather_is_told_as_it_moves() -> None:
    """The worst hour of a year, 370 Pa: every 6 Pa, a minute; noise of 3 Pa is averaged."""
    noise = np.random.default_rng(1).normal(0.0, 3.0, 3600)
    falling = list(95_461.0 - 370.0 / 3600.0 * np.arange(3600) + noise)
    reference = ReferenceBarometer(500.0, 100.0)
    values = told(reference, falling)
    assert len(values) >= 60
    assert values[-1] - values[0] == pytest.approx(-370.0 * 1.06, abs=12.0)
    assert not reference.counters


def test_a_step_is_counted_and_left_out_until_it_ends() -> None:
    reference = ReferenceBarometer(500.0, 100.0)
    steady, stepped = [95_461.0] * 60, [95_461.0 + 300.0] * 1800
    assert told(reference, steady)
    assert told(reference, stepped, 60) == []
    assert reference.problem == "reference stepped: not used"
    assert reference.counters[ReferenceReject.STEP] > 100
    assert told(reference, steady, 1860)
    assert reference.problem == ""


@pytest.mark.parametrize("ramp_pa_per_s", [5.0, 1.0, 0.4, -0.4])
def test_a_ramp_that_is_no_weather_is_left_out(ramp_pa_per_s: float) -> None:
    """A failing station, .03 to .4 m/s. Expected Result: no value is told that is further than 5 m
    and 31 m/h beyond the first."""
    reference = ReferenceBarometer(500.0, 100.0)
    ramp = list(95_461.0 + np.clip(ramp_pa_per_s * np.arange(600.0), -3000.0, 3000.0))
    values = told(reference, [95_461.0] * 60 + ramp)
    assert max(abs(value - values[0]) for value in values) <= 60.0 + 372.0 / 6.0
    assert reference.problem == "reference stepped: not used"


def test_a_contradiction_needs_a_minute() -> None:
    """The estimate's QNH, good to 12 Pa, is 800 Pa elsewhere."""
    reference, estimate = ReferenceBarometer(500.0, 100.0), unknown()
    estimate["qnh_pa"], estimate["qnh_sd_pa"], estimate["altitude_amsl_m"] = 102_125.0, 12.0, 500.0
    found = []
    for second in range(200):
        reference.hear(95_461.0, second * SECOND_US)
        found.append(reference.tell(second * SECOND_US, estimate) is not None)
    assert 10 <= max(i for i, each in enumerate(found) if each) <= 70
    assert reference.problem == "reference contradicted: not used"


def test_silence_and_impossible_values() -> None:
    reference = ReferenceBarometer(500.0, 100.0)
    assert told(reference, [0.0, float("nan"), 2e5]) == []
    assert reference.counters[ReferenceReject.RANGE] == 3
    assert told(reference, [95_461.0] * 20)
    reference.tell(60 * SECOND_US, unknown())
    assert reference.problem == "reference barometer silent"
    told(reference, [95_461.0] * 20, 70)
    assert reference.problem == ""


@pytest.mark.parametrize("keys", [{"reference": "udpin:0.0.0.0:1"}, {"reference_elevation_m": 3.0}])
def test_half_a_reference_is_refused(keys: dict[str, object]) -> None:
    with pytest.raises(ConfigError, match="reference_elevation_m"):
        CompanionSettings().with_changes(air=keys)
    assert AirSettings.model_validate(HERE).reference_system_id == 9


def test_another_system_on_the_vehicles_link() -> None:
    """System 9, an autopilot as well, stands beside the vehicle: it tells the QNH, and is neither
    the vehicle nor a rival. Expected Result: AIR samples with the QNH where it stands."""
    station = standing(
        29.0, 90.0, vehicle=Vehicle(9, 1), imu=None, gps=None, pressure=(1.0, pressure),
        heartbeat=lambda s: heartbeat(type=mavlink.MAV_TYPE_FIXED_WING),
    )  # fmt: skip
    settings = CompanionSettings().with_changes(air=HERE)
    outcome = feed(merged(station, standing(30.0, 90.0)), settings)
    assert outcome.pipeline.identity.vehicle == (1, 1)
    assert outcome.pipeline.identity.refusal == ""
    aired = [row for kind, row in outcome.rows if kind is Kind.AIR]
    assert aired[0]["qnh_pa"] == pytest.approx(100_725.0, abs=20.0)
    assert aired[0]["qnh_elevation_m"] == ALTITUDE_M
    assert aired[0]["qnh_sd_pa"] == 100.0
    assert len(outcome.amsl_m()) > 400


def test_a_link_of_its_own() -> None:
    """The station is spoken to and asked for its pressure; a second sender there is left out."""
    clock = ManualClock()
    near, far = pair(clock)
    reference, station, heard = ReferenceLink(near, None), Vehicle(1, 1), list[Frame]()
    far.send(station.pack(heartbeat()))
    for _ in range(6):
        reference.poll(clock.now_us(), heard.append)
        clock.advance_s(1.0)
    decoder, data = Decoder(), b""
    while chunk := far.receive(0.0):
        data += chunk
    sent = [decoder.decode(frame) for frame in decoder.feed(data)]
    names = [message.get_type() for message in sent if message is not None]
    assert names.count("HEARTBEAT") == 6
    asked = next(m for m in sent if m is not None and m.get_type() == "COMMAND_LONG")
    assert (asked.target_system, asked.command, asked.param1) == (1, 511, 29.0)
    far.send(station.pack(pressure(1.0)))
    far.send(Vehicle(2, 1).pack(pressure(1.0)))
    reference.poll(clock.now_us(), heard.append)
    assert [frame.system_id for frame in heard] == [1]
    assert reference.station == (1, 1)
    near.close()
    far.close()
