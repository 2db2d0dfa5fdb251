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

from companion.intake import screen_steps as steps
from companion.intake.screen_steps import NONE, SCREEN, SCREEN_PARAMS
from companion.intake.settings import IntakeSettings
from companion.samples import Kind, Rows, rows

logger = logging.getLogger("kollsman.intake")

_NAMES = {Kind.PRESSURE: "barometer", Kind.GNSS: "GNSS height"}


class DatumScreen:
    """Marks rows of barometers and of the first GNSS receiver that are finite and in range, and
    still impossible."""

    def __init__(self, settings: IntakeSettings) -> None:
        self.state: Rows = rows(SCREEN)
        self.params: Rows = rows(SCREEN_PARAMS)
        for name in ("datum_limit_m", "datum_limit_ratio", "credible_gnss_sd_m", "step_limit_m"):
            self.params[name] = getattr(settings, name)
        self.params["datum_time_us"] = settings.datum_time_s * 1e6
        self._told = 0
        self.restart()

    def restart(self) -> None:
        """Forget everything, as after a reboot."""
        steps.forget(self.state)

    def baro_m(self, time_us: int) -> float:
        """The height of the first barometer; NaN when it is older than 5 s."""
        return float(steps.baro_m(self.state, time_us))

    def gnss(self, row: Rows) -> None:
        """Note a credible GNSS height, and mark it when it is the suspect."""
        steps.judge_fix(self.state, self.params, row)
        self.tell()

    def pressure(self, row: Rows) -> None:
        """Judge a pressure, and mark it when it is the suspect."""
        steps.judge_pressure(self.state, self.params, row)
        self.tell()

    def tell(self) -> None:
        """Log a suspect that changed, once."""
        changes = int(self.state["changes"][0])
        if changes == self._told:
            return
        self._told = changes
        state = self.state[0]
        instance, suspect = int(state["changed"]), int(state["suspect"])
        verdict = (
            "believed again" if suspect == NONE else f"the {_NAMES[Kind(suspect)]} is not used"
        )
        logger.warning(
            "barometer %d reads %.0f m, GNSS %.0f m: %s",
            instance,
            state["baros"]["height_m"][instance],
            state["gnss_m"],
            verdict,
        )
