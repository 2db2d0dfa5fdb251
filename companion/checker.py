"""An independent check of any estimator's altitude against the sensors (doer and checker).

It shares nothing with an estimator. An altitude is supported near the barometer or the receiver
(`companion.agreement`) while the two agree; near the other one while one of them is excluded, or
near either once a receiver that jumped has stayed where it went; by none once they are 30 m apart
and the faulty one is not known. An altitude that is not supported is not published. An estimator
that was supported, and is not for 10 s while the sensors agree, is restarted: once, until it was
supported for 10 s again.

It fails when both sensors are wrong alike, or when the barometer shifts while there is no GNSS.
"""

import math

from companion.agreement import FRESH_US, Agreement
from companion.samples import Kind, Rows

LIMIT_M = 30.0
"""Largest distance of a supported altitude from a sensor: an error of 50 m must not be published,
less 10 m of unobserved drift and 10 m of GNSS error."""
RESTART_US = 10_000_000


class Checker:
    """Compares the altitude of an estimator with the samples of its vehicle."""

    def __init__(self) -> None:
        self.restarts = 0
        """number of restarts of the estimator"""
        self.restart()

    def restart(self) -> None:
        """Forget everything: the vehicle started anew."""
        self.sensors = Agreement()
        self._is_armed: bool | None = None
        self._supported_us: int | None = None
        self._unsupported_us: int | None = None

    def sample(self, kind: Kind, row: Rows) -> None:
        """Follow a sample, shape (1,)."""
        if kind is Kind.PRESSURE:
            self.sensors.pressure(row)
        elif kind is Kind.GNSS:
            self.sensors.fix(row)

    def objection(self, now_us: int, altitude_m: float) -> str:
        """The reason why the altitude is not supported; empty when it is supported or cannot be
        checked."""
        sensors = self.sensors
        (baro_us, baro_m), (gnss_us, gnss_m) = sensors.baro, sensors.gnss
        by_baro = now_us - baro_us <= FRESH_US and math.isfinite(sensors.difference_m)
        by_gnss = now_us - gnss_us <= FRESH_US
        gap_m, unexplained = abs(sensors.gap_m), not sensors.agree and sensors.excluded is None
        if unexplained and gap_m > max(LIMIT_M, sensors.limit_m):
            return f"barometer and GNSS {gap_m:.0f} m apart"
        if not (by_baro or by_gnss):
            return ""
        above_m = altitude_m - baro_m - sensors.difference_m
        follows_gnss = above_m * math.copysign(2.0, sensors.gap_m) > gap_m
        near_baro = by_baro and abs(above_m) <= sensors.limit_m
        near_gnss = by_gnss and abs(altitude_m - gnss_m) <= sensors.gnss_limit_m
        supported = {
            None: near_baro or near_gnss,
            Kind.GNSS: (near_baro and not follows_gnss) or (near_gnss and sensors.has_lasted),
            Kind.PRESSURE: near_gnss,
        }[sensors.excluded]
        return "" if supported else "altitude contradicts the sensors"

    def asks_restart(self, now_us: int, *, supported: bool) -> bool:
        """Whether to restart the estimator now; `supported` is whether its altitude is usable."""
        if supported:
            self._unsupported_us = None
            self._supported_us = now_us if self._supported_us is None else self._supported_us
            if self._is_armed is None or now_us - self._supported_us >= RESTART_US:
                self._is_armed = True
            return False
        self._supported_us = None
        if not self.sensors.agree or now_us - self.sensors.gnss[0] > FRESH_US:
            self._unsupported_us = None
        elif self._unsupported_us is None:
            self._unsupported_us = now_us
        elif self._is_armed and now_us - self._unsupported_us >= RESTART_US:
            self._is_armed, self._unsupported_us = False, None
            self.restarts += 1
            return True
        return False
