"""A vehicle as its bytes: real MAVLink made by pymavlink, second by second, and what the companion
makes of it.

`Vehicle` packs messages with its own ids, version and signature; `standing` is a healthy vehicle at
rest, whose values a test replaces; `replay` writes the packets as a tlog and runs it as ``kollsman
replay`` would.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from companion.health import Health
from companion.logs.tlog import TlogReader, TlogWriter
from companion.mavlink.codec import Message, mavlink
from companion.pipeline import Pipeline
from companion.samples import Kind, Packet, Rows, Verdict
from companion.settings import CompanionSettings
from tests.flights import HOST_EPOCH_US, standard_pressure_pa

SEA_LEVEL_PA = 100_725.0
ALTITUDE_M = 500.0
MILLI_G = 1000


class Vehicle:
    """Packs messages as one MAVLink component."""

    def __init__(
        self,
        system_id: int = 1,
        component_id: int = 1,
        *,
        version: int = 2,
        key: bytes | None = None,
        link_id: int = 0,
    ) -> None:
        self.version = version
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        if key is not None:
            self._mav.signing.secret_key = key
            self._mav.signing.sign_outgoing = True
            self._mav.signing.link_id = link_id

    def pack(self, message: Message) -> bytes:
        data: bytes = message.pack(self._mav, force_mavlink1=self.version == 1)
        self._mav.seq = (self._mav.seq + 1) % 256
        return data


def hectopascals(altitude_m: float) -> float:
    """True pressure at an altitude in this test's air."""
    return float(standard_pressure_pa(np.array(altitude_m), SEA_LEVEL_PA)) * 0.01


def heartbeat(**fields: Any) -> Message:
    values = {
        "type": mavlink.MAV_TYPE_QUADROTOR,
        "autopilot": mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
        "base_mode": 0,
        "custom_mode": 0,
        "system_status": mavlink.MAV_STATE_ACTIVE,
        "mavlink_version": 3,
    }
    return mavlink.MAVLink_heartbeat_message(**values | fields)


def pressure(boot_s: float, altitude_m: float = ALTITUDE_M, **fields: Any) -> Message:
    values = {
        "time_boot_ms": round(boot_s * 1e3) & 0xFFFFFFFF,
        "press_abs": hectopascals(altitude_m),
        "press_diff": 0.0,
        "temperature": 3000,
    }
    return mavlink.MAVLink_scaled_pressure_message(**values | fields)


def gps(boot_s: float, altitude_m: float = ALTITUDE_M, **fields: Any) -> Message:
    values = {
        "time_usec": round(boot_s * 1e6),
        "fix_type": 3,
        "lat": 470_000_000,
        "lon": 80_000_000,
        "alt": round(altitude_m * 1e3),
        "eph": 90,
        "epv": 140,
        "vel": 0,
        "cog": 0,
        "satellites_visible": 12,
        "alt_ellipsoid": round(altitude_m * 1e3) + 47_000,
        "h_acc": 1200,
        "v_acc": 2000,
    }
    return mavlink.MAVLink_gps_raw_int_message(**values | fields)


def raw_imu(boot_s: float, **fields: Any) -> Message:
    names = ("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro", "xmag", "ymag", "zmag")
    values = {"time_usec": round(boot_s * 1e6)} | dict.fromkeys(names, 0) | {"zacc": -MILLI_G}
    return mavlink.MAVLink_raw_imu_message(**values | fields)


def highres_imu(boot_s: float, **fields: Any) -> Message:
    names = (
        "xacc",
        "yacc",
        "xgyro",
        "ygyro",
        "zgyro",
        "xmag",
        "ymag",
        "zmag",
        "diff_pressure",
        "pressure_alt",
    )
    values = {"time_usec": round(boot_s * 1e6)} | dict.fromkeys(names, 0.0)
    values |= {
        "zacc": -9.81,
        "abs_pressure": hectopascals(ALTITUDE_M),
        "temperature": 30.0,
        "fields_updated": 0xFFFF,
    }
    return mavlink.MAVLink_highres_imu_message(**values | fields)


def attitude(boot_s: float, **fields: Any) -> Message:
    names = ("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed")
    return mavlink.MAVLink_attitude_message(
        **{"time_boot_ms": round(boot_s * 1e3) & 0xFFFFFFFF} | dict.fromkeys(names, 0.0) | fields
    )


def range_finder(boot_s: float, **fields: Any) -> Message:
    values = {
        "time_boot_ms": round(boot_s * 1e3) & 0xFFFFFFFF,
        "min_distance": 20,
        "max_distance": 4000,
        "current_distance": 1000,
        "type": mavlink.MAV_DISTANCE_SENSOR_LASER,
        "id": 0,
        "orientation": mavlink.MAV_SENSOR_ROTATION_PITCH_270,
        "covariance": 255,
    }
    return mavlink.MAVLink_distance_sensor_message(**values | fields)


def system_time(boot_s: float, unix_us: int = 0) -> Message:
    return mavlink.MAVLink_system_time_message(unix_us, round(boot_s * 1e3) & 0xFFFFFFFF)


