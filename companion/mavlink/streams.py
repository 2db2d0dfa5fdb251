"""Which messages the estimator needs from the vehicle, how often, and what the link can carry.

`wanted` lists the messages; `planned` lowers their rates until they fit the link.
`companion.mavlink.supervisor` requests them and measures their rates.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

from pydantic import Field

from companion.config import Settings
from companion.mavlink.codec import mavlink
from companion.samples import Kind

FRAME_OVERHEAD_BYTES = 12
"""overhead of a MAVLink 2 frame: ten bytes of header, two of checksum"""
LINK_SHARE = 0.6
"""share of a link's bytes; the rest is for messages that were not requested"""
RATES_HZ = (50.0, 40.0, 25.0, 20.0, 10.0, 5.0, 2.0, 1.0)
"""lower rates; ArduPlane grants 40 Hz with its default loop of 50 Hz"""


class StreamSettings(Settings):
    """Section ``streams``: message rates requested from the vehicle; a rate of 0 requests
    nothing."""

    request: bool = True
    """whether message rates are requested with SET_MESSAGE_INTERVAL, measured, and requested again
    when they fall short; nothing is saved in the vehicle"""
    data_stream: Literal["auto", "always", "never"] = "auto"
    """when REQUEST_DATA_STREAM is sent, where SET_MESSAGE_INTERVAL is refused or ignored; auto: not
    to ArduPlane, which saves these rates to its parameters"""
    link_bytes_per_s: float | None = Field(None, gt=0)
    """capacity of the link, for example 3000 over a telemetry radio; default: by the baud rate of a
    serial port, unlimited elsewhere"""
    pressure_hz: float = Field(20.0, ge=0, le=200)
    """rate of SCALED_PRESSURE"""
    gnss_hz: float = Field(5.0, ge=0, le=50)
    """rate of GPS_RAW_INT and GPS2_RAW"""
    imu_hz: float = Field(50.0, ge=0, le=400)
    """rate of RAW_IMU, or of HIGHRES_IMU from PX4"""
    attitude_hz: float = Field(10.0, ge=0, le=200)
    """rate of ATTITUDE"""
    position_hz: float = Field(5.0, ge=0, le=50)
    """rate of GLOBAL_POSITION_INT, the vehicle's own height, sent on in ALTITUDE while ours is
    LOST"""
    range_hz: float = Field(10.0, ge=0, le=50)
    """rate of DISTANCE_SENSOR"""
    spare_hz: float = Field(10.0, ge=0, le=50)
    """rate of SCALED_PRESSURE2 and SCALED_PRESSURE3, the redundant barometers"""
    air_hz: float = Field(2.0, ge=0, le=50)
    """rate of VFR_HUD, WIND and HYGROMETER_SENSOR, where the estimator uses them"""
    status_hz: float = Field(1.0, ge=0, le=10)
    """rate of SYSTEM_TIME, HOME_POSITION and EXTENDED_SYS_STATE"""


@dataclass(frozen=True)
class Stream:
    """One message that is wanted at a rate."""

    message_id: int
    rate_hz: float
    label: str = ""
    """the sensor's name in messages to the user; empty: its absence is normal and not reported"""
    floor_hz: float = 1.0
    """lowest rate on a full link"""
    group: int = -1
    """MAV_DATA_STREAM of REQUEST_DATA_STREAM that contains it; -1 none"""

    @property
    def name(self) -> str:
        return str(mavlink.mavlink_map[self.message_id].msgname)

    @property
    def bytes_per_s(self) -> float:
        size: int = mavlink.mavlink_map[self.message_id].unpacker.size
        return (size + FRAME_OVERHEAD_BYTES) * self.rate_hz


class _Row(NamedTuple):
    """One line of `_TABLE`: the message is wanted when the estimator uses `kind`, or always."""

    message: str
    kind: Kind | None
    rate_key: str
    group: str = ""
    floor_hz: float = 1.0
    label: str = ""


