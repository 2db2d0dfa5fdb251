"""Commands addressed to us: what we are and what we send is told on request, and what a ground
station set of the air is kept; everything else is refused.

No command changes the vehicle or the estimate.

============================== ================================================================
REQUEST_MESSAGE                AUTOPILOT_VERSION; MESSAGE_INTERVAL of a message of ours (param2);
                               each message of `ON_REQUEST`, as sent last; DENIED when none was
                               sent in the last two seconds: no old altitude goes out
REQUEST_AUTOPILOT_CAPABILITIES AUTOPILOT_VERSION
GET_MESSAGE_INTERVAL           MESSAGE_INTERVAL of a message of ours
PREFLIGHT_STORAGE              param1 1 keeps the parameters ``AIR_...`` for the next start, 2
                               forgets what is kept
============================== ================================================================
"""

import re
from collections.abc import Callable, Iterable, Sequence

from companion import __version__
from companion.mavlink.codec import Message, mavlink

REQUEST_MESSAGE = mavlink.MAV_CMD_REQUEST_MESSAGE
REQUEST_CAPABILITIES = mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES
GET_MESSAGE_INTERVAL = mavlink.MAV_CMD_GET_MESSAGE_INTERVAL
PREFLIGHT_STORAGE = mavlink.MAV_CMD_PREFLIGHT_STORAGE
AUTOPILOT_VERSION = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
MESSAGE_INTERVAL = mavlink.MAVLINK_MSG_ID_MESSAGE_INTERVAL
NAMED_VALUE_FLOAT = mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT
CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
ON_REQUEST = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_HEARTBEAT,
        mavlink.MAVLINK_MSG_ID_ALTITUDE,
        mavlink.MAVLINK_MSG_ID_DEBUG,
        mavlink.MAVLINK_MSG_ID_DEBUG_VECT,
        mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY,
        NAMED_VALUE_FLOAT,
    }
)
FRESH_US = 2_000_000
STORE, FORGET = 1, 2
ACCEPTED, DENIED, UNSUPPORTED, FAILED = (
    mavlink.MAV_RESULT_ACCEPTED,
    mavlink.MAV_RESULT_DENIED,
    mavlink.MAV_RESULT_UNSUPPORTED,
    mavlink.MAV_RESULT_FAILED,
)


class Commands:
    """Answers COMMAND_LONG and COMMAND_INT.

    Parameters
    ----------
    intervals : message id -> interval in microseconds, of what we send at a rate.
    """

    def __init__(self, intervals: dict[int, int]) -> None:
        self._intervals = intervals
        self._newest: dict[tuple[int, str], tuple[int, Message]] = {}
        self.store: Callable[[bool], bool] = lambda _: False
        """keeps the parameters (True) or forgets them (False); whether that worked"""

    def sent(self, messages: Iterable[Message], host_us: int) -> None:
        """Remember what was sent at `host_us`, the newest of each message and name."""
        for message in messages:
            number = message.id
            if number in ON_REQUEST:
                name = message.name if number == NAMED_VALUE_FLOAT else ""
                self._newest[number, str(name)] = (host_us, message)

    def answer(self, command: Message, asker: tuple[int, int], host_us: int) -> list[Message]:
        """COMMAND_ACK, and what was requested."""
        result, requested = self._obey(command, host_us)
        ack = mavlink.MAVLink_command_ack_message(command.command, result, 0, 0, *asker)
        return [ack, *requested]

    def _obey(self, command: Message, host_us: int) -> tuple[int, Sequence[Message]]:
        number = command.command
        if number == REQUEST_CAPABILITIES:
            return ACCEPTED, [autopilot_version()]
        if number == GET_MESSAGE_INTERVAL:
            return ACCEPTED, [self._interval(command.param1)]
        if number == PREFLIGHT_STORAGE and command.param1 in (STORE, FORGET):
            return (ACCEPTED if self.store(command.param1 == STORE) else FAILED), []
        if number != REQUEST_MESSAGE:
            return UNSUPPORTED, []
        if command.param1 == AUTOPILOT_VERSION:
            return ACCEPTED, [autopilot_version()]
        if command.param1 == MESSAGE_INTERVAL:
            return ACCEPTED, [self._interval(command.param2)]
        if command.param1 not in ON_REQUEST:
            return UNSUPPORTED, []
        newest = [
            message
            for (number, _), (sent_us, message) in self._newest.items()
            if number == command.param1 and abs(host_us - sent_us) <= FRESH_US
        ]
        return (ACCEPTED if newest else DENIED), newest

    def _interval(self, message_id: float) -> Message:
        """0 where the message is not available, as MAVLink has it."""
        number = int(message_id) if 0 <= message_id <= 0xFFFF else 0xFFFF
        return mavlink.MAVLink_message_interval_message(number, self._intervals.get(number, 0))


def autopilot_version() -> Message:
    """AUTOPILOT_VERSION: our version, and what of MAVLink we speak."""
    numbers = [int(part) for part in re.findall(r"\d+", __version__)[:3]]
    major, minor, patch = (*numbers, 0, 0, 0)[:3]
    software = major << 24 | minor << 16 | patch << 8
    nothing = [0] * 8
    return mavlink.MAVLink_autopilot_version_message(
        CAPABILITIES, software, software, 0, 0, nothing, nothing, nothing, 0, 0, 0
    )
