"""Sections ``vehicle``, ``identity`` and ``publish`` of the configuration.

They are known before the estimators are loaded (`companion.interim`), so nothing heavy is imported.
"""

from typing import Literal

from pydantic import Field

from companion.config import Settings
from companion.mavlink.identity import AUTOPILOT_COMPONENT_ID, OUR_COMPONENT_ID, Identity


class VehicleSettings(Settings):
    """Section ``vehicle``."""

    system_id: int | None = Field(None, ge=0, le=255)
    """MAVLink system id of the vehicle to follow; default: the first autopilot heard"""
    component_id: int = Field(AUTOPILOT_COMPONENT_ID, ge=0, le=255)
    """MAVLink component id of the vehicle's autopilot"""


class IdentitySettings(Settings):
    """Section ``identity``: who we are on the link."""

    system_id: int | None = Field(None, ge=1, le=255)
    """our MAVLink system id; default: the vehicle's"""
    component_id: int = Field(OUR_COMPONENT_ID, ge=1, le=255)
    """our MAVLink component id"""
    on_conflict: Literal["next", "warn"] = "next"
    """what is done when another program on the link uses our ids: next takes the next free
    component id of 191 to 194, warn keeps ours; both are reported in one line"""


def identity_of(
    vehicle: VehicleSettings, own: IdentitySettings, other_system_id: int | None
) -> Identity:
    """The identification by these sections; `other_system_id` is never the vehicle."""
    return Identity(
        vehicle.system_id,
        own.component_id,
        vehicle_component_id=vehicle.component_id,
        own_system_id=own.system_id,
        other_system_id=other_system_id,
    )


class PublishSettings(Settings):
    """Section ``publish``."""

    altitude: Literal["auto", "always", "never"] = "auto"
    """whether ALTITUDE is sent; auto: not while the vehicle sends it itself; never: the ground
    station goes on showing the autopilot's own height"""
    altitude_hz: float = Field(10.0, ge=0.1, le=100)
    """rate of ALTITUDE in vehicle time; a message goes out with the first update after its slot
    falls due"""
    debug: bool = True
    """whether DEBUG, DEBUG_VECT, NAMED_VALUE_FLOAT and DEBUG_FLOAT_ARRAY are sent"""
    debug_hz: float = Field(1.0, ge=0.1, le=50)
    """rate of each message of the DEBUG family"""
    statustext: bool = True
    """whether STATUSTEXT tells changes of health, at most one text of a kind in five seconds"""
