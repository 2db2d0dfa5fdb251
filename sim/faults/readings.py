"""Faults that repeat earlier readings: frozen and lagging sensors."""

from collections import deque
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from companion.samples import FaultySensor, Packet
from sim.faults.base import Effect, Fault, KeyedRandom, PacketContext
from sim.faults.editing import Editor
from sim.faults.values import SENSORS


class Freeze(Fault):
    """A sensor repeats its last reading under new time stamps."""

    fault: Literal["freeze"] = "freeze"
    sensor: Literal["barometer", "gnss", "imu"] = "barometer"
    """sensor whose readings are changed"""

    @property
    def faulty_sensor(self) -> FaultySensor:
        return FaultySensor[self.sensor.upper()]

    def effect(self, random: KeyedRandom) -> Effect:
        return _Freeze(SENSORS[self.sensor])


class _Freeze(Effect):
    def __init__(self, fields: Mapping[int, tuple[str, ...]]) -> None:
        self.ids = frozenset(fields)
        self._fields = fields
        self._last: dict[int, dict[str, Any]] = {}

    def feed(self, packet: Packet, context: PacketContext) -> Iterable[Packet]:
        message = Editor(packet.data, context.message_id)
        names = self._fields[context.message_id]
        if not context.active or context.message_id not in self._last:
            self._last[context.message_id] = {name: message[name] for name in names}
            return (packet,)
        for name, value in self._last[context.message_id].items():
            message[name] = value
        return (Packet(packet.time_us, message.close()),)


class Lag(Fault):
    """A sensor's readings are old, under present time stamps."""

    fault: Literal["lag"] = "lag"
    sensor: Literal["barometer", "gnss", "imu"] = "barometer"
    """sensor whose readings are changed"""
    lag_s: Annotated[float, Field(gt=0.0, le=60.0)] = 0.15
    """age of the readings"""

    @property
    def faulty_sensor(self) -> FaultySensor:
        return FaultySensor[self.sensor.upper()]

    def effect(self, random: KeyedRandom) -> Effect:
        return _Lag(SENSORS[self.sensor], round(self.lag_s * 1e6))


class _Lag(Effect):
    def __init__(self, fields: Mapping[int, tuple[str, ...]], lag_us: int) -> None:
        self.ids = frozenset(fields)
        self._fields, self._lag_us = fields, lag_us
        self._readings: dict[int, deque[tuple[int, dict[str, Any]]]] = {
            each: deque() for each in fields
        }

    def feed(self, packet: Packet, context: PacketContext) -> Iterable[Packet]:
        message, readings = (
            Editor(packet.data, context.message_id),
            self._readings[context.message_id],
        )
        readings.append(
            (context.since_us, {name: message[name] for name in self._fields[context.message_id]})
        )
        while len(readings) > 1 and readings[1][0] <= context.since_us - self._lag_us:
            readings.popleft()
        if not context.active:
            return (packet,)
        for name, value in readings[0][1].items():
            message[name] = value
        return (Packet(packet.time_us, message.close()),)
