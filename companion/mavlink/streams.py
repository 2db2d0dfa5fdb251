"""Asking the vehicle for the messages that the estimator needs.

Once a vehicle is latched, SET_MESSAGE_INTERVAL goes out once for each message, one at a time: the
next when the last was acknowledged, again when it was not. Nothing is written to the vehicle's
parameters, and a refusal is only logged.
"""

import logging
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass

from pydantic import Field

from companion.config import Settings
from companion.mavlink.codec import Message, mavlink
from companion.samples import Kind

logger = logging.getLogger("kollsman.streams")

ACK_TIMEOUT_US = 1_000_000
ATTEMPTS = 4
SET_MESSAGE_INTERVAL = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
RESULTS = {
    value.name[len("MAV_RESULT_") :]: key for key, value in mavlink.enums["MAV_RESULT"].items()
}


class StreamSettings(Settings):
    """Section ``streams``: rates to ask for; 0 asks for nothing."""

    request: bool = True
    """ask once with SET_MESSAGE_INTERVAL for what the estimator uses; nothing is saved in the
    vehicle"""
    pressure_hz: float = Field(20.0, ge=0, le=200)
    """SCALED_PRESSURE"""
    gnss_hz: float = Field(5.0, ge=0, le=50)
    """GPS_RAW_INT"""
    imu_hz: float = Field(50.0, ge=0, le=400)
    """RAW_IMU; HIGHRES_IMU from PX4"""
    attitude_hz: float = Field(10.0, ge=0, le=200)
    """ATTITUDE"""
    status_hz: float = Field(1.0, ge=0, le=10)
    """SYSTEM_TIME, HOME_POSITION, EXTENDED_SYS_STATE"""


@dataclass(frozen=True)
class Request:
    """One message at one rate."""

    message_id: int
    rate_hz: float

    @property
    def name(self) -> str:
        return str(mavlink.mavlink_map[self.message_id].msgname)


def wanted(settings: StreamSettings, uses: Collection[Kind], autopilot: int) -> list[Request]:
    """What to ask for: the kinds that the estimator uses, and what places and labels them."""
    imu_id = (
        mavlink.MAVLINK_MSG_ID_HIGHRES_IMU
        if autopilot == mavlink.MAV_AUTOPILOT_PX4
        else mavlink.MAVLINK_MSG_ID_RAW_IMU
    )
    table = [
        (Kind.PRESSURE, mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE, settings.pressure_hz),
        (Kind.GNSS, mavlink.MAVLINK_MSG_ID_GPS_RAW_INT, settings.gnss_hz),
        (Kind.IMU, imu_id, settings.imu_hz),
        (Kind.ATTITUDE, mavlink.MAVLINK_MSG_ID_ATTITUDE, settings.attitude_hz),
        (None, mavlink.MAVLINK_MSG_ID_SYSTEM_TIME, settings.status_hz),
        (None, mavlink.MAVLINK_MSG_ID_HOME_POSITION, settings.status_hz),
        (None, mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, settings.status_hz),
    ]
    return [
        Request(message_id, hz)
        for kind, message_id, hz in table
        if (kind is None or kind in uses) and hz > 0
    ]


class StreamRequester:
    """Sends the requests one at a time and reads the answers. Its clock is the host's."""

    def __init__(self, requests: list[Request], target: tuple[int, int]) -> None:
        self._queue = deque(requests)
        self._target = target
        self._attempts = 0
        self._due_us = 0
        self.granted: list[Request] = []
        self.refused: list[tuple[Request, str]] = []

    @property
    def done(self) -> bool:
        return not self._queue

    def poll(self, now_us: int) -> Message | None:
        """The message to send now, if any."""
        if not self._queue or now_us < self._due_us:
            return None
        if self._attempts == ATTEMPTS:
            self._refuse("no answer")
            return self.poll(now_us)
        request = self._queue[0]
        message = mavlink.MAVLink_command_long_message(
            *self._target,
            SET_MESSAGE_INTERVAL,
            self._attempts,
            request.message_id,
            1e6 / request.rate_hz,
            0,
            0,
            0,
            0,
            0,
        )
        self._attempts += 1
        self._due_us = now_us + ACK_TIMEOUT_US
        return message

    def acknowledge(self, message: Message) -> None:
        """COMMAND_ACK came; it does not say for which message, which is why we ask one at a time."""
        if message.command != SET_MESSAGE_INTERVAL or not self._queue or self._attempts == 0:
            return
        if message.result == mavlink.MAV_RESULT_ACCEPTED:
            self.granted.append(self._queue[0])
            self._next()
        elif message.result == mavlink.MAV_RESULT_TEMPORARILY_REJECTED:
            return  # ask again when the answer is overdue
        elif message.result != mavlink.MAV_RESULT_IN_PROGRESS:
            self._refuse(
                next(
                    (name for name, value in RESULTS.items() if value == message.result),
                    str(message.result),
                )
            )

    def _refuse(self, why: str) -> None:
        request = self._queue[0]
        logger.warning(
            "the vehicle does not grant %s at %g Hz: %s", request.name, request.rate_hz, why
        )
        self.refused.append((request, why))
        self._next()

    def _next(self) -> None:
        self._queue.popleft()
        self._attempts = 0
        self._due_us = 0
