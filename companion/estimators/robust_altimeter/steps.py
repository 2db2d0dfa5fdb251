"""Fault-tolerant integrated baro-inertial-GPS altimeter.

A. Mañero Contreras, C. Hajiyev, "Robust Kalman Filter-Based Fault-Tolerant Integrated
Baro-Inertial-GPS Altimeter",
2019. Its equations are in `vertical_error`, its altimeters in `integrated_altimeters` and
      `fault_isolation`. Letters:

==================  ======================  ===========================================================================
H_I                 ``height_m[k]``         height of the mechanised vertical channel of altimeter k: IBI 0, IIG 1
X                   ``x[k]``                its errors (8): height, climb, acceleration, gravity, barometer's bias
P, K                ``P[k]``, ``K``         covariance, gain
Z                   ``Z_sum``, ``Z_count``  H_I - h_B or H_I - h_GPS (10), mean over an iteration
R                   `height_variance`              (13), (18)
prob(1/i)           ``prob[k]``             posterior probability of normal operation (32)
IBIG                `write_estimate`        the two altimeters weighted by each other's variance (19)-(21)
==================  ======================  ===========================================================================

Three integrated altimeters run side by side: IBI and IIG each mechanise the upward specific force
and estimate its errors from the barometer or from GNSS; IBIG weighs them. ``publish`` says which
one becomes the estimate. ``gain`` is optimal (22) or robust (28), where a measurement counts with
the probability that it is normal. ``trust`` in the state is what the paper's conclusions recommend:
IBIG while nothing is faulty, the healthy one of two, IBIG again when both are faulty; ``publish:
recommended`` obeys it, and the estimate names the sensor.

Errata
------
(14) has five elements for the four states of (15). sigma_w of Table 1 enters no equation. sigma_B = 1 m as the driving
noise of (2) makes a bias of 5.0 m; 0.2 makes one of 1 m, and both presets use that. (26) reduces P as if the
measurement had counted in full, whatever prob(1/i): neither P nor the weights of (19) see a fault.

Departures
----------
- Closed loop: the estimated errors of height and climb are taken out of the mechanisation after
  each iteration, those of acceleration and gravity while it integrates. Open loop, the errors of a
  small IMU grow to kilometres.
- An iteration takes T_d = 0.5 s as in the paper, or as long as no measurement comes; what arrives
  meanwhile is averaged, without what lies beyond 3 sigma as long as anything lies within (robust
  gain). A fix meets the height of its own time.
- Re-acquisition: the paper has none, and after a fault of 15 m its robust filter never listens
  again. When prob(1/i) has been below 0.5 for ``reacquire_s``, the altimeter takes its height from
  the measurement and its climb from the other altimeter. For so long the inertial channel alone is
  better than what it rejects: 10 s with a small IMU, 120 s with the paper's.
- Preset ``tuned`` is for small IMUs: sigma_Daz stands for an acceleration error of 0.1 m/s2 that
  changes within 30 s (attitude errors of 1-2 degrees in turns); the paper's 2e-5 is navigation
  grade (preset ``paper``). sigma_GPS is what the receiver claims, and the paper's 2.23 m at least.
- The paper's "central processing unit" aligns the datum of the barometer with that of the inertial
  channel. Here it is the running mean of barometer less IIG height over ``reference_s``, for as
  long as correlated GNSS errors last (300 s); a large difference moves it little. It stands still
  while one altimeter is in doubt, and begins anew when a difference outlasts the doubt, or grows
  beyond 2 sigma for 10 s as slowly as weather and climbs make it grow.
- When both altimeters refuse their measurements twice in the same direction, it is the IMU: both
  re-acquire. The paper's scenario 3, the same bias on both sensors at once, looks alike.
- Fault isolation: an altimeter is in doubt when prob(1/i), averaged over 3 s, is below 0.5, and
  then until the two agree again, for 60 s at most. When they part without that it is the one that
  has jumped, or the barometer if fast.
- Without an IMU that can be integrated (below about 10 Hz, silent for 0.5 s, attitude unknown; slow
  samples are IGNORED) the acceleration is unknown: 2 m/s2 for 2 s, R has no sigma_INS, and the
  robust gain refuses no more than one iteration. IBI then follows the barometer, IIG GNSS.
- ``altitude_sd_m`` is not sqrt(P): see `spread_m`. An altimeter whose own sqrt(P) exceeds 100 m
  starts anew.

Breaks when
-----------
The air is warmer or colder than standard and the vehicle climbs, or weather changes: IBIG keeps its share of the
barometer's error until the datum has followed. GNSS that drifts, or is wrong by less than 4 sigma, takes the datum
along. A fault below about 20 m passes the robust gain in part, bends the climb, and is worse than with the optimal
gain. Preset ``paper`` on a small IMU: it believes an accelerometer that is wrong by 0.1 m/s2, by tens of metres.
"""

