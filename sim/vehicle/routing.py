"""Forwarding of frames between links, by the rules of ArduPilot's MAVLink_routing (and of PX4 with
MAV_n_FORWARD).

A component is where it was heard from. A message without a target goes to every link from which
something has been heard, one with a target to the links of that target, and nothing back to where
it came from. A silent listener so gets nothing. A heartbeat is not sent to a link that brings the
same component's.
"""

from typing import Any

from companion.mavlink.codec import Frame, mavlink
from sim.vehicle.frames import COMPONENT_ID, SYSTEM_ID
from sim.vehicle.ports import Port

_HEARTBEAT: int = mavlink.MAVLINK_MSG_ID_HEARTBEAT
_OF_ONE_LINK = {mavlink.MAVLINK_MSG_ID_RADIO, mavlink.MAVLINK_MSG_ID_RADIO_STATUS}
"""messages in which a radio describes its own link"""


class Routing:
    """Remembers on which port each component was heard."""

    def __init__(self) -> None:
        self._routes: dict[tuple[int, int], list[Port]] = {}

    def onward(self, arrived: Port, frame: Frame, message: Any) -> list[Port]:
        """The ports to which `frame` is forwarded, once each."""
        source = (frame.system_id, frame.component_id)
        if frame.system_id == 0 or source == (SYSTEM_ID, COMPONENT_ID):
            return []
        heard_at = self._routes.setdefault(source, [])
        if arrived not in heard_at:
            heard_at.append(arrived)
        if frame.message_id in _OF_ONE_LINK:
            return []
        system_id: int = getattr(message, "target_system", 0)
        component_id: int = getattr(message, "target_component", 0)
        barred = [arrived, *heard_at] if frame.message_id == _HEARTBEAT else [arrived]
        found: list[Port] = []
        for (known_system, known_component), ports in self._routes.items():
            if system_id == 0 or (
                system_id == known_system and component_id in (0, known_component)
            ):
                found += [port for port in ports if port not in barred and port not in found]
        return found
