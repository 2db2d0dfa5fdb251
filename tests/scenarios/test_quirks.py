"""What real vehicles, links and recorders do, each as a small log of real MAVLink bytes.

Expected everywhere: no exception, and whatever ALTITUDE goes out is within 50 m of the healthy
source. The quirks are those of the recordings described in the shared data's README, made anew here
so that a clean clone tests them too.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.health import Health
from companion.intake import SampleReject
from companion.mavlink.codec import Message, mavlink
from companion.mavlink.identity import Origin
from companion.samples import Kind, Packet, Verdict
from tests import vehicle
from tests.flights import HOST_EPOCH_US
from tests.vehicle import (
    ALTITUDE_M,
    Maker,
    Outcome,
    Vehicle,
    gps,
    heartbeat,
    hectopascals,
    highres_imu,
    merged,
    pressure,
    range_finder,
    raw_imu,
    replay,
    standing,
    write,
)

OK, DEGRADED, LOST = Health
KEY = bytes(range(32))
LIMIT_M = 50.0
Replay = Callable[..., Outcome]


@pytest.fixture
def play(tmp_path: Path) -> Replay:
    """Write packets as a tlog and replay it; every published altitude must be near the healthy
    one."""

    def run(
        packets: list[Packet], healthy_m: float = ALTITUDE_M, tail: bytes = b"", cut: int = 0
    ) -> Outcome:
        path = write(tmp_path / "quirk.tlog", packets)
        data = path.read_bytes()
        path.write_bytes(data[: len(data) - cut] + tail)
        outcome = replay(path)
        for altitude_m in outcome.amsl_m():
            assert altitude_m == pytest.approx(healthy_m, abs=LIMIT_M)
        return outcome

    return run


def from_s(start_s: float, quirk: Maker, usual: Maker, end_s: float = math.inf) -> Maker:
    """`usual`, but `quirk` from `start_s` to `end_s` of boot time."""
    return lambda boot_s: quirk(boot_s) if start_s <= boot_s < end_s else usual(boot_s)


def published_s(outcome: Outcome) -> np.ndarray[Any, Any]:
    """Boot seconds of what was published."""
    return np.array([message.time_usec * 1e-6 for message in outcome.altitudes])


def nothing(boot_s: float) -> Message | None:
    return None


def test_a_healthy_vehicle_is_published(play: Replay) -> None:
    """Expected Result: ALTITUDE at the rate of the barometer, from two seconds after the first pair
    on."""
    outcome = play(standing())
    assert len(outcome.altitudes) > 130
    assert outcome.pipeline.health.health is OK


class TestBarometer:
    @pytest.mark.parametrize("hectopascal", [0.0, -3.0, math.nan, math.inf, 5000.0])
    def test_no_pressure(self, play: Replay, hectopascal: float) -> None:
        """Pressure 0 (a sensor that was never found). Expected Result: refused; GNSS alone is
        published, DEGRADED."""
        outcome = play(
            standing(30, 60, pressure=lambda boot_s: pressure(boot_s, press_abs=hectopascal))
        )
        assert outcome.count(Kind.PRESSURE, Verdict.INVALID) == 150
        assert outcome.pipeline.health.health is DEGRADED
        assert len(outcome.altitudes) > 100
        assert all(math.isnan(message.altitude_monotonic) for message in outcome.altitudes)

    def test_pressure_that_becomes_zero(self, play: Replay) -> None:
        """A sensor that dies in flight. Expected Result: DEGRADED, and GNSS goes on."""
        dead = from_s(45, lambda boot_s: pressure(boot_s, press_abs=0.0), pressure)
        outcome = play(standing(30, 70, pressure=dead))
        assert outcome.pipeline.health.health is DEGRADED
        assert published_s(outcome).max() > 69

    def test_half_the_true_pressure(self, play: Replay) -> None:
        """505 hPa at 90 m, from the start. Expected Result: the barometer is refused at once and
        GNSS is published."""
        outcome = play(
            standing(
                30,
                80,
                pressure=lambda boot_s: pressure(boot_s, press_abs=505.0 + 0.02 * math.sin(boot_s)),
                gps=lambda boot_s: gps(boot_s, 90.0),
            ),
            healthy_m=90.0,
        )
        assert outcome.count(Kind.PRESSURE, Verdict.USED) <= 1
        assert len(outcome.altitudes) > 200

    def test_half_the_true_pressure_from_one_moment_on(self, play: Replay) -> None:
        """Expected Result: refused with the first wrong sample, not after ten seconds."""
        broken = from_s(
            50, lambda boot_s: pressure(boot_s, press_abs=505.0 + 0.02 * math.sin(boot_s)), pressure
        )
        outcome = play(standing(30, 90, pressure=broken))
        assert outcome.count(Kind.PRESSURE, Verdict.USED) == 100
        assert published_s(outcome).max() > 89

    def test_pascals_in_highres_imu(self, play: Replay) -> None:
        """Old PX4 sent Pa where hPa belong. Expected Result: understood."""
        both = (
            10.0,
            lambda boot_s: highres_imu(boot_s, abs_pressure=hectopascals(ALTITUDE_M) * 100.0),
        )
        clock = (1.0, vehicle.system_time)
        outcome = play(standing(30, 60, pressure=None, imu=both, clock=clock))
        assert outcome.count(Kind.PRESSURE, Verdict.USED) > 290
        assert outcome.pipeline.health.health is OK

    @pytest.mark.parametrize("centidegrees", [-13_500, 3000])
    def test_a_jump_of_60_hpa(self, play: Replay, centidegrees: int) -> None:
        """With -135 degC as recorded, and with an innocent temperature. Expected Result: refused at
        once."""
        jump = lambda boot_s: pressure(
            boot_s, press_abs=hectopascals(ALTITUDE_M) - 60.0, temperature=centidegrees
        )
        outcome = play(standing(30, 100, pressure=from_s(60, jump, pressure, 63)))
        assert outcome.count(Kind.PRESSURE, Verdict.INVALID) == 15
        assert published_s(outcome).max() > 99
        steps_m = np.abs(np.diff([message.altitude_monotonic for message in outcome.altitudes]))
        assert np.nanmax(steps_m) < 1.0

    @pytest.mark.parametrize("rate_hz", [1.0, 5.0])
    def test_a_lasting_jump_of_60_hpa(self, play: Replay, rate_hz: float) -> None:
        """Expected Result: refused, then learned against GNSS; the monotonic altitude does not
        step."""
        jump = lambda boot_s: pressure(
            boot_s, press_abs=hectopascals(ALTITUDE_M) - 60.0 + 0.01 * (boot_s % 1)
        )
        made = standing(30, 120, pressure=(rate_hz, from_s(60, jump, pressure)), gps=(rate_hz, gps))
        outcome = play(made)
        assert outcome.pipeline.health.health is OK
        monotonic_m = np.array([message.altitude_monotonic for message in outcome.altitudes])
        assert np.nanmax(np.abs(monotonic_m)) < 5.0

    def test_another_component_that_sends_zero(self, play: Replay) -> None:
        """0.0 hPa from component 154 of the same vehicle. Expected Result: not listened to."""
        gimbal = standing(
            30, 60, vehicle=Vehicle(1, 154), heartbeat=None, gps=None, imu=None,
            pressure=lambda boot_s: pressure(boot_s, press_abs=0.0),
        )  # fmt: skip
        outcome = play(merged(standing(), gimbal))
        assert outcome.count(Kind.PRESSURE, Verdict.INVALID) == 0
        assert outcome.pipeline.identity.strangers == {(1, 154): 150}
        assert outcome.pipeline.health.health is OK

    def test_values_that_repeat(self) -> None:
        """ArduPilot sends twice as often as its barometer updates. Expected Result: as good as
        without repeats."""
        climb_mps = 4.0

        def repeated(boot_s: float) -> Message:
            return pressure(boot_s, 500.0 + climb_mps * (math.floor(boot_s * 5) / 5 - 30))

        packets = standing(
            30, 60, pressure=(10.0, repeated), gps=lambda s: gps(s, 500.0 + climb_mps * (s - 30.12))
        )
        outcome = vehicle.feed(packets)
        assert len(outcome.altitudes) > 200
        for message in outcome.altitudes:
            assert message.altitude_amsl == pytest.approx(
                500.0 + climb_mps * (message.time_usec * 1e-6 - 30), abs=5.0
            )

    def test_a_frozen_barometer(self) -> None:
        """Fresh stamps, one value, for ever, while the vehicle climbs 20 m/s. Expected Result: GNSS
        is followed.

        It gets there at 2 m/s2, which the IMU feels: barometer and IMU that both deny a climb are
        two against one.
        """

        def climb(boot_s: float) -> float:
            away_s = max(0.0, boot_s - 60.0)
            return 500.0 + min(away_s, 10.0) ** 2 + 20.0 * max(0.0, away_s - 10.0)

        def felt(boot_s: float) -> Message:
            return raw_imu(boot_s, zacc=-1204 if 60.0 <= boot_s < 70.0 else -1000)

        packets = standing(
            30,
            160,
            pressure=pressure,
            imu=(50.0, felt),
            gps=lambda boot_s: gps(boot_s, climb(boot_s - 0.12)),
        )
        outcome = vehicle.feed(packets)
        assert len(outcome.altitudes) > 400
        for message in outcome.altitudes:
            assert message.altitude_amsl == pytest.approx(
                climb(message.time_usec * 1e-6), abs=LIMIT_M
            )


class TestGnss:
    def test_19_km_without_a_fix(self, play: Replay) -> None:
        """Expected Result: refused; without any fix there is no altitude and nothing is
        published."""
        lost = lambda boot_s: gps(
            boot_s, 19_400.0, fix_type=1, v_acc=3_750_000_128, eph=9999, epv=9999
        )
        outcome = play(standing(30, 60, gps=lost))
        assert outcome.altitudes == []
        assert outcome.pipeline.health.health is LOST

    def test_19_km_without_a_fix_after_a_good_one(self, play: Replay) -> None:
        """Expected Result: DEGRADED, and the barometer goes on with what was learned."""
        lost = from_s(
            50, lambda s: gps(s, -917.0 + 300 * (s - 50), fix_type=1, v_acc=3_750_000_128), gps
        )
        outcome = play(standing(30, 120, gps=lost))
        assert outcome.pipeline.health.health is DEGRADED
        assert published_s(outcome).max() > 119

    @pytest.mark.parametrize("claim", [{"v_acc": 900_000}, {"v_acc": 0, "epv": 65535, "eph": 9999}])
    def test_a_3d_fix_that_slides(self, play: Replay, claim: dict[str, int]) -> None:
        """1149 to 376 m in 20 s on the ground with v_acc of kilometres, then the truth with 7 m.
        Expected Result: the slide is rejected, the truth is used."""
        slide = from_s(
            0, lambda s: gps(s, 1149 - 38.65 * (s - 30), satellites_visible=4, **claim), gps, 50
        )
        outcome = play(standing(30, 90, gps=slide))
        assert published_s(outcome).min() > 50
        assert outcome.pipeline.health.health is OK

    def test_a_jump_with_a_clear_conscience(self, play: Replay) -> None:
        """3 km up with a 3D fix and 2 m reported. Expected Result: refused at once, the barometer
        goes on."""
        outcome = play(
            standing(30, 120, gps=from_s(60, lambda boot_s: gps(boot_s, 3500.0), gps, 90))
        )
        assert published_s(outcome).max() > 119
        assert outcome.count(Kind.GNSS, Verdict.INVALID) >= 150

    @pytest.mark.parametrize("fix", [0, 3])
    def test_nowhere(self, play: Replay, fix: int) -> None:
        """Latitude, longitude and altitude 0 until there is a position. Expected Result: no
        altitude before it."""
        nowhere = from_s(0, lambda s: gps(s, 0.0, lat=0, lon=0, fix_type=fix, v_acc=0), gps, 45)
        outcome = play(standing(30, 70, gps=nowhere))
        assert published_s(outcome).min() > 45
        assert outcome.pipeline.health.health is OK

    @pytest.mark.parametrize("epv", [65535, 0])
    @pytest.mark.parametrize("v_acc", [0, 2000])
    def test_unknown_vertical_dilution(self, play: Replay, epv: int, v_acc: int) -> None:
        """Expected Result: used; HDOP or the reported accuracy tells how good it is."""
        outcome = play(standing(30, 60, gps=lambda boot_s: gps(boot_s, epv=epv, v_acc=v_acc)))
        assert outcome.pipeline.health.health is OK
        assert outcome.count(Kind.GNSS, Verdict.USED) == 150

    def test_hopeless_dilution(self, play: Replay) -> None:
        """epv and eph 9999 say that there is no solution. Expected Result: nothing is published."""
        hopeless = lambda boot_s: gps(boot_s, -17.0, fix_type=3, eph=9999, epv=9999, v_acc=0)
        assert play(standing(30, 60, gps=hopeless)).altitudes == []

    @staticmethod
    def frozen_stamps(**streams: Any) -> tuple[vehicle.Outcome, Callable[[float], float]]:
        """A dead receiver whose last fix is repeated while the vehicle climbs."""
        climb: Callable[[float], float] = lambda boot_s: 500.0 + max(0.0, 3.0 * (boot_s - 60))
        frozen = from_s(60, lambda boot_s: gps(60.0), gps)
        pressures = lambda s: pressure(s, climb(s))
        packets = standing(30, 120, gps=frozen, pressure=pressures, **streams)
        return vehicle.feed(packets), climb

    def test_stamps_that_freeze(self) -> None:
        """Expected Result: each fix counts once; no restart is seen; no altitude is wrong."""
        outcome, climb = self.frozen_stamps()
        assert outcome.count(Kind.GNSS, Verdict.STALE) == 299
        assert outcome.pipeline.intake.clock.reboots == 0
        for message in outcome.altitudes:
            assert message.altitude_amsl == pytest.approx(
                climb(message.time_usec * 1e-6), abs=LIMIT_M
            )

    def test_the_barometer_goes_on_when_stamps_freeze(self) -> None:
        """Expected Result: published for half a minute, right to the end; then silent, as without
        an IMU nobody would see a barometer fault: at .13 an hour one is a thousandth probable
        after 28 s."""
        outcome, climb = self.frozen_stamps(imu=None)
        assert published_s(outcome).max() > 60 + 28
        assert "may be wrong" in outcome.pipeline.health.reason
        altitude_m = outcome.pipeline.filter.estimate[0]["altitude_amsl_m"]
        assert altitude_m == pytest.approx(climb(120), abs=10.0)

    @pytest.mark.parametrize("offset_us", [0, HOST_EPOCH_US, 29_600_000_000_000_000])
    def test_stamps_from_1970_or_2908(self, play: Replay, offset_us: int) -> None:
        """time_usec from boot, from 1970, and in the year 2908, with SYSTEM_TIME alike. Expected
        Result: the same."""
        outcome = play(
            standing(
                30,
                60,
                gps=lambda boot_s: gps(boot_s, time_usec=round(boot_s * 1e6) + offset_us),
                clock=(
                    1.0,
                    lambda boot_s: vehicle.system_time(
                        boot_s, offset_us and round(boot_s * 1e6) + offset_us
                    ),
                ),
            )
        )
        assert outcome.count(Kind.GNSS, Verdict.USED) >= 149
        assert len(outcome.altitudes) > 130

    def test_no_stamps_at_all(self, play: Replay) -> None:
        """time_usec 0 in GPS_RAW_INT. Expected Result: taken as of now."""
        outcome = play(standing(30, 60, gps=lambda boot_s: gps(boot_s, time_usec=0)))
        assert outcome.count(Kind.GNSS, Verdict.USED) >= 148
        assert outcome.pipeline.health.health is OK

    def test_an_injected_position_at_sea_level(self, play: Replay) -> None:
        """A submarine with GPS_RAW_INT.alt 0, a fix and 21 satellites, whose pressure follows the
        hull's temperature by 26 m. Expected Result: near 0."""
        hull = lambda boot_s: pressure(boot_s, -30.0 - 0.43 * (boot_s - 30))
        surface = lambda boot_s: gps(boot_s, 0.0, satellites_visible=21, v_acc=0, epv=65535)
        outcome = play(standing(30, 90, pressure=hull, gps=surface), healthy_m=0.0)
        assert len(outcome.altitudes) > 200


