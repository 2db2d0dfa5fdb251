"""What a pilot sees: a double of QGroundControl's rule beside the whole service, through start,
loss, failure and stop.

QGroundControl (Vehicle.cc, _handleAltitude and _handleGlobalPositionInt) copies ALTITUDE from any
component of the vehicle's system id, NaN or not, and from the first one on takes no height from
GLOBAL_POSITION_INT for the session.
"""

import math
from collections.abc import Iterator

import pytest

from companion.clock import ManualClock
from companion.health import Health
from companion.links.memory import pair
from companion.mavlink.codec import Decoder, Message, mavlink
from companion.restarts import serve
from companion.service import Service
from companion.settings import CompanionSettings
from tests import vehicle
from tests.vehicle import Vehicle

AMSL_M, RELATIVE_M = 507.123, 12.345
"""the vehicle's own heights; the sensors say 500 m"""


class QGroundControl:
    """The heights that it shows."""

    def __init__(self) -> None:
        self.amsl_m = self.relative_m = math.nan
        self.texts: list[str] = []
        self._follows_altitude = False

    def take(self, message: Message) -> None:
        if message.get_srcSystem() != 1:
            return
        if message.get_type() == "ALTITUDE":
            self._follows_altitude = True
            self.amsl_m, self.relative_m = message.altitude_amsl, message.altitude_relative
        elif message.get_type() == "GLOBAL_POSITION_INT" and not self._follows_altitude:
            self.amsl_m, self.relative_m = message.alt * 1e-3, message.relative_alt * 1e-3
        elif message.get_type() == "STATUSTEXT":
            self.texts.append(message.text)


class Bench:
    """A vehicle that stands at 500 m and reports 507.123 m, the service, and a ground station that
    hears both."""

    def __init__(self, **publish: object) -> None:
        self.clock = ManualClock()
        self.near, self.far = pair(self.clock)
        settings = CompanionSettings()
        publish = settings.publish.model_dump() | publish
        self.settings = settings.with_changes(publish=publish)
        self.service = Service(self.near, self.settings, self.clock)
        self.station = QGroundControl()
        self.altitudes: list[Message] = []
        self.amsl_m = AMSL_M
        self.boot_s = 30.0
        self.armed = False
        self._vehicle, self._decoder = Vehicle(), Decoder()

    def run(self, duration_s: float, *, sensors: bool = True, served: bool = True) -> None:
        for _ in range(round(duration_s * 10)):
            self.boot_s += 0.1
            tenth = round(self.boot_s * 10)
            armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0
            messages = [vehicle.heartbeat(base_mode=armed)] if tenth % 10 == 0 else []
            if sensors:
                messages += [vehicle.pressure(self.boot_s), vehicle.raw_imu(self.boot_s)]
                messages += [vehicle.gps(self.boot_s)] if tenth % 2 == 0 else []
            if tenth % 2 == 1:
                messages.append(self._own())
            for message in messages:
                data = self._vehicle.pack(message)
                self._show(data)
                self.far.send(data)
            if served:
                for _ in range(len(messages) + 1):
                    self.service.turn(0.0)
            self.clock.advance_s(0.1)
            self.hear()

    def hear(self) -> None:
        """The vehicle passes on what we send."""
        while data := self.far.receive(0.0):
            self._show(data)

    def _own(self) -> Message:
        return mavlink.MAVLink_global_position_int_message(
            round(self.boot_s * 1e3),
            470_000_000,
            80_000_000,
            round(self.amsl_m * 1e3),
            round(RELATIVE_M * 1e3),
            *(0, 0, 0, 0),
        )

    def _show(self, data: bytes) -> None:
        for frame in self._decoder.feed(data):
            message = self._decoder.decode(frame)
            assert message is not None
            self.station.take(message)
            if message.get_type() == "ALTITUDE":
                self.altitudes.append(message)
                assert math.isfinite(message.altitude_amsl)
                assert math.isfinite(message.altitude_relative)


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.near.close()
    made.far.close()


def shows_own(bench: Bench) -> bool:
    """To the millimetre, so that a log shows which is which."""
    station = bench.station
    return abs(station.amsl_m - bench.amsl_m) < 5e-4 and abs(station.relative_m - RELATIVE_M) < 5e-4


