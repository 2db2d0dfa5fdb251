"""An independent check of any estimator's altitude against the sensors (doer and checker).

It shares nothing with an estimator. An altitude is supported near the barometer or the receiver
(`companion.agreement`) while the two agree; near the other one while one of them is excluded, or
near either once a receiver that jumped has stayed where it went; by none once they are 25 m apart
and the faulty one is not known. An altitude that is not supported is not published. An estimator
that was supported, and is not for 10 s while the sensors agree within 10 m, and differ by what they
did while it was supported (for 300 s when they differ by something else), is restarted: once, until
it was supported for 10 s again. One that doubts a sensor which slides away must not be: it would
forget the doubt and follow.

It fails when both sensors are wrong alike, or when the barometer shifts while there is no GNSS.
"""

import math

import numpy as np

from companion.agreed_difference import agreed_m
from companion.agreement import (
    AGREEMENT,
    BARO,
    FRESH_US,
    GNSS,
    LEVEL_M,
    NONE,
    Agreement,
    follow_fix,
    follow_pressure,
    limit_m,
)
from companion.jit import step
from companion.samples import Kind, Rows, rows

__all__ = ["AGREEMENT", "CHECKER", "Checker", "asks_restart", "objection"]

LIMIT_M = 25.0
"""Largest distance of a supported altitude from a sensor: an error of 50 m must not be published,
less 15 m of unobserved drift and 10 m of GNSS error."""
RESTART_US = 10_000_000
USUAL_US = 300_000_000
"""A difference of the two heights that lasts for as long is the usual one, and ends a doubt: longer
than the slow error of a receiver (250 s)."""
NEVER_US = -(1 << 62)

NO_OBJECTION, APART, CONTRADICTS, ELLIPSOID = 0, 1, 2, 3
"""codes of an objection; the last is of the intake (`companion.intake.rows`)"""
OBJECTIONS = {
    NO_OBJECTION: "",
    APART: "barometer and GNSS {:.0f} m apart",
    CONTRADICTS: "altitude contradicts the sensors",
    ELLIPSOID: "GNSS height in doubt by {:.0f} m (ellipsoid?)",
}

CHECKER = np.dtype(
    [
        ("restarts", "i8"),
        ("is_armed", "i8"),  # -1 unknown
        ("supported_us", "i8"),  # NEVER_US: not supported now
        ("unsupported_us", "i8"),
        ("usual_us", "i8"),  # newest compared; NEVER_US: none
        ("usual_m", "f8"),  # difference of the two heights over `USUAL_US` of support
    ],
    align=True,
)


class Checker:
    """Compares the altitude of an estimator with the samples of its vehicle."""

    def __init__(self) -> None:
        self.state: Rows = rows(CHECKER)
        self.restart()

    @property
    def restarts(self) -> int:
        """Number of restarts of the estimator."""
        return int(self.state["restarts"][0])

    def restart(self) -> None:
        """Forget everything: the vehicle started anew."""
        self.sensors = Agreement()
        self.state["is_armed"] = -1
        for name in ("supported_us", "unsupported_us", "usual_us"):
            self.state[name] = NEVER_US

    def sample(self, kind: Kind, row: Rows) -> None:
        """Follow a sample, shape (1,)."""
        if kind is Kind.PRESSURE:
            follow_pressure(self.sensors.state, row)
        elif kind is Kind.GNSS:
            follow_fix(self.sensors.state, row)

    def judge(self, now_us: int, estimate: Rows) -> tuple[int, float]:
        """The code of why the altitude of an estimate is not supported, 0 when it is supported or
        cannot be checked, and the distance of the sensors from each other, m."""
        sensors, altitude_m = self.sensors.state, float(estimate["altitude_amsl_m"][0])
        return objection(sensors, now_us, altitude_m), abs(float(sensors["gap_m"][0]))

    def objection(self, now_us: int, altitude_m: float) -> str:
        """The reason why the altitude is not supported; empty when it is supported or cannot be
        checked."""
        sensors = self.sensors.state
        return OBJECTIONS[objection(sensors, now_us, altitude_m)].format(abs(sensors["gap_m"][0]))

    def asks_restart(self, now_us: int, *, supported: bool) -> bool:
        """Whether to restart the estimator now; `supported` is whether its altitude is usable."""
        return bool(asks_restart(self.state, self.sensors.state, now_us, supported))


