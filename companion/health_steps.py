"""The compiled rules of `companion.health`: a state record, and what a sample and time do to it.

Instants that are not known are `NEVER_US`. A reason is a code with the numbers that its text names;
`companion.health` makes the text.
"""

import math

import numpy as np

from companion.jit import step
from companion.samples import Kind, Rows, Verdict

ASSESS_US = 100_000
NEVER_US = -(1 << 62)
LOWEST_M, HIGHEST_M = -2000.0, 60_000.0
"""bounds of a possible altitude"""
OK, DEGRADED, LOST = 0, 1, 2
USED = int(Verdict.USED)
BARO, GNSS = 0, 1
PRESSURE_KIND, GNSS_KIND = int(Kind.PRESSURE), int(Kind.GNSS)

(NOTHING_YET, NO_ALTITUDE, IMPOSSIBLE, NO_USABLE, OBJECTED, UNCERTAIN, MAY_BE_WRONG, EXCLUDED,
 MISSING, GOOD, OF_HOST) = range(11)  # fmt: skip
"""codes of the reason; the last is that of `silence`"""

HEALTH = np.dtype(
    [
        ("health", "i8"),
        ("has_altitude", "i8"),
        ("reason", "i8"),
        ("detail", "i8"),  # what is missing, excluded or objected
        ("detail_us", "i8"),
        ("value_m", "f8"),
        ("alive_us", "i8"),  # on the host's clock: the newest frame,
        ("height_us", "i8"),  # barometer or GNSS sample,
        ("usable_us", "i8"),  # and used sample of them
        ("back_us", "i8"),  # the first frame after a silence
        ("silenced", "i8"),  # whether it is LOST only because the vehicle fell silent
        ("shift_us", "i8"),  # length of our own interruption,
        ("before_us", "i8"),  # and time of the estimate from before it
        ("used_us", "i8", (2,)),  # of barometer and GNSS, on the vehicle's clock
        ("verdict", "i8", (2,)),  # -1 before the first
        ("better_since_us", "i8"),
        ("assessed_us", "i8"),
    ],
    align=True,
)
HEALTH_PARAMS = np.dtype(
    [
        ("fresh_us", "f8"),
        ("lost_us", "f8"),
        ("silent_us", "f8"),
        ("recover_us", "f8"),
        ("sd_ok_m", "f8"),
        ("sd_lost_m", "f8"),
        ("needed", "i8", (2,)),  # whether the estimator uses barometer and GNSS
    ],
    align=True,
)


@step
def restart(h: Rows) -> None:
    """Forget every instant of the vehicle's clock: it started anew."""
    for k in range(2):
        h[0].used_us[k], h[0].verdict[k] = NEVER_US, -1
    h[0].better_since_us, h[0].assessed_us = NEVER_US, -ASSESS_US


@step
def alive(h: Rows, p: Rows, host_us: int) -> None:
    """A frame of the vehicle arrived."""
    if h[0].alive_us != NEVER_US and host_us - h[0].alive_us > 0.5 * p[0].silent_us:
        h[0].back_us = host_us
    h[0].alive_us = host_us
    if h[0].height_us == NEVER_US:
        h[0].height_us = h[0].usable_us = host_us


@step
def heard(h: Rows, p: Rows, kind: int, verdict: int, now_us: int, host_us: int) -> None:
    """A sample of the primary instance, or one that was used, got this verdict."""
    if kind not in (PRESSURE_KIND, GNSS_KIND):
        return
    k = BARO if kind == PRESSURE_KIND else GNSS
    h[0].verdict[k] = verdict
    if p[0].needed[k]:
        h[0].height_us = host_us
    if verdict == USED:
        h[0].used_us[k] = now_us
        if p[0].needed[k]:
            h[0].usable_us = host_us


@step
def is_due(h: Rows, now_us: int) -> bool:
    """Whether the last assessment is old enough for one without a new measurement."""
    return not 0 <= now_us - h[0].assessed_us < ASSESS_US


@step
def silence(h: Rows, p: Rows, host_us: int) -> int:
    """What is missing on the host's clock: 1 the vehicle, 2 its heights, 3 a usable one, 0 none."""
    if h[0].alive_us == NEVER_US or h[0].height_us == NEVER_US or h[0].usable_us == NEVER_US:
        return 0
    needs = p[0].needed[BARO] or p[0].needed[GNSS]
    no_height = needs and host_us - h[0].height_us > p[0].silent_us
    if host_us - h[0].alive_us > (0.5 * p[0].silent_us if no_height else p[0].silent_us):
        return 1
    if no_height:
        return 2
    if needs and host_us - h[0].usable_us > max(p[0].lost_us, p[0].silent_us):
        return 3
    return 0


