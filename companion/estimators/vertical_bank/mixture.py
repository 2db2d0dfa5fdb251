"""Several vertical channels at one instant: inertial integration, propagation, and the interacting
bank.

`BANK` channels differ in the drift rate that they expect of the weather; they are the models of an
interacting multiple model filter (Blom, Bar-Shalom 1988). Letters of that paper: mu
``probability``, p_ij from ``switching_s``, mixing probabilities ``share``. The others
(`vertical_integrity`) are copies that leave something out.

All stand at ``filter_us``. Specific force turned up is integrated as it comes; the channels move
only when a measurement does, over the whole stretch at once, which is exact since nothing changes
their biases in between.
"""

import math
from typing import Any

from companion.estimators.vertical_bank.channel import (
    ACCEL,
    CLIMB,
    FAST,
    OFFSET,
    RATE,
    SCALE,
    SIZE,
    begin,
    decay,
    duplicate,
    propagate,
)
from companion.jit import step
from companion.kernels.levelling import DISTURBANCE_TIME_S
from companion.kernels.ring import at, clear, push, ring_fields
from companion.samples import Rows

BANK = 3
FREE = 4
NO_BARO, NO_IMU, STIFF, TAKEOFF, NO_GNSS = range(BANK, BANK + 5)
"""the copies: without barometer; without IMU; of barometer and IMU alone, believing both, since now
and since take-off; and, from `NO_GNSS` on, `FREE` of them without GNSS since different instants"""
CHANNELS = NO_GNSS + FREE

BLIND_US = 250_000
"""IMU samples further apart than this leave a gap that nothing is known about"""
NORMAL_INTERVAL_S = 0.02
"""of an IMU stream with the noise of the settings"""
LONGEST_STEP_S, MOST_STEPS = 1.0, 100
MIX_US = 1_000_000
RING_SIZE = 160
RING_SPACING_US = 8_000
"""together the delay horizon of a second and more"""
SHAKING_TIME_S, STAYING_TIME_S = 1.0, 60.0
START_CLIMB_M2PS2 = 900.0


def mixture_fields() -> tuple[tuple[Any, ...], ...]:
    """The state fields of this component."""
    return (
        *ring_fields("fallen", RING_SIZE),  # S at recent instants
        ("x", "f8", (CHANNELS, SIZE)),
        ("P", "f8", (CHANNELS, SIZE, SIZE)),
        ("steady", "f8", (CHANNELS, SIZE)),  # stationary variance of the Gauss-Markov states
        ("walk", "f8", (CHANNELS, SIZE)),  # growth of variance in a second
        ("weight", "f8", (BANK,)),  # model probabilities when last mixed
        ("evidence", "f8", (BANK,)),  # log likelihood since
        ("probability", "f8", (BANK,)),  # of both
        ("mixed_x", "f8", (BANK, SIZE)),
        ("mixed_P", "f8", (BANK, SIZE, SIZE)),
        ("average", "f8", (SIZE,)),  # of the bank
        ("cov", "f8", (SIZE, SIZE)),
        ("keep", "f8", (SIZE,)),
        ("H", "f8", (SIZE,)),
        ("K", "f8", (SIZE,)),
        ("filter_us", "i8"),  # the instant of all channels, -1 before the first measurement
        ("mixed_us", "i8"),
        ("up_us", "i8"),  # newest upward acceleration
        ("up_mps2", "f8"),
        ("shake_psd", "f8"),  # of what it changes by from sample to sample
        ("tilt_psd", "f8"),  # of its error by a wrong attitude
        (
            "across_new",
            "f8",
            (3,),
        ),  # horizontal specific force in the body, over a second and over a minute
        ("across_old", "f8", (3,)),
        ("inertial_us", "i8"),  # until when it is integrated
        ("gained_v", "f8"),  # integrated once and twice since filter_us
        ("gained_h", "f8"),
        ("gained_psd", "f8"),
        ("gained_tilt_psd", "f8"),
        ("V", "f8"),  # the same since the start
        ("S", "f8"),
        ("path_m", "f8"),  # displacement since the start, without any correction
    )


