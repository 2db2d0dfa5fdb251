"""Plausibility check of barometer and GNSS: which of the two contradicts the other by more than
weather can explain.

Two rules, both on the difference of GNSS height and barometer height:

- **Datum**: half the true pressure (505 hPa at 90 m) is 5400 m wrong. When they agreed before, the
  one that moved since is the suspect; when they never agreed it is the barometer, since the fix
  admits its own accuracy. A barometer that repeats one value for ever is broken, whoever moved.
- **Step**: weather, temperature and climbs change the difference slowly. If it jumps, the one that
  jumped is the suspect at once, before an estimator can follow it. A barometer that stays at its
  new level is accepted there after ``datum_time_s`` (GNSS is the reference), a GNSS height after a
  minute, as receivers correct themselves.

A suspect row is marked; estimators reject it.
"""

import logging
import math
from dataclasses import dataclass

from companion.intake.settings import IntakeSettings
from companion.kernels.atmosphere import baro_altitude_m
from companion.kernels.gnss import HIGHEST_GNSS_M, LOWEST_GNSS_M, gnss_sd_m
from companion.samples import Kind, Rows, Suspicion

logger = logging.getLogger("kollsman.intake")

PAIR_US = 5_000_000
"""largest distance in time of two heights that are compared"""
FROZEN_US = 5_000_000
FASTEST_MPS = 50.0
"""largest difference of heights taken at different instants, for each second"""
GNSS_STEP_US = 60_000_000
_NAMES = {Kind.PRESSURE: "barometer", Kind.GNSS: "GNSS height"}


@dataclass
class _Gnss:
    """The last credible fix."""

    time_us: int
    height_m: float
    sd_m: float


@dataclass
class _Baro:
    """One barometer, and its state beside GNSS."""

    time_us: int
    height_m: float
    changed_us: int
    """start of the repetition of this height"""
    judged_us: int | None = None
    datum: Kind | None = None
    since_us: int | None = None
    """start of the (dis)agreement that contradicts the present state"""
    agreed_m: tuple[float, float] | None = None
    """(barometer, GNSS) at the last agreement on the datum"""
    level: tuple[int, float, float] | None = None
    """(time_us, barometer, GNSS) when they last moved together"""
    step: Kind | None = None
    step_us: int = 0


