"""Health of the altitude: OK, DEGRADED or LOST.

===========  ====================================================================================
OK           barometer and GNSS were both used within ``fresh_s``, the spread is within ``sd_ok_m``
DEGRADED     one of them is missing or refused, or the spread is larger
LOST         no height for ``lost_s``, spread above ``sd_lost_m``, protection level (of an
             estimator that has one) above its alert limit, no finite, possible estimate, one
             that neither barometer nor GNSS supports (`companion.checker`), or nothing from the
             vehicle, or none of its heights, for ``silent_s``
===========  ====================================================================================

These conditions hold on the vehicle's clock, so that a simulation at twenty times real time counts
the same. What stops the vehicle's clock is seen on the host's: `HealthMonitor.age`.

A turn for the worse takes effect at once (its conditions already wait), one for the better after
``recover_s``, or half of it where the vehicle was only silent.
"""

import math
from collections.abc import Callable, Collection
from enum import IntEnum

from pydantic import Field

from companion.config import Settings
from companion.samples import FaultySensor, Kind, Rows, Verdict

ASSESS_US = 100_000


EXCLUDED_NAMES = {
    FaultySensor.BAROMETER: "barometer",
    FaultySensor.GNSS: "GNSS height",
    FaultySensor.IMU: "IMU",
}

LOWEST_M, HIGHEST_M = -2000.0, 60_000.0
"""bounds of a possible altitude"""


class Health(IntEnum):
    """Ordered: a larger value is worse."""

    OK = 0
    DEGRADED = 1
    LOST = 2


class HealthSettings(Settings):
    """Section ``health``."""

    fresh_s: float = Field(2.0, gt=0, le=60)
    """largest age of the last used barometer and GNSS heights with which health is OK"""
    lost_s: float = Field(5.0, gt=0, le=60)
    """time without any used height after which health is LOST"""
    silent_s: float = Field(3.0, gt=0, le=60)
    """time of the host's clock without any message of the vehicle, or without any height, after
    which health is LOST"""
    recover_s: float = Field(2.0, ge=0, le=60)
    """time for which better conditions must last before health improves"""
    sd_ok_m: float = Field(15.0, gt=0, le=1000)
    """largest standard deviation of the altitude with which health is OK; above it is DEGRADED"""
    sd_lost_m: float = Field(30.0, gt=0, le=1000)
    """standard deviation of the altitude above which health is LOST: ALTITUDE stops"""