@step
def mixture_start(state: Rows, params: Rows) -> None:
    """Nothing known."""
    s, p = state[0], params[0]
    clear(s.fallen_us, s.fallen_values)
    s.filter_us, s.mixed_us, s.up_us, s.inertial_us = -1, -1, -1, -1
    s.up_mps2, s.shake_psd, s.tilt_psd = math.nan, 0.0, 0.0
    for i in range(3):
        s.across_new[i], s.across_old[i] = 0.0, 0.0
    s.gained_v, s.gained_h, s.gained_psd, s.gained_tilt_psd = 0.0, 0.0, 0.0, 0.0
    s.V, s.S, s.path_m = 0.0, 0.0, 0.0
    for i in range(CHANNELS):
        begin(s.x[i], s.P[i])
        for k in range(SIZE):
            s.steady[i, k] = 0.0
            s.walk[i, k] = 0.0
        s.P[i, CLIMB, CLIMB] = START_CLIMB_M2PS2
        s.P[i, ACCEL, ACCEL] = p.accel_bias_sd_mps2 * p.accel_bias_sd_mps2
        s.walk[i, ACCEL] = p.accel_bias_walk_mps2 * p.accel_bias_walk_mps2
    for i in range(BANK):
        expect_weather(state, params, i, p.rate_sd_mps[i])
        s.P[i, RATE, RATE] = s.steady[i, RATE]
        s.P[i, FAST, FAST] = s.steady[i, FAST]
        s.weight[i] = p.weather_prior[i]
        s.probability[i] = p.weather_prior[i]
        s.evidence[i] = 0.0


@step
def expect_weather(state: Rows, params: Rows, i: int, rate_sd_mps: float) -> None:
    """Let channel `i` expect that the barometer's error drifts at rates of this size."""
    s, p = state[0], params[0]
    s.walk[i, OFFSET] = p.offset_walk_m * p.offset_walk_m
    s.walk[i, SCALE] = p.scale_walk_ratio * p.scale_walk_ratio
    s.steady[i, RATE] = rate_sd_mps * rate_sd_mps
    s.steady[i, FAST] = p.fast_sd_m * p.fast_sd_m


@step
def integrate(state: Rows, params: Rows, to_us: int) -> None:
    """Integrate the newest upward acceleration until `to_us`; without one that is fresh, count the
    time as blind."""
    s, p = state[0], params[0]
    if s.inertial_us < 0:
        s.inertial_us = to_us
    dt = (to_us - s.inertial_us) * 1e-6
    if dt <= 0.0:
        return
    seen = not math.isnan(s.up_mps2) and to_us - s.up_us <= BLIND_US
    up = s.up_mps2 if seen else 0.0
    psd, tilt_psd = p.blind_noise_mps2 * p.blind_noise_mps2, 0.0
    if seen:
        psd = min(psd, inertial_psd(state, params))
        tilt_psd = min(p.blind_noise_mps2 * p.blind_noise_mps2, p.tilt_ratio * s.tilt_psd)
    s.gained_h += s.gained_v * dt + 0.5 * up * dt * dt
    s.gained_v += up * dt
    s.gained_psd += psd * dt
    s.gained_tilt_psd += tilt_psd * dt
    s.S += s.V * dt + 0.5 * up * dt * dt
    s.V += up * dt
    s.inertial_us = to_us
    newest_us = s.fallen_us[(s.fallen_us[RING_SIZE] + RING_SIZE - 1) % RING_SIZE]
    if to_us - newest_us >= RING_SPACING_US:
        push(s.fallen_us, s.fallen_values, to_us, s.S)


@step
def inertial_psd(state: Rows, params: Rows) -> float:
    """Spectral density of the upward acceleration's noise, m2/s3: as it shakes, but no less than
    that of a fast stream, and no more than a slow one may miss, which grows with T^3. Vibration is
    a tone: it shakes more than it moves."""
    noise = params[0].accel_noise_mps2
    slower = max(1.0, state[0].attitude.interval_s / NORMAL_INTERVAL_S)
    return max(noise * noise, min(state[0].shake_psd, noise * noise * slower * slower * slower))


