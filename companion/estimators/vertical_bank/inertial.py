"""The inertial part: upward acceleration between measurements, its integrals and its noise.

Specific force is turned up by `companion.kernels.attitude` and integrated as it comes. The channels
move only when a measurement does, over the whole stretch at once. A stretch without an acceleration
that can be integrated (no IMU, a stream below about 10 Hz, a vague attitude) is blind: no
acceleration, and the noise of manoeuvres.

A precise receiver shows how much a vehicle manoeuvres between its fixes: a blind stretch has the
noise that it showed of late (`learn_manoeuvre`).

An acceleration is as noisy as it changes from sample to sample (`note_shake`), and as the doubt in
the attitude makes it while the vehicle turns (`note_tilt`).
"""

import math

import numpy as np

from companion.jit import step
from companion.kernels.levelling import DISTURBANCE_TIME_S
from companion.kernels.ring import at, clear, push, ring_fields
from companion.samples import Record, Rows

BLIND_US = 250_000
"""IMU samples further apart than this leave a gap that nothing is known about."""
NORMAL_INTERVAL_S = 0.02
"""of an IMU stream with the noise of the settings"""
VAGUE_TILT_RAD = 0.2
"""by which gravity alone shows 0.2 m/s2 too little: as much as the prior of the accelerometer's
bias"""
QUIET_PSD_M2PS3 = 0.1
"""Least noise of a blind stretch: a hover in calm air, 0.2 m/s2 for 1.3 s."""
MANOEUVRE_TIME_S, MOST_SURPRISE = 10.0, 100.0
RING_SIZE, RING_SPACING_US = 160, 8_000
"""together the delay horizon of a second and more"""
SHAKING_TIME_S, STAYING_TIME_S = 1.0, 60.0

INERTIAL = np.dtype(
    [
        *ring_fields("fallen", RING_SIZE),  # S at recent instants
        ("up_us", "i8"),  # newest upward acceleration
        ("up_mps2", "f8"),
        ("since_us", "i8"),  # since when samples have come without a gap
        ("blind_psd", "f8"),  # of the vehicle's acceleration in a blind stretch
        ("shake_psd", "f8"),  # of what it changes by from sample to sample
        ("tilt_psd", "f8"),  # of its error by a wrong attitude
        ("across_new", "f8", (3,)),  # horizontal force in the body, over a second, over a minute
        ("across_old", "f8", (3,)),
        ("until_us", "i8"),  # until when it is integrated
        ("gained_v", "f8"),  # integrated once and twice since the channels' instant
        ("gained_h", "f8"),
        ("gained_psd", "f8"),
        ("gained_s", "f8"),  # length of that stretch, and of its part that is not blind
        ("seen_s", "f8"),
        ("V", "f8"),  # the same since the start
        ("S", "f8"),
    ],
    align=True,
)


@step
def inertial_start(imu: Record, p: Record) -> None:
    """Nothing known."""
    clear(imu.fallen_us, imu.fallen_values)
    imu.up_us, imu.until_us, imu.since_us = -1, -1, -1
    imu.up_mps2, imu.shake_psd, imu.tilt_psd = math.nan, 0.0, 0.0
    for i in range(3):
        imu.across_new[i], imu.across_old[i] = 0.0, 0.0
    imu.V, imu.S, imu.blind_psd = 0.0, 0.0, p.blind_psd_m2ps3
    begin_stretch(imu)


@step
def begin_stretch(imu: Record) -> None:
    """The channels stand where the integrals do."""
    imu.gained_v, imu.gained_h, imu.gained_psd, imu.gained_s, imu.seen_s = 0.0, 0.0, 0.0, 0.0, 0.0


@step
def integrate(imu: Record, p: Record, interval_s: float, to_us: int) -> None:
    """Integrate the newest upward acceleration until `to_us`; without one that is fresh, count the
    time as blind."""
    if imu.until_us < 0:
        imu.until_us = to_us
    dt = (to_us - imu.until_us) * 1e-6
    if dt <= 0.0:
        return
    seen = not math.isnan(imu.up_mps2) and to_us - imu.up_us <= BLIND_US
    up, psd = 0.0, imu.blind_psd
    if seen:
        up = imu.up_mps2
        noise = inertial_psd(imu, p, interval_s) + p.tilt_ratio * imu.tilt_psd
        psd = min(p.blind_psd_m2ps3, noise)
        imu.seen_s += dt
    imu.gained_h += imu.gained_v * dt + 0.5 * up * dt * dt
    imu.gained_v += up * dt
    imu.gained_psd += psd * dt
    imu.gained_s += dt
    imu.S += imu.V * dt + 0.5 * up * dt * dt
    imu.V += up * dt
    imu.until_us = to_us
    newest_us = imu.fallen_us[(imu.fallen_us[RING_SIZE] + RING_SIZE - 1) % RING_SIZE]
    if to_us - newest_us >= RING_SPACING_US:
        push(imu.fallen_us, imu.fallen_values, to_us, imu.S)