@step
def objection(a: Rows, now_us: int, altitude_m: float) -> int:
    """The code of the reason why the altitude is not supported; `a` is an AGREEMENT row."""
    by_baro = now_us - a[0].baro_us <= FRESH_US and math.isfinite(a[0].agreed.metres)
    by_baro = by_baro and a[0].is_suspect == 0
    by_gnss = now_us - a[0].gnss_us <= FRESH_US
    gap_m, excluded = abs(a[0].gap_m), a[0].excluded
    if a[0].is_suspect == 1:
        excluded = BARO
    if not a[0].agree and excluded == NONE and gap_m > max(LIMIT_M, limit_m(a)):
        return APART
    if not (by_baro or by_gnss):
        return NO_OBJECTION
    above_m = altitude_m - a[0].baro_m - agreed_m(a[0].agreed, a[0].baro_m)
    follows_gnss = gap_m > LEVEL_M and above_m * math.copysign(2.0, a[0].gap_m) > gap_m
    near_baro = by_baro and abs(above_m) <= limit_m(a)
    near_gnss = by_gnss and abs(altitude_m - a[0].gnss_m) <= a[0].gnss_limit_m
    supported = near_baro or near_gnss
    if excluded == GNSS:
        supported = (near_baro and not follows_gnss) or (near_gnss and a[0].has_lasted == 1)
    elif excluded == BARO:
        supported = near_gnss
    return NO_OBJECTION if supported else CONTRADICTS


@step
def asks_restart(c: Rows, a: Rows, now_us: int, supported: bool) -> bool:
    """Whether to restart the estimator now; `c` is a CHECKER row, `a` an AGREEMENT row."""
    if supported:
        c[0].unsupported_us = NEVER_US
        _follow_usual(c, a, now_us)
        if c[0].supported_us == NEVER_US:
            c[0].supported_us = now_us
        if c[0].is_armed < 0 or now_us - c[0].supported_us >= RESTART_US:
            c[0].is_armed = 1
        return False
    c[0].supported_us = NEVER_US
    is_close = a[0].agree and abs(a[0].gap_m) <= LEVEL_M
    patience_us = RESTART_US if _is_usual(c, a) else USUAL_US
    if not is_close or now_us - a[0].gnss_us > FRESH_US:
        c[0].unsupported_us = NEVER_US
    elif c[0].unsupported_us == NEVER_US:
        c[0].unsupported_us = now_us
    elif c[0].is_armed == 1 and now_us - c[0].unsupported_us >= patience_us:
        c[0].is_armed, c[0].unsupported_us = 0, NEVER_US
        c[0].restarts += 1
        return True
    return False


@step
def _follow_usual(c: Rows, a: Rows, now_us: int) -> None:
    """The difference of the two heights over the last minutes in which they agreed and supported
    the estimator."""
    difference_m = a[0].gnss_m - a[0].baro_m
    if not a[0].agree or now_us - a[0].gnss_us > FRESH_US or not math.isfinite(difference_m):
        return
    if c[0].usual_us == NEVER_US:
        c[0].usual_us, c[0].usual_m = now_us, difference_m
    share = min(1.0, max(0, now_us - c[0].usual_us) / USUAL_US)
    c[0].usual_us = now_us
    c[0].usual_m += share * (difference_m - c[0].usual_m)


@step
def _is_usual(c: Rows, a: Rows) -> bool:
    """Whether the two heights differ by what they did while the estimator was supported: else its
    doubt has a reason, however slowly that came."""
    away_m = a[0].gnss_m - a[0].baro_m - c[0].usual_m
    return c[0].usual_us == NEVER_US or abs(away_m) <= LEVEL_M