class HealthMonitor:
    """Follows verdicts, estimates and the vehicle's silence.

    Parameters
    ----------
    uses : the kinds that the estimator uses; of these, barometer and GNSS must be fresh.
    """

    def __init__(self, settings: HealthSettings, uses: Collection[Kind]) -> None:
        self.health = Health.LOST
        self.reason = "nothing heard yet"
        self.has_altitude = False
        """whether there is an altitude that is possible, certain enough, and supported"""
        self._settings = settings
        self._needed = [kind for kind in (Kind.PRESSURE, Kind.GNSS) if kind in uses]
        self._alive_us: int | None = None
        self._height_us: int | None = None
        self._usable_us: int | None = None
        """the host's clock at the newest frame, barometer or GNSS sample, and used sample of
        them"""
        self._silenced = False
        """whether it is LOST only because the vehicle fell silent"""
        self._back_us: int | None = None
        """the host's clock when the vehicle was heard again after a silence"""
        self._shift_us = 0
        self._before_us: int | None = None
        """length of our own interruption, and time of the estimate from before it"""
        self.restart()

    def restart(self) -> None:
        """Forget every instant: the vehicle's clock started anew."""
        self._used_us: dict[Kind, int] = {}
        self._verdict: dict[Kind, Verdict] = {}
        self._better_since_us: int | None = None
        self._assessed_us = -ASSESS_US

    def shift(self, by_us: int) -> None:
        """Shift every instant by the length of our own interruption, in which the vehicle was not
        silent."""
        self._used_us = {kind: used_us + by_us for kind, used_us in self._used_us.items()}
        if self._better_since_us is not None:
            self._better_since_us += by_us
        self._alive_us = self._height_us = self._usable_us = None
        self._shift_us, self._before_us = by_us, None

    def alive(self, host_us: int) -> None:
        """A frame of the vehicle arrived."""
        if self._alive_us is not None and host_us - self._alive_us > 0.5 * self._silent_us:
            self._back_us = host_us
        self._alive_us = host_us
        if self._height_us is None:
            self._height_us = self._usable_us = host_us

    def sample(self, kind: Kind, verdict: Verdict, now_us: int, host_us: int) -> None:
        """A sample of the primary instance got this verdict.

        `now_us` is the vehicle's clock, `host_us` when the sample arrived.
        """
        self._verdict[kind] = verdict
        if kind in self._needed:
            self._height_us = host_us
        if verdict is Verdict.USED:
            self._used_us[kind] = now_us
            if kind in self._needed:
                self._usable_us = host_us

    def age(self, host_us: int, others: Callable[[], str]) -> bool:
        """Set health to LOST when the vehicle has been silent on the host's clock; True when it
        changed.

        `others` tells who else is heard.
        """
        if self._alive_us is None or self._height_us is None or self._usable_us is None:
            return False
        silent_us = self._silent_us
        no_height = bool(self._needed) and host_us - self._height_us > silent_us
        if host_us - self._alive_us > (0.5 * silent_us if no_height else silent_us):
            heard = others()
            self._silenced |= self.health is not Health.LOST
            return self.lose(f"vehicle silent, heard: {heard}" if heard else "nothing heard")
        if no_height:
            is_back = self._back_us is not None and host_us - self._back_us < silent_us
            self._silenced |= is_back and self.health is not Health.LOST
            return self.lose("vehicle heard, but no barometer and no GNSS")
        if not self._needed:
            return False
        if host_us - self._usable_us > max(self._settings.lost_s * 1e6, silent_us):
            return self.lose(f"no usable height for {self._settings.lost_s:g} s")
        return False

    def is_due(self, now_us: int) -> bool:
        """Whether the last assessment is old enough for one without a new measurement."""
        return not 0 <= now_us - self._assessed_us < ASSESS_US

    def assess(self, now_us: int, estimate: Rows, objection: str = "") -> bool:
        """Bring `health` and `reason` up to date; True when the health changed.

        `objection` is why the sensors do not support the altitude; empty when they do.
        """
        self._assessed_us = now_us
        health, reason = self._judge(now_us, estimate, objection)
        self._silenced = self._silenced and self.has_altitude
        if health >= self.health:
            self._better_since_us = None
        else:
            if self._better_since_us is None or self._better_since_us > now_us:
                self._better_since_us = now_us
            if now_us - self._better_since_us < self._recovery_us:
                return False
            self._better_since_us, self._silenced = None, False
        changed = health is not self.health
        self.health, self.reason = health, reason
        return changed

    def _continued(self, estimate_us: int) -> int:
        """The time of an estimate; one from before our own interruption is as old as it was then,
        until the first sample renews it."""
        if not self._shift_us:
            return estimate_us
        if self._before_us is None:
            self._before_us = estimate_us
        if estimate_us != self._before_us:
            self._shift_us = 0
        return estimate_us + self._shift_us

    @property
    def _silent_us(self) -> float:
        return self._settings.silent_s * 1e6

    @property
    def _recovery_us(self) -> float:
        """How long a turn for the better must last: half as long after a mere silence, such as a
        cable that was unplugged, since nothing spoke against the height then."""
        return self._settings.recover_s * (0.5e6 if self._silenced else 1e6)

    def lose(self, reason: str) -> bool:
        """Health is LOST by the host's clock; True when it changed."""
        changed = self.health is not Health.LOST
        self.health, self.reason, self._better_since_us = Health.LOST, reason, None
        return changed

    def _judge(self, now_us: int, estimate: Rows, objection: str) -> tuple[Health, str]:
        settings, value = self._settings, estimate[0]
        altitude_m, sd_m = float(value["altitude_amsl_m"]), float(value["altitude_sd_m"])
        self.has_altitude = not objection and LOWEST_M <= altitude_m <= HIGHEST_M
        level_m = float(value["protection_level_m"])
        alert = level_m > float(value["alert_limit_m"])  # False of an estimator without a level
        self.has_altitude &= sd_m <= settings.sd_lost_m and not alert
        if not (math.isfinite(altitude_m) and math.isfinite(sd_m)):
            return Health.LOST, self._missing(now_us) or "no altitude yet"
        if not LOWEST_M <= altitude_m <= HIGHEST_M:
            return Health.LOST, "altitude impossible"
        estimate_us = self._continued(int(value["time_us"]))
        heights_us = (self._used_us[kind] for kind in self._needed if kind in self._used_us)
        newest_us = min(
            estimate_us, max(heights_us, default=estimate_us)
        )  # an inertial estimate goes on without any
        if now_us - newest_us > settings.lost_s * 1e6:
            return Health.LOST, f"no usable height for {settings.lost_s:g} s"
        if objection:
            return Health.LOST, objection
        if sd_m > settings.sd_lost_m:
            return Health.LOST, f"altitude uncertain by {sd_m:.0f} m"
        if alert:
            return Health.LOST, f"altitude may be wrong by {level_m:.0f} m"
        problem = excluded(estimate) or self._missing(now_us)
        if problem:
            return Health.DEGRADED, problem
        if sd_m > settings.sd_ok_m:
            return Health.DEGRADED, f"altitude uncertain by {sd_m:.0f} m"
        return Health.OK, f"altitude good to {sd_m:.1f} m"

    def _missing(self, now_us: int) -> str:
        for kind in self._needed:
            used_us = self._used_us.get(kind)
            if used_us is not None and now_us - used_us <= self._settings.fresh_s * 1e6:
                continue
            verdict = self._verdict.get(kind)
            name = "barometer" if kind is Kind.PRESSURE else "GNSS height"
            if verdict is None:
                return f"no {name}"
            return f"{name} {'silent' if verdict is Verdict.USED else verdict.name.lower()}"
        return ""


def excluded(estimate: Rows) -> str:
    """Which sensor the estimator excludes, and since when on the vehicle's clock; empty when
    none."""
    sensor = FaultySensor(int(estimate[0]["faulty"]))
    if sensor is FaultySensor.NONE:
        return ""
    since_s = max(0, int(estimate[0]["faulty_since_us"])) * 1e-6
    return f"{EXCLUDED_NAMES[sensor]} excluded since {since_s:.0f} s"
