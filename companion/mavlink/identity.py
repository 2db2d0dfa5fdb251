"""Who speaks: the vehicle we are latched to, another program with our ids, or somebody else.

One vehicle is latched for the life of the process: the first component whose HEARTBEAT names a real
autopilot. Ground stations, gimbals, companions that call themselves quadrotors (autopilot INVALID)
and second vehicles are strangers: what they send is counted and never measured. Once the vehicle
has sent signed frames, unsigned ones with its ids are forged.
"""

import logging
from collections import Counter
from enum import StrEnum

from companion.mavlink.codec import Frame, Message, mavlink

logger = logging.getLogger("kollsman.identity")

OUR_COMPONENT_ID = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER  # 191
SIGNING_TIMEOUT_US = 10_000_000
"""After this long without a signed frame, the vehicle may have been set up anew without signing."""


class Origin(StrEnum):
    """Whose frame it is."""

    VEHICLE = "vehicle"
    OURSELVES = "our own ids"
    STRANGER = "other components"
    EARLY = "before the first heartbeat"
    FORGED = "unsigned in a signed stream"


class Identity:
    """The vehicle lock.

    Parameters
    ----------
    system_id : latch only this vehicle; None latches the first one heard.
    component_id : our own component id, on the vehicle's system id.
    """

    def __init__(self, system_id: int | None = None, component_id: int = OUR_COMPONENT_ID) -> None:
        self.component_id = component_id
        self.vehicle: tuple[int, int] | None = None
        self.autopilot = int(mavlink.MAV_AUTOPILOT_GENERIC)
        self.vehicle_type = int(mavlink.MAV_TYPE_GENERIC)
        self.version = 1
        """highest MAVLink version heard from the vehicle: we answer in it"""
        self.counters: Counter[Origin] = Counter()
        self.strangers: Counter[tuple[int, int]] = Counter()
        self._wanted = system_id
        self._signed_us: int | None = None

    def origin(self, frame: Frame, arrival_us: int) -> Origin:
        """Whose `frame` it is, counted."""
        origin = self._origin(frame, arrival_us)
        self.counters[origin] += 1
        return origin

    def _origin(self, frame: Frame, arrival_us: int) -> Origin:
        speaker = (frame.system_id, frame.component_id)
        if self.vehicle is None:
            return Origin.EARLY
        if speaker != self.vehicle:
            if speaker == (self.vehicle[0], self.component_id):
                return Origin.OURSELVES
            self.strangers[speaker] += 1
            return Origin.STRANGER
        if frame.signed:
            self._signed_us = arrival_us
        elif self._signed_us is not None and abs(arrival_us - self._signed_us) < SIGNING_TIMEOUT_US:
            return Origin.FORGED
        self.version = max(self.version, frame.version)
        return Origin.VEHICLE

    def offer(self, frame: Frame, heartbeat: Message) -> bool:
        """Latch the sender of a HEARTBEAT if none is latched and it is an autopilot; True when that
        happened now."""
        if (
            self.vehicle is not None
            or self._wanted not in (None, frame.system_id)
            or frame.system_id == 0
        ):
            return False
        if not is_autopilot(heartbeat):
            return False
        self.vehicle = (frame.system_id, frame.component_id)
        self.version = frame.version
        self.note(heartbeat)
        logger.info("vehicle %d/%d: autopilot %s", *self.vehicle, autopilot_name(self.autopilot))
        return True

    def note(self, heartbeat: Message) -> None:
        """Remember what the vehicle's HEARTBEAT says it is."""
        self.autopilot, self.vehicle_type = heartbeat.autopilot, heartbeat.type


def is_autopilot(heartbeat: Message) -> bool:
    """Whether a HEARTBEAT is of a vehicle's autopilot, not of a ground station or an accessory."""
    return bool(
        heartbeat.autopilot != mavlink.MAV_AUTOPILOT_INVALID
        and heartbeat.type != mavlink.MAV_TYPE_GCS
    )


def autopilot_name(autopilot: int) -> str:
    """A readable name of MAV_AUTOPILOT."""
    names = {mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: "ArduPilot", mavlink.MAV_AUTOPILOT_PX4: "PX4"}
    return names.get(autopilot, f"type {autopilot}")
