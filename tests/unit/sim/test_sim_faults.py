"""Each fault does what its line says, while it lasts, to the frames it is for; and nothing else.

The stream is a healthy vehicle at rest for a minute (MAVLink 2, or 1), and a companion's frames
between them.
"""

import math
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.clock import ManualClock
from companion.config import validate
from companion.errors import ConfigError, LogFormatError
from companion.kernels.atmosphere import pressure_altitude_m
from companion.links.memory import pair
from companion.logs.tlog import TlogReader
from companion.mavlink.codec import Decoder, decode, mavlink, scan
from companion.mavlink.framing import Frame
from companion.samples import Packet
from sim.faults import FAULTS, Fault, apply_faults, parse_fault
from sim.faults.editing import Editor, header, with_sequence
from sim.flight import Flight
from sim.scenario import Scenario
from sim.studies.corrupt import corrupt, table
from tests.vehicle import Vehicle, highres_imu, merged, parsed, pressure, raw_imu, standing

START_S, DURATION_S = 20.0, 15.0
WINDOW = f"start_s={START_S},duration_s={DURATION_S}"
PARAMETERS = {
    "drop": "probability=0.5", "duplicate": "probability=0.3,after_s=0.5",
    "reorder": "probability=0.2", "delay": "delay_s=0.7,jitter_s=0.3", "freeze": "sensor=imu",
    "spike": "size=500,probability=0.3", "step": "size=80", "ramp": "rate=3,quantity=gnss_height",
    "noise": "sd=1,quantity=accel_z", "swapped_units": "", "outage": "",
    "blocked_static_port": "leak_s=20", "jamming": "ramp_s=5", "spoofing": "north_mps=2",
    "slide": "", "clock_jump": "jump_s=-5", "reboot": "", "lag": "lag_s=0.5", "two_dimensional": "",
    "swing": "size=3,period_s=7,quantity=gnss_height",
}  # fmt: skip


def fault(name: str, parameters: str | None = None, window: str = WINDOW) -> Fault:
    parameters = PARAMETERS[name] if parameters is None else parameters
    return parse_fault(f"{name}:{window},{parameters}")


def shaking(boot_s: float) -> Any:
    return raw_imu(boot_s, zacc=-1000 + round(50 * math.sin(boot_s)))


def stream(version: int = 2) -> list[Packet]:
    # HIGHRES_IMU carries two sensors in one message.
    vehicle = standing(
        30.0,
        90.0,
        vehicle=Vehicle(version=version),
        pressure=lambda boot_s: pressure(boot_s, 500.0 + boot_s),
        imu=shaking,
        highres=(5.0, lambda boot_s: highres_imu(boot_s, id=0)),
    )
    companion = standing(30.0, 90.0, vehicle=Vehicle(1, 191), imu=None)
    return merged(vehicle, companion)


STREAM = stream()
ORIGIN_US = STREAM[0].time_us


def age_s(packet: Packet) -> float:
    return (packet.time_us - ORIGIN_US) * 1e-6


def inside(packet: Packet) -> bool:
    return START_S <= age_s(packet) < START_S + DURATION_S


def message(packet: Packet) -> Any:
    frame = scan(packet.data)
    assert isinstance(frame, Frame)
    assert len(frame.data) == len(packet.data)
    return decode(frame)


def of(packets: Iterable[Packet], name: str, *, component: int = 1) -> list[tuple[Packet, Any]]:
    pairs = [(packet, message(packet)) for packet in packets]
    return [(p, m) for p, m in pairs if m.get_type() == name and m.get_srcComponent() == component]


def series(packets: Iterable[Packet], name: str, field: str) -> "np.ndarray[Any, Any]":
    """The field's values while the fault lasts."""
    return np.array([getattr(m, field) for p, m in of(packets, name) if inside(p)], float)


def differing(before: Any, after: Any) -> set[str]:
    return {
        name for name in before.get_fieldnames() if getattr(before, name) != getattr(after, name)
    }


