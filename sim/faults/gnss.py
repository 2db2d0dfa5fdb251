"""Faults of the first GNSS receiver (GPS_RAW_INT): outage, 2D fix, jamming, spoofing, sliding
fix."""

import math
from collections.abc import Iterable
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from companion.samples import FaultySensor, Packet
from sim.constants import EARTH_M_PER_DEG
from sim.faults.base import Edit, Effect, Fault, KeyedRandom, Metres, PacketContext
from sim.faults.editing import Editor
from sim.faults.values import GPS

_UNKNOWN_U16 = 65535
Rate = Annotated[float, Field(ge=-1000.0, le=1000.0)]
Span = Annotated[float, Field(gt=0.0, le=1e5)]


def _blind(message: Editor) -> None:
    """Set the fields to those of an autopilot without a fix."""
    for name in (
        "lat",
        "lon",
        "alt",
        "vel",
        "satellites_visible",
        "alt_ellipsoid",
        "h_acc",
        "v_acc",
        "vel_acc",
    ):
        message[name] = 0
    for name in ("eph", "epv", "cog"):
        message[name] = _UNKNOWN_U16
    message["fix_type"] = 1


def _move(message: Editor, north_m: float, east_m: float, up_m: float) -> None:
    message["lat"] = message["lat"] + north_m / EARTH_M_PER_DEG * 1e7
    shrink = math.cos(math.radians(message["lat"] * 1e-7))
    message["lon"] = message["lon"] + east_m / (EARTH_M_PER_DEG * shrink) * 1e7
    message["alt"] = message["alt"] + up_m * 1e3
    _add_known(message, "alt_ellipsoid", up_m * 1e3)


def _add_known(message: Editor, name: str, value: float) -> None:
    """Add `value` to an extension field, if it was sent."""
    if message[name] != 0:
        message[name] = message[name] + value


class ReceiverFault(Fault):
    """Parameters of all faults of the receiver."""

    @property
    def faulty_sensor(self) -> FaultySensor:
        return FaultySensor.GNSS


class Outage(ReceiverFault):
    """The receiver has no fix, or sends nothing."""

    announced: ClassVar[bool] = True

    fault: Literal["outage"] = "outage"
    silent: bool = False
    """whether the receiver sends nothing, instead of messages without a fix"""

    def effect(self, random: KeyedRandom) -> Effect:
        def change(message: Editor, _: PacketContext) -> bool | None:
            if self.silent:
                return False
            _blind(message)
            return None

        return Edit({GPS}, change)


class Jamming(ReceiverFault):
    """A jammer approaches and leaves: fewer satellites, noise, reported accuracy that grows with
    it, and no fix near its full strength."""

    announced: ClassVar[bool] = True

    fault: Literal["jamming"] = "jamming"
    duration_s: Span = 120.0
    """duration of the jamming"""
    ramp_s: Span = 30.0
    """time in which the jamming rises to full strength, and in which it falls"""
    noise_m: Annotated[float, Field(ge=0.0, le=10_000.0)] = 30.0
    """standard deviation of the height error just before the fix is lost; half of it
    horizontally"""
    blind_above: Annotated[float, Field(gt=0.0, le=1.0)] = 0.8
    """share of the full strength at which the fix is lost, 0 to 1"""

    def effect(self, random: KeyedRandom) -> Effect:
        def change(message: Editor, context: PacketContext) -> None:
            strength = max(
                0.0,
                min(
                    1.0,
                    context.since_s / self.ramp_s,
                    (self.duration_s - context.since_s) / self.ramp_s,
                ),
            )
            if strength > self.blind_above:
                _blind(message)
            if message["fix_type"] < 2:
                return
            sd_m = self.noise_m * strength / self.blind_above
            north, east, up = (random.normal(context.since_us, axis) * sd_m for axis in range(3))
            _move(message, 0.5 * north, 0.5 * east, up)
            if message["satellites_visible"] != 255:
                message["satellites_visible"] = max(
                    4, message["satellites_visible"] * (1.0 - strength)
                )
            for name in ("eph", "epv"):
                if message[name] != _UNKNOWN_U16:
                    message[name] = min(message[name] * (1.0 + 4.0 * strength), _UNKNOWN_U16 - 1)
            for name, share in (("h_acc", math.sqrt(0.5)), ("v_acc", 1.0)):
                if message[name] != 0:
                    message[name] = math.hypot(message[name], share * sd_m * 1e3)

        return Edit({GPS}, change)