@step
def is_inertial(state: Rows) -> bool:
    """Whether an upward acceleration is known now."""
    s = state[0]
    return not math.isnan(s.up_mps2) and s.filter_us - s.up_us <= BLIND_US


@step
def take_acceleration(state: Rows, params: Rows, time_us: int, up_mps2: float) -> None:
    """The upward acceleration of the stretch since the last one, if that was not long ago; NaN is
    unknown."""
    s = state[0]
    before_us, s.up_us = s.up_us, time_us
    note_shake(state, up_mps2)
    s.up_mps2 = up_mps2 if time_us - before_us <= BLIND_US else math.nan
    integrate(state, params, time_us)
    s.up_mps2 = up_mps2


@step
def note_shake(state: Rows, up_mps2: float) -> None:
    """What a stream misses between its samples: they stand for an interval T each, and shaken by w,
    for a density w2 T.

    So a slow stream is as good as a fast one while nothing shakes.
    """
    s, change_mps2 = state[0], up_mps2 - state[0].up_mps2
    if not math.isnan(change_mps2):
        share = min(1.0, s.attitude.interval_s / SHAKING_TIME_S)
        s.shake_psd += share * (
            0.5 * change_mps2 * change_mps2 * s.attitude.interval_s - s.shake_psd
        )


@step
def note_tilt(state: Rows, sample: Rows) -> None:
    """How much a wrong attitude may spoil the upward acceleration: its error turns horizontal force
    into vertical.

    Only a change of the horizontal force counts: what stays is in the accelerometer bias, what
    shakes averages out. Entering a turn with 40 degrees of bank, 8 m/s2 become horizontal, and 0.02
    rad are 0.16 m/s2, for as long as a disturbance of the attitude lasts.
    """
    s, up, force = state[0], state[0].attitude.own.up_b, sample[0].specific_force_b_mps2
    s.tilt_psd = 0.0
    if math.isnan(up[0]):
        return
    along = force[0] * up[0] + force[1] * up[1] + force[2] * up[2]
    new_share = min(1.0, s.attitude.interval_s / SHAKING_TIME_S)
    old_share = min(1.0, s.attitude.interval_s / STAYING_TIME_S)
    changed2 = 0.0
    for i in range(3):
        across = force[i] - along * up[i]
        s.across_new[i] += new_share * (across - s.across_new[i])
        s.across_old[i] += old_share * (across - s.across_old[i])
        changed2 += (s.across_new[i] - s.across_old[i]) ** 2
    s.tilt_psd = 2.0 * DISTURBANCE_TIME_S * s.attitude.own.tilt_var * changed2


@step
def tilt_mps2_squared(state: Rows) -> float:
    """Variance of the upward acceleration by a wrong attitude, now."""
    return state[0].tilt_psd / (2.0 * DISTURBANCE_TIME_S) if is_inertial(state) else 0.0


@step
def known_displacement(state: Rows, time_us: int) -> float:
    """T V - (S(t) - S(t - T)) of `vertical_channel`, for a measurement of `time_us`, older than the
    channels."""
    s = state[0]
    late_s = (s.filter_us - time_us) * 1e-6
    then = at(s.fallen_us, s.fallen_values, time_us, BLIND_US)
    return 0.0 if math.isnan(then) else late_s * s.V - (s.S - then)


