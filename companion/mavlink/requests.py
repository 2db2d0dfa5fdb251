"""Commands and parameter requests of other programs: which are for us, and our answers."""

from companion.mavlink.codec import Message, mavlink
from companion.mavlink.commands import Commands
from companion.mavlink.parameters import Parameters
from companion.mavlink.texts import Allowance

COMMANDS = frozenset({mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT})
PARAMETER_REQUESTS = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST,
        mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
        mavlink.MAVLINK_MSG_ID_PARAM_SET,
    }
)
REQUESTS = COMMANDS | PARAMETER_REQUESTS
SET_MESSAGE_INTERVAL = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
ANSWERS_PER_S = 10


def asks_rate(message: Message, message_id: int) -> bool:
    """Whether a request sets the rate of one message."""
    return message_id in COMMANDS and bool(message.command == SET_MESSAGE_INTERVAL)


class Requests:
    """Answers what is addressed to us, at most `ANSWERS_PER_S` times a second.

    A parameter request may be addressed to everybody, a command may not: it is meant for the
    autopilot.
    """

    def __init__(self, parameters: Parameters, commands: Commands) -> None:
        self._parameters, self._commands = parameters, commands
        self._allowance = Allowance(ANSWERS_PER_S)

    def answer(
        self, message: Message, asker: tuple[int, int], own: tuple[int, int], arrival_us: int
    ) -> list[Message]:
        """The messages that answer a request of `asker`; `own` are our ids."""
        is_command = message.get_msgId() in COMMANDS
        everybody = () if is_command else (0,)
        target = (message.target_system, message.target_component)
        if not all(ask in (us, *everybody) for ask, us in zip(target, own, strict=True)):
            return []
        if not self._allowance.takes(arrival_us):
            return []
        if is_command:
            return self._commands.answer(message, asker, arrival_us)
        return self._parameters.answer(message)
