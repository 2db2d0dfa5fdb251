"""The vehicle's parameters: a small table for each flavour, with real names and defaults, and the
effect of PARAM_SET.

Types are those of the firmware. An integer travels as ArduPilot sends it, its value as a float, or
as PX4 does, its bytes in the place of the float. Values are held in memory until the end of the
flight. Of these, BARO_ALT_OFFSET and SENS_BARO_QNH move the vehicle's own altitude.
"""

import math
import struct
from collections.abc import Sequence
from typing import NamedTuple

from companion.mavlink.codec import mavlink
from sim.vehicle.frames import packer

REAL32: int = mavlink.MAV_PARAM_TYPE_REAL32
INT8: int = mavlink.MAV_PARAM_TYPE_INT8
INT16: int = mavlink.MAV_PARAM_TYPE_INT16
INT32: int = mavlink.MAV_PARAM_TYPE_INT32
NO_INDEX = 65535


class Parameter(NamedTuple):
    """One parameter with its value at boot."""

    name: str
    value: float
    kind: int = REAL32
    """MAV_PARAM_TYPE"""
    read_only: bool = False


class Parameters:
    """Values by name, in the order of the table.

    `indexed` says whether PARAM_VALUE tells the index whatever the question was (PX4), or only to
    who asked by index or for the list (ArduPilot). `bytewise` is PX4's encoding of integers; it
    refuses a value of another type, which ArduPilot converts.
    """

    def __init__(
        self, table: Sequence[Parameter], *, indexed: bool, bytewise: bool = False
    ) -> None:
        self.values = {row.name: row.value for row in table}
        self._kinds = {row.name: row.kind for row in table}
        self._bytewise = bytewise
        self._names = [row.name for row in table]
        self._read_only = {row.name for row in table if row.read_only}
        self._indexed = indexed

    def __len__(self) -> int:
        return len(self._names)

    def find(self, name: str, index: int) -> int | None:
        """The index of the parameter that PARAM_REQUEST_READ requests, by name if `index` is -1;
        None if there is none."""
        if index >= 0:
            return index if index < len(self._names) else None
        return self._names.index(name) if name in self.values else None

    def set(self, name: str, value: float, kind: int) -> bool:
        """Set a known parameter from a PARAM_SET; False when it may not be written and keeps its
        value."""
        own = self._kinds[name]
        if self._bytewise and own != REAL32:
            if kind != own:
                return False
            value = struct.unpack("<i", struct.pack("<f", value))[0]
        elif self._bytewise and kind != REAL32:
            return False
        if name in self._read_only or not math.isfinite(value):
            return False
        is_real = own == REAL32  # ArduPilot drops the fraction but for rounding errors
        self.values[name] = value if is_real else float(int(value + math.copysign(0.01, value)))
        return True

    def payload(self, index: int, *, by_index: bool) -> bytes:
        """PARAM_VALUE."""
        name = self._names[index]
        value, kind = self.values[name], self._kinds[name]
        if self._bytewise and kind != REAL32:
            value = struct.unpack("<f", struct.pack("<i", round(value)))[0]
        return packer("PARAM_VALUE").named(
            param_value=value,
            param_count=len(self._names),
            param_index=index if by_index or self._indexed else NO_INDEX,
            param_id=name,
            param_type=kind,
        )


