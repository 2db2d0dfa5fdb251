"""What every measurement does before it is fused and after: predict, conclude."""

from companion.estimators.vertical_bank.aids import fuse_field, note_takeoff
from companion.estimators.vertical_bank.attribution import attribute, attribution_start
from companion.estimators.vertical_bank.baro_terms.static_port import unseen_head_m2
from companion.estimators.vertical_bank.barometer import unseen_speed_mps
from companion.estimators.vertical_bank.beginning import resume
from companion.estimators.vertical_bank.channel import PORT
from companion.estimators.vertical_bank.hypotheses import search
from companion.estimators.vertical_bank.inertial import forget_manoeuvre, has_seen
from companion.estimators.vertical_bank.mixture import advance, climb_the_column, mean, variance
from companion.estimators.vertical_bank.publishing import publish
from companion.estimators.vertical_bank.switching import switch
from companion.estimators.vertical_bank.takeoff import REST_SPEED_MPS, watch_takeoff
from companion.estimators.vertical_bank.weather import age_weather
from companion.jit import step
from companion.samples import Rows

OUTAGE_S = 5.0
"""A barometer that went wrong in an outage of GNSS as long as this was not seen to do so."""
UNWATCHED_S = 1.5
"""Longer than between two fixes of a slow receiver."""
LONG_SILENCE_US = 60_000_000
"""After so long without any height, what moved is unknown."""
DATUM_SIGMA = 5.0
"""A barometer that is further off after a silence has another datum."""


@step
def is_blind(state: Rows, elapsed_s: float) -> bool:
    """Whether the vehicle's acceleration is unknown now or was within the last `elapsed_s`: an IMU
    that was away too has not denied a motion since the last height."""
    return not has_seen(state[0].imu, state[0].bank.now_us, elapsed_s)


@step
def predict(state: Rows, params: Rows, time_us: int) -> None:
    """Bring the mixture to a measurement; after a long silence of both sensors, begin again."""
    s, p = state[0], params[0]
    bank = s.bank
    before_us = bank.now_us
    k, k2 = mean(bank, PORT), variance(bank, PORT)
    unseen_mps = unseen_speed_mps(s.baro, p, time_us)
    bank.fast_m2 = p.fast_sd_m**2 + unseen_head_m2(s.baro.head_m, unseen_mps, k * k + k2)
    advance(bank, s.imu, p, s.attitude.interval_s, max(time_us, bank.now_us))
    age_weather(bank, p)
    heard_us = max(s.baro.heard_us, s.gnss.used_us)
    if before_us >= 0 and heard_us >= 0 and bank.now_us - heard_us > LONG_SILENCE_US:
        resume(bank, p)
        attribution_start(s.named)
        s.baro.heard_us = bank.now_us


@step
def conclude(state: Rows, params: Rows, estimate: Rows) -> None:
    """Let hypotheses change into each other, name the sensors that are wrong, publish."""
    s, p = state[0], params[0]
    climb_the_column(s.bank)
    if s.bank.switched_us < 0:
        s.bank.switched_us, s.bank.searched_us = s.bank.now_us, s.bank.now_us
    away_s = (s.bank.now_us - s.gnss.used_us) * 1e-6
    s.bank.outage = 1 if s.gnss.seen == 0 or away_s > OUTAGE_S else 0
    s.bank.unwatched = 1 if s.gnss.seen == 0 or away_s > UNWATCHED_S else 0
    if s.bank.unwatched == 1:
        forget_manoeuvre(s.imu, p)
    switch(s.bank, p, s.baro.stuck)
    if p.integrity == 1 and s.gnss.seen == 1 and s.baro.seen == 1:
        search(s.bank, p)
        attribute(s.named, s.bank, p.attribution_probability, is_blind(state, 0.0))
    if watch_takeoff(s.takeoff, s.bank, s.gnss.ground_speed_mps):
        note_takeoff(s.aids, s.bank.now_us)
    if s.takeoff.time_us < 0 and not s.gnss.ground_speed_mps > REST_SPEED_MPS:
        fuse_field(s.aids, s.bank, p)
    state[0].log_likelihood, state[0].innovations = s.bank.evidence, s.bank.heard
    publish(state, params, estimate)
