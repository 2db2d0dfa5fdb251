"""Identification: which sender is the vehicle, which is another program with our ids, and which are
foreign.

The vehicle is an autopilot by the type **and** the component of its HEARTBEAT: ground stations,
cameras, gimbals, antenna trackers, radios and companions are never it, whatever autopilot they
name. The first one heard is followed at once. Two of them within three seconds, or before either
has sent sensor data, are refused with a line that names both. From then on one vehicle is followed
for the life of the process; a single stray heartbeat before it does not count.

Frames with the vehicle's ids are accepted from the network address that it sends from, until that
one has been silent for three seconds. Once the vehicle has sent signed frames, unsigned ones are
forged.
"""

import logging
from collections import Counter
from collections.abc import Hashable
from enum import StrEnum

from companion.mavlink.codec import Frame, Message, mavlink
from companion.samples import Kind

logger = logging.getLogger("kollsman.identity")

OUR_COMPONENT_ID = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER  # 191
OUR_COMPONENT_IDS = range(191, 195)
AUTOPILOT_COMPONENT_ID = mavlink.MAV_COMP_ID_AUTOPILOT1  # 1
RADIO_COMPONENT_ID = mavlink.MAV_COMP_ID_TELEMETRY_RADIO  # 68
SIGNING_TIMEOUT_US = 10_000_000
"""time without a signed frame after which the vehicle may have been set up without signing"""
SETTLE_US = 3_000_000
CONFIRM_US = 500_000
GONE_US = 10_000_000
SOURCE_US = 3_000_000
HEIGHTS = (Kind.PRESSURE, Kind.GNSS)
"""kinds of samples that tell more of a vehicle than heartbeats"""
CHANGES = 3
"""heartbeats in a row that name another autopilot before it is accepted"""
MOST_REMEMBERED = 64
MOST_NOTES = 20
MOST_NAMED = 4

VEHICLE_TYPES = frozenset(
    getattr(mavlink, f"MAV_TYPE_{name}")
    for name in (
        *("GENERIC", "FIXED_WING", "QUADROTOR", "COAXIAL", "HELICOPTER", "AIRSHIP"),
        *("FREE_BALLOON", "ROCKET", "GROUND_ROVER", "SURFACE_BOAT", "SUBMARINE", "HEXAROTOR"),
        *("OCTOROTOR", "TRICOPTER", "FLAPPING_WING", "KITE", "VTOL_DUOROTOR", "VTOL_QUADROTOR"),
        *("VTOL_TILTROTOR", "VTOL_RESERVED2", "VTOL_RESERVED3", "VTOL_RESERVED4"),
        *("VTOL_RESERVED5", "VTOL_GYRODYNE", "PARAFOIL", "DODECAROTOR", "DECAROTOR"),
        *("GENERIC_MULTIROTOR", "SPACECRAFT_ORBITER", "GROUND_QUADRUPED"),
    )
)


class Origin(StrEnum):
    """The sender of a frame."""

    __hash__ = str.__hash__  # an enum's own is Python code, and one is hashed for each frame

    VEHICLE = "vehicle"
    OURSELVES = "our own ids"
    STRANGER = "other components"
    EARLY = "before the first heartbeat"
    FORGED = "unsigned in a signed stream"
    ELSEWHERE = "vehicle's ids from another address"


# Looked up in its class, a member of an enum costs ten times as much (Python 3.11).
VEHICLE, OURSELVES = Origin.VEHICLE, Origin.OURSELVES


class _Autopilot:
    """A sender of autopilot heartbeats."""

    def __init__(self, arrival_us: int) -> None:
        self.first_us = self.last_us = arrival_us
        self.told = False

    @property
    def confirmed(self) -> bool:
        """Whether it sent more than one stray heartbeat."""
        return self.last_us - self.first_us >= CONFIRM_US


