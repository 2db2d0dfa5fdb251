"""Whether the vehicle still rests on the field of its take-off: then the field's elevation is its
height.

It follows the samples of one vehicle. Rest needs a barometer that has kept its height for three
seconds, a receiver that shows no speed, and a vehicle that is disarmed or says that it is on the
ground. A vehicle that has been in the air, or was too fast or too high for a vehicle on the ground,
never rests on that field again: it may land elsewhere.
"""

import math

from companion.kernels.atmosphere import baro_altitude_m
from companion.kernels.gnss import HIGHEST_GNSS_M, LOWEST_GNSS_M, gnss_sd_m
from companion.samples import Kind, Rows

STILL_US, STILL_M = 3_000_000, 2.0
"""Rest: so long, within so much barometer height (wind over a static port is 1 m)."""
SLOW_MPS, FAST_MPS = 1.5, 15.0
"""A receiver at rest shows less than the first; no vehicle on the ground exceeds the second."""
LEFT_M = 10.0
"""What moves by more from one rest to the next has left the ground: weather takes 20 minutes."""
FRESH_US = 2_000_000
GEOID_M, SIGMAS, UNKNOWN_SD_M = 30.0, 3.0, 20.0
"""A fix may lie beside the field's elevation by the error of its geoid and so many spreads."""


class AtRest:
    """Follows one vehicle: `left` says that it has left the field."""

    def __init__(self) -> None:
        self.left = False
        self._armed = self._landed = -1
        self._still_us, self._low_m, self._high_m = math.inf, math.nan, math.nan
        self._baro_us, self._rest_m = 0, math.nan
        self._speed: tuple[int, float] | None = None
        self._fix: tuple[int, float, float] | None = None

    def forget_flight(self) -> None:
        """Where it rests from now on is the field: somebody has just told its elevation."""
        self.left, self._rest_m = False, math.nan

    def sample(self, kind: Kind, row: Rows) -> None:
        """Follow a sample, shape (1,), of the first sensor of its kind."""
        if kind is Kind.STATUS:
            armed, landed = int(row["armed"][0]), int(row["landed"][0])
            self._armed = armed if armed >= 0 else self._armed
            self._landed = landed if landed >= 0 else self._landed
            self.left |= landed == 0
        elif kind is Kind.GNSS and row["instance"][0] == 0:
            self._note_fix(row)
        elif kind is Kind.PRESSURE and row["instance"][0] == 0:
            self._note_pressure(int(row["time_us"][0]), float(row["pressure_pa"][0]))

    def rests(self, now_us: int) -> bool:
        """Whether the vehicle rests on the field now."""
        is_down = self._landed == 1 or (self._armed == 0 and self._landed != 0)
        if self.left or not is_down or now_us - self._still_us < STILL_US:
            return False
        return (
            self._speed is None or now_us - self._speed[0] > FRESH_US or self._speed[1] <= SLOW_MPS
        )

    def contradiction_m(self, now_us: int, elevation_m: float) -> float:
        """What GNSS shows beside the elevation where that is not possible, else 0."""
        if self._fix is None or now_us - self._fix[0] > FRESH_US:
            return 0.0
        apart_m = self._fix[1] - elevation_m
        return apart_m if abs(apart_m) > GEOID_M + SIGMAS * self._fix[2] else 0.0

    def _note_fix(self, row: Rows) -> None:
        value, height_m = row[0], float(row["altitude_amsl_m"][0])
        time_us, speed_mps = int(value["time_us"]), float(value["ground_speed_mps"])
        if value["fix_type"] < 3 or not LOWEST_GNSS_M <= height_m <= HIGHEST_GNSS_M:
            return
        self._fix = time_us, height_m, float(gnss_sd_m(row, 0.0, UNKNOWN_SD_M))
        if math.isfinite(speed_mps):
            self._speed = time_us, speed_mps
            self.left |= speed_mps > FAST_MPS

    def _note_pressure(self, time_us: int, pressure_pa: float) -> None:
        height_m = float(baro_altitude_m(pressure_pa))
        if not math.isfinite(height_m):
            return
        low_m, high_m = min(self._low_m, height_m), max(self._high_m, height_m)
        if not 0 <= time_us - self._baro_us <= FRESH_US or not high_m - low_m <= STILL_M:
            self._still_us, low_m, high_m = time_us, height_m, height_m
        self._baro_us, self._low_m, self._high_m = time_us, low_m, high_m
        if self.rests(time_us) or math.isnan(self._rest_m):
            self._rest_m = height_m
        self.left |= abs(height_m - self._rest_m) > LEFT_M
