"""Faults of a sensor's values: steps, ramps, swings, spikes, noise, wrong units, a blocked static
port.

They change the vehicle's first sensor of a kind (SCALED_PRESSURE, GPS_RAW_INT, RAW_IMU, SCALED_IMU,
HIGHRES_IMU). A second sensor and the autopilot's own estimate stay correct.
"""

import math
from collections.abc import Iterable, Mapping
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field

from companion.mavlink.codec import mavlink
from companion.samples import FaultySensor, Packet
from sim.constants import G0_MPS2
from sim.faults.base import Edit, Effect, Fault, KeyedRandom, PacketContext, Probability
from sim.faults.editing import Editor

PRESSURE: int = mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE
GPS: int = mavlink.MAVLINK_MSG_ID_GPS_RAW_INT
RAW_IMU: int = mavlink.MAVLINK_MSG_ID_RAW_IMU
SCALED_IMU: int = mavlink.MAVLINK_MSG_ID_SCALED_IMU
HIGHRES_IMU: int = mavlink.MAVLINK_MSG_ID_HIGHRES_IMU

_AXES = "xyz"
_MG = 1e-3 * G0_MPS2
_P0_PA, _T0_K, _LAPSE_KPM = 101_325.0, 288.15, 6.5e-3
_TROPOSPHERE = 287.05287 * _LAPSE_KPM / G0_MPS2
"""exponent x of T / T_0 = (p / p_0)^x in the standard atmosphere below 11 km"""


class Quantity(NamedTuple):
    """A physical quantity: its unit, and the fields that contain it with the size of one count."""

    unit: str
    fields: Mapping[int, tuple[tuple[str, float], ...]]

    def shift(self, message: Editor, by: float) -> None:
        for name, size in self.fields[message.message_id]:
            if _holds(message, name):
                message[name] = message[name] + by / size

    def scale(self, message: Editor, factor: float) -> None:
        for name, _ in self.fields[message.message_id]:
            if _holds(message, name):
                message[name] = message[name] * factor


class PressureAltitude(Quantity):
    """Pressure as metres of the standard atmosphere's troposphere; a greater height is a lower
    pressure."""

    def shift(self, message: Editor, by: float) -> None:
        for name, size in self.fields[message.message_id]:
            ratio = (
                max(0.0, message[name] * size / _P0_PA) ** _TROPOSPHERE - by * _LAPSE_KPM / _T0_K
            )
            message[name] = _P0_PA * max(0.0, ratio) ** (1.0 / _TROPOSPHERE) / size


def _inertial(kind: str, axis: str, milli: float) -> Quantity:
    fields = dict.fromkeys((RAW_IMU, SCALED_IMU), ((f"{axis}{kind}", milli),))
    return Quantity(
        "m/s2" if kind == "acc" else "rad/s", {**fields, HIGHRES_IMU: ((f"{axis}{kind}", 1.0),)}
    )


_PRESSURES = {PRESSURE: (("press_abs", 100.0),), HIGHRES_IMU: (("abs_pressure", 100.0),)}
QUANTITIES: Mapping[str, Quantity] = {
    "pressure": Quantity("Pa", _PRESSURES),
    "pressure_altitude": PressureAltitude("m", _PRESSURES),
    "die_temperature": Quantity(
        "K", {PRESSURE: (("temperature", 0.01),), HIGHRES_IMU: (("temperature", 1.0),)}
    ),
    "gnss_height": Quantity("m", {GPS: (("alt", 1e-3), ("alt_ellipsoid", 1e-3))}),
    "gnss_speed": Quantity("m/s", {GPS: (("vel", 1e-2),)}),
    **{f"accel_{axis}": _inertial("acc", axis, _MG) for axis in _AXES},
    **{f"gyro_{axis}": _inertial("gyro", axis, 1e-3) for axis in _AXES},
}

_INERTIAL = tuple(f"{axis}{kind}" for kind in ("acc", "gyro") for axis in _AXES)
_FIX = ("fix_type", "lat", "lon", "alt", "eph", "epv", "vel", "cog", "satellites_visible",
        "alt_ellipsoid", "h_acc", "v_acc", "vel_acc", "hdg_acc", "yaw")  # fmt: skip