# What holds for all of them


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_makes_good_frames_repeats_and_leaves_the_rest_alone(
    name: str, version: int
) -> None:
    packets = stream(version)
    found = list(apply_faults(packets, [fault(name)], 7))
    assert found == list(apply_faults(packets, [fault(name)], 7))
    assert found != packets
    decoder = Decoder()
    for packet in found:  # stock pymavlink reads them too
        assert len(decoder.feed(packet.data)) == 1
    assert not decoder.counters
    assert len(parsed(packet.data for packet in found)) == len(found)
    assert {packet.data[0] for packet in found if header(packet.data).component_id == 1} == {
        0xFE if version == 1 else 0xFD
    }

    def others(some: list[Packet]) -> list[Packet]:
        return [packet for packet in some if header(packet.data).component_id != 1]

    assert others(found) == others(packets)
    untouched = [packet for packet in packets if not inside(packet)]
    if name == "reboot":  # its clock stays restarted
        untouched = [packet for packet in untouched if age_s(packet) < START_S]
    late = {"delay", "duplicate", "reorder"}
    kept = [
        packet for packet in found if name in late or age_s(packet) < START_S or not inside(packet)
    ]
    assert set(untouched) - set(kept) <= (
        {packet for packet in untouched if age_s(packet) < START_S + DURATION_S + 2.0}
        if name == "delay"
        else set()
    )


@pytest.mark.parametrize("name", FAULTS)
def test_only_what_draws_depends_on_the_seed(name: str) -> None:
    draws = {"drop", "duplicate", "reorder", "delay", "spike", "noise", "jamming"}
    first, second = (list(apply_faults(STREAM, [fault(name)], seed)) for seed in (1, 2))
    assert (first != second) is (name in draws)
    own = parse_fault(f"{name}:{WINDOW},{PARAMETERS[name]},seed=2")
    assert list(apply_faults(STREAM, [own], 1)) == second


def test_the_clock_of_the_log_does_not_matter() -> None:
    later = [Packet(packet.time_us + 10**12, packet.data) for packet in STREAM]
    faults = [fault(name) for name in FAULTS]
    moved = [
        Packet(packet.time_us - 10**12, packet.data) for packet in apply_faults(later, faults, 1)
    ]
    assert moved == list(apply_faults(STREAM, faults, 1))


@pytest.mark.parametrize("name", ["step", "drop", "clock_jump"])
def test_whose_frames_are_touched_can_be_chosen(name: str) -> None:
    chosen = parse_fault(f"{name}:component=191,{WINDOW},{PARAMETERS[name]}")
    found = list(apply_faults(STREAM, [chosen], 1))
    assert found != STREAM
    assert [p for p in found if header(p.data).component_id == 1] == [
        p for p in STREAM if header(p.data).component_id == 1
    ]


def test_what_is_no_frame_passes() -> None:
    packets = [
        Packet(time_us, data) for time_us, data in ((0, b""), (1, b"noise"), (2, STREAM[0].data))
    ]
    assert list(apply_faults(packets, [fault("step"), fault("reboot")], 1)) == packets


# One by one: the way


def test_drop() -> None:
    found = list(apply_faults(STREAM, [fault("drop", "probability=0.3")], 1))
    assert set(found) <= set(STREAM)
    candidates = [
        packet for packet in STREAM if inside(packet) and header(packet.data).component_id == 1
    ]
    lost = len(STREAM) - len(found)
    share = lost / len(candidates)
    assert share == pytest.approx(0.3, abs=5 * math.sqrt(0.21 / len(candidates)))
    only = list(apply_faults(STREAM, [fault("drop", "message=GPS_RAW_INT")], 1))
    assert len(of(STREAM, "GPS_RAW_INT")) - len(of(only, "GPS_RAW_INT")) == pytest.approx(
        5 * DURATION_S, abs=1
    )
    assert of(only, "RAW_IMU") == of(STREAM, "RAW_IMU") or len(of(only, "RAW_IMU")) == len(
        of(STREAM, "RAW_IMU")
    )