class TestClocks:
    def test_reboots(self, play: Replay) -> None:
        """Five boots in one log, the clock starting again each time, once overlapping. Expected
        Result: one restart each, a new estimate each, and a monotonic altitude without steps."""
        boots = [
            Packet(packet.time_us + number * 60_000_000, packet.data)
            for number in range(5)
            for packet in standing(10, 40)
        ]
        outcome = play(boots)
        assert outcome.pipeline.intake.clock.reboots == 4
        assert np.count_nonzero(np.diff(published_s(outcome)) < 0) == 4
        assert len(outcome.altitudes) > 5 * 100
        monotonic_m = np.array([message.altitude_monotonic for message in outcome.altitudes])
        assert np.abs(np.diff(monotonic_m)).max() < 1.0

    def test_the_wall_clock_steps(self, play: Replay) -> None:
        """Back by minutes, forward by a day, to 1970, at double speed. Expected Result: bit for bit
        the same."""
        plain = standing(30, 90)

        def stepped(packet: Packet, index: int) -> Packet:
            steps_us = (0, -300_000_000, 86_400_000_000, -HOST_EPOCH_US, index * 200_000)
            return Packet(max(0, packet.time_us + steps_us[index // 200 % 5]), packet.data)

        outcomes = [
            play(plain),
            play([stepped(packet, index) for index, packet in enumerate(plain)]),
        ]
        assert [message.altitude_amsl for message in outcomes[0].altitudes] == outcomes[1].amsl_m()
        assert outcomes[0].sent == outcomes[1].sent

    def test_one_damaged_boot_time(self, play: Replay) -> None:
        """A stamp far in the future, one in the past. Expected Result: two readings are left out,
        nothing restarts."""
        odd = {50.0: 4_000_000_000, 60.0: 5}
        damaged = lambda s: pressure(s, time_boot_ms=odd.get(round(s, 3), round(s * 1e3)))
        outcome = play(standing(30, 70, pressure=damaged))
        assert outcome.pipeline.intake.clock.reboots == 0
        assert outcome.pipeline.intake.counters[SampleReject.CLOCK] == 2
        assert outcome.pipeline.health.health is OK

    def test_boot_time_wraps(self, play: Replay) -> None:
        """time_boot_ms after 49.7 days. Expected Result: nobody notices."""
        outcome = play(standing(4_294_937.0, 4_294_997.0))
        assert outcome.pipeline.intake.clock.reboots == 0
        assert np.diff(published_s(outcome)).min() > 0
        assert published_s(outcome).max() > 4_294_996

    def test_packets_arrive_out_of_order(self, play: Replay) -> None:
        """A radio that holds packets back for up to 0.9 s. Expected Result: no restart, no
        garbage."""
        random = np.random.default_rng(5)
        plain = standing(30, 90)
        late = sorted(plain, key=lambda packet: packet.time_us + random.uniform(0, 900_000))
        outcome = play(late)
        assert outcome.pipeline.intake.clock.reboots == 0
        assert len(outcome.altitudes) > 150

    def test_no_boot_time_anywhere(self, play: Replay) -> None:
        """Raw streams with stamps of 0. Expected Result: no clock, so no estimate, and no
        exception."""
        packets = standing(
            0,
            30,
            pressure=None,
            gps=lambda boot_s: gps(boot_s, time_usec=0),
            imu=lambda s: raw_imu(0.0),
        )
        outcome = play(packets)
        assert outcome.altitudes == []
        assert outcome.pipeline.intake.counters[SampleReject.NO_CLOCK] > 300


class TestSenders:
    def test_a_second_vehicle(self, play: Replay) -> None:
        """System 2 at 3000 m appears later on the same link. Expected Result: the first one is
        served, the other is not used."""
        other = standing(
            40,
            60,
            vehicle=Vehicle(2, 1),
            gps=lambda s: gps(s, 3000.0),
            pressure=lambda s: pressure(s, 3000.0),
        )
        outcome = play(merged(standing(), other))
        assert outcome.pipeline.identity.vehicle == (1, 1)
        assert outcome.pipeline.identity.counters[Origin.STRANGER] == len(other)
        assert outcome.count(Kind.GNSS, Verdict.USED) == 150

    def test_a_companion_that_claims_to_be_a_quadrotor(self, play: Replay) -> None:
        """Its HEARTBEAT comes first, 1:0, type quadrotor, autopilot INVALID. Expected Result: not a
        vehicle."""
        claim = (1.0, lambda boot_s: heartbeat(autopilot=mavlink.MAV_AUTOPILOT_INVALID))
        companion = standing(
            20,
            60,
            vehicle=Vehicle(1, 0),
            heartbeat=claim,
            gps=None,
            imu=None,
            pressure=lambda s: pressure(s, 9000.0),
        )
        outcome = play(merged(companion, standing()))
        assert outcome.pipeline.identity.vehicle == (1, 1)
        assert len(outcome.altitudes) > 130

    def test_unsigned_frames_in_a_signed_stream(self, play: Replay) -> None:
        """An attacker sends unsigned frames with the vehicle's ids, 3000 m too high. Expected
        Result: forged."""
        forger = standing(
            32,
            60,
            heartbeat=None,
            gps=lambda s: gps(s + 0.01, 3500.0),
            pressure=lambda s: pressure(s + 0.01, 3500.0),
        )
        outcome = play(merged(standing(vehicle=Vehicle(key=KEY)), forger))
        assert outcome.pipeline.identity.counters[Origin.FORGED] == len(forger)
        assert len(outcome.altitudes) > 130

    def test_both_versions_of_mavlink(self, play: Replay) -> None:
        """A vehicle that speaks 1, a ground station that speaks 2. Expected Result: we answer in
        1."""
        station = standing(
            30, 60, vehicle=Vehicle(255, 190), gps=None, imu=None, pressure=None,
            heartbeat=lambda s: heartbeat(
                type=mavlink.MAV_TYPE_GCS, autopilot=mavlink.MAV_AUTOPILOT_INVALID
            ),
        )  # fmt: skip
        outcome = play(merged(standing(vehicle=Vehicle(version=1)), station))
        assert {frame[0] for frame in outcome.sent} == {0xFE}
        assert len(outcome.altitudes) > 130

    def test_the_vehicle_changes_its_type(self, play: Replay) -> None:
        """Rover, then boat. Expected Result: the same vehicle."""
        kinds = lambda s: heartbeat(
            type=mavlink.MAV_TYPE_GROUND_ROVER if s < 45 else mavlink.MAV_TYPE_SURFACE_BOAT
        )
        assert play(standing(30, 60, heartbeat=kinds)).pipeline.health.health is OK


class TestRecorders:
    def test_a_tail_of_zeros(self, play: Replay) -> None:
        """Expected Result: everything before it is read, the rest is counted as junk."""
        outcome = play(standing(), tail=bytes(3434))
        assert outcome.pipeline.decoder.frames == len(standing())
        assert outcome.damage == {"junk bytes": 3434}

    def test_a_cut_last_frame(self, play: Replay) -> None:
        """Expected Result: all but the last."""
        outcome = play(standing(), cut=7)
        assert outcome.pipeline.decoder.frames == len(standing()) - 1
        assert outcome.damage == {"cut frame": 1}

    def test_a_gap_of_zeros_and_junk_between_frames(self, play: Replay, tmp_path: Path) -> None:
        """Expected Result: found again behind it."""
        data = write(tmp_path / "whole.tlog", standing()).read_bytes()
        half = len(data) // 2
        path = tmp_path / "gap.tlog"
        path.write_bytes(
            b"\x55\xfd\xfe" * 900 + data[:half] + bytes(700) + b"\xfe\x09junk" * 40 + data[half:]
        )
        outcome = replay(path)
        assert outcome.pipeline.decoder.frames >= len(standing()) - 4
        assert all(abs(altitude_m - ALTITUDE_M) <= LIMIT_M for altitude_m in outcome.amsl_m())
        assert len(outcome.altitudes) > 125

    def test_frames_of_another_dialect(self, play: Replay) -> None:
        """A ground station's message 142 with another definition: well-made, but its checksum
        fails. Expected Result: skipped by its length, the rest is read."""
        station = Vehicle(255, 190)
        packets = []
        for packet in standing():
            frame = bytearray(station.pack(heartbeat(type=6, autopilot=8)))
            frame[-2:] = ((frame[-2] | frame[-1] << 8) ^ 0x5A5A).to_bytes(2, "little")
            packets += [packet, Packet(packet.time_us, bytes(frame))]
        outcome = play(packets)
        assert outcome.pipeline.decoder.frames == len(standing())
        assert len(outcome.altitudes) > 130


class TestOthers:
    def test_a_range_finder_that_looks_forward(self, play: Replay) -> None:
        """Expected Result: no height above ground."""
        ahead = (
            5.0,
            lambda boot_s: range_finder(boot_s, orientation=mavlink.MAV_SENSOR_ROTATION_NONE),
        )
        outcome = play(standing(30, 60, range=ahead))
        assert all(math.isnan(message.bottom_clearance) for message in outcome.altitudes)
        assert len(outcome.altitudes) > 130

    @pytest.mark.parametrize("centimetres", [0, 19, 4001, 65535])
    def test_a_range_finder_out_of_its_range(self, play: Replay, centimetres: int) -> None:
        """Expected Result: no height above ground."""
        beyond = (5.0, lambda boot_s: range_finder(boot_s, current_distance=centimetres))
        outcome = play(standing(30, 60, range=beyond))
        assert all(math.isnan(message.bottom_clearance) for message in outcome.altitudes)

    def test_a_range_finder_that_sees_the_ground(self, play: Replay) -> None:
        """Expected Result: 10 m."""
        outcome = play(standing(30, 60, range=(5.0, range_finder)))
        assert outcome.altitudes[-1].bottom_clearance == pytest.approx(10.0)

    @pytest.mark.parametrize("rate_hz", [1.0, 2.0, 4.0])
    def test_streams_at_ground_station_rates(self, play: Replay, rate_hz: float) -> None:
        """All streams at 1 to 4 Hz. Expected Result: published at that rate, OK."""
        made = standing(
            30, 90, pressure=(rate_hz, pressure), gps=(rate_hz, gps), imu=(rate_hz, raw_imu),
            attitude=(rate_hz, vehicle.attitude),
        )  # fmt: skip
        outcome = play(made)
        assert outcome.pipeline.health.health is OK
        assert len(outcome.altitudes) >= 55 * rate_hz

    def test_an_infinite_attitude(self, play: Replay) -> None:
        """Expected Result: nothing breaks, no height above ground."""
        sick = (5.0, lambda boot_s: vehicle.attitude(boot_s, roll=math.inf, pitch=math.nan))
        outcome = play(standing(30, 60, attitude=sick, range=(5.0, range_finder)))
        assert len(outcome.altitudes) > 130
        assert all(math.isnan(message.bottom_clearance) for message in outcome.altitudes)

    @pytest.mark.parametrize("seed", range(4))
    def test_any_payloads(self, seed: int) -> None:
        """Well-made frames of the vehicle with random contents among good ones. Expected Result: no
        exception."""
        random = np.random.default_rng(seed)
        names = ("scaled_pressure", "gps_raw_int", "attitude", "highres_imu", "distance_sensor",
                 "system_time",
                 "home_position", "extended_sys_state", "heartbeat", "attitude_quaternion",
                 "gps2_raw")  # fmt: skip
        sender = Vehicle()
        packets = []
        for packet in standing(30, 40):
            kind = getattr(mavlink, f"MAVLink_{random.choice(names)}_message")
            values = kind.unpacker.unpack(random.bytes(kind.unpacker.size))
            wire = (
                dict(zip(kind.ordered_fieldnames, values, strict=False))
                if max(kind.lengths) == 1
                else {}
            )
            if wire:
                wire = {name: value for name, value in wire.items() if not isinstance(value, bytes)}
                noise = sender.pack(kind(**wire)) if set(wire) == set(kind.fieldnames) else b""
                packets += [packet] + ([Packet(packet.time_us, noise)] if noise else [])
        vehicle.feed(packets)
