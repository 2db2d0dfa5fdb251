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

from enum import Enum
from typing import Any

from companion.health import Health
from companion.mavlink import altitude_steps as steps
from companion.mavlink.altitude_steps import ALTITUDE, NEVER_US, OUTPUT_PARAMS, OUTPUTS
from companion.mavlink.codec import Message, mavlink, numbers
from companion.mavlink.continuity import Leap, Monotonic
from companion.mavlink.debug import debug_messages, state_floats
from companion.mavlink.own_heights import OwnHeights, own_heights
from companion.mavlink.sections import PublishSettings
from companion.samples import Kind, Rows, Verdict, rows

MODES = {"never": steps.NEVER, "always": steps.ALWAYS, "auto": steps.AUTO}
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


SOURCES = (Source.NONE, Source.OURS, Source.VEHICLE)
"""by `altitude_steps.OF_NONE` and its neighbours"""
# Looked up in its class, a member of an enum costs ten times as much (Python 3.11).
_PRESSURE, _HOME, _STATUS, _RANGE, _ATTITUDE = (
    Kind.PRESSURE,
    Kind.HOME,
    Kind.STATUS,
    Kind.RANGE,
    Kind.ATTITUDE,
)
_STALE = Verdict.STALE


class Outputs:
    """Follows the samples, and makes the messages. What it remembers is in records, which compiled
    steps read and write (`companion.mavlink.altitude_steps`)."""

    def __init__(self, settings: PublishSettings) -> None:
        self.settings = settings
        self.monotonic = Monotonic()
        self.leap = Leap()
        self.state: Rows = rows(OUTPUTS)
        self.state["due_us"] = NEVER_US
        self.params: Rows = rows(OUTPUT_PARAMS)
        self.params["mode"] = MODES[settings.altitude]
        rates_hz = (settings.altitude_hz, settings.altitude_hz, settings.debug_hz)
        self.params["period_us"] = [round(1e6 / rate_hz) for rate_hz in rates_hz]
        self.heights: Rows = rows(ALTITUDE)
        self.restart()

    def restart(self) -> None:
        """The vehicle booted: home, arming point and local origin are void; the monotonic altitude
        goes on."""
        steps.restart(self.state)

    @property
    def source(self) -> Source:
        """Source of the last ALTITUDE."""
        return SOURCES[int(self.state["source"][0])]

    @property
    def own(self) -> OwnHeights | None:
        """The vehicle's own heights that were heard last; None before the first."""
        state = self.state[0]
        if state["own_us"] == NEVER_US:
            return None
        return OwnHeights(
            int(state["own_us"]), float(state["own_amsl_m"]), float(state["own_home_m"])
        )

    def vehicle_altitude(self, now_us: int) -> None:
        """The vehicle sent ALTITUDE itself; one alone may be forged."""
        steps.vehicle_altitude(self.state, now_us)

    def own_height(self, message: Message, now_us: int, health: Health) -> Message | None:
        """Take GLOBAL_POSITION_INT; ALTITUDE with these heights while ours cannot be sent."""
        state, out = self.state[0], self.heights
        state["own_us"], state["own_amsl_m"], state["own_home_m"] = own_heights(message)
        monotonic = self.monotonic.state
        if not steps.own_height(self.state, self.params, monotonic, now_us, int(health), out):
            return None
        return self.message()

    def last_height(self, now_us: int) -> Message | None:
        """ALTITUDE with the vehicle's own heights, for the end of a run; None when these are
        old."""
        own = self.own
        if own is None or abs(now_us - own.time_us) > steps.OWN_HEIGHT_US:
            return None
        if not steps.may_send(self.state, self.params, now_us):
            return None
        steps.of_vehicle(self.state, self.monotonic.state, now_us, self.heights)
        return self.message()

    def sample(self, kind: Kind, row: Rows, verdict: Verdict, estimate: Rows) -> None:
        """Follow a sample and its verdict."""
        if verdict is _STALE:
            return  # a late copy
        if kind is _PRESSURE:
            steps.follow_pressure(self.state, self.monotonic.state, row, int(verdict))
        elif kind is _HOME:
            steps.follow_home(self.state, row)
        elif kind is _STATUS:
            steps.follow_status(self.state, row, estimate)
        elif kind is _RANGE:
            steps.follow_range(self.state, row)
        elif kind is _ATTITUDE:
            steps.follow_attitude(self.state, row)

    def altitude(self, now_us: int, health: Health, estimate: Rows) -> Message | None:
        """ALTITUDE, when one is due and may be sent."""
        out, monotonic, leap = self.heights, self.monotonic.state, self.leap.state
        args = (monotonic, leap, now_us, int(health), estimate, out)
        if not steps.altitude(self.state, self.params, *args):
            return None
        return self.message()

    def message(self) -> Message:
        """ALTITUDE with the heights that the compiled rules left."""
        return altitude_message(self.heights[0].item())

    def is_debug_due(self, now_us: int) -> bool:
        """Whether the DEBUG family is due."""
        takes = self.settings.debug and now_us >= 0
        return takes and bool(steps.takes(self.state, self.params, steps.DEBUG_SLOT, now_us))

    def debug(self, now_us: int, health: Health, estimate: Rows, state: Rows) -> list[Message]:
        """The DEBUG family: in LOST only the health."""
        qnh_hpa = steps.qnh_hpa(self.state, self.monotonic.state, estimate, now_us)
        return debug_messages(now_us, health, estimate, state_floats(state), float(qnh_hpa))


_LAYOUT = numbers(mavlink.MAVLINK_MSG_ID_ALTITUDE)
assert _LAYOUT is not None
_make_altitude = _LAYOUT.make
"""of the fields in the order of the wire, which is that of the message"""


def altitude_message(heights: tuple[Any, ...]) -> Message:
    """The light message of the fields of an `ALTITUDE` record."""
    time_us, monotonic_m, amsl_m, local_m, relative_m, clearance_m = heights
    return _make_altitude(
        (time_us, monotonic_m, amsl_m, local_m, relative_m, clearance_m, clearance_m)
    )


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
