"""The same synthetic flight as a log of every format, written from the formats' descriptions alone.

Not the code under test: the writers share nothing with the readers.
"""

import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from companion.mavlink.codec import Encoder, mavlink
from companion.samples import Kind
from tests.flights import HOST_EPOCH_US, Flight, flight

G0 = 9.80665
BIN_FORMATS = {
    128: ("FMT", "BBnNZ", "Type,Length,Name,Format,Columns"),
    130: ("BARO", "QBffc", "TimeUS,I,Alt,Press,Temp"),
    131: (
        "GPS",
        "QBBIHBcLLeff" + "f",
        "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ",
    ),
    132: ("GPA", "QBCCCCB", "TimeUS,I,VDop,HAcc,VAcc,SAcc,VV"),
    133: ("IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    134: ("ATT", "QccC", "TimeUS,Roll,Pitch,Yaw"),
    135: ("SIM", "Qf", "TimeUS,Alt"),
    136: ("MSG", "QZ", "TimeUS,Message"),
    137: ("EV", "QB", "TimeUS,Id"),
    138: ("PARM", "QNf", "TimeUS,Name,Value"),
    139: ("MODE", "QMB", "TimeUS,Mode,ModeNum"),
}
LETTERS = {"c": 100, "C": 100, "e": 100, "E": 100, "L": 1e7}
CODES = {
    "B": "B", "H": "H", "I": "I", "Q": "Q", "f": "f", "M": "B", "c": "h", "C": "H", "e": "i",
    "L": "i", "n": "4s", "N": "16s", "Z": "64s",
}  # fmt: skip
WEEK, WEEK_MS = 2286, 302_400_000
"""of GPS time at boot"""

Row = tuple[int, str, tuple[Any, ...]]


def rows_of(made: Flight) -> list[Row]:
    """(time_us, message, values) of a flight, sorted by arrival."""
    found: list[tuple[int, Row]] = []
    first_us = made.start_us
    for kind, table in made.tables.items():
        for row in table:
            arrival, time_us = int(row["arrival_us"]), int(row["time_us"])
            for name, values in _messages(kind, row, made):
                found.append((arrival, (time_us, name, values)))
    found.sort(key=lambda entry: entry[0])
    head: list[Row] = [
        (first_us, "MSG", ("ArduPlane V4.5.0 (test)",)),
        (first_us, "PARM", ("SYSID_THISMAV", 7.0)),
        (first_us, "MODE", (10, 10)),
        (first_us, "EV", (10,)),
    ]
    return head + [row for _, row in found]


def _messages(kind: Kind, row: Any, made: Flight) -> list[tuple[str, tuple[Any, ...]]]:
    if kind is Kind.PRESSURE:
        truth_m = float(made.truth_m(int(row["time_us"])))
        return [
            ("BARO", (0, 0.0, float(row["pressure_pa"]), 29.85)),
            ("SIM", (truth_m,)),
        ]
    if kind is Kind.GNSS:
        ms = WEEK_MS + int(row["time_us"]) // 1000
        fix = (0, 3, ms, WEEK, 14, 0.8, row["latitude_deg"], row["longitude_deg"])
        course = math.degrees(row["course_rad"])
        moving = (row["altitude_amsl_m"], row["ground_speed_mps"], course, 0.0)
        return [
            ("GPS", fix + tuple(map(float, moving))),
            ("GPA", (0, 1.2, 1.0, float(row["vertical_sd_m"]), 0.3, 0)),
        ]
    if kind is Kind.IMU:
        rates, force = row["angular_rate_b_radps"], row["specific_force_b_mps2"]
        return [("IMU", (0, *map(float, rates), *map(float, force)))]
    if kind is Kind.ATTITUDE:
        angles = (math.degrees(row[name]) for name in ("roll_rad", "pitch_rad"))
        return [("ATT", (*angles, math.degrees(row["yaw_rad"]) % 360.0))]
    return []


def write_bin(path: Path, made: Flight) -> None:
    types = {name: number for number, (name, _, _) in BIN_FORMATS.items()}
    parts = []
    for number, (name, letters, labels) in BIN_FORMATS.items():
        length = 3 + struct.calcsize("<" + "".join(CODES[letter] for letter in letters))
        fields = (number, length, name.encode(), letters.encode(), labels.encode())
        parts.append(b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", *fields))
    for time_us, name, values in rows_of(made):
        number = types[name]
        letters = BIN_FORMATS[number][1]
        packed: list[Any] = []
        for letter, value in zip(letters, (time_us, *values), strict=True):
            scaled = round(value * LETTERS[letter]) if letter in LETTERS else value
            packed.append(scaled.encode() if isinstance(scaled, str) else scaled)
        codes = "".join(CODES[letter] for letter in letters)
        parts.append(b"\xa3\x95" + bytes([number]) + struct.pack("<" + codes, *packed))
    path.write_bytes(b"".join(parts))


def write_text(path: Path, made: Flight) -> None:
    lines = []
    for number, (name, letters, labels) in BIN_FORMATS.items():
        lines.append(f"FMT, {number}, 89, {name}, {letters}, {labels}")
    lines += [
        ", ".join(
            [name, str(time_us), *(v if isinstance(v, str) else format(v, ".9g") for v in values)]
        )
        for time_us, name, values in rows_of(made)
    ]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


ULG_FORMATS = {
    "vehicle_air_data": ("float baro_pressure_pa;float baro_temp_celcius;", "ff"),
    "vehicle_gps_position": (
        "uint64_t time_utc_usec;int32_t lat;int32_t lon;int32_t alt;int32_t alt_ellipsoid;"
        "float eph;float epv;float hdop;float vdop;float vel_m_s;float cog_rad;float vel_d_m_s;"
        "uint8_t fix_type;uint8_t satellites_used;uint8_t vel_ned_valid;",
        "QiiiifffffffBBB",
    ),
    "sensor_combined": ("float[3] gyro_rad;float[3] accelerometer_m_s2;", "ffffff"),
    "vehicle_attitude": ("float[4] q;", "ffff"),
    "vehicle_global_position_groundtruth": ("double lat;double lon;float alt;", "ddf"),
    "vehicle_status": ("uint8_t arming_state;uint8_t nav_state;uint8_t vehicle_type;", "BBB"),
}


def write_ulg(path: Path, made: Flight, hardware: str = "") -> None:
    """A PX4 log, written from the description of the format in PX4's documentation."""

    def message(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<Hc", len(body), kind) + body

    parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", made.start_us)]
    parts.append(message(b"B", bytes(40)))
    for name, (fields, _) in ULG_FORMATS.items():
        parts.append(message(b"F", f"{name}:uint64_t timestamp;{fields}".encode()))
    if hardware:
        key = f"char[{len(hardware)}] ver_hw".encode()
        parts.append(message(b"I", bytes([len(key)]) + key + hardware.encode()))
    key = b"int32_t MAV_SYS_ID"
    parts.append(message(b"P", bytes([len(key)]) + key + struct.pack("<i", 7)))
    for number, name in enumerate(ULG_FORMATS):
        parts.append(message(b"A", struct.pack("<BH", 0, number) + name.encode()))
    numbers = {name: number for number, name in enumerate(ULG_FORMATS)}
    for time_us, name, values in _ulg_rows(made):
        codes = ULG_FORMATS[name][1]
        body = struct.pack("<HQ" + codes, numbers[name], time_us, *values)
        parts.append(message(b"D", body))
    path.write_bytes(b"".join(parts))


def _ulg_rows(made: Flight) -> list[Row]:
    found: list[Row] = [(made.start_us, "vehicle_status", (2, 3, 2))]
    for time_us, name, values in rows_of(made):
        if name == "BARO":
            found.append((time_us, "vehicle_air_data", (values[2], values[3])))
        elif name == "SIM":
            found.append((time_us, "vehicle_global_position_groundtruth", (45.0, 8.0, values[0])))
        elif name == "GPS":
            lat, lon, alt, speed, course = values[6:11]
            unix_us = HOST_EPOCH_US + time_us
            place = (round(lat * 1e7), round(lon * 1e7), round(alt * 1e3), round(alt * 1e3) + 47000)
            spread = (1.0, made.plan.gnss_sd_m, 0.8, 1.2)
            motion = (speed, math.radians(course), 0.0, 3, 14, 0)
            found.append((time_us, "vehicle_gps_position", (unix_us, *place, *spread, *motion)))
        elif name == "IMU":
            found.append((time_us, "sensor_combined", values[1:]))
        elif name == "ATT":
            roll, pitch, yaw = np.radians(values) / 2
            cr, sr, cp, sp, cy, sy = (
                f(angle) for angle in (roll, pitch, yaw) for f in (math.cos, math.sin)
            )
            q = (
                cr * cp * cy + sr * sp * sy,
                sr * cp * cy - cr * sp * sy,
                cr * sp * cy + sr * cp * sy,
                cr * cp * sy - sr * sp * cy,
            )
            found.append((time_us, "vehicle_attitude", q))
    return found


def frames_of(made: Flight) -> list[tuple[int, bytes]]:
    """(arrival_us, frame) of a flight, with a HEARTBEAT a second."""
    encoder, found = Encoder(7, 1), []
    beat = mavlink.MAVLink_heartbeat_message(1, 3, 128, 0, 4, 3)
    due_us = 0
    for time_us, name, values in rows_of(made):
        arrival_us = HOST_EPOCH_US + time_us - made.start_us
        if time_us >= due_us:
            found.append((arrival_us, encoder.encode(beat)))
            due_us = time_us + 1_000_000
        message = _mavlink(time_us, name, values, made)
        if message is not None:
            found.append((arrival_us, encoder.encode(message)))
    return found


def _mavlink(time_us: int, name: str, values: tuple[Any, ...], made: Flight) -> Any:
    if name == "BARO":
        return mavlink.MAVLink_scaled_pressure_message(time_us // 1000, values[2] / 100, 0, 2985)
    if name == "SIM":
        state = [0.0] * 13 + [45.0, 8.0, values[0]] + [0.0] * 5
        return mavlink.MAVLink_sim_state_message(*state)
    if name == "GPS":
        lat, lon, alt, speed, course = values[6:11]
        return mavlink.MAVLink_gps_raw_int_message(
            time_us, 3, round(lat * 1e7), round(lon * 1e7), round(alt * 1e3), 80, 120,
            round(speed * 100), round(course * 100) % 36000, 14, round(alt * 1e3) + 47000, 1000,
            round(made.plan.gnss_sd_m * 1e3), 0, 0,
        )  # fmt: skip
    if name == "IMU":
        force = (round(value / G0 * 1e3) for value in values[4:7])
        rate = (round(value * 1e3) for value in values[1:4])
        return mavlink.MAVLink_raw_imu_message(time_us, *force, *rate, 0, 0, 0)
    if name == "ATT":
        roll, pitch, yaw = np.radians(values)
        yaw = (yaw + math.pi) % (2 * math.pi) - math.pi
        return mavlink.MAVLink_attitude_message(time_us // 1000, roll, pitch, yaw, 0, 0, 0)
    return None


def write_tlog(path: Path, made: Flight) -> None:
    path.write_bytes(b"".join(struct.pack(">Q", time) + data for time, data in frames_of(made)))


def write_raw(path: Path, made: Flight) -> None:
    path.write_bytes(b"".join(data for _, data in frames_of(made)))


WRITERS: dict[str, Callable[[Path, Flight], None]] = {
    "bin": write_bin,
    "log": write_text,
    "ulg": write_ulg,
    "tlog": write_tlog,
    "raw": write_raw,
}


def write(name: str, folder: Path, **changes: Any) -> tuple[Path, Flight]:
    """A log of the format `name` in `folder`, and the flight in it."""
    made = flight(**changes)
    path = folder / f"flight.{name}"
    WRITERS[name](path, made)
    return path, made