def test_from_the_start_it_shows_a_height_and_then_ours(bench: Bench) -> None:
    bench.run(1.5)
    assert shows_own(bench)
    assert bench.altitudes
    bench.run(20.0)
    assert bench.service.pipeline.health.health is Health.OK
    assert bench.station.amsl_m == pytest.approx(500.0, abs=3.0)
    bench.armed = True
    bench.run(5.0)
    assert bench.station.relative_m == pytest.approx(0.0, abs=3.0)


def test_in_lost_it_follows_the_vehicle_and_does_not_freeze(bench: Bench) -> None:
    bench.run(20.0)
    bench.run(4.0, sensors=False)
    assert bench.service.pipeline.health.health is Health.LOST
    for amsl_m in (510.0, 520.5, 530.999):
        bench.amsl_m = amsl_m
        bench.run(0.5, sensors=False)
        assert shows_own(bench)
    assert "ALTITUDE: the autopilot's own height" in bench.station.texts
    assert any("LOST" in text for text in bench.station.texts)
    bench.run(10.0)
    assert bench.station.amsl_m == pytest.approx(500.0, abs=3.0)


def test_a_stop_leaves_the_vehicles_own_height_behind(bench: Bench) -> None:
    bench.run(20.0)
    assert not shows_own(bench)
    bench.service.stop()
    bench.hear()
    assert shows_own(bench)
    assert bench.station.texts[-1] == "Kollsman stops: the autopilot's own height"


def test_after_a_failure_it_shows_the_vehicles_own_height_within_a_second(bench: Bench) -> None:
    """A fault in the code: the service is made anew on the same link."""
    bench.run(20.0)
    assert not shows_own(bench)
    made = [bench.service]

    def make() -> Service:
        return Service(bench.near, bench.settings, bench.clock, earlier=made[-1])

    def run(service: Service) -> None:
        bench.service = service
        made.append(service)
        if len(made) == 2:
            raise ZeroDivisionError("a fault in the code")
        bench.run(0.9)
        assert shows_own(bench)
        bench.run(19.0)

    started_us = bench.clock.now_us()
    assert serve(make, run, bench.clock) == 1
    assert bench.clock.now_us() - started_us < 21_000_000
    assert bench.station.amsl_m == pytest.approx(500.0, abs=3.0)


def test_never_leaves_the_display_alone() -> None:
    bench = Bench(altitude="never")
    bench.run(20.0)
    bench.service.stop()
    bench.hear()
    assert bench.altitudes == []
    assert shows_own(bench)


def test_a_forged_altitude_does_not_silence_ours(bench: Bench) -> None:
    bench.run(20.0)
    forged = mavlink.MAVLink_altitude_message(0, 0.0, 9000.0, 0.0, 0.0, math.nan, math.nan)
    before = len(bench.altitudes)
    bench.far.send(Vehicle().pack(forged))
    bench.run(3.0)
    assert len(bench.altitudes) - before == pytest.approx(30, abs=2)


def test_where_the_estimator_has_no_height_above_takeoff_it_is_the_vehicles() -> None:
    bench = Bench()
    bench.settings = bench.settings.with_changes(estimator="adaptive-fusion")
    bench.service = Service(bench.near, bench.settings, bench.clock)
    bench.run(20.0)
    assert bench.service.pipeline.health.health is Health.OK
    last = bench.altitudes[-1]
    assert last.altitude_amsl == pytest.approx(500.0, abs=5.0)
    assert last.altitude_relative == pytest.approx(RELATIVE_M, abs=1e-3)


def test_texts_of_a_kind_are_five_seconds_apart(bench: Bench) -> None:
    """A link that loses a third of its bytes must not flood the pilot with words."""
    bench.run(20.0)
    count = len(bench.station.texts)
    for _ in range(20):
        bench.run(2.6, sensors=False)
        bench.run(2.4)
    healths = [text for text in bench.station.texts[count:] if text.startswith("Kollsman ")]
    assert len(healths) <= 100 / 5 + 1
