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

from collections.abc import Callable, Collection
from enum import IntEnum

from pydantic import Field

from companion import health_steps as steps
from companion.checker import OBJECTIONS
from companion.config import Settings
from companion.health_steps import HEALTH, HEALTH_PARAMS, NEVER_US
from companion.samples import FaultySensor, Kind, Rows, Verdict, rows

EXCLUDED_NAMES = {
    FaultySensor.BAROMETER: "barometer",
    FaultySensor.GNSS: "GNSS height",
    FaultySensor.IMU: "IMU",
}

SENSORS = ("barometer", "GNSS height")


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


_HEALTHS = tuple(Health)


class HealthMonitor:
    """Follows verdicts, estimates and the vehicle's silence.

    Parameters
    ----------
    uses : the kinds that the estimator uses; of these, barometer and GNSS must be fresh.
    """

    def __init__(self, settings: HealthSettings, uses: Collection[Kind]) -> None:
        self._settings = settings
        self.params: Rows = rows(HEALTH_PARAMS)
        for name in ("fresh", "lost", "silent", "recover"):
            self.params[f"{name}_us"] = getattr(settings, f"{name}_s") * 1e6
        self.params["sd_ok_m"], self.params["sd_lost_m"] = settings.sd_ok_m, settings.sd_lost_m
        self.params["needed"][0] = Kind.PRESSURE in uses, Kind.GNSS in uses
        self.state: Rows = rows(HEALTH)
        self.state["health"] = Health.LOST
        for name in ("alive_us", "height_us", "usable_us", "back_us", "before_us"):
            self.state[name] = NEVER_US
        self._heard = ""
        """the reason while the vehicle is silent: who else is heard"""
        self.restart()

    @property
    def health(self) -> Health:
        return _HEALTHS[int(self.state["health"][0])]

    @property
    def has_altitude(self) -> bool:
        """Whether there is an altitude that is possible, certain enough, and supported."""
        return bool(self.state["has_altitude"][0])

    @property
    def is_vehicle_silent(self) -> bool:
        """Whether it is LOST because nothing of the vehicle is heard."""
        return bool(self.state["reason"][0] == steps.OF_HOST and self.state["detail"][0] == 1)

    @property
    def reason(self) -> str:
        """Why the health is what it is."""
        state, settings = self.state[0], self._settings
        code, detail, value_m = int(state["reason"]), int(state["detail"]), float(state["value_m"])
        texts = {
            steps.NOTHING_YET: "nothing heard yet",
            steps.NO_ALTITUDE: "no altitude yet",
            steps.IMPOSSIBLE: "altitude impossible",
            steps.NO_USABLE: f"no usable height for {settings.lost_s:g} s",
            steps.UNCERTAIN: f"altitude uncertain by {value_m:.0f} m",
            steps.MAY_BE_WRONG: f"altitude may be wrong by {value_m:.0f} m",
            steps.GOOD: f"altitude good to {value_m:.1f} m",
            steps.OF_HOST: self._silence(detail),
        }
        if code == steps.OBJECTED:
            return OBJECTIONS[detail].format(value_m)
        if code == steps.EXCLUDED:
            return _excluded(FaultySensor(detail), int(state["detail_us"]))
        return _missing(detail) if code == steps.MISSING else texts[code]

    def restart(self) -> None:
        """Forget every instant: the vehicle's clock started anew."""
        steps.restart(self.state)

    def shift(self, by_us: int) -> None:
        """Shift every instant by the length of our own interruption, in which the vehicle was not
        silent."""
        state = self.state[0]
        for k in range(2):
            if state["used_us"][k] != NEVER_US:
                state["used_us"][k] += by_us
        if state["better_since_us"] != NEVER_US:
            state["better_since_us"] += by_us
        state["alive_us"] = state["height_us"] = state["usable_us"] = NEVER_US
        state["back_us"] = NEVER_US
        state["shift_us"], state["before_us"] = by_us, NEVER_US

    def alive(self, host_us: int) -> None:
        """A frame of the vehicle arrived."""
        steps.alive(self.state, self.params, host_us)

    def sample(self, kind: Kind, verdict: Verdict, now_us: int, host_us: int) -> None:
        """A sample of the primary instance got this verdict.

        `now_us` is the vehicle's clock, `host_us` when the sample arrived.
        """
        steps.heard(self.state, self.params, int(kind), int(verdict), now_us, host_us)

    def age(self, host_us: int, others: Callable[[], str]) -> bool:
        """Set health to LOST when the vehicle has been silent on the host's clock; True when it
        changed.

        `others` tells who else is heard.
        """
        silence = steps.silence(self.state, self.params, host_us)
        if not silence:
            return False
        changed = self.health is not Health.LOST
        if silence == 1:
            heard = others()
            self._heard = f"vehicle silent, heard: {heard}" if heard else "nothing heard"
        steps.lose(self.state, self.params, silence, host_us)
        return changed

    def is_due(self, now_us: int) -> bool:
        """Whether the last assessment is old enough for one without a new measurement."""
        return bool(steps.is_due(self.state, now_us))

    def assess(self, now_us: int, estimate: Rows, objection: int = 0, value_m: float = 0.0) -> bool:
        """Bring `health` and `reason` up to date; True when the health changed.

        `objection` is the code (`companion.checker.OBJECTIONS`) of why the sensors do not support
        the altitude, with the size that its text names; 0 when they do.
        """
        return bool(steps.assess(self.state, self.params, now_us, estimate, objection, value_m))

    def _silence(self, code: int) -> str:
        if code == 2:
            return "vehicle heard, but no barometer and no GNSS"
        return f"no usable height for {self._settings.lost_s:g} s" if code == 3 else self._heard


def _missing(code: int) -> str:
    """Text of a code of `health_steps`: which sensor is missing, and its last verdict."""
    name, verdict = SENSORS[code // 8], code % 8
    if verdict == 7:
        return f"no {name}"
    return f"{name} {'silent' if verdict == Verdict.USED else Verdict(verdict).name.lower()}"


def excluded(estimate: Rows) -> str:
    """Which sensor the estimator excludes, and since when on the vehicle's clock; empty when
    none."""
    sensor = FaultySensor(int(estimate[0]["faulty"]))
    if sensor is FaultySensor.NONE:
        return ""
    return _excluded(sensor, int(estimate[0]["faulty_since_us"]))


def _excluded(sensor: FaultySensor, since_us: int) -> str:
    return f"{EXCLUDED_NAMES[sensor]} excluded since {max(0, since_us) * 1e-6:.0f} s"
