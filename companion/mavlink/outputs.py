"""The messages to the vehicle and its ground stations: ALTITUDE, the DEBUG family, HEARTBEAT.

ALTITUDE replaces the altitude that QGroundControl shows the pilot. Once it has heard one, it
ignores GLOBAL_POSITION_INT, so that its display freezes when ALTITUDE stops. While our height may
not be sent, at the start and in LOST, ALTITUDE carries the vehicle's own height
(`Outputs.own_height`), equal to GLOBAL_POSITION_INT to the millimetre. The fields:

====================  ==============================================================================
altitude_monotonic    standard-atmosphere height above the first accepted pressure; joined without a
                      step across a reboot or a change of barometer; NaN without a barometer
altitude_amsl         the fused altitude, or the vehicle's own
altitude_local        altitude_amsl minus its value in the first ALTITUDE since boot
altitude_relative     the estimator's height above take-off; where it has none the vehicle's own
                      relative height, else altitude_amsl above HOME_POSITION, else above where
                      it was armed, else NaN
altitude_terrain,     from a fresh downward range finder, corrected for tilt, else NaN
bottom_clearance
time_usec             vehicle boot time of the estimate, or of the vehicle's own height
====================  ==============================================================================

`continuity` keeps steps and leaps out of these heights.
"""

import math
from enum import Enum

from companion.health import Health
from companion.kernels.atmosphere import qnh_pa
from companion.mavlink.codec import Message, mavlink
from companion.mavlink.continuity import Leap, Monotonic
from companion.mavlink.debug import debug_messages
from companion.mavlink.own_heights import OwnHeights, own_altitude, own_heights
from companion.mavlink.schedule import Schedule
from companion.mavlink.sections import PublishSettings
from companion.samples import Kind, Rows, Verdict

FRESH_US = 1_000_000
VEHICLE_ALTITUDE_US = 5_000_000
OWN_HEIGHT_US = 2_000_000
OURS_MISSING_US = 1_000_000
VEHICLE_ALTITUDES = 3
"""number of ALTITUDE of the vehicle within five seconds that shows that it sends them itself"""
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


class Source(Enum):
    """The source of the height in ALTITUDE."""

    NONE = "none"
    OURS = "ours"
    VEHICLE = "the vehicle's own"