import math
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from companion.config import Settings
from companion.estimators.judging import (
    ATTITUDE,
    GNSS,
    IGNORED,
    IMU,
    PRESSURE,
    STATUS,
    USED,
    forget,
    judge_attitude,
    judge_gnss,
    judge_imu,
    judge_pressure,
    place,
    reset,
    state_dtype,
    tally,
)
from companion.estimators.method import Method
from companion.estimators.robust_altimeter.altimeters import (
    ALTIMETER_FIELDS,
    ALTIMETER_PARAMS,
    FRESH_US,
    advance,
    altimeters_start,
    begin,
    correct_errors,
    extrapolate_errors,
    gather,
    lost,
    switch,
)
from companion.estimators.robust_altimeter.error_model import IBI, IIG, share
from companion.estimators.robust_altimeter.isolation import (
    CORRELATED_SHARE,
    TRUST_IBI,
    TRUST_IIG,
    expected_apart_m,
)
from companion.jit import step
from companion.kernels.atmosphere import baro_altitude_m
from companion.kernels.attitude import (
    ATTITUDE_STATE,
    attitude_gnss,
    attitude_imu,
    attitude_start,
    attitude_vehicle,
    imu_can_be_integrated,
    up_acceleration_mps2,
)
from companion.kernels.gnss import gnss_sd_m
from companion.kernels.ring import at
from companion.samples import FaultySensor, Kind, Rows, Tables, readable, rows

LOWEST_PA, HIGHEST_PA = 1_000.0, 120_000.0
IMU_TIMEOUT_US = 500_000
COLUMN_ERROR = 0.035
"""Of a height gained: the air's temperature is off by 10 K of 288."""

IBIG, RECOMMENDED = 2, 3
BAROMETER, RECEIVER = int(FaultySensor.BAROMETER), int(FaultySensor.GNSS)
PUBLISH = {"ibi": IBI, "iig": IIG, "ibig": IBIG, "recommended": RECOMMENDED}

STATE = state_dtype(
    ("attitude", ATTITUDE_STATE),
    *ALTIMETER_FIELDS,
    ("baro_m", "f8"),  # newest barometer height
    ("innovation_m", "f8"),  # newest GNSS height less the predicted one
)

PARAMS = np.dtype(
    [
        *ALTIMETER_PARAMS,
        ("weather_mps", "f8"),
        ("publish", "i8"),
        ("use_attitude", "i8"),
    ],
    align=True,
)

PAPER = {"sigma_a": 2e-5, "P_a": 1e-6, "reacquire_s": 120.0}
TUNED = {"sigma_a": 0.037, "P_a": 0.01, "reacquire_s": 10.0}
"""sigma_a: the variance 0.1^2 with a time constant of 30 s has the noise density 2 0.1^2 / 30 = T_d
sigma_a^2."""
MANOEUVRE_MPS2, MANOEUVRE_S = 2.0, 2.0
"""Acceleration of a vehicle that nobody measures, and for how long it stays the same: a climb of 4
m/s begins."""
BLIND_PATIENCE_S = 0.1
"""``reacquire_s`` without an IMU: one iteration is refused, not two in a row."""


Patience = Annotated[float, Field(gt=0, le=3600)]


