"""What we tell the vehicle and its ground stations: ALTITUDE, the DEBUG family, STATUSTEXT,
HEARTBEAT.

ALTITUDE replaces the altitude that QGroundControl shows the pilot, so it is right or it is not
sent. Its fields:

====================  ==========================================================================================
altitude_monotonic    standard-atmosphere height above the first accepted pressure; joined without a step across a
                      reboot or a change of barometer; NaN while there is no barometer
altitude_amsl         the fused altitude
altitude_local        altitude_amsl minus its value at the first valid estimate since boot
altitude_relative     above HOME_POSITION, else above where it was armed, else NaN
altitude_terrain,     from a fresh downward range finder, corrected for tilt, else NaN
bottom_clearance
time_usec             vehicle boot time of the estimate
====================  ==========================================================================================

An altitude that leaps further than a vehicle can is withheld until it comes back or has stayed
there for two seconds.
"""

import math
from typing import Literal

import numpy as np
from pydantic import Field

from companion.config import Settings
from companion.health import Health
from companion.kernels.atmosphere import baro_altitude_m, qnh_pa
from companion.mavlink.codec import Message, mavlink
from companion.samples import Kind, Rows, Verdict

FRESH_US = 1_000_000
VEHICLE_ALTITUDE_US = 5_000_000
LEAP_US = 2_000_000
TAKEOVER_S = 2.0
STATUSTEXT_SIZE = 50
LARGEST_FLOAT = 3.4028234e38
FLOAT_ARRAY_SIZE = 58
LONGEST_ARRAY = 16
"""Longest array of a state that klState shows: histories are longer."""
SEVERITY = {
    Health.OK: mavlink.MAV_SEVERITY_INFO,
    Health.DEGRADED: mavlink.MAV_SEVERITY_WARNING,
    Health.LOST: mavlink.MAV_SEVERITY_ERROR,
}
SYSTEM_STATUS = {
    Health.OK: mavlink.MAV_STATE_ACTIVE,
    Health.DEGRADED: mavlink.MAV_STATE_ACTIVE,
    Health.LOST: mavlink.MAV_STATE_CRITICAL,
}


class PublishSettings(Settings):
    """Section ``publish``."""

    altitude: Literal["auto", "always", "never"] = "auto"
    """auto: silent while the vehicle sends ALTITUDE itself"""
    altitude_hz: float = Field(10.0, ge=0.1, le=100)
    """in vehicle time; a message goes out with the first update after its slot falls due"""
    debug: bool = True
    """DEBUG, DEBUG_VECT, NAMED_VALUE_FLOAT and DEBUG_FLOAT_ARRAY"""
    debug_hz: float = Field(1.0, ge=0.1, le=50)
    """of each message of the DEBUG family"""
    statustext: bool = True
    """one line for each change of health"""


class Schedule:
    """Slots of vehicle time: the first update after a slot falls due takes it. There is no timer."""

    def __init__(self, rate_hz: float) -> None:
        self._period_us = round(1e6 / rate_hz)
        self._due_us: int | None = None

    def takes(self, now_us: int) -> bool:
        """Whether an update at `now_us` is due; if so its slot is used up. A clock that went back
        starts anew."""
        due_us = self._due_us
        if due_us is None or now_us >= due_us or now_us < due_us - 2 * self._period_us:
            behind = due_us is None or now_us >= due_us + self._period_us or now_us < due_us
            self._due_us = (now_us if behind or due_us is None else due_us) + self._period_us
            return True
        return False


class Monotonic:
    """Height of the standard atmosphere above the first accepted pressure, without steps."""

    def __init__(self) -> None:
        self.altitude_m = math.nan
        self._offset_m = 0.0
        self._source: tuple[int, int] | None = None
        self._time_us = 0

    def update(self, boots: int, instance: int, time_us: int, pressure_pa: float) -> bool:
        """Take an accepted pressure, unless it is of another barometer while the one followed is
        alive.

        A reboot, a barometer that takes over from one that fell silent, and a jump of one that
        recovered from a fault are joined to where the altitude was.
        """
        source, elapsed_s = (boots, instance), (time_us - self._time_us) * 1e-6
        is_other = (
            self._source is not None and self._source[0] == boots and self._source[1] != instance
        )
        if is_other and elapsed_s <= TAKEOVER_S:
            return False
        baro_m = baro_altitude_m(pressure_pa)
        if math.isnan(self.altitude_m):
            self._offset_m = -baro_m
        elif source != self._source or abs(baro_m + self._offset_m - self.altitude_m) > _reach_m(
            elapsed_s, TAKEOVER_S
        ):
            self._offset_m = self.altitude_m - baro_m
        self.altitude_m = baro_m + self._offset_m
        self._source, self._time_us = source, time_us
        return True

    def at(self, now_us: int) -> float:
        """The value now: NaN when the last pressure is older than two seconds."""
        return self.altitude_m if abs(now_us - self._time_us) <= 2 * FRESH_US else math.nan