ARDUPILOT = (
    Parameter("FORMAT_VERSION", 13, INT16),
    Parameter("MAV_SYSID", 1, INT16),
    Parameter("MAV_GCS_SYSID", 255, INT16),
    Parameter("SCHED_LOOP_RATE", 100, INT16),
    Parameter("AHRS_EKF_TYPE", 3, INT8),
    Parameter("AHRS_TRIM_X", 0.0),
    Parameter("AHRS_TRIM_Y", 0.0),
    Parameter("AIRSPEED_CRUISE", 12.0),
    Parameter("AIRSPEED_MIN", 9.0),
    Parameter("AIRSPEED_MAX", 22.0),
    Parameter("ARSPD_TYPE", 0, INT8),
    Parameter("BARO1_GND_PRESS", 0.0, read_only=True),  # known at boot
    Parameter("BARO_GND_TEMP", 0.0),
    Parameter("BARO_ALT_OFFSET", 0.0),
    Parameter("BARO_PRIMARY", 0, INT8),
    Parameter("BARO_EXT_BUS", -1, INT8),
    Parameter("BARO_FLTR_RNG", 0, INT8),
    Parameter("BARO_OPTIONS", 0, INT8),
    Parameter("EK3_ENABLE", 1, INT8),
    Parameter("EK3_ALT_M_NSE", 3.0),
    Parameter("EK3_HGT_I_GATE", 500, INT16),
    Parameter("EK3_OGN_HGT_MASK", 0, INT8),
    Parameter("EK3_SRC1_POSXY", 3, INT8),
    Parameter("EK3_SRC1_VELXY", 3, INT8),
    Parameter("EK3_SRC1_POSZ", 1, INT8),
    Parameter("EK3_SRC1_VELZ", 3, INT8),
    Parameter("EK3_SRC1_YAW", 1, INT8),
    Parameter("GPS1_TYPE", 1, INT8),
    Parameter("GPS1_DELAY_MS", 0, INT16),
    Parameter("INS_GYR_CAL", 1, INT8),
    Parameter("LOG_DISARMED", 0, INT8),
    Parameter("RTL_ALTITUDE", 100.0),
    Parameter("TERRAIN_ENABLE", 1, INT8),
    Parameter("WP_LOITER_RAD", 60, INT16),
    Parameter("WP_RADIUS", 90, INT16),
)
"""ArduPlane 4.7, but for a loop of 100 Hz instead of 50: at most four fifths of it may be asked of
a message."""

PX4 = (
    Parameter("CAL_BARO0_OFF", 0.0),
    Parameter("COM_DISARM_LAND", 2.0),
    Parameter("EKF2_ABL_LIM", 0.4),
    Parameter("EKF2_ACC_B_NOISE", 0.003),
    Parameter("EKF2_ACC_NOISE", 0.35),
    Parameter("EKF2_BARO_DELAY", 0.0),
    Parameter("EKF2_BARO_GATE", 5.0),
    Parameter("EKF2_BARO_NOISE", 3.5),
    Parameter("EKF2_EV_DELAY", 0.0),
    Parameter("EKF2_GND_EFF_DZ", 4.0),
    Parameter("EKF2_GND_MAX_HGT", 0.5),
    Parameter("EKF2_GPS_DELAY", 110.0),
    Parameter("EKF2_GPS_P_GATE", 5.0),
    Parameter("EKF2_GPS_P_NOISE", 0.5),
    Parameter("EKF2_GPS_V_GATE", 5.0),
    Parameter("EKF2_GPS_V_NOISE", 0.3),
    Parameter("EKF2_GYR_B_NOISE", 0.001),
    Parameter("EKF2_BARO_CTRL", 1, INT32),
    Parameter(
        "EKF2_HGT_REF", 0, INT32
    ),  # barometer, as the estimate here; PX4's default is 1, GNSS
    Parameter("EKF2_GYR_NOISE", 0.015),
    Parameter("EKF2_REQ_EPH", 3.0),
    Parameter("EKF2_REQ_EPV", 5.0),
    Parameter("FW_AIRSPD_MAX", 20.0),
    Parameter("FW_AIRSPD_MIN", 10.0),
    Parameter("FW_AIRSPD_TRIM", 15.0),
    Parameter("MIS_TAKEOFF_ALT", 2.5),
    Parameter("NAV_ACC_RAD", 10.0),
    Parameter("NAV_LOITER_RAD", 80.0),
    Parameter("RTL_RETURN_ALT", 60.0),
    Parameter("SENS_BARO_QNH", 1013.25),
    Parameter("SENS_BARO_RATE", 20.0),
)

GENERIC = (
    Parameter("SYS_ID", 1),
    Parameter("BARO_OFFSET", 0.0),
    Parameter("BARO_QNH", 1013.25),
    Parameter("GPS_DELAY", 0.11),
    Parameter("CRUISE_SPEED", 15.0),
    Parameter("LOITER_RADIUS", 60.0),
)