class RobustAltimeterSettings(Settings):
    """Section ``estimators.robust-altimeter``."""

    preset: Literal["tuned", "paper"] = "tuned"
    """inertial errors of a small IMU, or those of the paper's navigation-grade one"""
    gain: Literal["robust", "optimal"] = "robust"
    """weigh a measurement by its probability of being normal, or not"""
    publish: Literal["ibig", "ibi", "iig", "recommended"] = "ibig"
    """both altimeters fused, the one by barometer, the one by GNSS, or whichever fault isolation
    recommends"""
    use_attitude: bool = True
    """take the autopilot's roll and pitch while they agree with our own"""
    reacquire_s: Patience | Literal["preset", "never"] = "preset"
    """how long a measurement may be refused: 10 s in preset tuned, 120 s in paper; never is the
    paper's filter"""
    reference_s: float = Field(300.0, gt=0, le=1e6)
    """over how long the barometer's datum is averaged"""
    gnss_sd_floor_m: float = Field(2.23, gt=0, le=100)
    """a claimed spread below this is not believed"""
    gnss_sd_unknown_m: float = Field(13.0, gt=0, le=1000)
    """spread of a receiver that claims nothing"""
    pressure_drift_mps: float = Field(0.003, ge=0, le=10)
    """how fast weather moves the pressure level: 10 m an hour is usual, 30 a front"""

    def params(self) -> Rows:
        row = rows(PARAMS)
        preset = PAPER if self.preset == "paper" else TUNED
        row["T_d"], row["beta_g"], row["beta"], row["H"] = 0.5, 0.005, 0.01, 1000.0
        row["sigma_g"], row["sigma_UB"] = 2e-5, 0.2
        row["alpha"] = 1.0 / MANOEUVRE_S, 0.001
        row["sigma_a"] = (
            math.sqrt(2.0 * MANOEUVRE_MPS2**2 / MANOEUVRE_S / row["T_d"][0]),
            preset["sigma_a"],
        )
        row["P_a"] = MANOEUVRE_MPS2**2, preset["P_a"]
        row["rows_H"] = ((1.0, 0.0, 0.0, 0.0, -1.0), (1.0, 0.0, 0.0, 0.0, 0.0))
        row["sigma_INS"], row["sigma_B"], row["sigma_GPS"] = 3.0, 1.0, self.gnss_sd_floor_m
        row["sigma_GPS_unknown"] = self.gnss_sd_unknown_m
        row["P_W"], row["P_g"] = 25.0, 1e-6
        chosen = self.reacquire_s
        reacquire_s = (
            preset["reacquire_s"]
            if chosen == "preset"
            else math.inf
            if chosen == "never"
            else chosen
        )
        row["reacquire_s"] = BLIND_PATIENCE_S, reacquire_s
        row["blame_imu"] = chosen != "never"
        row["reference_s"], row["weather_mps"] = self.reference_s, self.pressure_drift_mps
        row["robust"], row["publish"] = self.gain == "robust", PUBLISH[self.publish]
        row["use_attitude"] = self.use_attitude
        return row


def init(params: Rows) -> Rows:
    """A fresh state: nothing known."""
    state = rows(STATE)
    start(state)
    return readable(state)


@step
def start(state: Rows) -> None:
    """Forget everything but the counters."""
    reset(state)
    attitude_start(state[0].attitude)
    altimeters_start(state)
    state[0].baro_m = math.nan
    state[0].innovation_m = math.nan


@step
def listen(state: Rows, params: Rows, time_us: int) -> float:
    """Before a height is taken in: mechanise without an IMU if it is silent; the iteration that
    begins, or 0."""
    s = state[0]
    if s.inertial == 1 and s.now_us - s.attitude.time_us > IMU_TIMEOUT_US:
        switch(state, params, 0)
    if s.inertial == 0:
        advance(state, time_us, 0.0)
    return extrapolate_errors(state, params)


@step
def answer(state: Rows, params: Rows, T: float, estimate: Rows) -> None:
    """After a sample: end the iteration, if one began, and publish."""
    if T > 0.0:
        correct_errors(state, params, T)
    write_estimate(state, params, estimate)