def _reach_m(elapsed_s: float, longest_s: float) -> float:
    """How far a height may go between two samples; beyond, it was wrong before or is now."""
    return 60.0 + 50.0 * min(max(0.0, elapsed_s), longest_s)


class Leap:
    """Tells an altitude that no vehicle can have reached since the last one."""

    def __init__(self) -> None:
        self._last: tuple[int, float] | None = None
        self._new: tuple[int, float] | None = None
        self._since_us = 0

    def withholds(self, time_us: int, altitude_m: float) -> bool:
        """Whether the altitude must wait. A clock that went back starts anew."""
        last = self._last
        if last is None or time_us < last[0] or self._reaches(last, time_us, altitude_m):
            self._last, self._new = (time_us, altitude_m), None
            return False
        new = self._new
        if new is None or not self._reaches(new, time_us, altitude_m):
            self._since_us = time_us
        self._new = (time_us, altitude_m)
        if time_us - self._since_us < LEAP_US:
            return True
        self._last, self._new = self._new, None
        return False

    @staticmethod
    def _reaches(start: tuple[int, float], time_us: int, altitude_m: float) -> bool:
        return abs(altitude_m - start[1]) <= _reach_m((time_us - start[0]) * 1e-6, 10.0)


class Outputs:
    """Follows what was taken in, and makes the messages."""

    def __init__(self, settings: PublishSettings) -> None:
        self.settings = settings
        self.monotonic = Monotonic()
        self._altitude_slots = Schedule(settings.altitude_hz)
        self._debug_slots = Schedule(settings.debug_hz)
        self._leap = Leap()
        self._boots = 0
        self.restart()

    def restart(self) -> None:
        """The vehicle booted: home, arming point and local origin are void; the monotonic altitude
        goes on."""
        self._boots += 1
        self._local_origin_m = math.nan
        self._home_m = math.nan
        self._arming_m = math.nan
        self._armed: bool | None = None  # unknown: a vehicle may be met in the air
        self._range: tuple[int, float] | None = None
        self._cos_tilt: tuple[int, float] | None = None
        self._vehicle_altitude_us: int | None = None
        self._pressure_pa = math.nan

    def vehicle_altitude(self, now_us: int) -> None:
        """The vehicle sent ALTITUDE itself."""
        self._vehicle_altitude_us = now_us

    def sample(self, kind: Kind, row: Rows, verdict: Verdict, estimate: Rows) -> None:
        """Follow a sample and its verdict."""
        value = row[0]
        if kind is Kind.PRESSURE:
            pressure_pa = float(value["pressure_pa"])
            if verdict is Verdict.USED and self.monotonic.update(
                self._boots, int(value["instance"]), int(value["time_us"]), pressure_pa
            ):
                self._pressure_pa = pressure_pa
        elif kind is Kind.HOME:
            home_m = float(value["altitude_amsl_m"])
            self._home_m = home_m if -1000.0 < home_m < 10_000.0 else self._home_m
        elif kind is Kind.STATUS:
            if value["armed"] == 1 and self._armed is False:
                is_fresh = abs(int(value["time_us"]) - int(estimate[0]["time_us"])) <= 2 * FRESH_US
                self._arming_m = float(estimate[0]["altitude_amsl_m"]) if is_fresh else math.nan
            if value["armed"] >= 0:
                self._armed = bool(value["armed"] == 1)
        elif kind is Kind.RANGE:
            if value["downward"] == 1:
                self._range = (int(value["time_us"]), float(value["distance_m"]))
        elif kind is Kind.ATTITUDE:
            cos_tilt = math.cos(value["roll_rad"]) * math.cos(value["pitch_rad"])
            self._cos_tilt = (int(value["time_us"]), cos_tilt if cos_tilt > 0.0 else math.nan)

    def altitude(self, now_us: int, health: Health, estimate: Rows) -> Message | None:
        """ALTITUDE, when one is due and may be sent."""
        altitude_m = float(estimate[0]["altitude_amsl_m"])
        time_us = int(estimate[0]["time_us"])
        if (
            health is Health.LOST
            or not math.isfinite(altitude_m)
            or self._leap.withholds(time_us, altitude_m)
        ):
            return None
        if math.isnan(self._local_origin_m):
            self._local_origin_m = altitude_m
        if self.settings.altitude == "never":
            return None
        heard_us = self._vehicle_altitude_us
        if (
            self.settings.altitude == "auto"
            and heard_us is not None
            and abs(now_us - heard_us) < VEHICLE_ALTITUDE_US
        ):
            return None
        if time_us < 0 or not self._altitude_slots.takes(time_us):
            return None
        reference_m = self._arming_m if math.isnan(self._home_m) else self._home_m
        clearance_m = self._clearance_m(now_us)
        return mavlink.MAVLink_altitude_message(
            time_us,
            self.monotonic.at(now_us),
            altitude_m,
            altitude_m - self._local_origin_m,
            altitude_m - reference_m,
            clearance_m,
            clearance_m,
        )

    def debug(self, now_us: int, health: Health, estimate: Rows, state: Rows) -> list[Message]:
        """The DEBUG family, when due: in LOST only the health."""
        if not self.settings.debug or now_us < 0 or not self._debug_slots.takes(now_us):
            return []
        boot_ms = now_us // 1000 & 0xFFFFFFFF
        messages: list[Message] = [_named(boot_ms, "klHealth", int(health))]
        if health is Health.LOST:
            return messages
        value = estimate[0]
        altitude_m, climb_mps = float(value["altitude_amsl_m"]), float(value["climb_mps"])
        sd_m = float(value["altitude_sd_m"])
        qnh_hpa = math.nan
        if math.isfinite(self.monotonic.at(now_us)) and math.isfinite(altitude_m):
            qnh_hpa = qnh_pa(self._pressure_pa, altitude_m) * 0.01
        messages += [
            _named(boot_ms, "klAltSd", sd_m),
            _named(boot_ms, "klClimb", climb_mps),
            _named(boot_ms, "klBaroOff", float(value["baro_offset_m"])),
            _named(boot_ms, "klQnhHpa", qnh_hpa),
            mavlink.MAVLink_debug_message(boot_ms, 0, sd_m),
            mavlink.MAVLink_debug_vect_message(
                b"kollsman", now_us, altitude_m, _single(climb_mps), sd_m
            ),
            mavlink.MAVLink_debug_float_array_message(now_us, b"klState", 0, state_floats(state)),
        ]
        return messages

    def status_text(self, health: Health, reason: str) -> list[Message]:
        """One line for a change of health."""
        if not self.settings.statustext:
            return []
        text = f"Kollsman {health.name}: {reason}".encode("ascii", "replace")[:STATUSTEXT_SIZE]
        return [mavlink.MAVLink_statustext_message(SEVERITY[health], text)]

    def _clearance_m(self, now_us: int) -> float:
        if self._range is None or abs(now_us - self._range[0]) > FRESH_US:
            return math.nan
        tilted = self._cos_tilt is not None and abs(now_us - self._cos_tilt[0]) <= FRESH_US
        return self._range[1] * (self._cos_tilt[1] if tilted and self._cos_tilt else 1.0)


