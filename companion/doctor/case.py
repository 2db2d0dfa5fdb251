"""What the rules of ``kollsman doctor`` look at, and what they find."""

from dataclasses import dataclass
from enum import IntEnum

from companion.hearing import Hearing, Speaker
from companion.mavlink.codec import Message, mavlink
from companion.mavlink.identity import is_autopilot
from companion.service import Service


class Grade(IntEnum):
    """How bad a finding is."""

    GOOD = 0
    NOTE = 1
    WRONG = 2


@dataclass(frozen=True)
class Finding:
    """One thing found: what it is, and what to do."""

    grade: Grade
    what: str
    cure: str = ""


@dataclass(frozen=True)
class Case:
    """What the rules look at."""

    hearing: Hearing
    service: Service
    vehicle: Speaker | None
    """the sender that is the vehicle, also where the service does not follow it"""
    host_us: int

    @property
    def is_px4(self) -> bool:
        beat = self.hearing.senders[self.vehicle].heartbeat if self.vehicle else None
        return beat is not None and beat.autopilot == mavlink.MAV_AUTOPILOT_PX4

    def rate_hz(self, *message_ids: int) -> float:
        """Rate of the fastest of these messages of the vehicle."""
        if self.vehicle is None:
            return 0.0
        return max(self.hearing.rate_hz(self.vehicle, number) for number in message_ids)

    def last(self, *message_ids: int) -> Message | None:
        """The newest of the first of these messages that was heard."""
        if self.vehicle is None:
            return None
        found = (self.hearing.last(self.vehicle, number) for number in message_ids)
        return next((message for message in found if message is not None), None)

    def either(self, ardupilot: str, px4: str) -> str:
        """Advice for the autopilot at hand."""
        return px4 if self.is_px4 else ardupilot


def autopilots(hearing: Hearing) -> list[Speaker]:
    """Who says that it is an autopilot, the one with most messages first."""
    found = [
        speaker
        for speaker, sender in hearing.senders.items()
        if sender.heartbeat is not None and is_autopilot(sender.heartbeat)
    ]
    return sorted(found, key=lambda speaker: -hearing.senders[speaker].frames)


def rates_advice(case: Case, group: str) -> str:
    return case.either(
        f"let Kollsman ask for it (streams.request), or set SRn_{group} of this port to 10 "
        "(n is the number of the MAVLink port, counted from 0)",
        "set MAV_n_MODE of this port to Onboard, or MAV_n_RATE higher",
    )