@step
def advance(state: Rows, params: Rows, to_us: int) -> None:
    """Bring every channel to `to_us`, or to where the inertial integrals stand, in steps of a
    second at most.

    The integrals belong to that instant: a channel left behind it would meet a late fix with those
    of another time, and be wrong by V times the difference, which grows with the flight.
    """
    s, p = state[0], params[0]
    to_us = max(to_us, s.inertial_us)
    integrate(state, params, to_us)
    total_s = (to_us - s.filter_us) * 1e-6
    if s.filter_us >= 0 and total_s > 0.0:
        steps = min(MOST_STEPS, int(total_s / LONGEST_STEP_S) + 1)
        dt = total_s / steps
        dv = s.gained_v / steps
        dh = s.gained_h if steps == 1 else 0.5 * dv * dt
        psd, tilt_psd = s.gained_psd / total_s, s.gained_tilt_psd / total_s
        blind_psd = p.blind_noise_mps2 * p.blind_noise_mps2
        decay(s.keep, dt, p.rate_time_s, p.fast_time_s, p.gnss_time_s)
        for _ in range(steps):
            for i in range(CHANNELS):
                if i == NO_IMU:
                    propagate(
                        s.x[i], s.P[i], s.keep, s.steady[i], s.walk[i], dt, 0.0, 0.0, blind_psd
                    )
                    continue
                noise = psd if i == STIFF else psd + tilt_psd
                moved = propagate(s.x[i], s.P[i], s.keep, s.steady[i], s.walk[i], dt, dv, dh, noise)
                if i < BANK:
                    s.path_m += s.probability[i] * moved
    if to_us > s.filter_us:
        s.gained_v, s.gained_h, s.gained_psd, s.gained_tilt_psd = 0.0, 0.0, 0.0, 0.0
        s.filter_us = to_us
    mix(state, params)


@step
def weigh(state: Rows) -> None:
    """Model probabilities: those of the last mixing times the likelihood since."""
    s = state[0]
    best = max(s.evidence[0], s.evidence[1], s.evidence[2])
    total = 0.0
    for i in range(BANK):
        s.probability[i] = s.weight[i] * math.exp(s.evidence[i] - best)
        total += s.probability[i]
    for i in range(BANK):
        s.probability[i] /= total


@step
def combine(state: Rows) -> None:
    """Mean and covariance of the bank."""
    s = state[0]
    weigh(state)
    for k in range(SIZE):
        s.average[k] = 0.0
        for i in range(BANK):
            s.average[k] += s.probability[i] * s.x[i, k]
    for k in range(SIZE):
        for m in range(k, SIZE):
            total = 0.0
            for i in range(BANK):
                apart = (s.x[i, k] - s.average[k]) * (s.x[i, m] - s.average[m])
                total += s.probability[i] * (s.P[i, k, m] + apart)
            s.cov[k, m] = total
            s.cov[m, k] = total


@step
def mix(state: Rows, params: Rows) -> None:
    """Interaction: each channel restarts from what all say, weighed by how likely the weather
    changed to its kind."""
    s, p = state[0], params[0]
    elapsed_us = s.filter_us - s.mixed_us
    if s.mixed_us >= 0 and elapsed_us < MIX_US:
        return
    change = 0.0 if s.mixed_us < 0 else 1.0 - math.exp(-elapsed_us * 1e-6 / p.switching_s)
    s.mixed_us = s.filter_us
    weigh(state)
    for j in range(BANK):
        s.weight[j] = (1.0 - change) * s.probability[j] + change * p.weather_prior[j]
        for k in range(SIZE):
            s.mixed_x[j, k] = 0.0
            for m in range(SIZE):
                s.mixed_P[j, k, m] = 0.0
        for i in range(BANK):
            share = mixing_share(state, params, i, j, change)
            for k in range(SIZE):
                s.mixed_x[j, k] += share * s.x[i, k]
        for i in range(BANK):
            share = mixing_share(state, params, i, j, change)
            for k in range(SIZE):
                for m in range(SIZE):
                    apart = (s.x[i, k] - s.mixed_x[j, k]) * (s.x[i, m] - s.mixed_x[j, m])
                    s.mixed_P[j, k, m] += share * (s.P[i, k, m] + apart)
    for j in range(BANK):
        duplicate(s.x[j], s.P[j], s.mixed_x[j], s.mixed_P[j])
        s.evidence[j] = 0.0


@step
def mixing_share(state: Rows, params: Rows, i: int, j: int, change: float) -> float:
    """Probability that it was model `i` when it is model `j` now: p_ij mu_i / sum."""
    s = state[0]
    stay = 1.0 - change if i == j else 0.0
    return (stay + change * params[0].weather_prior[j]) * s.probability[i] / s.weight[j]