def home(altitude_m: float, **fields: Any) -> Message:
    values: dict[str, Any] = {
        "latitude": 470_000_000,
        "longitude": 80_000_000,
        "altitude": round(altitude_m * 1e3),
    }
    values |= dict.fromkeys(("x", "y", "z", "approach_x", "approach_y", "approach_z"), 0.0) | {
        "q": [1.0, 0.0, 0.0, 0.0]
    }
    return mavlink.MAVLink_home_position_message(**values | fields)


Maker = Callable[[float], Message | None]
"""Boot seconds -> a message, or None to send nothing."""

HEALTHY: Mapping[str, tuple[float, Maker]] = {
    "heartbeat": (1.0, lambda boot_s: heartbeat()),
    "pressure": (5.0, pressure),
    "gps": (5.0, gps),
    "imu": (10.0, raw_imu),
}
"""name -> (rate in Hz, how to make one)"""


def standing(
    start_s: float = 30.0,
    end_s: float = 60.0,
    *,
    vehicle: Vehicle | None = None,
    host_us: int = HOST_EPOCH_US,
    **streams: tuple[float, Maker] | Maker | None,
) -> list[Packet]:
    """Packets of a vehicle between two boot times, in order.

    `streams` replace or add to `HEALTHY`: a maker keeps the healthy rate, None silences. `host_us`
    is the host's clock at boot time 0.
    """
    vehicle = vehicle if vehicle is not None else Vehicle()
    chosen: dict[str, tuple[float, Maker]] = dict(HEALTHY)
    for name, stream in streams.items():
        if stream is None:
            del chosen[name]
        else:
            chosen[name] = stream if isinstance(stream, tuple) else (HEALTHY[name][0], stream)
    due = [
        (start_s + number / rate_hz, order, make)
        for order, (rate_hz, make) in enumerate(chosen.values())
        for number in range(round((end_s - start_s) * rate_hz))
    ]
    packets = []
    for boot_s, _, make in sorted(due, key=lambda item: item[:2]):
        message = make(boot_s)
        if message is not None:
            packets.append(Packet(host_us + round(boot_s * 1e6), vehicle.pack(message)))
    return packets


def merged(*streams: Iterable[Packet]) -> list[Packet]:
    """Packets of several senders in order of arrival."""
    return sorted(
        (packet for stream in streams for packet in stream), key=lambda packet: packet.time_us
    )


@dataclass
class Outcome:
    """What a replay did: an observer that keeps everything."""

    pipeline: Pipeline
    altitudes: list[Message] = field(default_factory=list)
    sent: list[bytes] = field(default_factory=list)
    samples: list[tuple[Kind, int, Verdict]] = field(default_factory=list)
    """(kind, instance, verdict)"""
    rows: list[tuple[Kind, Any]] = field(default_factory=list)
    health: list[Health] = field(default_factory=list)
    """after each sample"""
    damage: dict[str, int] = field(default_factory=dict)

    def sample(self, kind: Kind, row: Rows, verdict: Verdict, estimate: Rows) -> None:
        self.samples.append((kind, int(row[0]["instance"]), verdict))
        self.rows.append((kind, row.copy()[0]))
        self.health.append(self.pipeline.health.health)

    def truth(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        """Not kept."""

    def autopilot(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        """Not kept."""

    def published(self, message: Message) -> None:
        self.altitudes.append(message)

    def count(self, kind: Kind, verdict: Verdict) -> int:
        return int(self.pipeline.verdicts[kind][verdict])

    def amsl_m(self) -> list[float]:
        return [float(message.altitude_amsl) for message in self.altitudes]

    def names(self) -> list[str]:
        """Types of what was sent, in order."""
        return [message.get_type() for message in parsed(self.sent)]


def feed(packets: Iterable[Packet], settings: CompanionSettings | None = None) -> Outcome:
    """Packets straight into a pipeline."""
    outcome = Outcome(Pipeline(settings or CompanionSettings(), datagrams=True))
    outcome.pipeline.observe(outcome)
    for packet in packets:
        outcome.sent += outcome.pipeline.feed(packet)
    return outcome


def write(path: Path, packets: Iterable[Packet]) -> Path:
    """The packets as a tlog."""
    with TlogWriter(path) as writer:
        for packet in packets:
            writer.write(packet.time_us, packet.data)
    return path


def replay(path: Path, settings: CompanionSettings | None = None) -> Outcome:
    """A tlog through the companion."""
    reader = TlogReader(path)
    outcome = feed(reader, settings)
    outcome.damage = {str(cause): count for cause, count in reader.counters.items() if count}
    return outcome


def parsed(frames: Iterable[bytes]) -> list[Message]:
    """Frames as a stock pymavlink receiver reads them."""
    receiver = mavlink.MAVLink(None)
    receiver.robust_parsing = False
    return [message for frame in frames for message in receiver.parse_buffer(frame) or []]


def changes(health: Iterable[Health]) -> Iterator[Health]:
    """Health without repeats."""
    last = None
    for value in health:
        if value is not last:
            yield value
        last = value