def test_the_truth_shares_the_fate_of_the_frame_before_it() -> None:
    vehicle = Vehicle()
    names = mavlink.MAVLink_sim_state_message.fieldnames
    packets = []
    for number in range(400):
        time_us = 10_000_000 + number * 100_000
        packets.append(
            Packet(time_us, vehicle.pack(mavlink.MAVLink_heartbeat_message(1, 3, 81, 0, 3, 3)))
        )
        packets.append(
            Packet(
                time_us, vehicle.pack(mavlink.MAVLink_sim_state_message(**dict.fromkeys(names, 0)))
            )
        )
    for name, parameters in (
        ("drop", "probability=0.4"),
        ("reorder", "probability=0.4"),
        ("delay", "message=HEARTBEAT"),
    ):
        found = list(apply_faults(packets, [parse_fault(f"{name}:{parameters}")], 3))
        kinds = [header(packet.data).message_id for packet in found]
        sequences = [header(packet.data).sequence for packet in found]
        assert all(kind == (0 if number % 2 == 0 else 108) for number, kind in enumerate(kinds))
        assert all(
            (sequences[i] + 1) % 256 == sequences[i + 1] for i in range(0, len(sequences), 2)
        )


def test_duplicate() -> None:
    at_once = list(apply_faults(STREAM, [fault("duplicate", "probability=0.3")], 1))
    twice = [after for before, after in pairwise(at_once) if before == after]
    assert len(twice) == len(at_once) - len(STREAM) > 50
    assert [p for p, q in zip(at_once, [None, *at_once], strict=False) if p != q] == STREAM
    later = list(apply_faults(STREAM, [fault("duplicate", "probability=0.3,after_s=0.5")], 1))
    assert len(later) == len(at_once)
    assert {(p.time_us + 500_000, p.data) for p in twice} <= set(later)


def test_reorder() -> None:
    found = list(apply_faults(STREAM, [fault("reorder", "probability=0.3,hold_s=0.15")], 1))
    assert sorted(p.data for p in found) == sorted(p.data for p in STREAM)
    assert [p.time_us for p in found] == sorted(p.time_us for p in found)
    moved = set(found) - set(STREAM)
    assert {Packet(p.time_us - 150_000, p.data) for p in moved} <= set(STREAM)
    sequence = [header(p.data).sequence for p in found if header(p.data).component_id == 1]
    backwards = sum((after - before) % 256 > 128 for before, after in pairwise(sequence))
    assert backwards > 0.3 * len(moved)


def test_delay_keeps_the_order_and_drains() -> None:
    found = list(apply_faults(STREAM, [fault("delay", "delay_s=2,jitter_s=1")], 1))

    def vehicle(packets: list[Packet]) -> list[Packet]:
        return [packet for packet in packets if header(packet.data).component_id == 1]

    assert [p.data for p in vehicle(found)] == [p.data for p in vehicle(STREAM)]
    late_s = np.array(
        [
            (b.time_us - a.time_us) * 1e-6
            for a, b in zip(vehicle(STREAM), vehicle(found), strict=True)
        ]
    )
    when = np.array([age_s(p) for p in vehicle(STREAM)])
    during = (when >= START_S) & (when < START_S + DURATION_S)
    assert late_s[during].min() >= 2.0
    assert late_s[during].max() <= 3.0
    assert not late_s[when < START_S].any()
    assert not late_s[when > START_S + DURATION_S + 3.0].any()


# One by one: readings

FIELDS = {
    "pressure": ("SCALED_PRESSURE", "press_abs", 100.0),
    "die_temperature": ("SCALED_PRESSURE", "temperature", 0.01),
    "gnss_height": ("GPS_RAW_INT", "alt", 1e-3),
    "gnss_speed": ("GPS_RAW_INT", "vel", 1e-2),
    "accel_z": ("RAW_IMU", "zacc", 9.80665e-3),
    "gyro_x": ("RAW_IMU", "xgyro", 1e-3),
}


@pytest.mark.parametrize("quantity", FIELDS)
def test_step_and_ramp_are_in_si_units(quantity: str) -> None:
    name, field, size = FIELDS[quantity]
    step = series(
        apply_faults(STREAM, [fault("step", f"size=6,quantity={quantity}")], 1), name, field
    )
    healthy = series(STREAM, name, field)
    if quantity == "gnss_speed":  # it stands: vel is 0, which is a value all the same
        return
    assert (step - healthy) * size == pytest.approx(6.0, abs=0.51 * size + 1e-3)
    ramp = series(
        apply_faults(STREAM, [fault("ramp", f"rate=-2,quantity={quantity}")], 1), name, field
    )
    times = np.array([age_s(p) - START_S for p, _ in of(STREAM, name) if inside(p)])
    assert (ramp - healthy) * size == pytest.approx(-2.0 * times, abs=0.51 * size + 1e-3)