class DatumScreen:
    """Marks rows of barometers and of the first GNSS receiver that are finite and in range, and
    still impossible."""

    def __init__(self, settings: IntakeSettings) -> None:
        self._settings = settings
        self.restart()

    def restart(self) -> None:
        """Forget everything, as after a reboot."""
        self._gnss: _Gnss | None = None
        self._baros: dict[int, _Baro] = {}

    def baro_m(self, time_us: int) -> float:
        """The height of the first barometer; NaN when it is older than 5 s."""
        baro = self._baros.get(0)
        fresh = baro is not None and abs(time_us - baro.time_us) < PAIR_US
        return baro.height_m if fresh and baro is not None else math.nan

    def gnss(self, row: Rows) -> None:
        """Note a credible GNSS height, and mark it when it is the suspect."""
        value = row[0]
        if value["instance"] != 0:
            return
        height_m, sd_m = float(value["altitude_amsl_m"]), float(gnss_sd_m(row, 0.0, 0.0))
        credible = value["fix_type"] >= 3 and LOWEST_GNSS_M <= height_m <= HIGHEST_GNSS_M
        baro = self._baros.get(0)
        is_late = self._gnss is not None and value["time_us"] < self._gnss.time_us
        if credible and not is_late and sd_m <= self._settings.credible_gnss_sd_m:
            self._gnss = _Gnss(int(value["time_us"]), height_m, sd_m)
            if baro is not None and abs(self._gnss.time_us - baro.time_us) < PAIR_US:
                self._judge_step(0, baro, self._gnss, self._gnss.time_us)
        if baro is not None and Kind.GNSS in (baro.datum, baro.step):
            value["suspect"] = Suspicion.DATUM

    def pressure(self, row: Rows) -> None:
        """Judge a pressure, and mark it when it is the suspect."""
        value = row[0]
        instance, time_us = int(value["instance"]), int(value["time_us"])
        height_m = baro_altitude_m(float(value["pressure_pa"]))
        if not math.isfinite(height_m):
            return
        baro = self._baros.get(instance)
        if baro is None:
            baro = self._baros[instance] = _Baro(time_us, height_m, time_us)
        elif time_us < baro.time_us:
            return  # a late copy
        elif height_m != baro.height_m:
            baro.changed_us = time_us
        baro.time_us, baro.height_m = time_us, height_m
        if self._gnss is not None and abs(time_us - self._gnss.time_us) < PAIR_US:
            self._judge_datum(instance, baro, self._gnss)
            self._judge_step(instance, baro, self._gnss, time_us)
        if Kind.PRESSURE in (baro.datum, baro.step):
            value["suspect"] = Suspicion.DATUM

    @property
    def suspects(self) -> tuple[Kind, ...]:
        """The kinds that are marked as suspect now."""
        return tuple(
            kind
            for baro in self._baros.values()
            for kind in (baro.datum, baro.step)
            if kind is not None
        )

    def _judge_datum(self, instance: int, baro: _Baro, gnss: _Gnss) -> None:
        limit_m = self._settings.datum_limit_m + self._settings.datum_limit_ratio * abs(
            gnss.height_m
        )
        agree = abs(baro.height_m - gnss.height_m) <= limit_m
        first = baro.judged_us is None
        if baro.judged_us is not None and baro.time_us - baro.judged_us > PAIR_US:
            baro.since_us = None  # nobody could tell meanwhile
        baro.judged_us = baro.time_us
        if not first and agree == (baro.datum is None):
            baro.since_us = None
        else:
            baro.since_us = baro.time_us if baro.since_us is None else baro.since_us
            if first or baro.time_us - baro.since_us >= self._settings.datum_time_s * 1e6:
                baro.since_us = None
                is_frozen = baro.time_us - baro.changed_us > FROZEN_US
                moved = Kind.PRESSURE if is_frozen else _mover(baro, gnss, baro.agreed_m)
                baro.datum = None if agree else baro.step or moved
                if not (first and agree):
                    self._say(instance, baro, gnss, baro.datum)
        if agree:
            baro.agreed_m = (baro.height_m, gnss.height_m)

    def _judge_step(self, instance: int, baro: _Baro, gnss: _Gnss, now_us: int) -> None:
        here = (now_us, baro.height_m, gnss.height_m)
        if (
            baro.datum is not None
            or baro.level is None
            or (now_us - baro.level[0] > PAIR_US and baro.step is None)
        ):
            baro.level, baro.step = here, None
            return
        then_us, baro_then_m, gnss_then_m = baro.level
        apart_m = abs((gnss.height_m - gnss_then_m) - (baro.height_m - baro_then_m))
        until_us = now_us if baro.step is None else baro.step_us
        apart_s = (abs(gnss.time_us - baro.time_us) + abs(until_us - then_us)) * 1e-6
        if apart_m <= self._settings.step_limit_m + 3.0 * gnss.sd_m + FASTEST_MPS * apart_s:
            if baro.step is not None:
                self._say(instance, baro, gnss, None)
            baro.level, baro.step = here, None
        elif baro.step is None:
            baro.step, baro.step_us = _mover(baro, gnss, (baro_then_m, gnss_then_m)), now_us
            self._say(instance, baro, gnss, baro.step)
        elif now_us - baro.step_us >= (
            self._settings.datum_time_s * 1e6 if baro.step is Kind.PRESSURE else GNSS_STEP_US
        ):
            baro.level, baro.step = here, None
            self._say(instance, baro, gnss, None)

    @staticmethod
    def _say(instance: int, baro: _Baro, gnss: _Gnss, suspect: Kind | None) -> None:
        verdict = "believed again" if suspect is None else f"the {_NAMES[suspect]} is not used"
        logger.warning(
            "barometer %d reads %.0f m, GNSS %.0f m: %s",
            instance,
            baro.height_m,
            gnss.height_m,
            verdict,
        )


def _mover(baro: _Baro, gnss: _Gnss, then_m: tuple[float, float] | None) -> Kind:
    """The sensor that moved more since the heights `then_m`."""
    if then_m is None:
        return Kind.PRESSURE
    return (
        Kind.GNSS
        if abs(gnss.height_m - then_m[1]) > abs(baro.height_m - then_m[0])
        else Kind.PRESSURE
    )