class Outputs:
    """Follows the samples, and makes the messages."""

    def __init__(self, settings: PublishSettings) -> None:
        self.settings = settings
        self.monotonic = Monotonic()
        self.source = Source.NONE
        """source of the last ALTITUDE"""
        self._altitude_slots = Schedule(settings.altitude_hz)
        self._own_slots = Schedule(settings.altitude_hz)
        """slots of the vehicle's own heights, apart from those of ours, which must not wait for
        them"""
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
        self._vehicle_altitudes_us: list[int] = []
        self._own: OwnHeights | None = None
        self._ours_us: int | None = None
        self._pressure_pa = math.nan

    @property
    def own(self) -> OwnHeights | None:
        """The vehicle's own heights that were heard last; None before the first."""
        return self._own

    def vehicle_altitude(self, now_us: int) -> None:
        """The vehicle sent ALTITUDE itself; one alone may be forged."""
        recent = [us for us in self._vehicle_altitudes_us if abs(now_us - us) < VEHICLE_ALTITUDE_US]
        self._vehicle_altitudes_us = [*recent[1 - VEHICLE_ALTITUDES :], now_us]

    def own_height(self, message: Message, now_us: int, health: Health) -> Message | None:
        """Take GLOBAL_POSITION_INT; ALTITUDE with these heights while ours cannot be sent."""
        own = self._own = own_heights(message)
        ours_us = self._ours_us
        is_ours = ours_us is not None and abs(now_us - ours_us) < OURS_MISSING_US
        if (health is not Health.LOST and is_ours) or not self._may_send(now_us):
            return None
        if not self._own_slots.takes(own.time_us):
            return None
        return self._of_vehicle(own, now_us)

    def last_height(self, now_us: int) -> Message | None:
        """ALTITUDE with the vehicle's own heights, for the end of a run; None when these are
        old."""
        own = self._own
        if own is None or abs(now_us - own.time_us) > OWN_HEIGHT_US or not self._may_send(now_us):
            return None
        return self._of_vehicle(own, now_us)

    def _of_vehicle(self, own: OwnHeights, now_us: int) -> Message:
        self.source = Source.VEHICLE
        if math.isnan(self._local_origin_m):
            self._local_origin_m = own.altitude_amsl_m
        return own_altitude(
            own,
            self._local_origin_m,
            monotonic_m=self.monotonic.at(now_us),
            clearance_m=self._clearance_m(now_us),
        )

    def _may_send(self, now_us: int) -> bool:
        if self.settings.altitude != "auto":
            return self.settings.altitude == "always"
        heard_us = self._vehicle_altitudes_us
        enough = VEHICLE_ALTITUDES if self._ours_us is not None else 1
        return len(heard_us) < enough or abs(now_us - heard_us[-1]) >= VEHICLE_ALTITUDE_US

    def sample(self, kind: Kind, row: Rows, verdict: Verdict, estimate: Rows) -> None:
        """Follow a sample and its verdict."""
        value = row[0]
        if verdict is Verdict.STALE:
            return  # a late copy
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
        if time_us < 0 or not self._may_send(now_us) or not self._altitude_slots.takes(time_us):
            return None
        self.source, self._ours_us = Source.OURS, now_us
        clearance_m = self._clearance_m(now_us)
        return mavlink.MAVLink_altitude_message(
            time_us,
            self.monotonic.at(now_us),
            altitude_m,
            altitude_m - self._local_origin_m,
            self._relative_m(estimate, now_us),
            clearance_m,
            clearance_m,
        )

    def _relative_m(self, estimate: Rows, now_us: int) -> float:
        """Height above take-off, from the best source that is known."""
        height_m = float(estimate[0]["height_above_takeoff_m"])
        own = self._own
        if math.isfinite(height_m):
            return height_m
        if own is not None and abs(now_us - own.time_us) <= OWN_HEIGHT_US:
            return own.height_above_home_m
        reference_m = self._arming_m if math.isnan(self._home_m) else self._home_m
        return float(estimate[0]["altitude_amsl_m"]) - reference_m

    def debug(self, now_us: int, health: Health, estimate: Rows, state: Rows) -> list[Message]:
        """The DEBUG family, when due: in LOST only the health."""
        if not self.settings.debug or now_us < 0 or not self._debug_slots.takes(now_us):
            return []
        qnh_hpa = math.nan
        altitude_m = float(estimate[0]["altitude_amsl_m"])
        if math.isfinite(self.monotonic.at(now_us)) and math.isfinite(altitude_m):
            qnh_hpa = qnh_pa(self._pressure_pa, altitude_m) * 0.01
        return debug_messages(now_us, health, estimate, state, qnh_hpa)

    def _clearance_m(self, now_us: int) -> float:
        if self._range is None or abs(now_us - self._range[0]) > FRESH_US:
            return math.nan
        tilted = self._cos_tilt is not None and abs(now_us - self._cos_tilt[0]) <= FRESH_US
        return self._range[1] * (self._cos_tilt[1] if tilted and self._cos_tilt else 1.0)


def intervals(settings: PublishSettings) -> dict[int, int]:
    """Message id -> interval in microseconds of what is sent at a rate."""
    altitude_us, debug_us = (
        round(1e6 / settings.altitude_hz) if settings.altitude != "never" else 0,
        round(1e6 / settings.debug_hz) if settings.debug else 0,
    )
    debug = dict.fromkeys(
        (
            mavlink.MAVLINK_MSG_ID_DEBUG,
            mavlink.MAVLINK_MSG_ID_DEBUG_VECT,
            mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY,
            mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT,
        ),
        debug_us,
    )
    return {
        mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1_000_000,
        mavlink.MAVLINK_MSG_ID_ALTITUDE: altitude_us,
        **debug,
    }


def heartbeat(health: Health) -> Message:
    """Our own HEARTBEAT: an onboard controller, no autopilot; CRITICAL while the altitude is
    lost."""
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
        mavlink.MAV_AUTOPILOT_INVALID,
        0,
        0,
        SYSTEM_STATUS[health],
        3,
    )