def test_step_touches_that_quantity_alone_in_every_message_that_has_it() -> None:
    found = list(apply_faults(STREAM, [fault("step", "size=100")], 1))
    changed: dict[str, set[str]] = {}
    for before, after in zip(STREAM, found, strict=True):
        assert before.time_us == after.time_us
        assert header(before.data) == header(after.data)
        if before != after:
            assert inside(before)
            kind = message(before)
            changed.setdefault(kind.get_type(), set()).update(differing(kind, message(after)))
    assert changed == {"SCALED_PRESSURE": {"press_abs"}, "HIGHRES_IMU": {"abs_pressure"}}


def test_what_an_integer_cannot_hold_ends_at_its_bound() -> None:
    found = apply_faults(STREAM, [fault("step", "size=1e6,quantity=accel_x")], 1)
    assert set(series(found, "RAW_IMU", "xacc")) == {32767.0}


def test_spike() -> None:
    found = list(apply_faults(STREAM, [fault("spike", "size=500,probability=0.2")], 1))
    errors = series(found, "SCALED_PRESSURE", "press_abs") - series(
        STREAM, "SCALED_PRESSURE", "press_abs"
    )
    assert set(np.round(errors, 2)) == {-5.0, 0.0, 5.0}
    assert np.mean(errors != 0) == pytest.approx(0.2, abs=5 * math.sqrt(0.16 / errors.size))


def test_noise_is_white_and_has_its_spread() -> None:
    long = standing(30.0, 1030.0, gps=None, imu=None)
    noisy = apply_faults(long, [parse_fault("noise:quantity=pressure,sd=20")], 5)
    errors = np.array([m.press_abs for _, m in of(noisy, "SCALED_PRESSURE")])
    errors = (errors - np.array([m.press_abs for _, m in of(long, "SCALED_PRESSURE")])) * 100.0
    bound = 5.0 / math.sqrt(errors.size)
    assert errors.std() == pytest.approx(20.0, rel=bound)
    assert abs(errors.mean()) < 20.0 * bound
    assert abs(np.corrcoef(errors[1:], errors[:-1])[0, 1]) < bound


def test_freeze_repeats_the_last_reading_under_new_stamps() -> None:
    climbing = standing(30.0, 90.0, pressure=lambda boot_s: pressure(boot_s, 500.0 + 3.0 * boot_s))
    found = list(apply_faults(climbing, [fault("freeze", "sensor=barometer")], 1))
    before = [m.press_abs for p, m in of(climbing, "SCALED_PRESSURE") if age_s(p) < START_S]
    assert set(series(found, "SCALED_PRESSURE", "press_abs")) == {before[-1]}
    stamps = series(found, "SCALED_PRESSURE", "time_boot_ms")
    assert (np.diff(stamps) > 0).all()
    after = [
        m.press_abs for p, m in of(found, "SCALED_PRESSURE") if age_s(p) > START_S + DURATION_S
    ]
    assert after == [
        m.press_abs for p, m in of(climbing, "SCALED_PRESSURE") if age_s(p) > START_S + DURATION_S
    ]


@pytest.mark.parametrize(
    ("swap", "name", "field", "factor"),
    [
        ("pascal", "SCALED_PRESSURE", "press_abs", 100.0),
        ("half_pressure", "HIGHRES_IMU", "abs_pressure", 0.5),
        ("feet", "GPS_RAW_INT", "alt", 3.28084),
        ("metres_for_millimetres", "GPS_RAW_INT", "alt", 0.001),
        ("mps2_for_g", "RAW_IMU", "zacc", 9.80665),
    ],
)
def test_swapped_units(swap: str, name: str, field: str, factor: float) -> None:
    found = series(apply_faults(STREAM, [fault("swapped_units", f"swap={swap}")], 1), name, field)
    assert found == pytest.approx(series(STREAM, name, field) * factor, rel=1e-5, abs=0.5)


