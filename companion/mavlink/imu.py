"""Which of the vehicle's IMU messages is used, and in which unit.

The same primary IMU may be sent as HIGHRES_IMU, SCALED_IMU and RAW_IMU. The first of these that was
accepted within two seconds is used. RAW_IMU is in mG from ArduPilot (whatever the XML says), in
mm/s2 from others by custom; of a generic autopilot, the scale that fits gravity. A source is
accepted once the median of its specific force over ten seconds is near 1 g, and for as long as that
stays what a vehicle can bear, so that wrong units or a dead accelerometer never reach an estimator.
"""

import math
from collections import deque
from statistics import median

from companion.kernels.atmosphere import G0_MPS2
from companion.mavlink import convert
from companion.mavlink.codec import Message, mavlink
from companion.mavlink.convert import Reading

MILLI_G = 1e-3 * G0_MPS2
MILLI_MPS2 = 1e-3
PRIORITY = {
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: 0,
    mavlink.MAVLINK_MSG_ID_SCALED_IMU: 1,
    mavlink.MAVLINK_MSG_ID_RAW_IMU: 2,
}
SOURCE_TIMEOUT_US = 2_000_000
GRAVITY_WINDOW_US = 10_000_000
GRAVITY_SPACING_US = 100_000
KNOWN_AFTER_US = 5_000_000
LOWEST_G, HIGHEST_G = 0.8, 1.25
LOWEST_BORNE_G, HIGHEST_BORNE_G = 0.2, 8.0
"""bounds over seconds, once gravity has been seen: 1.4 g in a turn at 45 degrees of bank, 1.6 on a
fighter's runway"""
RAW_SCALES = {
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: MILLI_G,
    mavlink.MAV_AUTOPILOT_PX4: MILLI_MPS2,
}


class GravityCheck:
    """Whether the median |specific force| of ten seconds (sampled at 10 Hz) has been about 1 g, and
    is within what a vehicle can bear."""

    def __init__(self) -> None:
        self._window: deque[tuple[int, float]] = deque()
        self._plausible = False

    def accepts(self, time_us: int, force_mps2: float) -> bool:
        """Add a magnitude and say whether the source is plausible now; a clock that went back
        starts anew."""
        if not math.isfinite(force_mps2):
            return False
        window = self._window
        if window and time_us < window[-1][0] - SOURCE_TIMEOUT_US:
            window.clear()
            self._plausible = False
        if not window or time_us - window[-1][0] >= GRAVITY_SPACING_US:
            window.append((time_us, force_mps2))
            while time_us - window[0][0] > GRAVITY_WINDOW_US:
                window.popleft()
            known = self._plausible and time_us - window[0][0] >= KNOWN_AFTER_US
            lowest_g, highest_g = (
                (LOWEST_BORNE_G, HIGHEST_BORNE_G) if known else (LOWEST_G, HIGHEST_G)
            )
            self._plausible = (
                lowest_g * G0_MPS2 <= median(force for _, force in window) <= highest_g * G0_MPS2
            )
        return self._plausible


class ImuSelector:
    """Chooses among the IMU messages of instance 0 and checks every instance against gravity."""

    def __init__(self) -> None:
        self._heard_us: dict[int, int] = {}
        self._checks: dict[int, GravityCheck] = {}
        self._generic_scale: float | None = None

    def accepts(self, message_id: int, reading: Reading, time_us: int) -> bool:
        """Whether no better source replaces an IMU reading and gravity does not refute it.

        `time_us` is the vehicle's clock when the message was heard.
        """
        check = self._checks.setdefault(message_id * 8 + reading.instance, GravityCheck())
        if not check.accepts(time_us, math.hypot(*reading.values[0])):
            return False  # what gravity refutes replaces nothing
        rank = PRIORITY.get(message_id)
        if rank is None or reading.instance != 0:
            return True
        self._heard_us[rank] = time_us
        return not any(
            better < rank and abs(time_us - heard_us) < SOURCE_TIMEOUT_US
            for better, heard_us in self._heard_us.items()
        )

    def raw_imu(self, message: Message, autopilot: int) -> tuple[Reading, ...]:
        """RAW_IMU in SI units."""
        scale = RAW_SCALES.get(autopilot)
        if scale is None:
            scale = self._generic_scale or self._fitting_scale(message)
        return convert.raw_imu(message, scale)

    def _fitting_scale(self, message: Message) -> float:
        """The scale under which this message is about 1 g: kept from now on if one is."""
        counts = math.hypot(message.xacc, message.yacc, message.zacc)
        for scale in (MILLI_G, MILLI_MPS2):
            if LOWEST_G * G0_MPS2 <= counts * scale <= HIGHEST_G * G0_MPS2:
                self._generic_scale = scale
                return scale
        return MILLI_G