class Spoofing(ReceiverFault):
    """The position drifts away slowly, while the reported accuracy does not change."""

    fault: Literal["spoofing"] = "spoofing"
    up_mps: Rate = 1.0
    """rate of the height error, positive upwards"""
    north_mps: Rate = 0.0
    """rate of the position error to the north"""
    east_mps: Rate = 0.0
    """rate of the position error to the east"""
    limit_s: Span = 300.0
    """time after which the error stays constant"""

    def effect(self, random: KeyedRandom) -> Effect:
        def change(message: Editor, context: PacketContext) -> None:
            if message["fix_type"] < 2:
                return
            led_s = min(context.since_s, self.limit_s)
            _move(message, self.north_mps * led_s, self.east_mps * led_s, self.up_mps * led_s)
            if context.since_s < self.limit_s and message["vel"] != _UNKNOWN_U16 != message["cog"]:
                course = math.radians(message["cog"] * 0.01)
                north = message["vel"] * 0.01 * math.cos(course) + self.north_mps
                east = message["vel"] * 0.01 * math.sin(course) + self.east_mps
                message["vel"] = math.hypot(north, east) * 100.0
                message["cog"] = (
                    round(math.degrees(math.atan2(east, north)) % 360.0 * 100.0) % 36000
                )

        return Edit({GPS}, change)


class TwoDimensional(ReceiverFault):
    """Three satellites are left: a 2D fix (type 2) with the height of the last 3D fix."""

    announced: ClassVar[bool] = True

    fault: Literal["two_dimensional"] = "two_dimensional"

    def effect(self, random: KeyedRandom) -> Effect:
        return _TwoDimensional()


class _TwoDimensional(Effect):
    ids = frozenset({GPS})
    _HELD = ("alt", "alt_ellipsoid")

    def __init__(self) -> None:
        self._held: dict[str, float] = {}

    def feed(self, packet: Packet, context: PacketContext) -> Iterable[Packet]:
        message = Editor(packet.data, context.message_id)
        if not context.active or not self._held:
            self._held = (
                {name: message[name] for name in self._HELD}
                if message["fix_type"] >= 3
                else self._held
            )
        if not context.active or message["fix_type"] < 3:
            return (packet,)
        message["fix_type"], message["satellites_visible"] = 2, 3
        for name, value in self._held.items():
            message[name] = value
        return (Packet(packet.time_us, message.close()),)


class Slide(ReceiverFault):
    """A 3D fix has an error of hundreds of metres that decreases to zero; its reported accuracy
    shows the error."""

    announced: ClassVar[bool] = True

    fault: Literal["slide"] = "slide"
    duration_s: Span = 60.0
    """time in which the error decreases to zero"""
    height_m: Metres = 770.0
    """height error at the start; a real receiver on the ground reported 1149 m, then 376 m"""

    def effect(self, random: KeyedRandom) -> Effect:
        def change(message: Editor, context: PacketContext) -> None:
            if message["fix_type"] < 3:
                return
            offset_m = self.height_m * (1.0 - context.since_s / self.duration_s)
            _move(message, 0.0, 0.0, offset_m)
            for name, share in (("h_acc", 1.0), ("v_acc", 3.0)):
                _add_known(message, name, share * abs(offset_m) * 1e3)

        return Edit({GPS}, change)