def test_a_sealed_static_port_keeps_its_pressure_and_its_noise() -> None:
    def air(boot_s: float) -> Any:
        noise_hpa = 0.05 * math.sin(1000.0 * boot_s)
        reading = pressure(boot_s, 500.0 + 5.0 * max(0.0, boot_s - 55.0))
        reading.press_abs += noise_hpa
        reading.press_diff = 10.0
        return reading

    climbing = standing(30.0, 90.0, pressure=air)
    found = of(
        apply_faults(climbing, [fault("blocked_static_port", "", "start_s=20")], 1),
        "SCALED_PRESSURE",
    )
    outside = [m.press_abs for _, m in of(climbing, "SCALED_PRESSURE")]
    assert outside[-1] - outside[0] < -15.0
    blocked = [
        (m.press_abs, m.press_diff, true)
        for (p, m), true in zip(found, outside, strict=True)
        if age_s(p) > 20
    ]
    values = np.array(blocked)[:, 0]
    assert values.mean() == pytest.approx(outside[0], abs=0.05)  # 0.4 m
    assert 0.01 < values.std() < 0.08
    for value, differential, true in blocked:  # the pitot tube feels the same
        assert value + differential == pytest.approx(true + 10.0, abs=1e-3)


def test_a_leaking_static_port_follows_with_its_time_constant() -> None:
    def jump(boot_s: float) -> Any:
        return pressure(boot_s, 500.0 if boot_s < 52.0 else 600.0)

    packets = standing(30.0, 90.0, pressure=jump)
    found = of(
        apply_faults(packets, [parse_fault("blocked_static_port:start_s=20,leak_s=10")], 1),
        "SCALED_PRESSURE",
    )
    values = np.array([m.press_abs for _, m in found])
    times = np.array([age_s(p) for p, _ in found])
    start, end = (
        values[times < 20.0][-1],
        [m.press_abs for _, m in of(packets, "SCALED_PRESSURE")][-1],
    )
    share = (np.interp(22.0 + 10.0, times, values) - start) / (end - start)
    assert share == pytest.approx(1.0 - math.exp(-1.0), abs=0.03)


# One by one: the receiver


def test_outage() -> None:
    found = of(apply_faults(STREAM, [fault("outage")], 1), "GPS_RAW_INT")
    blind = [m for p, m in found if inside(p)]
    assert {(m.fix_type, m.lat, m.alt, m.eph, m.satellites_visible) for m in blind} == {
        (1, 0, 0, 65535, 0)
    }
    silent = of(apply_faults(STREAM, [fault("outage", "silent=true")], 1), "GPS_RAW_INT")
    assert [p for p, _ in silent] == [p for p, _ in of(STREAM, "GPS_RAW_INT") if not inside(p)]


def test_jamming_comes_blinds_and_goes() -> None:
    found = of(
        apply_faults(STREAM, [fault("jamming", "ramp_s=5,noise_m=40,blind_above=0.8")], 1),
        "GPS_RAW_INT",
    )
    times = np.array([age_s(p) - START_S for p, _ in found])
    fixes = np.array([m.fix_type for _, m in found])
    assert (fixes[(times > 4.2) & (times < 10.8)] == 1).all()
    assert (fixes[(times < 3.8) | (times > 11.2)] == 3).all()
    height = {
        round(t, 2): (m.alt, m.v_acc, m.satellites_visible)
        for t, (_, m) in zip(times, found, strict=True)
    }
    near = height[3.8]
    assert near[1] == pytest.approx(math.hypot(2000, 40_000 * 0.76 / 0.8), rel=0.01)  # honest
    assert 4 <= near[2] < 12
    assert max(abs(alt - 500_000) for t, (alt, _, _) in height.items() if 2.0 < t < 3.9) > 5_000