_TABLE = (
    _Row("SCALED_PRESSURE", Kind.PRESSURE, "pressure_hz", "RAW_SENSORS", 5.0, "barometer"),
    _Row("GPS_RAW_INT", Kind.GNSS, "gnss_hz", "EXTENDED_STATUS", 1.0, "GNSS"),
    _Row("RAW_IMU", Kind.IMU, "imu_hz", "RAW_SENSORS", 10.0, "IMU"),
    _Row("ATTITUDE", Kind.ATTITUDE, "attitude_hz", "EXTRA1", 2.0),
    _Row("SYSTEM_TIME", None, "status_hz", "EXTRA3"),
    _Row("HOME_POSITION", None, "status_hz"),
    _Row("EXTENDED_SYS_STATE", None, "status_hz"),
    _Row("GLOBAL_POSITION_INT", None, "position_hz", "POSITION", 2.0),
    _Row("DISTANCE_SENSOR", None, "range_hz", "EXTRA3", 2.0),
    _Row("SCALED_PRESSURE2", Kind.PRESSURE, "spare_hz", "RAW_SENSORS", 2.0),
    _Row("SCALED_PRESSURE3", Kind.PRESSURE, "spare_hz", "RAW_SENSORS", 2.0),
    _Row("GPS2_RAW", Kind.GNSS, "gnss_hz", "EXTENDED_STATUS", 2.0),
    _Row("VFR_HUD", Kind.AIRSPEED, "air_hz", "EXTRA2"),
    _Row("WIND", Kind.AIRSPEED, "air_hz", "EXTRA3"),
    _Row("HYGROMETER_SENSOR", Kind.AIR, "air_hz", "EXTRA3"),
)
_PX4_IMU = "HIGHRES_IMU"


def wanted(
    settings: StreamSettings,
    uses: Collection[Kind],
    autopilot: int,
    *,
    vehicle_height: bool = True,
) -> list[Stream]:
    """The messages of the sample kinds that the estimator uses, what places and labels them, and
    the vehicle's own height where it is sent on."""
    is_px4 = autopilot == mavlink.MAV_AUTOPILOT_PX4
    found: list[Stream] = []
    for row in _TABLE:
        rate_hz = getattr(settings, row.rate_key)
        if row.message == "GLOBAL_POSITION_INT" and not vehicle_height:
            rate_hz = 0.0
        if rate_hz > 0.0 and (row.kind is None or row.kind in uses):
            message = _PX4_IMU if row.kind is Kind.IMU and is_px4 else row.message
            message_id = getattr(mavlink, f"MAVLINK_MSG_ID_{message}")
            group = getattr(mavlink, f"MAV_DATA_STREAM_{row.group}") if row.group else -1
            found.append(Stream(message_id, rate_hz, row.label, row.floor_hz, group))
    return found


def planned(streams: Sequence[Stream], link_bytes_per_s: float | None) -> list[Stream]:
    """`streams` with rates that fit into `LINK_SHARE` of the link's bytes per second.

    The stream that takes the most is lowered one step of `RATES_HZ` at a time, none below its
    floor: what remains then is requested even if it is too much, since less is of no use.
    """
    plan = list(streams)
    if link_bytes_per_s is None:
        return plan
    while sum(stream.bytes_per_s for stream in plan) > LINK_SHARE * link_bytes_per_s:
        lowered = [
            (stream.bytes_per_s, number, lower_hz)
            for number, stream in enumerate(plan)
            if (lower_hz := next_lower_hz(stream.rate_hz)) >= stream.floor_hz
        ]
        if not lowered:
            break
        _, number, lower_hz = max(lowered)
        plan[number] = replace(plan[number], rate_hz=lower_hz)
    return plan


def next_lower_hz(rate_hz: float) -> float:
    """The next lower rate of `RATES_HZ`; 0 below the lowest."""
    return next((lower_hz for lower_hz in RATES_HZ if lower_hz < rate_hz), 0.0)