def heartbeat(health: Health) -> Message:
    """Our own HEARTBEAT: an onboard controller, no autopilot; CRITICAL while the altitude is lost."""
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
        mavlink.MAV_AUTOPILOT_INVALID,
        0,
        0,
        SYSTEM_STATUS[health],
        3,
    )


def state_floats(state: Rows) -> list[float]:
    """The floats of an estimator's state in the order of its dtype, histories left out; 58 of them,
    zero-filled."""
    values = np.array(_floats(state))
    padded = np.zeros(FLOAT_ARRAY_SIZE)
    padded[: min(values.size, FLOAT_ARRAY_SIZE)] = values[:FLOAT_ARRAY_SIZE]
    return [_single(float(value)) for value in padded]


def _floats(state: Rows) -> list[float]:
    """Floats and short arrays of floats of a record, shape (1,), those of nested records in their
    place."""
    found: list[float] = []
    for name, (kind, *_) in (state.dtype.fields or {}).items():
        if kind.base.kind == "V":
            found += _floats(state[name])
        elif kind.base.kind == "f" and (not kind.shape or kind.shape[0] <= LONGEST_ARRAY):
            found += np.ravel(state[name][0]).tolist()
    return found


def _single(value: float) -> float:
    """A float that a message can hold: what is too large for single precision is infinite."""
    return (
        value
        if math.isnan(value) or abs(value) <= LARGEST_FLOAT
        else math.copysign(math.inf, value)
    )


def _named(boot_ms: int, name: str, value: float) -> Message:
    return mavlink.MAVLink_named_value_float_message(boot_ms, name.encode(), _single(value))
