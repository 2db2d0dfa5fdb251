"""Readings of the vehicle's messages: one message for each sensor, where several carry it."""

from companion.mavlink import convert
from companion.mavlink import imu_steps as steps
from companion.mavlink.codec import Message, mavlink
from companion.mavlink.convert import Reading
from companion.mavlink.imu import ImuSelector
from companion.samples import Kind

RAW_IMU = mavlink.MAVLINK_MSG_ID_RAW_IMU
HIGHRES_IMU = mavlink.MAVLINK_MSG_ID_HIGHRES_IMU
# Looked up in its class, a member of an enum costs ten times as much (Python 3.11).
_IMU = Kind.IMU
_PRESSURE = Kind.PRESSURE


class ReadingSelector:
    """Converts messages, and tells which readings a better message replaces.

    Parameters
    ----------
    air_temperature : key of `convert.THERMOMETERS`: the messages that tell the air's temperature.
    """

    def __init__(self, air_temperature: str) -> None:
        self._air_temperature = air_temperature
        self.imu = ImuSelector()

    @property
    def message_ids(self) -> set[int]:
        """Ids of the messages that become readings."""
        return {*convert.CONVERTERS, RAW_IMU, *convert.THERMOMETERS[self._air_temperature]}

    def restart(self) -> None:
        """The vehicle booted: its barometer may be sent in another message."""
        steps.forget_pressure(self.imu.state)

    def of(self, message: Message, message_id: int, autopilot: int) -> tuple[Reading, ...]:
        """The readings of a message, in SI units."""
        if message_id == RAW_IMU:
            return self.imu.raw_imu(message, autopilot)
        converter = convert.CONVERTERS.get(message_id)
        readings = converter(message) if converter is not None else ()
        thermometer = convert.THERMOMETERS[self._air_temperature].get(message_id)
        return readings + thermometer(message) if thermometer is not None else readings

    def is_replaced(self, reading: Reading, message_id: int, now_us: int) -> bool:
        """Whether the same sensor has a better message. `now_us` is the vehicle's clock."""
        if reading.kind is _IMU:
            return not self.imu.accepts(message_id, reading, now_us)
        if reading.kind is _PRESSURE:
            is_highres = message_id == HIGHRES_IMU
            return bool(
                steps.replaces_pressure(self.imu.state, is_highres, reading.instance, now_us)
            )
        return False
