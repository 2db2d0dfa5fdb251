"""How far the autopilot's altitude is below ours: the slow part, with what was written taken
out."""

import math

TIME_S = 5.0
"""time constant of the low-pass; an autopilot's height lags in turbulence, climbs and gusts"""
LAG_S = 3.0
"""time from a write to its effect, rather short than long: ArduPilot follows BARO_ALT_OFFSET with
5 s (2 s before 4.6), its EKF later still. A longer time delays the correction by as much; a shorter
one lets it overshoot by what is written in the difference, 0.05 m/s."""
LONGEST_S = 5.0
"""a gap between two heights that ends what was settled"""


class LowPass:
    """A first-order low-pass that starts as the average of its samples. NaN before the first."""

    def __init__(self, time_s: float) -> None:
        self.value = math.nan
        self._time_s = time_s
        self._weight_s = 0.0

    def update(self, sample: float, dt_s: float) -> None:
        """Take a sample that stands for the last `dt_s`."""
        if math.isnan(self.value):
            self.value = sample
        self._weight_s = min(self._weight_s + dt_s, self._time_s)
        if self._weight_s > 0.0:
            self.value += min(1.0, dt_s / self._weight_s) * (sample - self.value)


class Need:
    """The correction that would make the autopilot's altitude ours, and whether it follows its
    barometer.

    The correction is that of all writes together: a write changes the altitude and `total_m` alike,
    so that the low-pass does not see it.
    """

    def __init__(self) -> None:
        self._written_m = self._effect_m = 0.0
        self.restart()

    def restart(self) -> None:
        """Forget what was measured, not what was written."""
        self._total, self._beside = LowPass(TIME_S), LowPass(TIME_S)
        self.time_us = -1
        """time of the newest altitude"""
        self._effect_m = self._written_m

    def wrote(self, metres: float) -> None:
        """The parameter has been set so as to raise the altitude by `metres`."""
        self._written_m = metres

    def holds(self, metres: float) -> None:
        """The parameter has raised the altitude by `metres` for a while."""
        self._written_m = self._effect_m = metres

    @property
    def total_m(self) -> float:
        """The correction to reach our altitude, from the original value of the parameter, m."""
        return self._total.value

    @property
    def beside_m(self) -> float:
        """The autopilot's altitude above the barometer's, without what was written, m: constant
        while it follows the barometer."""
        return self._beside.value

    def update(
        self, time_us: int, vehicle_m: float, our_altitude_m: float, pressure_altitude_m: float
    ) -> None:
        """Take the autopilot's altitude, and ours and the barometer's of the same instant."""
        dt_s = (time_us - self.time_us) * 1e-6
        if self.time_us < 0 or not 0.0 <= dt_s <= LONGEST_S:
            self.restart()
            dt_s = 0.0
        self.time_us = time_us
        self._effect_m += (self._written_m - self._effect_m) * (1.0 - math.exp(-dt_s / LAG_S))
        self._total.update(our_altitude_m - vehicle_m + self._effect_m, dt_s)
        self._beside.update(vehicle_m - pressure_altitude_m - self._effect_m, dt_s)