class Identity:
    """Which sender is the vehicle.

    Parameters
    ----------
    system_id : follow only this vehicle; None follows the first one heard.
    component_id : our own component id.
    vehicle_component_id : the component of the vehicle's autopilot.
    own_system_id : our own system id; None takes the vehicle's.
    other_system_id : a system that is never the vehicle: the ground barometer.
    """

    def __init__(
        self,
        system_id: int | None = None,
        component_id: int = OUR_COMPONENT_ID,
        *,
        vehicle_component_id: int = AUTOPILOT_COMPONENT_ID,
        own_system_id: int | None = None,
        other_system_id: int | None = None,
    ) -> None:
        self.component_id = component_id
        self.vehicle: tuple[int, int] | None = None
        self.autopilot = int(mavlink.MAV_AUTOPILOT_GENERIC)
        self.vehicle_type = int(mavlink.MAV_TYPE_GENERIC)
        self.version = 1
        """highest MAVLink version heard from the vehicle: we answer in it"""
        self.counters: Counter[Origin] = Counter()
        self.strangers: Counter[tuple[int, int]] = Counter()
        self.stations: dict[tuple[int, int], int] = {}
        """ground stations, and when each was last heard"""
        self.notes: list[str] = []
        """notices about senders for the user, in the order of their detection"""
        self.refusal = ""
        """why no vehicle is followed; empty while one is, or none was heard"""
        self._strangers_us: dict[tuple[int, int], int] = {}
        """when each other sender was last heard"""
        self._wanted, self._wanted_component = system_id, vehicle_component_id
        self._own_system_id, self._other_system_id = own_system_id, other_system_id
        self._autopilots: dict[tuple[int, int], _Autopilot] = {}
        self._latched_us = 0
        self._firm = False
        self._changes = 0
        self.signed_us: int | None = None
        """when the vehicle's last signed frame arrived"""
        self._source: Hashable = None
        self._source_us = 0

    @property
    def spoken(self) -> int:
        """The MAVLink version that we send: an autopilot that can speak 2 may wait for it."""
        return self.version if self.vehicle is not None else 2

    @property
    def own(self) -> tuple[int, int]:
        """Our system and component id: the vehicle's system unless configured; 1 before one is
        known."""
        system_id = self._own_system_id or (self.vehicle or (self._wanted or 0, 0))[0]
        return system_id or 1, self.component_id

    def origin(self, frame: Frame, arrival_us: int, source: Hashable = None) -> Origin:
        """The origin of `frame`, which is counted. `source` is its network address."""
        origin = self._origin(frame, arrival_us, source)
        self.counters[origin] += 1
        return origin

    def _origin(self, frame: Frame, arrival_us: int, source: Hashable) -> Origin:
        speaker, vehicle = (frame.system_id, frame.component_id), self.vehicle
        if speaker != vehicle and speaker == self.own:
            return OURSELVES
        if vehicle is None:
            return Origin.EARLY
        if speaker != vehicle:
            self._note_stranger(speaker, arrival_us)
            return Origin.STRANGER
        if frame.signed:
            self.signed_us = arrival_us
        elif self.signed_us is not None and abs(arrival_us - self.signed_us) < SIGNING_TIMEOUT_US:
            return Origin.FORGED
        if source != self._source:
            if 0 <= arrival_us - self._source_us < SOURCE_US:
                return Origin.ELSEWHERE
            self._source = source
        self._source_us = arrival_us
        self.version = max(self.version, frame.version)
        return VEHICLE

    def _note_stranger(self, speaker: tuple[int, int], arrival_us: int) -> None:
        if speaker in self.strangers or len(self.strangers) < MOST_REMEMBERED:
            self.strangers[speaker] += 1
            self._strangers_us[speaker] = arrival_us

    def took(
        self, count: int, version: int, arrival_us: int, signed_us: int | None, *, told_again: bool
    ) -> None:
        """Count frames of the vehicle, from where it was heard before; `told_again` is whether a
        HEARTBEAT among them says again what the vehicle is."""
        self.counters[Origin.VEHICLE] += count
        self._source_us, self.version = arrival_us, max(self.version, version)
        self.signed_us = self.signed_us if signed_us is None else signed_us
        if told_again:
            self._changes = 0

    def stranger(self, speaker: tuple[int, int], arrival_us: int) -> None:
        """Count a frame of another sender."""
        self.counters[Origin.STRANGER] += 1
        self._note_stranger(speaker, arrival_us)

    def station(self, speaker: tuple[int, int], arrival_us: int) -> None:
        """A HEARTBEAT of a ground station."""
        if speaker in self.stations or len(self.stations) < MOST_REMEMBERED:
            self.stations[speaker] = arrival_us

    def heartbeat(
        self, frame: Frame, message: Message, arrival_us: int, source: Hashable = None
    ) -> bool:
        """Handle a HEARTBEAT of another sender than the vehicle; True when another vehicle is
        followed now, or none."""
        speaker = (frame.system_id, frame.component_id)
        if message.type == mavlink.MAV_TYPE_GCS:
            self.station(speaker, arrival_us)
            return False
        if not is_autopilot(message) or frame.system_id == self._other_system_id:
            return False
        heard = self._autopilots.get(speaker)
        if heard is None:
            if len(self._autopilots) >= MOST_REMEMBERED:
                return False
            heard = self._autopilots[speaker] = _Autopilot(arrival_us)
        heard.last_us = arrival_us
        if not self._may_be_followed(speaker):
            self._tell_unfit(speaker, heard, message)
            return False
        before = self.vehicle
        if self.vehicle is None:
            self._consider(speaker, frame, message, arrival_us, source)
        elif speaker != self.vehicle:
            self._compete(speaker, frame, message, arrival_us, source)
        return self.vehicle != before

    def resume(self, earlier: "Identity", arrival_us: int) -> None:
        """Follow the vehicle that `earlier` followed, without waiting for its heartbeat."""
        if earlier.vehicle is None:
            return
        self.vehicle, self.component_id = earlier.vehicle, earlier.component_id
        self.autopilot, self.vehicle_type = earlier.autopilot, earlier.vehicle_type
        self.version, self._source = earlier.version, earlier.source
        self._latched_us = self._source_us = arrival_us
        self._autopilots[earlier.vehicle] = _Autopilot(arrival_us)

    def note(self, heartbeat: Message) -> None:
        """Remember what the vehicle's HEARTBEAT says it is: another autopilot must be named by
        three in a row."""
        if heartbeat.autopilot != self.autopilot:
            self._changes += 1
            if self._changes < CHANGES:
                return
        self._changes = 0
        self.autopilot, self.vehicle_type = heartbeat.autopilot, heartbeat.type

    def measured(self, kind: Kind) -> None:
        """A sample of the vehicle came: with a height it is more than heartbeats."""
        self._firm = self._firm or kind in HEIGHTS

    def others(self, since_us: int) -> list[str]:
        """The senders besides the vehicle that were heard after `since_us`; a few of them are
        named."""
        heard = [
            f"{self._role(ids)}{_ids(ids)}"
            for ids, last_us in self._strangers_us.items()
            if ids != self.vehicle and last_us > since_us
        ]
        more = len(heard) - MOST_NAMED
        return heard if more <= 0 else [*heard[:MOST_NAMED], f"{more} more"]

    def _role(self, speaker: tuple[int, int]) -> str:
        if speaker in self._autopilots:
            return "autopilot "
        return "radio " if speaker[1] == RADIO_COMPONENT_ID else ""

    def yield_ids(self, may_move: bool) -> str:
        """Another program uses our ids: take the next free component id where we may. A line that
        says what was done."""
        system_id, component_id = self.own
        free = [
            number
            for number in OUR_COMPONENT_IDS
            if number != component_id and (system_id, number) not in self.strangers
        ]
        text = f"another program uses {system_id}/{component_id}"
        if may_move and free:
            self.component_id = free[0]
            text += f", we are {system_id}/{free[0]} now"
        if text not in self.notes:
            self.tell(text)
        return text

    @property
    def source(self) -> Hashable:
        """The network address of the vehicle, on a link with several peers."""
        return self._source

    def tell(self, text: str) -> None:
        """Log a line about a sender, and keep it for the report."""
        logger.warning("%s", text)
        if len(self.notes) < MOST_NOTES:
            self.notes.append(text)

    def _may_be_followed(self, speaker: tuple[int, int]) -> bool:
        system_id, component_id = speaker
        is_wanted = system_id == self._wanted if self._wanted is not None else system_id != 0
        return is_wanted and component_id == self._wanted_component

    def _consider(
        self,
        speaker: tuple[int, int],
        frame: Frame,
        message: Message,
        arrival_us: int,
        source: Hashable,
    ) -> None:
        """No vehicle is followed: follow this one, unless two were refused and both still send."""
        if self.refusal and len(self._present(arrival_us)) > 1:
            return
        self._latch(speaker, frame, message, arrival_us, source)

    def _compete(
        self,
        speaker: tuple[int, int],
        frame: Frame,
        message: Message,
        arrival_us: int,
        source: Hashable,
    ) -> None:
        """Another autopilot beside the vehicle."""
        assert self.vehicle is not None
        rival, followed = self._autopilots[speaker], self._autopilots[self.vehicle]
        if self._firm and arrival_us - self._latched_us > SETTLE_US:
            if not rival.told and rival.confirmed:
                rival.told = True
                self.tell(
                    f"another autopilot {_ids(speaker)} ({autopilot_name(message.autopilot)}) is "
                    f"heard beside {_ids(self.vehicle)}: not used; vehicle.system_id chooses"
                )
            return
        if not rival.confirmed:
            return
        is_gone = arrival_us - followed.last_us > GONE_US
        if not self._firm and (is_gone or not followed.confirmed):
            if is_gone or arrival_us - self._latched_us > SETTLE_US:
                self._latch(speaker, frame, message, arrival_us, source)
            return
        self.refusal = (
            f"two autopilots, {_ids(self.vehicle)} and {_ids(speaker)}: choose one with "
            "vehicle.system_id"
        )
        self.vehicle = None
        self.tell(self.refusal)

    def _present(self, arrival_us: int) -> list[tuple[int, int]]:
        """The autopilots that may be followed and were heard lately."""
        return [
            ids
            for ids, heard in self._autopilots.items()
            if self._may_be_followed(ids)
            and heard.confirmed
            and arrival_us - heard.last_us < GONE_US
        ]

    def _latch(
        self,
        speaker: tuple[int, int],
        frame: Frame,
        message: Message,
        arrival_us: int,
        source: Hashable,
    ) -> None:
        self.vehicle, self.refusal = speaker, ""
        self.autopilot, self.vehicle_type = message.autopilot, message.type
        self.version = frame.version
        self._latched_us = self._source_us = arrival_us
        self._source, self._firm, self._changes = source, False, 0
        self.signed_us = None
        logger.info("vehicle %s: autopilot %s", _ids(speaker), autopilot_name(self.autopilot))

    def _tell_unfit(self, speaker: tuple[int, int], heard: _Autopilot, message: Message) -> None:
        """One line about an autopilot with ids that are not followed unless configured."""
        lasts = heard.last_us - heard.first_us >= SETTLE_US
        is_another = self._wanted is not None and speaker[0] != self._wanted
        if heard.told or not lasts or is_another or self.vehicle is not None:
            return
        heard.told = True
        keys = f"vehicle.system_id: {speaker[0]} and vehicle.component_id: {speaker[1]}"
        self.tell(
            f"an autopilot with system id {speaker[0]}/{speaker[1]} is heard "
            f"({autopilot_name(message.autopilot)}): to follow it, set {keys}"
        )


def is_autopilot(heartbeat: Message) -> bool:
    """Whether a HEARTBEAT is of a vehicle's autopilot, not of a ground station or an accessory."""
    return bool(
        heartbeat.autopilot != mavlink.MAV_AUTOPILOT_INVALID and heartbeat.type in VEHICLE_TYPES
    )


def autopilot_name(autopilot: int) -> str:
    """A readable name of MAV_AUTOPILOT."""
    names = {mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: "ArduPilot", mavlink.MAV_AUTOPILOT_PX4: "PX4"}
    return names.get(autopilot, f"type {autopilot}")


def _ids(speaker: tuple[int, int]) -> str:
    return f"{speaker[0]}/{speaker[1]}"