@step
def learn_manoeuvre(imu: Record, p: Record, interval_s: float, surprise: float) -> None:
    """After a blind stretch of `interval_s` a precise fix was off by the variance expected times
    `surprise`: the noise of such a stretch is followed until that is 1 on average."""
    share = min(1.0, interval_s / MANOEUVRE_TIME_S)
    psd = imu.blind_psd * math.exp(share * (min(surprise, MOST_SURPRISE) - 1.0))
    imu.blind_psd = min(p.blind_psd_m2ps3, max(min(QUIET_PSD_M2PS3, p.blind_psd_m2ps3), psd))


@step
def forget_manoeuvre(imu: Record, p: Record) -> None:
    """Nobody shows how the vehicle manoeuvres."""
    imu.blind_psd = p.blind_psd_m2ps3


@step
def inertial_psd(imu: Record, p: Record, interval_s: float) -> float:
    """Spectral density of the upward acceleration's noise, m2/s3: as it shakes, but no less than
    that of a fast stream, and no more than a slow one may miss, which grows with T^3. Vibration is
    a tone: it shakes more than it moves."""
    noise = p.accel_noise_mps2_rthz
    slower = max(1.0, interval_s / NORMAL_INTERVAL_S)
    return max(noise * noise, min(imu.shake_psd, noise * noise * slower * slower * slower))


@step
def is_inertial(imu: Record, time_us: int) -> bool:
    """Whether an upward acceleration is known now."""
    return not math.isnan(imu.up_mps2) and time_us - imu.up_us <= BLIND_US


@step
def has_seen(imu: Record, time_us: int, elapsed_s: float) -> bool:
    """Whether the upward acceleration is known, and samples have come throughout the last
    `elapsed_s`."""
    return is_inertial(imu, time_us) and (time_us - imu.since_us) * 1e-6 >= elapsed_s


@step
def take_acceleration(
    imu: Record, p: Record, interval_s: float, time_us: int, up_mps2: float
) -> None:
    """The upward acceleration of the stretch since the last one, if that was not long ago; NaN is
    unknown."""
    before_us, imu.up_us = imu.up_us, time_us
    if time_us - before_us > BLIND_US:
        imu.since_us = time_us
    note_shake(imu, interval_s, up_mps2)
    imu.up_mps2 = up_mps2 if time_us - before_us <= BLIND_US else math.nan
    integrate(imu, p, interval_s, time_us)
    imu.up_mps2 = up_mps2


@step
def note_shake(imu: Record, interval_s: float, up_mps2: float) -> None:
    """What a stream misses between its samples: they stand for an interval T each, and shaken by w,
    for a density w2 T. So a slow stream is as good as a fast one while nothing shakes."""
    change_mps2 = up_mps2 - imu.up_mps2
    if not math.isnan(change_mps2):
        share = min(1.0, interval_s / SHAKING_TIME_S)
        imu.shake_psd += share * (0.5 * change_mps2 * change_mps2 * interval_s - imu.shake_psd)


@step
def note_tilt(imu: Record, attitude: Record, sample: Rows) -> None:
    """How much a wrong attitude may spoil the upward acceleration: its error turns horizontal force
    into vertical.

    Only a change of the horizontal force counts: what stays is in the accelerometer bias, what
    shakes averages out. Entering a turn with 40 degrees of bank, 8 m/s2 become horizontal, and 0.02
    rad are 0.16 m/s2, for as long as a disturbance of the attitude lasts.
    """
    up, force = attitude.own.up_b, sample[0].specific_force_b_mps2
    interval_s, tilt_var = attitude.interval_s, attitude.own.tilt_var
    imu.tilt_psd = 0.0
    if math.isnan(up[0]):
        return
    along = force[0] * up[0] + force[1] * up[1] + force[2] * up[2]
    new_share, old_share = (
        min(1.0, interval_s / SHAKING_TIME_S),
        min(1.0, interval_s / STAYING_TIME_S),
    )
    changed2 = 0.0
    for i in range(3):
        across = force[i] - along * up[i]
        imu.across_new[i] += new_share * (across - imu.across_new[i])
        imu.across_old[i] += old_share * (across - imu.across_old[i])
        changed2 += (imu.across_new[i] - imu.across_old[i]) ** 2
    imu.tilt_psd = 2.0 * DISTURBANCE_TIME_S * tilt_var * changed2


@step
def known_displacement(imu: Record, now_us: int, time_us: int) -> float:
    """T V - (S(t) - S(t - T)) of `channel`, for a measurement of `time_us`, older than the
    channels, which stand at `now_us`."""
    late_s = (now_us - time_us) * 1e-6
    then = at(imu.fallen_us, imu.fallen_values, time_us, BLIND_US)
    return 0.0 if math.isnan(then) else late_s * imu.V - (imu.S - then)