def test_spoofing_leads_away_with_a_clean_conscience() -> None:
    found = of(
        apply_faults(STREAM, [fault("spoofing", "up_mps=2,north_mps=3,limit_s=10")], 1),
        "GPS_RAW_INT",
    )
    for packet, fix in found:
        if inside(packet):
            led_s = min(age_s(packet) - START_S, 10.0)
            assert (fix.alt - 500_000) * 1e-3 == pytest.approx(2.0 * led_s, abs=0.01)
            assert (fix.alt_ellipsoid - 547_000) * 1e-3 == pytest.approx(2.0 * led_s, abs=0.01)
            assert (fix.lat - 470_000_000) * 1e-7 * 111_319.49 == pytest.approx(
                3.0 * led_s, abs=0.02
            )
            assert (fix.v_acc, fix.h_acc, fix.fix_type) == (2000, 1200, 3)
            assert fix.vel == (300 if age_s(packet) - START_S < 10.0 else 0)


def test_the_sliding_fix_admits_it() -> None:
    found = of(apply_faults(STREAM, [fault("slide", "height_m=700")], 1), "GPS_RAW_INT")
    sliding = [(age_s(p) - START_S, m) for p, m in found if inside(p)]
    for since_s, fix in sliding:
        offset_m = 700.0 * (1.0 - since_s / DURATION_S)
        assert (fix.alt - 500_000) * 1e-3 == pytest.approx(offset_m, abs=0.01)
        assert fix.v_acc * 1e-3 == pytest.approx(2.0 + 3.0 * offset_m, abs=0.01)
        assert fix.fix_type == 3


# One by one: the clock


@pytest.mark.parametrize("jump_s", [40.0, -7.0])
def test_clock_jump(jump_s: float) -> None:
    found = list(apply_faults(STREAM, [fault("clock_jump", f"jump_s={jump_s}")], 1))
    for before, after in zip(STREAM, found, strict=True):
        if before != after:
            kind, edited = message(before), message(after)
            (name,) = differing(kind, edited)
            size_s = 1e-3 if name == "time_boot_ms" else 1e-6
            assert (getattr(edited, name) - getattr(kind, name)) * size_s == pytest.approx(jump_s)
    stamped = {"SCALED_PRESSURE", "GPS_RAW_INT", "RAW_IMU", "HIGHRES_IMU"}
    assert {message(a).get_type() for a, b in zip(STREAM, found, strict=True) if a != b} == stamped


def test_reboot_is_silent_and_begins_at_zero() -> None:
    found = [
        p
        for p in apply_faults(STREAM, [fault("reboot", "duration_s=4", "start_s=20")], 1)
        if header(p.data).component_id == 1
    ]
    after = [packet for packet in found if age_s(packet) >= START_S]
    assert age_s(after[0]) >= START_S + 4.0
    assert [header(p.data).sequence for p in after] == [
        number % 256 for number in range(len(after))
    ]
    for packet in after:
        kind = message(packet)
        if kind.get_type() == "RAW_IMU":
            assert kind.time_usec * 1e-6 == pytest.approx(age_s(packet) - START_S - 4.0, abs=0.01)
        if kind.get_type() == "SCALED_PRESSURE":
            assert kind.time_boot_ms * 1e-3 == pytest.approx(
                age_s(packet) - START_S - 4.0, abs=0.01
            )


# Editing


def test_an_edited_frame_keeps_everything_else() -> None:
    for packet in STREAM[:50]:
        opened = Editor(packet.data, header(packet.data).message_id)
        assert opened.close() == packet.data
        assert with_sequence(packet.data, header(packet.data).sequence) == packet.data
        again = with_sequence(packet.data, 77)
        assert header(again).sequence == 77
        assert message(Packet(0, again)).to_dict() == message(packet).to_dict()


def test_an_edited_signed_frame_is_unsigned() -> None:
    signer = Vehicle(key=b"k" * 32)
    packets = standing(30.0, 60.0, vehicle=signer)
    found = list(apply_faults(packets, [parse_fault("step:size=100")], 1))
    for before, after in zip(packets, found, strict=True):
        signed = bool(after.data[2] & 1)
        assert signed is (before == after)
        assert message(after).get_type() == message(before).get_type()


# A simulated stream and its log

