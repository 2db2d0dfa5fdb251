"""Which of the vehicle's IMU messages is used, and in which unit.

The same primary IMU may be sent as HIGHRES_IMU, SCALED_IMU and RAW_IMU. The first of these that was
accepted within two seconds is used. RAW_IMU is in mG from ArduPilot (whatever the XML says), in
mm/s2 from others by custom; of a generic autopilot, the scale that fits gravity. A source is
accepted once the median of its specific force over ten seconds is near 1 g, and for as long as that
stays what a vehicle can bear, so that wrong units or a dead accelerometer never reach an estimator.
"""

import math

from companion.kernels.atmosphere import G0_MPS2
from companion.mavlink import convert
from companion.mavlink import imu_steps as steps
from companion.mavlink.codec import Message, mavlink
from companion.mavlink.convert import Reading
from companion.mavlink.imu_steps import (
    CHOICE,
    GRAVITY,
    HIGHEST_G,
    LOWEST_G,
    SOURCE_TIMEOUT_US,
)
from companion.samples import Rows, rows

__all__ = ["SOURCE_TIMEOUT_US", "GravityCheck", "ImuSelector"]

MILLI_G = 1e-3 * G0_MPS2
MILLI_MPS2 = 1e-3
PRIORITY = {
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: 0,
    mavlink.MAVLINK_MSG_ID_SCALED_IMU: 1,
    mavlink.MAVLINK_MSG_ID_RAW_IMU: 2,
}
RAW_SCALES = {
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: MILLI_G,
    mavlink.MAV_AUTOPILOT_PX4: MILLI_MPS2,
}


class GravityCheck:
    """Whether the median |specific force| of ten seconds (sampled at 10 Hz) has been about 1 g, and
    is within what a vehicle can bear."""

    def __init__(self) -> None:
        self.state: Rows = rows(GRAVITY)

    def accepts(self, time_us: int, force_mps2: float) -> bool:
        """Add a magnitude and say whether the source is plausible now; a clock that went back
        starts anew."""
        return bool(steps.plausible(self.state, time_us, force_mps2))


class ImuSelector:
    """Chooses among the IMU messages of instance 0 and checks every instance against gravity."""

    def __init__(self) -> None:
        self.state: Rows = rows(CHOICE)
        steps.begin(self.state)
        self._generic_scale: float | None = None

    def accepts(self, message_id: int, reading: Reading, time_us: int) -> bool:
        """Whether no better source replaces an IMU reading and gravity does not refute it.

        `time_us` is the vehicle's clock when the message was heard.
        """
        number, rank = message_id * 8 + reading.instance, self.rank(message_id, reading.instance)
        x_mps2, y_mps2, z_mps2 = reading.values[0]
        return bool(steps.accepts(self.state, number, rank, x_mps2, y_mps2, z_mps2, time_us))

    @staticmethod
    def rank(message_id: int, instance: int) -> int:
        """The place of a message among those of the primary IMU; -1 of another IMU."""
        return -1 if instance else PRIORITY.get(message_id, -1)

    def scale(self, autopilot: int) -> float | None:
        """Of the accelerations in RAW_IMU; None where the next message has to tell it."""
        return RAW_SCALES.get(autopilot, self._generic_scale)

    def raw_imu(self, message: Message, autopilot: int) -> tuple[Reading, ...]:
        """RAW_IMU in SI units."""
        scale = self.scale(autopilot)
        if scale is None:
            scale = self._fitting_scale(message)
        return convert.raw_imu(message, scale)

    def _fitting_scale(self, message: Message) -> float:
        """The scale under which this message is about 1 g: kept from now on if one is."""
        counts = math.hypot(message.xacc, message.yacc, message.zacc)
        for scale in (MILLI_G, MILLI_MPS2):
            if LOWEST_G * G0_MPS2 <= counts * scale <= HIGHEST_G * G0_MPS2:
                self._generic_scale = scale
                return scale
        return MILLI_G
