"""Answers to commands addressed to us: our version is sent, every other command is refused.

No command changes the vehicle or the estimate.
"""

import re

from companion import __version__
from companion.mavlink.codec import Message, mavlink

REQUEST_MESSAGE = mavlink.MAV_CMD_REQUEST_MESSAGE
REQUEST_CAPABILITIES = mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES
AUTOPILOT_VERSION = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)


def answers(command: Message, asker: tuple[int, int]) -> list[Message]:
    """COMMAND_ACK to COMMAND_LONG or COMMAND_INT, and the message that was asked for."""
    wanted = command.command == REQUEST_CAPABILITIES or (
        command.command == REQUEST_MESSAGE and command.param1 == AUTOPILOT_VERSION
    )
    result = mavlink.MAV_RESULT_ACCEPTED if wanted else mavlink.MAV_RESULT_UNSUPPORTED
    ack = mavlink.MAVLink_command_ack_message(command.command, result, 0, 0, *asker)
    return [ack, autopilot_version()] if wanted else [ack]


def autopilot_version() -> Message:
    """AUTOPILOT_VERSION: our version and our MAVLink capabilities."""
    numbers = [int(part) for part in re.findall(r"\d+", __version__)[:3]]
    major, minor, patch = (*numbers, 0, 0, 0)[:3]
    software = major << 24 | minor << 16 | patch << 8
    nothing = [0] * 8
    return mavlink.MAVLink_autopilot_version_message(
        CAPABILITIES, software, software, 0, 0, nothing, nothing, nothing, 0, 0, 0
    )