@step
def lose(h: Rows, p: Rows, silence: int, host_us: int) -> None:
    """Health is LOST by the host's clock, for what `silence` tells. Heights are missing for the
    vehicle's silence only where it was heard again a moment ago."""
    is_back = h[0].back_us != NEVER_US and host_us - h[0].back_us < p[0].silent_us
    if h[0].health != LOST and (silence == 1 or (silence == 2 and is_back)):
        h[0].silenced = 1
    h[0].health, h[0].reason, h[0].detail, h[0].better_since_us = LOST, OF_HOST, silence, NEVER_US


@step
def assess(h: Rows, p: Rows, now_us: int, estimate: Rows, objection: int, value_m: float) -> bool:
    """Bring the state up to date; True when the health changed. An `objection` other than 0 is the
    code of why the sensors do not support the altitude, with the size that its text names."""
    h[0].assessed_us = now_us
    reason, detail, detail_us = h[0].reason, h[0].detail, h[0].detail_us
    old_value_m, before = h[0].value_m, h[0].health
    health = _judge(h, p, now_us, estimate, objection, value_m)
    if not h[0].has_altitude:
        h[0].silenced = 0
    if health >= before:
        h[0].better_since_us = NEVER_US
    else:
        if h[0].better_since_us == NEVER_US or h[0].better_since_us > now_us:
            h[0].better_since_us = now_us
        # half as long after a mere silence, such as a cable that was unplugged: nothing spoke
        # against the height then
        wait_us = 0.5 * p[0].recover_us if h[0].silenced else p[0].recover_us
        if now_us - h[0].better_since_us < wait_us:
            h[0].reason, h[0].detail, h[0].detail_us = reason, detail, detail_us
            h[0].value_m = old_value_m
            return False
        h[0].better_since_us, h[0].silenced = NEVER_US, 0
    h[0].health = health
    return health != before


@step
def _because(h: Rows, reason: int, detail: int, value_m: float) -> None:
    h[0].reason, h[0].detail, h[0].value_m = reason, detail, value_m


@step
def _judge(h: Rows, p: Rows, now_us: int, estimate: Rows, objection: int, value_m: float) -> int:
    altitude_m, sd_m = estimate[0].altitude_amsl_m, estimate[0].altitude_sd_m
    level_m, possible = estimate[0].protection_level_m, LOWEST_M <= altitude_m <= HIGHEST_M
    alert = level_m > estimate[0].alert_limit_m  # False of an estimator without a level
    certain = sd_m <= p[0].sd_lost_m and not alert
    h[0].has_altitude = 1 if objection == 0 and possible and certain else 0
    missing = _missing(h, p, now_us)
    if not (math.isfinite(altitude_m) and math.isfinite(sd_m)):
        _because(h, MISSING if missing >= 0 else NO_ALTITUDE, missing, 0.0)
        return LOST
    if not possible:
        _because(h, IMPOSSIBLE, 0, 0.0)
        return LOST
    if now_us - _newest_us(h, p, estimate[0].time_us) > p[0].lost_us:
        _because(h, NO_USABLE, 0, 0.0)
        return LOST
    if objection != 0:
        _because(h, OBJECTED, objection, value_m)
        return LOST
    if sd_m > p[0].sd_lost_m:
        _because(h, UNCERTAIN, 0, sd_m)
        return LOST
    if alert:
        _because(h, MAY_BE_WRONG, 0, level_m)
        return LOST
    if estimate[0].faulty != 0:
        _because(h, EXCLUDED, estimate[0].faulty, 0.0)
        h[0].detail_us = estimate[0].faulty_since_us
        return DEGRADED
    if missing >= 0:
        _because(h, MISSING, missing, 0.0)
        return DEGRADED
    _because(h, UNCERTAIN if sd_m > p[0].sd_ok_m else GOOD, 0, sd_m)
    return DEGRADED if sd_m > p[0].sd_ok_m else OK


@step
def _newest_us(h: Rows, p: Rows, estimate_us: int) -> int:
    """Time of the newest used height or, where it is older, of the estimate: an inertial estimate
    goes on without any. An estimate from before our own interruption is as old as it was then,
    until the first sample renews it."""
    if h[0].shift_us:
        if h[0].before_us == NEVER_US:
            h[0].before_us = estimate_us
        if estimate_us != h[0].before_us:
            h[0].shift_us = 0
        estimate_us += h[0].shift_us
    newest_us = NEVER_US
    for k in range(2):
        if p[0].needed[k]:
            newest_us = max(newest_us, h[0].used_us[k])
    return estimate_us if newest_us == NEVER_US else min(estimate_us, newest_us)


@step
def _missing(h: Rows, p: Rows, now_us: int) -> int:
    """The needed sensor without a fresh used sample, -1 when there is none: sensor * 8 + verdict,
    with 7 for none."""
    for k in range(2):
        used_us = h[0].used_us[k]
        if not p[0].needed[k] or (used_us != NEVER_US and now_us - used_us <= p[0].fresh_us):
            continue
        return k * 8 + (h[0].verdict[k] if h[0].verdict[k] >= 0 else 7)
    return -1
