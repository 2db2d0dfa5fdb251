"""The link to a ground barometer (`air.reference`), beside the links of the vehicle.

Its frames never reach the vehicle's pipeline but for the pressure. Our heartbeat goes out every
second, as many senders speak only to who spoke, and SCALED_PRESSURE is requested while it does not
come. The link reconnects as any other.
"""

import logging
from collections.abc import Callable
from contextlib import ExitStack

from companion.clock import Clock
from companion.known_air import AirSettings
from companion.links import Link, open_link
from companion.mavlink.codec import Decoder, Encoder, Frame, Message, decode, mavlink
from companion.mavlink.identity import OUR_COMPONENT_ID, is_autopilot

logger = logging.getLogger("kollsman.air")

HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT
SCALED_PRESSURE = mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE
HEARTBEAT_US = 1_000_000
REQUEST_US, MISSED_US = 5_000_000, 3_000_000
INTERVAL_US = 500_000
MOST_READS = 32
"""datagrams of one turn, so that a flood does not delay the vehicle"""


def open_reference(air: AirSettings, stack: ExitStack, clock: Clock) -> "ReferenceLink | None":
    """The open link to the ground barometer, where the settings name one; `stack` closes it."""
    if air.reference is None:
        return None
    link = open_link(air.reference, clock)
    stack.callback(link.close)
    return ReferenceLink(link, air.reference_system_id)


class ReferenceLink:
    """Hears one sender of SCALED_PRESSURE.

    Parameters
    ----------
    link : open; the caller closes it.
    system_id : the sender; None: the first one heard.
    """

    def __init__(self, link: Link, system_id: int | None) -> None:
        self.link = link
        self.station: tuple[int, int] | None = None
        """system and component id of the sender"""
        self._system_id = system_id
        self._decoder = Decoder()
        self._encoder: tuple[int, Encoder] | None = None
        self._autopilot: tuple[int, int] | None = None
        self._beat_us = self._request_us = 0
        self._heard_us = -MISSED_US

    def poll(self, now_us: int, take: Callable[[Frame], None]) -> None:
        """Read what came, give the sender's pressures to `take`, and send what is due. `now_us` is
        the host's clock."""
        for _ in range(MOST_READS):
            data = self.link.receive(0.0)
            if not data:
                break
            frames = self._decoder.feed(data)
            if frames:
                self.link.trust()
            for frame in frames:
                self._hear(frame, now_us, take)
        if now_us >= self._beat_us:
            self._beat_us = now_us + HEARTBEAT_US
            self._send(
                mavlink.MAVLink_heartbeat_message(
                    mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
                    mavlink.MAV_AUTOPILOT_INVALID,
                    0,
                    0,
                    mavlink.MAV_STATE_ACTIVE,
                    3,
                )
            )
        target = self.station or self._autopilot
        is_missed = now_us - self._heard_us > MISSED_US
        if target is not None and is_missed and now_us >= self._request_us:
            self._request_us = now_us + REQUEST_US
            values = (SCALED_PRESSURE, INTERVAL_US, 0, 0, 0, 0, 0)
            command = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
            self._send(mavlink.MAVLink_command_long_message(*target, command, 0, *values))

    def _hear(self, frame: Frame, now_us: int, take: Callable[[Frame], None]) -> None:
        speaker = (frame.system_id, frame.component_id)
        if self._system_id not in (None, frame.system_id):
            return
        if frame.message_id == HEARTBEAT and self._autopilot is None:
            message = decode(frame)
            if message is not None and is_autopilot(message):
                self._autopilot = speaker
        if frame.message_id != SCALED_PRESSURE:
            return
        if self.station is None:
            self.station = speaker
            logger.info("reference barometer: %d/%d on %s", *speaker, self.link.url)
        if speaker == self.station:
            self._heard_us = now_us
            take(frame)

    def _send(self, message: Message) -> None:
        """Send as an onboard computer of the station's system."""
        ids = self.station or self._autopilot
        system_id = self._system_id or (ids[0] if ids is not None else 1)
        if self._encoder is None or self._encoder[0] != system_id:
            self._encoder = system_id, Encoder(system_id, OUR_COMPONENT_ID)
        self.link.send(self._encoder[1].encode(message))