@step
def on_imu(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """Mechanise both altimeters with the upward specific force."""
    s = state[0]
    if sample[0].instance != 0:
        return tally(state, IMU, IGNORED)
    verdict = judge_imu(state, sample)
    if verdict != USED:
        return tally(state, IMU, verdict)
    place(state, IMU, 0, sample[0].time_us)
    attitude_imu(state[0].attitude, sample)
    up = up_acceleration_mps2(state[0].attitude, sample)
    if math.isnan(up):
        switch(state, params, 0)
        return tally(state, IMU, USED if imu_can_be_integrated(state[0].attitude) else IGNORED)
    if s.inertial == 0:
        advance(state, sample[0].time_us, 0.0)
        switch(state, params, 1)
    else:
        advance(state, sample[0].time_us, 0.5 * (s.up_mps2 + up))
    s.up_mps2 = up
    answer(state, params, extrapolate_errors(state, params), estimate)
    return tally(state, IMU, USED)


@step
def on_pressure(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """Z of IBI: mechanised less barometer height (10), (7)."""
    s = state[0]
    if sample[0].instance != 0:
        return tally(state, PRESSURE, IGNORED)
    verdict = judge_pressure(state, sample, LOWEST_PA, HIGHEST_PA)
    if verdict != USED:
        return tally(state, PRESSURE, verdict)
    time_us = sample[0].time_us
    place(state, PRESSURE, 0, time_us)
    T = listen(state, params, time_us)
    s.baro_m = baro_altitude_m(sample[0].pressure_pa)
    since_s = (time_us - s.ins_us) * 1e-6
    if (
        math.isnan(s.reference_m)
        and not lost(state, IIG)
        and time_us - s.last_us[GNSS, 0] < FRESH_US
    ):
        s.reference_at_m = s.height_m[IIG] + since_s * s.climb_mps[IIG]
        s.reference_m = s.baro_m - s.reference_at_m
    if not math.isnan(s.reference_m):
        altitude_m = s.baro_m - s.reference_m
        if lost(state, IBI):
            begin(state, params, IBI, altitude_m)
        else:
            Z = s.height_m[IBI] + since_s * s.climb_mps[IBI] - altitude_m
            verdict = gather(state, params, IBI, Z)
    answer(state, params, T, estimate)
    return tally(state, PRESSURE, verdict)


@step
def on_gnss(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """Z of IIG: height mechanised at the fix's own time less GNSS height (10), (14)."""
    s, p = state[0], params[0]
    if sample[0].instance != 0:
        return tally(state, GNSS, IGNORED)
    verdict = judge_gnss(state, sample)
    if verdict != USED:
        return tally(state, GNSS, verdict)
    time_us = sample[0].time_us
    place(state, GNSS, 0, time_us)
    attitude_gnss(state[0].attitude, sample)
    T = listen(state, params, time_us)
    s.sigma_gps_m = gnss_sd_m(sample, p.sigma_GPS, p.sigma_GPS_unknown)
    if lost(state, IIG):
        begin(state, params, IIG, sample[0].altitude_amsl_m)
    else:
        height_m = at(s.iig_us, s.iig_values, time_us, FRESH_US)
        if math.isnan(height_m):
            height_m = s.height_m[IIG] + (time_us - s.ins_us) * 1e-6 * s.climb_mps[IIG]
        s.innovation_m = sample[0].altitude_amsl_m - height_m
        verdict = gather(state, params, IIG, -s.innovation_m)
    answer(state, params, T, estimate)
    return tally(state, GNSS, verdict)


@step
def on_attitude(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """The autopilot's roll and pitch, if they may be used."""
    if sample[0].instance != 0 or params[0].use_attitude == 0:
        return tally(state, ATTITUDE, IGNORED)
    verdict = judge_attitude(state, sample)
    if verdict == USED:
        place(state, ATTITUDE, 0, sample[0].time_us)
        attitude_vehicle(state[0].attitude, sample)
    return tally(state, ATTITUDE, verdict)


@step
def on_status(state: Rows, params: Rows, sample: Rows, estimate: Rows) -> int:
    """A reboot restarts the vehicle's clock: start anew."""
    if sample[0].reboot == 1:
        start(state)
        forget(estimate)
    return tally(state, STATUS, USED)


@step
def ibi_weight(state: Rows, params: Rows) -> float:
    """Share of IBI in what is published: that of (19), or all, or nothing; NaN when there is
    nothing to publish."""
    s, publish = state[0], params[0].publish
    if publish == RECOMMENDED:
        publish = IBI if s.trust == TRUST_IBI else IIG if s.trust == TRUST_IIG else IBIG
    has_ibi, has_iig = not lost(state, IBI), not lost(state, IIG)
    if publish == IBIG and has_ibi and has_iig:
        return share(s.P[IBI], s.P[IIG])
    if publish != IIG and has_ibi:
        return 1.0
    if publish != IBI and has_iig:
        return 0.0
    return math.nan


@step
def spread_m(state: Rows, params: Rows, ibi: float) -> float:
    """Error to expect: P, what GNSS and the datum have in common for minutes, the datum's age, and
    the disagreement.

    Where the two altimeters are further apart than these explain, one of them is wrong, and nobody
    knows which.
    """
    s, p = state[0], params[0]
    iig, shared = 1.0 - ibi, CORRELATED_SHARE * s.sigma_gps_m * s.sigma_gps_m
    weather = p.weather_mps * (
        min(s.reference_age_s, p.reference_s) + (s.now_us - s.last_us[GNSS, 0]) * 1e-6
    )
    variance, apart2 = shared, 0.0
    if ibi > 0.0:
        column = COLUMN_ERROR * (s.height_m[IBI] - s.reference_at_m)
        variance += ibi * ibi * (s.P[IBI, 0, 0] + weather * weather + column * column)
    if iig > 0.0:
        variance += iig * iig * s.P[IIG, 0, 0]
    if s.runs[IBI] == 1 and s.runs[IIG] == 1:
        apart = s.height_m[IBI] - s.height_m[IIG]
        apart2 = max(0.0, apart * apart - expected_apart_m(state) * expected_apart_m(state))
    return math.sqrt(variance + max(ibi * ibi, iig * iig) * apart2)


@step
def fuse(ibi: float, values: NDArray[Any]) -> float:
    """A quantity of the two altimeters by the weight of the first; the one that counts nothing may
    be NaN."""
    if ibi == 1.0:
        return values[IBI]
    if ibi == 0.0:
        return values[IIG]
    return ibi * values[IBI] + (1.0 - ibi) * values[IIG]


@step
def write_estimate(state: Rows, params: Rows, estimate: Rows) -> None:
    """The published altimeter (19), (21)."""
    s = state[0]
    ibi = ibi_weight(state, params)
    if math.isnan(ibi):
        return
    estimate[0].time_us = s.ins_us
    estimate[0].altitude_amsl_m = fuse(ibi, s.height_m)
    estimate[0].climb_mps = fuse(ibi, s.climb_mps)
    estimate[0].altitude_sd_m = spread_m(state, params, ibi)
    estimate[0].climb_sd_mps = math.sqrt(ibi * s.P[IBI, 1, 1] + (1.0 - ibi) * s.P[IIG, 1, 1])
    estimate[0].baro_offset_m = estimate[0].altitude_amsl_m - s.baro_m
    estimate[0].innovation_m = s.innovation_m
    estimate[0].faulty = (
        BAROMETER if s.trust == TRUST_IIG else RECEIVER if s.trust == TRUST_IBI else 0
    )
    estimate[0].faulty_since_us = s.trust_us if s.trust in (TRUST_IBI, TRUST_IIG) else 0


@step
def run(state: Rows, params: Rows, tables: Tables, estimates: Rows, verdicts: Rows) -> None:
    """The steps over a whole log, in order of arrival."""
    estimate = estimates[:0]
    for i in range(tables.order.size):
        kind, row = tables.order[i].kind, tables.order[i].row
        if i > 0:
            estimates[i] = estimates[i - 1]
        estimate = estimates[i : i + 1]
        if kind == IMU:
            verdicts[i] = on_imu(state, params, tables.imu[row : row + 1], estimate)
        elif kind == PRESSURE:
            verdicts[i] = on_pressure(state, params, tables.pressure[row : row + 1], estimate)
        elif kind == GNSS:
            verdicts[i] = on_gnss(state, params, tables.gnss[row : row + 1], estimate)
        elif kind == ATTITUDE:
            verdicts[i] = on_attitude(state, params, tables.attitude[row : row + 1], estimate)
        elif kind == STATUS:
            verdicts[i] = on_status(state, params, tables.status[row : row + 1], estimate)


METHOD = Method(
    name="robust-altimeter",
    summary="two inertial altimeters, by barometer and by GNSS, with a probability for every measurement",
    citation="Mañero Contreras, Hajiyev 2019",
    settings=RobustAltimeterSettings,
    state=STATE,
    init=init,
    steps={
        Kind.IMU: on_imu,
        Kind.PRESSURE: on_pressure,
        Kind.GNSS: on_gnss,
        Kind.ATTITUDE: on_attitude,
        Kind.STATUS: on_status,
    },
    run=run,
    datum_invariant=True,
    follows_baro_step=True,
)