SENSORS: Mapping[str, Mapping[int, tuple[str, ...]]] = {
    "barometer": {
        PRESSURE: ("press_abs", "temperature"),
        HIGHRES_IMU: ("abs_pressure", "pressure_alt", "temperature"),
    },
    "gnss": {GPS: _FIX},
    "imu": dict.fromkeys((RAW_IMU, SCALED_IMU, HIGHRES_IMU), _INERTIAL),
}
"""Fields of each sensor, without its time stamps."""


_OWNERS = {
    "pressure": FaultySensor.BAROMETER,
    "gnss": FaultySensor.GNSS,
    "accel": FaultySensor.IMU,
    "gyro": FaultySensor.IMU,
}


def _owner(quantity: str) -> FaultySensor:
    """The sensor that measures a quantity; NONE for the temperature of the die."""
    return _OWNERS.get(quantity.split("_", maxsplit=1)[0], FaultySensor.NONE)


def _holds(message: Editor, name: str) -> bool:
    """Whether a field holds a value: there is a fix, an extension was sent, and it is no
    sentinel."""
    if message.message_id == GPS:
        return bool(message["fix_type"] >= 2 and (name == "alt" or message[name] not in (0, 65535)))
    return True


class ValueFault(Fault):
    """Parameters of faults of one quantity."""

    quantity: Literal[
        "pressure", "pressure_altitude", "die_temperature", "gnss_height", "gnss_speed", "accel_x",
        "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z",
    ] = "pressure"  # fmt: skip
    """quantity that is changed, in Pa, m, K, m, m/s, m/s2 or rad/s"""

    @property
    def target(self) -> Quantity:
        return QUANTITIES[self.quantity]

    @property
    def faulty_sensor(self) -> FaultySensor:
        return _owner(self.quantity)


Size = Annotated[float, Field(ge=-1e6, le=1e6)]


class Step(ValueFault):
    """A quantity has a constant error."""

    fault: Literal["step"] = "step"
    size: Size
    """size of the error in the quantity's unit"""

    def effect(self, random: KeyedRandom) -> Effect:
        target = self.target
        return Edit(target.fields, lambda message, _: target.shift(message, self.size))


class Ramp(ValueFault):
    """The error of a quantity grows at a constant rate and is zero again after the fault."""

    fault: Literal["ramp"] = "ramp"
    rate: Size
    """rate of the error in the quantity's unit per second"""

    def effect(self, random: KeyedRandom) -> Effect:
        target = self.target
        return Edit(
            target.fields,
            lambda message, context: target.shift(message, self.rate * context.since_s),
        )


class Swing(ValueFault):
    """The error of a quantity is a sine."""

    fault: Literal["swing"] = "swing"
    size: Size
    """amplitude of the error in the quantity's unit"""
    period_s: Annotated[float, Field(gt=0.0, le=1e6)] = 60.0
    """period of the error"""

    def effect(self, random: KeyedRandom) -> Effect:
        target, rate_radps = self.target, math.tau / self.period_s
        return Edit(
            target.fields,
            lambda message, context: target.shift(
                message, self.size * math.sin(rate_radps * context.since_s)
            ),
        )


class Spike(ValueFault):
    """Single readings have an error of one size, positive or negative."""

    fault: Literal["spike"] = "spike"
    size: Size
    """size of the error in the quantity's unit"""
    probability: Probability = 0.05
    """probability that a reading has the error, 0 to 1"""

    def effect(self, random: KeyedRandom) -> Effect:
        target = self.target

        def change(message: Editor, context: PacketContext) -> None:
            draw = random.uniform(context.since_us, context.message_id)
            if draw < self.probability:
                target.shift(message, self.size if draw < 0.5 * self.probability else -self.size)

        return Edit(target.fields, change)


class Noise(ValueFault):
    """A quantity has additional white noise."""

    fault: Literal["noise"] = "noise"
    sd: Annotated[float, Field(gt=0.0, le=1e6)]
    """standard deviation of the noise in the quantity's unit"""

    def effect(self, random: KeyedRandom) -> Effect:
        target = self.target
        return Edit(
            target.fields,
            lambda message, context: target.shift(
                message, self.sd * random.normal(context.since_us, context.message_id)
            ),
        )