BASE = {"name": "test", "summary": "of a test", "profile": [{"leg": "wait", "duration_s": 24}]}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_in_flight_and_the_same_on_the_log_agree_to_the_byte(
    name: str, tmp_path: Path
) -> None:
    chosen = parse_fault(
        f"{name}:start_s=12,{'' if name == 'reboot' else 'duration_s=8,'}{PARAMETERS[name]}"
    )
    sound = validate(BASE, Scenario, "a test")
    broken = validate({**BASE, "faults": [chosen.model_dump()]}, Scenario, "a test")
    clean, flown, made = (tmp_path / f"{part}.tlog" for part in ("clean", "flown", "made"))
    Flight(sound, tlog=clean, seed=3).run()
    Flight(broken, tlog=flown, seed=3).run()
    corrupt(clean, made, [chosen], 3)
    assert flown.read_bytes() == made.read_bytes()
    assert flown.read_bytes() != clean.read_bytes()


def test_all_faults_at_once_agree_too(tmp_path: Path) -> None:
    chosen = [parse_fault(f"{name}:start_s=10,duration_s=9,{PARAMETERS[name]}") for name in FAULTS]
    broken = validate(
        {**BASE, "faults": [each.model_dump() for each in chosen]}, Scenario, "a test"
    )
    clean, flown, made = (tmp_path / f"{part}.tlog" for part in ("clean", "flown", "made"))
    Flight(validate(BASE, Scenario, "a test"), tlog=clean, seed=3).run()
    Flight(broken, tlog=flown, seed=3).run()
    corrupt(clean, made, chosen, 3)
    assert flown.read_bytes() == made.read_bytes()


def test_every_link_of_a_flight_has_the_same_bad_readings() -> None:
    noisy = {
        **BASE,
        "faults": [{"fault": "noise", "sd": 50.0}, {"fault": "delay", "delay_s": 0.25}],
    }
    clock = ManualClock()
    ends = [pair(clock) for _ in range(2)]
    flight = Flight(
        validate(noisy, Scenario, "a test"),
        links=[near for near, _ in ends],
        all_streams=True,
        clock=clock,
    )
    heard: list[list[tuple[int, float]]] = [[], []]
    decoders = [Decoder(), Decoder()]
    while flight.time_us < 5_000_000:
        flight.tick()
        for number, (_, far) in enumerate(ends):
            while data := far.receive(0.0):
                for frame in decoders[number].feed(data):
                    if frame.message_id == mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE:
                        reading: Any = decode(frame)
                        heard[number].append((flight.time_us, reading.press_abs))
                        assert flight.time_us - reading.time_boot_ms * 1000 == 250_000
    assert heard[0] == heard[1]
    assert len(heard[0]) == pytest.approx(95, abs=2)


# Logs, and the table


def test_a_log_is_not_overwritten_by_itself(tmp_path: Path, short_hop: Path) -> None:
    path = tmp_path / "hop.tlog"
    path.write_bytes(short_hop.read_bytes())
    (tmp_path / "link.tlog").hardlink_to(path)
    for target in (path, tmp_path / "." / "hop.tlog", tmp_path / "link.tlog"):
        with pytest.raises(LogFormatError, match="is the log to be read"):
            corrupt(path, target, [fault("drop")], 1)
    assert path.read_bytes() == short_hop.read_bytes()


def test_corrupt_counts_and_reports(tmp_path: Path, short_hop: Path) -> None:
    seen: list[tuple[int, int]] = []
    found = corrupt(
        short_hop, tmp_path / "out.tlog", [fault("step"), fault("drop", "message=HEARTBEAT")], 1,
        lambda done, total: seen.append((done, total)),
    )  # fmt: skip
    packets, broken = list(TlogReader(short_hop)), list(TlogReader(tmp_path / "out.tlog"))
    assert (found.read, found.written) == (len(packets), len(broken))
    assert found.read - found.written == DURATION_S
    assert found.touched == 20 * DURATION_S
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)
    assert {total for _, total in seen} == {short_hop.stat().st_size}


REAL = Path("/work/shared/data/real")


