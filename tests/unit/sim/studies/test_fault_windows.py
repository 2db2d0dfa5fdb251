"""Which faults make a sensor wrong, when, and how their attribution is judged."""

import math

import numpy as np
import pytest

from companion.evaluation.compare import Series
from companion.evaluation.detection import Attribution
from companion.samples import FaultySensor
from sim import BOOT_UNIX_US
from sim.faults import FAULTS, parse_fault
from sim.studies.fault_windows import attribution, fault_windows


@pytest.mark.parametrize(
    ("text", "sensor", "announced"),
    [
        ("step:size=300", FaultySensor.BAROMETER, False),
        ("step:size=20,quantity=gnss_height", FaultySensor.GNSS, False),
        ("ramp:rate=1,quantity=accel_z", FaultySensor.IMU, False),
        ("noise:sd=1,quantity=gyro_x", FaultySensor.IMU, False),
        ("spike:size=5,quantity=die_temperature", FaultySensor.NONE, False),
        ("freeze:sensor=gnss", FaultySensor.GNSS, False),
        ("lag", FaultySensor.BAROMETER, False),
        ("swing:size=3,quantity=gnss_height", FaultySensor.GNSS, False),
        ("two_dimensional", FaultySensor.GNSS, True),
        ("swapped_units:swap=feet", FaultySensor.GNSS, False),
        ("swapped_units:swap=half_pressure", FaultySensor.BAROMETER, False),
        ("blocked_static_port", FaultySensor.BAROMETER, False),
        ("spoofing", FaultySensor.GNSS, False),
        ("outage", FaultySensor.GNSS, True),
        ("jamming", FaultySensor.GNSS, True),
        ("slide", FaultySensor.GNSS, True),
        ("drop", FaultySensor.NONE, False),
        ("reboot", FaultySensor.NONE, False),
    ],
)
def test_the_faulty_sensor_of_a_fault(text: str, sensor: FaultySensor, announced: bool) -> None:
    fault = parse_fault(text)
    assert (fault.faulty_sensor, fault.announced) == (sensor, announced)


def test_every_fault_of_a_sensor_has_an_owner() -> None:
    of_the_way_or_clock = {"drop", "duplicate", "reorder", "delay", "clock_jump", "reboot"}
    needs = {
        "step": ":size=1",
        "swing": ":size=1",
        "spike": ":size=1",
        "ramp": ":rate=1",
        "noise": ":sd=1",
    }
    harmless = {
        name for name in FAULTS if not parse_fault(name + needs.get(name, "")).faulty_sensor
    }
    assert harmless == of_the_way_or_clock


def test_fault_windows_are_those_of_sensors_within_the_flight() -> None:
    faults = [
        parse_fault(text)
        for text in ("drop", "spoofing:start_s=20,duration_s=30", "freeze:start_s=500")
    ]
    (found,) = fault_windows(faults, 100.0)
    assert (found.onset_us, found.end_us) == (BOOT_UNIX_US + 20e6, BOOT_UNIX_US + 50e6)
    assert fault_windows([parse_fault("freeze:start_s=50")], 100.0)[0].end_us == math.inf


def test_the_attribution_of_a_flight_is_over_what_is_silent() -> None:
    faults = [
        parse_fault(text)
        for text in ("spoofing:start_s=20,duration_s=30", "outage:start_s=60,duration_s=20")
    ]
    seconds = np.arange(100.0)
    faulty = np.zeros(100, np.int64)
    faulty[22:40] = FaultySensor.BAROMETER
    faulty[40:50] = FaultySensor.GNSS
    faulty[65:70] = FaultySensor.GNSS  # without a fix: no news, and not false
    faulty[90:95] = FaultySensor.IMU
    unknown = np.full(100, math.nan)
    attributed = Attribution(BOOT_UNIX_US + seconds * 1e6, faulty, np.zeros(100))
    found = attribution(
        fault_windows(faults, 100.0),
        Series("x", seconds, unknown, unknown, unknown, attribution=attributed),
    )
    assert (found["faults"], found["detected"], found["false_alarms"]) == (1, 1, 1)
    assert found["detection_s"] == pytest.approx(20.0)
    assert found["wrong_share"] == pytest.approx(18 / 30)


def test_a_source_without_attribution_is_not_judged() -> None:
    empty = np.zeros(0)
    assert set(attribution([], Series("raw GNSS", empty, empty, empty, empty)).values()) == {None}