SWAPS: Mapping[str, tuple[tuple[str, ...], float]] = {
    "pascal": (("pressure",), 100.0),
    "half_pressure": (("pressure",), 0.5),
    "feet": (("gnss_height",), 1.0 / 0.3048),
    "metres_for_millimetres": (("gnss_height",), 1e-3),
    "degrees": (tuple(f"gyro_{axis}" for axis in _AXES), math.degrees(1.0)),
    "mps2_for_g": (tuple(f"accel_{axis}" for axis in _AXES), G0_MPS2),
}
"""Wrong unit -> the quantities that it affects, and the factor of their values."""


class SwappedUnits(Fault):
    """A quantity is sent in the wrong unit."""

    fault: Literal["swapped_units"] = "swapped_units"
    swap: Literal[
        "pascal", "half_pressure", "feet", "metres_for_millimetres", "degrees", "mps2_for_g"
    ] = "pascal"
    """error of the unit: Pa for hPa, half the pressure, feet for metres, metres for millimetres,
    degrees for radians, or m/s2 for mG"""

    @property
    def faulty_sensor(self) -> FaultySensor:
        return _owner(SWAPS[self.swap][0][0])

    def effect(self, random: KeyedRandom) -> Effect:
        names, factor = SWAPS[self.swap]
        targets = [QUANTITIES[name] for name in names]

        def change(message: Editor, _: PacketContext) -> None:
            for target in targets:
                target.scale(message, factor)

        return Edit(targets[0].fields, change)


class BlockedStaticPort(Fault):
    """Ice or tape blocks the static port: the pressure stays constant or follows through a leak;
    the sensor's noise continues."""

    fault: Literal["blocked_static_port"] = "blocked_static_port"
    leak_s: Annotated[float, Field(gt=0.0, le=1e5)] | None = None
    """time constant of the leak; left out, the port is sealed"""

    @property
    def faulty_sensor(self) -> FaultySensor:
        return FaultySensor.BAROMETER

    def effect(self, random: KeyedRandom) -> Effect:
        return _BlockedPort(self.leak_s)


class _BlockedPort(Effect):
    """A critically damped filter, without lag in a steady climb, separates the port's pressure from
    the sensor's noise.

    The pitot tube is not blocked, so the differential pressure (press_diff) has the opposite error.
    """

    ids = frozenset({PRESSURE, HIGHRES_IMU})
    _FIELDS: ClassVar = {
        PRESSURE: ("press_abs", "press_diff"),
        HIGHRES_IMU: ("abs_pressure", "diff_pressure"),
    }
    _SMOOTHING_S = 1.0

    def __init__(self, leak_s: float | None) -> None:
        self._leak_s = leak_s
        self._state: dict[int, tuple[int, float, float, float]] = {}
        """message id -> time of the last reading, outside pressure, its rate, inside pressure
        (hPa)"""

    def feed(self, packet: Packet, context: PacketContext) -> Iterable[Packet]:
        message = Editor(packet.data, context.message_id)
        absolute, differential = self._FIELDS[context.message_id]
        reading = message[absolute]
        last_us, outside, rate, inside = self._state.get(
            context.message_id, (context.since_us, reading, 0.0, reading)
        )
        dt_s = (context.since_us - last_us) * 1e-6
        if dt_s > 0.0:
            keep = math.exp(-dt_s / self._SMOOTHING_S)
            outside += rate * dt_s
            innovation = reading - outside
            outside += (1.0 - keep**2) * innovation
            rate += (1.0 - keep) ** 2 * innovation / dt_s
        if not context.active:
            inside = outside
        elif self._leak_s is not None and dt_s > 0.0:
            inside += (1.0 - math.exp(-dt_s / self._leak_s)) * (outside - inside)
        self._state[context.message_id] = (context.since_us, outside, rate, inside)
        if not context.active:
            return (packet,)
        message[absolute] = reading + inside - outside
        message[differential] = message[differential] - (inside - outside)
        return (Packet(packet.time_us, message.close()),)