@pytest.mark.skipif(not REAL.is_dir(), reason="the recorded logs are not here")
@pytest.mark.parametrize(
    "log",
    [
        "codelever_2013-10-13_16-58-51.tlog",
        "SITL_wlichon_mixed_signed.tlog",
        "cuav_2018sitl_flight.tlog",
    ],
)
def test_every_fault_works_on_recorded_logs(log: str) -> None:
    packets = list(TlogReader(REAL / log))[:6000]
    for name in FAULTS:
        decoder = Decoder()
        found = list(
            apply_faults(
                packets, [parse_fault(f"{name}:start_s=5,duration_s=20,{PARAMETERS[name]}")], 1
            )
        )
        assert found
        for packet in found:
            assert len(decoder.feed(packet.data)) == 1
        assert not decoder.counters


def test_the_table_says_what_every_fault_does() -> None:
    rows = {name: (meaning, own) for name, meaning, own in table()}
    assert rows.keys() == FAULTS.keys() == PARAMETERS.keys()
    for meaning, own in rows.values():
        assert meaning.endswith(".")
        assert 10 < len(meaning) < 130
        assert len({row.name for row in own}) == len(own)
    assert any(row.default == "required" for row in rows["step"][1])
    assert any("feet" in row.allowed for row in rows["swapped_units"][1])


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("drp", "'drp' is unknown; did you mean `drop`?"),
        ("nothing", "'nothing' is unknown; give one of drop"),
        ("drop:60", "'60' is malformed or repeated"),
        ("drop:start_s=1,start_s=2", "'start_s=2' is malformed or repeated; expected key=value"),
        ("drop:strt_s=3", "strt_s: unknown key; did you mean `start_s`?"),
        ("drop:probability=2", "probability: '2' is out of range"),
        ("drop:message=GPS", "message: 'GPS': is no message of the dialect"),
        ("step:quantity=pressure", "size: this key is required"),
        ("drop:fault=step", "'fault=step' is malformed or repeated"),
    ],
)
def test_a_mistake_is_one_line(text: str, complaint: str) -> None:
    with pytest.raises(ConfigError) as failure:
        parse_fault(text)
    assert complaint in str(failure.value)
    assert "\n" not in str(failure.value)


def test_a_mistake_in_a_scenario_is_one_line() -> None:
    for broken in (
        {"fault": "drp"},
        {"fault": "drop", "chance": 1},
        {"start_s": 3},
        {"fault": "step", "size": "x"},
    ):
        with pytest.raises(ConfigError, match=r"^a test: faults") as failure:
            validate({**BASE, "faults": [broken]}, Scenario, "a test")
        assert "\n" not in str(failure.value)


def test_step_of_pressure_altitude_is_metres_of_the_standard_atmosphere() -> None:
    name, field = "SCALED_PRESSURE", "press_abs"
    step = apply_faults(STREAM, [fault("step", "size=40,quantity=pressure_altitude")], 1)
    right, wrong = (100.0 * series(packets, name, field) for packets in (STREAM, step))
    apart = [
        pressure_altitude_m(w) - pressure_altitude_m(r) for r, w in zip(right, wrong, strict=True)
    ]
    np.testing.assert_allclose(apart, 40.0, atol=0.01)


def test_swing_begins_at_what_is_right() -> None:
    swing = apply_faults(STREAM, [fault("swing", "size=4,period_s=4,quantity=gnss_height")], 1)
    wrong = series(swing, "GPS_RAW_INT", "alt") - series(STREAM, "GPS_RAW_INT", "alt")
    assert abs(wrong[0]) < 1500.0
    assert (wrong.min(), wrong.max()) == pytest.approx((-4000.0, 4000.0), abs=700.0)


def test_lag_says_what_was_read_before() -> None:
    """At 5 Hz half a second ago is between the second and the third reading before: the older one
    counts."""
    sound = series(STREAM, "SCALED_PRESSURE", "press_abs")
    lag = series(
        apply_faults(STREAM, [fault("lag", "lag_s=0.5")], 1), "SCALED_PRESSURE", "press_abs"
    )
    np.testing.assert_array_equal(lag[3:], sound[:-3])


def test_three_satellites_hold_the_height() -> None:
    flying = [
        gps for _, gps in of(apply_faults(STREAM, [fault("two_dimensional")], 1), "GPS_RAW_INT")
    ]
    flat = [gps for gps in flying if gps.fix_type == 2]
    assert flat
    assert {gps.satellites_visible for gps in flat} == {3}
    assert len({gps.alt for gps in flat}) == 1
