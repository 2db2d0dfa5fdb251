"""Whether the vehicle still rests on the field of its take-off: then the field's elevation is its
height.

It follows the samples of one vehicle. Rest needs a barometer that has kept its height for three
seconds, a receiver that shows no speed, and a vehicle that is disarmed or says that it is on the
ground. A vehicle that has been in the air, or was too fast or too high for a vehicle on the ground,
never rests on that field again: it may land elsewhere.
"""

import math

import numpy as np

from companion.jit import step
from companion.kernels.atmosphere import baro_altitude_m
from companion.kernels.gnss import HIGHEST_GNSS_M, LOWEST_GNSS_M, gnss_sd_m
from companion.samples import Kind, Rows, rows

STILL_US, STILL_M = 3_000_000, 2.0
"""Rest: so long, within so much barometer height (wind over a static port is 1 m)."""
SLOW_MPS, FAST_MPS = 1.5, 15.0
"""A receiver at rest shows less than the first; no vehicle on the ground exceeds the second."""
LEFT_M = 10.0
"""What moves by more from one rest to the next has left the ground: weather takes 20 minutes."""
FRESH_US = 2_000_000
GEOID_M, SIGMAS, UNKNOWN_SD_M = 30.0, 3.0, 20.0
"""A fix may lie beside the field's elevation by the error of its geoid and so many spreads."""
NEVER_US = -(1 << 62)
STATUS, GNSS, PRESSURE = int(Kind.STATUS), int(Kind.GNSS), int(Kind.PRESSURE)

AT_REST = np.dtype(
    [
        ("left", "i8"),  # 1 when it has left the field
        ("armed", "i8"),
        ("landed", "i8"),
        ("still_us", "i8"),  # since when the barometer keeps its height; NEVER_US before the first
        ("low_m", "f8"),
        ("high_m", "f8"),
        ("baro_us", "i8"),
        ("rest_m", "f8"),
        ("speed_us", "i8"),
        ("speed_mps", "f8"),
        ("fix_us", "i8"),
        ("fix_m", "f8"),
        ("fix_sd_m", "f8"),
    ],
    align=True,
)


class AtRest:
    """Follows one vehicle: `left` says that it has left the field."""

    def __init__(self) -> None:
        self.state: Rows = rows(AT_REST)
        for name in ("armed", "landed"):
            self.state[name] = -1
        for name in ("still_us", "speed_us", "fix_us"):
            self.state[name] = NEVER_US

    @property
    def left(self) -> bool:
        return bool(self.state["left"][0])

    def forget_flight(self) -> None:
        """Where it rests from now on is the field: somebody has just told its elevation."""
        self.state["left"], self.state["rest_m"] = 0, math.nan

    def sample(self, kind: Kind, row: Rows) -> None:
        """Follow a sample, shape (1,), of the first sensor of its kind."""
        if kind is Kind.STATUS:
            follow_status(self.state, row)
        elif kind is Kind.GNSS:
            follow_fix(self.state, row)
        elif kind is Kind.PRESSURE:
            follow_pressure(self.state, row)

    def rests(self, now_us: int) -> bool:
        """Whether the vehicle rests on the field now."""
        return bool(rests(self.state, now_us))

    def contradiction_m(self, now_us: int, elevation_m: float) -> float:
        """What GNSS shows beside the elevation where that is not possible, else 0."""
        return float(contradiction_m(self.state, now_us, elevation_m))


@step
def follow_status(r: Rows, row: Rows) -> None:
    """Whether the vehicle is armed, and on the ground."""
    if row[0].armed >= 0:
        r[0].armed = row[0].armed
    if row[0].landed >= 0:
        r[0].landed = row[0].landed
    if row[0].landed == 0:
        r[0].left = 1


@step
def follow_fix(r: Rows, row: Rows) -> None:
    """Height and speed of the first receiver."""
    height_m, speed_mps = row[0].altitude_amsl_m, row[0].ground_speed_mps
    if row[0].instance != 0 or row[0].fix_type < 3:
        return
    if not LOWEST_GNSS_M <= height_m <= HIGHEST_GNSS_M:
        return
    r[0].fix_us, r[0].fix_m = row[0].time_us, height_m
    r[0].fix_sd_m = gnss_sd_m(row, 0.0, UNKNOWN_SD_M)
    if math.isfinite(speed_mps):
        r[0].speed_us, r[0].speed_mps = row[0].time_us, speed_mps
        if speed_mps > FAST_MPS:
            r[0].left = 1


@step
def follow_pressure(r: Rows, row: Rows) -> None:
    """Height of the first barometer."""
    time_us, height_m = row[0].time_us, baro_altitude_m(row[0].pressure_pa)
    if row[0].instance != 0 or not math.isfinite(height_m):
        return
    low_m, high_m = height_m, height_m
    if r[0].still_us != NEVER_US:
        low_m, high_m = min(r[0].low_m, height_m), max(r[0].high_m, height_m)
    is_fresh = r[0].still_us != NEVER_US and 0 <= time_us - r[0].baro_us <= FRESH_US
    if not is_fresh or not high_m - low_m <= STILL_M:
        r[0].still_us, low_m, high_m = time_us, height_m, height_m
    r[0].baro_us, r[0].low_m, r[0].high_m = time_us, low_m, high_m
    if rests(r, time_us) or math.isnan(r[0].rest_m):
        r[0].rest_m = height_m
    if abs(height_m - r[0].rest_m) > LEFT_M:
        r[0].left = 1


@step
def rests(r: Rows, now_us: int) -> bool:
    """Whether the vehicle rests on the field now."""
    is_down = r[0].landed == 1 or (r[0].armed == 0 and r[0].landed != 0)
    if r[0].left or not is_down or r[0].still_us == NEVER_US or now_us - r[0].still_us < STILL_US:
        return False
    if r[0].speed_us == NEVER_US or now_us - r[0].speed_us > FRESH_US:
        return True
    return bool(r[0].speed_mps <= SLOW_MPS)


@step
def contradiction_m(r: Rows, now_us: int, elevation_m: float) -> float:
    """What GNSS shows beside the elevation where that is not possible, else 0."""
    if r[0].fix_us == NEVER_US or now_us - r[0].fix_us > FRESH_US:
        return 0.0
    apart_m = r[0].fix_m - elevation_m
    return apart_m if abs(apart_m) > GEOID_M + SIGMAS * r[0].fix_sd_m else 0.0
