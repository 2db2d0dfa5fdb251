"""The shared attitude: flights of known attitude, made by formula, with a consumer IMU's errors."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.estimators.judging import state_dtype
from companion.kernels import attitude as att
from companion.kernels.earth import gravity_mps2
from companion.samples import Kind, Rows, readable, rows, sample

STATE = state_dtype(("attitude", att.ATTITUDE_STATE))
LATITUDE_DEG, HEIGHT_M = 47.0, 500.0
G_MPS2 = gravity_mps2(LATITUDE_DEG, HEIGHT_M)
Vector = NDArray[np.float64]


class Instant(NamedTuple):
    """The truth of a vehicle whose nose lies along its track."""

    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    speed_mps: float = 0.0
    course_rad: float = 0.0
    along_mps2: float = 0.0
    course_rate_radps: float = 0.0
    climb_mps2: float = 0.0


Flight = Callable[[float], Instant]


def up_b(roll_rad: float, pitch_rad: float) -> Vector:
    c = math.cos(pitch_rad)
    return np.array([math.sin(pitch_rad), -c * math.sin(roll_rad), -c * math.cos(roll_rad)])


def imu_truth(now: Instant) -> tuple[Vector, Vector]:
    """Specific force and angular rate at constant roll and pitch."""
    up = up_b(now.roll_rad, now.pitch_rad)
    level = math.cos(now.pitch_rad)
    forward = (np.array([1.0, 0.0, 0.0]) - up[0] * up) / level
    right = np.cross(forward, up)
    across = now.speed_mps * now.course_rate_radps
    force = (G_MPS2 + now.climb_mps2) * up + now.along_mps2 * forward + across * right
    return force, -now.course_rate_radps * up  # heading turns clockwise about down


def fly(
    flight: Flight,
    seconds: float,
    *,
    rate_hz: float = 50.0,
    start_s: float = 0.0,
    force_bias: tuple[float, float, float] = (0.0, 0.0, 0.0),
    rate_bias: tuple[float, float, float] = (0.0, 0.0, 0.0),
    gnss: bool = True,
    vehicle: Callable[[float], tuple[float, float]] | None = None,
    state: Rows | None = None,
    seed: int = 1,
) -> tuple[Rows, Vector]:
    """Run the component; returns its state and rows of (time, roll, pitch, up acceleration)."""
    if state is None:
        state = rows(STATE)
        att.attitude_start(state[0]["attitude"])
        state = readable(state)
    attitude = state[0]["attitude"]
    rng = np.random.default_rng(seed)
    out = []
    for k in range(round(seconds * rate_hz)):
        t = start_s + k / rate_hz
        time_us = 1_000_000 + round(t * 1e6)
        force, rate = imu_truth(flight(t))
        row = sample(Kind.IMU, time_us)
        row["specific_force_b_mps2"] = force + force_bias + 0.14 * rng.standard_normal(3)
        row["angular_rate_b_radps"] = rate + rate_bias + 0.0035 * rng.standard_normal(3)
        if gnss and k % max(1, round(rate_hz / 5)) == 0:
            then = flight(t)
            noisy = then.speed_mps + 0.05 * rng.standard_normal()
            fix = sample(
                Kind.GNSS, time_us - 120_000, latitude_deg=LATITUDE_DEG, altitude_amsl_m=HEIGHT_M,
                ground_speed_mps=abs(noisy), course_rad=then.course_rad % math.tau, fix_type=3,
            )  # fmt: skip
            att.attitude_gnss(attitude, fix)
        att.attitude_imu(attitude, row)
        if vehicle is not None and k % 10 == 0:
            roll, pitch = vehicle(t)
            att.attitude_vehicle(
                attitude, sample(Kind.ATTITUDE, time_us, roll_rad=roll, pitch_rad=pitch)
            )
        out.append(
            (
                t,
                att.roll_rad(state[0]["attitude"]),
                att.pitch_rad(state[0]["attitude"]),
                att.up_acceleration_mps2(state[0]["attitude"], row),
            )
        )
    return state, np.array(out)


def tilt_deg(out: Vector, flight: Flight) -> Vector:
    """Angle between the estimated and the true up."""
    angles = []
    for t, roll, pitch, _ in out:
        now = flight(t)
        cosine = float(up_b(roll, pitch) @ up_b(now.roll_rad, now.pitch_rad))
        angles.append(math.degrees(math.acos(min(1.0, cosine))))
    return np.array(angles)


def still(roll_rad: float = 0.0, pitch_rad: float = 0.0) -> Flight:
    return lambda t: Instant(roll_rad, pitch_rad)


def turn(t: float) -> Instant:
    """A coordinated turn at 30 degrees of bank: full circles at 50 m/s."""
    bank, speed = math.radians(30.0), 50.0
    rate = G_MPS2 * math.tan(bank) / speed
    return Instant(bank, 0.0, speed, rate * t, 0.0, rate)


def test_unknown_before_a_second_of_samples() -> None:
    state, out = fly(still(), 1.0)
    assert np.isnan(out[:, 1:]).all()
    assert not att.up_is_known(state[0]["attitude"])


@pytest.mark.parametrize(
    ("roll_deg", "pitch_deg"), [(0.0, 0.0), (10.0, -5.0), (-40.0, 20.0), (180.0, 0.0)]
)
def test_still(roll_deg: float, pitch_deg: float) -> None:
    flight = still(math.radians(roll_deg), math.radians(pitch_deg))
    _, out = fly(flight, 30.0)
    known = out[80:]
    assert tilt_deg(known, flight).max() < 0.5
    assert abs(known[:, 3].mean()) < 0.01, "the specific force along up is local gravity"


def test_gyro_bias_is_learned_at_rest() -> None:
    bias = (0.02, -0.03, 0.01)
    state, out = fly(still(), 60.0, rate_bias=bias)
    assert tilt_deg(out[80:], still()).max() < 0.6
    assert state["attitude"]["own"]["bias_b_radps"][0][:2] == pytest.approx(bias[:2], abs=2e-3)


def test_gyro_bias_that_appears_in_flight_is_learned() -> None:
    def cruise(t: float) -> Instant:
        return Instant(speed_mps=40.0)

    state, _ = fly(cruise, 20.0)
    state, out = fly(cruise, 280.0, start_s=20.0, rate_bias=(0.01, 0.0, 0.0), state=state)
    tilt = tilt_deg(out, cruise)
    assert tilt[-50 * 50 :].max() < 1.5, "0.01 rad/s is 160 degrees in this time"


def test_accelerometer_bias_tilts_by_its_share_of_gravity() -> None:
    """No gravity reference can tell 0.1 m/s2 from 0.6 degrees."""
    _, out = fly(still(), 60.0, force_bias=(0.1, 0.0, 0.0))
    assert tilt_deg(out[-500:], still()).mean() == pytest.approx(
        math.degrees(0.1 / G_MPS2), abs=0.15
    )


def test_a_steady_pitch_rate_is_not_taken_for_gyro_bias_before_gnss_says_that_it_rests() -> None:
    """Started in a glide whose first fix comes three seconds late: as quiet as at rest, and turning
    slowly."""

    def glide(t: float) -> Instant:
        return Instant(speed_mps=25.0, pitch_rad=0.01 * t)

    state, out = fly(glide, 3.0, rate_bias=(0.0, 0.01, 0.0), gnss=False)
    assert np.isnan(out[:, 1]).all()
    assert state["attitude"]["own"]["bias_b_radps"][0][1] == 0.0


def test_without_gnss_what_is_quiet_rests_after_all() -> None:
    _, out = fly(still(), 15.0, gnss=False)
    assert np.isnan(out[: 10 * 50, 1]).all()
    assert tilt_deg(out[12 * 50 :], still()).max() < 0.5


def test_vibration_does_not_weaken_gravity() -> None:
    """15 m/s2 of vibration average out: a gyro bias of a degree a second is learned all the
    same."""
    rng = np.random.default_rng(1)

    def shaken(t: float) -> Instant:
        return Instant(along_mps2=15.0 * rng.standard_normal())

    state, _ = fly(shaken, 180.0, rate_bias=(0.0, 0.02, 0.0), gnss=False)
    assert state["attitude"]["own"]["bias_b_radps"][0][1] == pytest.approx(0.02, abs=0.004)


def test_a_speed_from_before_a_gap_says_nothing_about_rest() -> None:
    state, _ = fly(still(), 10.0)

    def gentle(t: float) -> Instant:
        return Instant(speed_mps=30.0, course_rad=0.05 * t, course_rate_radps=0.05)

    state, _ = fly(gentle, 1.5, start_s=120.0, state=state, gnss=False)
    assert math.isnan(state["attitude"]["own"]["up_b"][0][0])
    assert abs(state["attitude"]["own"]["bias_b_radps"][0][2]) < 0.01


def test_takeoff_run_is_not_taken_for_pitch() -> None:
    """Ten seconds of 3 m/s2: the specific force leans 17 degrees back."""

    def run(t: float) -> Instant:
        gone = min(max(t - 10.0, 0.0), 10.0)
        return Instant(speed_mps=3.0 * gone, along_mps2=3.0 if 0.0 < gone < 10.0 else 0.0)

    _, out = fly(run, 40.0)
    assert tilt_deg(out[80:], run).max() < 1.5
    assert abs(out[80:, 3]).mean() < 0.15


def test_coordinated_turn_is_not_taken_for_level() -> None:
    """Three minutes of it: the specific force is along the body's own vertical all the time."""

    def flight(t: float) -> Instant:
        return turn(t - 10.0) if t >= 10.0 else Instant(math.radians(30.0))

    _, out = fly(flight, 190.0)
    assert tilt_deg(out[80:], flight).max() < 3.0


def test_aligned_in_a_turn() -> None:
    state, out = fly(turn, 60.0)
    assert tilt_deg(out[80:100], turn).max() < 5.0
    assert tilt_deg(out[-500:], turn).max() < 3.0
    blind, out = fly(turn, 5.0, gnss=False)
    assert tilt_deg(out[80:100], turn).min() > 25.0, (
        "without GNSS a turn cannot be seen from inside"
    )
    assert att.tilt_sd_rad(blind[0]["attitude"]) > 0.25 > att.tilt_sd_rad(state[0]["attitude"]), (
        "and that is said"
    )


def test_vertical_acceleration() -> None:
    def hop(t: float) -> Instant:
        return Instant(climb_mps2=1.5 * math.sin(2.0 * t) if t > 5.0 else 0.0)

    _, out = fly(hop, 30.0)
    true = np.array([hop(t).climb_mps2 for t in out[:, 0]])
    assert (
        np.sqrt(np.mean((out[100:, 3] - true[100:]) ** 2)) < 0.15
    )  # the accelerometer's noise is 0.14


def test_gravity_is_that_of_the_place() -> None:
    state = rows(STATE)
    att.attitude_start(state[0]["attitude"])
    assert state["attitude"]["own"]["gravity_mps2"][0] == pytest.approx(9.8062, abs=1e-4)
    att.attitude_gnss(
        state[0]["attitude"], sample(Kind.GNSS, 0, latitude_deg=0.0, altitude_amsl_m=5000.0)
    )
    assert state["attitude"]["own"]["gravity_mps2"][0] == pytest.approx(9.7803 - 0.0154, abs=1e-4)


def test_the_vehicles_attitude_is_used_while_it_agrees() -> None:
    """0.5 degrees beside our own: then its value is the one in use."""
    _, out = fly(still(), 30.0, vehicle=lambda t: (math.radians(0.5), 0.0))
    assert out[-1, 1] == pytest.approx(math.radians(0.5), abs=2e-3)


def test_a_wrong_attitude_of_the_vehicle_is_found_out() -> None:
    """26 degrees of roll that come from nowhere, as under GNSS jamming, and go away again."""

    def vehicle(t: float) -> tuple[float, float]:
        return (math.radians(26.0) if 20.0 <= t < 60.0 else 0.0), 0.0

    state, out = fly(still(), 40.0, vehicle=vehicle)
    roll_deg = np.degrees(out[:, 1])
    assert roll_deg[21 * 50] > 20.0, "for three seconds it may have been a manoeuvre"
    assert abs(roll_deg[24 * 50 :]).max() < 1.0
    assert state["attitude"]["vehicle_trusted"][0] == 0
    state, out = fly(still(), 40.0, start_s=40.0, vehicle=vehicle, state=state)
    assert state["attitude"]["vehicle_trusted"][0] == 1


def test_a_silent_vehicle_leaves_our_own() -> None:
    def vehicle(t: float) -> tuple[float, float]:
        return math.radians(2.0), 0.0

    state, out = fly(still(), 10.0, vehicle=vehicle)
    assert np.degrees(out[-1, 1]) == pytest.approx(2.0, abs=0.3)
    _, out = fly(still(), 5.0, start_s=10.0, state=state)
    assert abs(np.degrees(out[-1, 1])) < 0.5


@pytest.mark.parametrize(
    ("rate_hz", "integrable"), [(1.0, 0), (4.0, 0), (8.0, 0), (10.0, 1), (50.0, 1), (400.0, 1)]
)
def test_imu_rate(rate_hz: float, integrable: int) -> None:
    state, out = fly(still(), max(3.0, 12.0 / rate_hz), rate_hz=rate_hz)
    assert att.imu_can_be_integrated(state[0]["attitude"]) == bool(integrable)
    assert state["attitude"]["interval_s"][0] == pytest.approx(1.0 / rate_hz, rel=1e-6)
    assert np.isfinite(out[-1, 1]) == bool(integrable)


def test_imu_rate_has_hysteresis() -> None:
    """9 Hz is good enough to go on with, not to start with."""
    state, _ = fly(still(), 5.0, rate_hz=20.0, gnss=False)
    state, _ = fly(still(), 10.0, start_s=5.0, rate_hz=9.0, gnss=False, state=state)
    assert att.imu_can_be_integrated(state[0]["attitude"])
    state, _ = fly(still(), 10.0, start_s=15.0, rate_hz=4.0, gnss=False, state=state)
    assert not att.imu_can_be_integrated(state[0]["attitude"])
    assert not att.up_is_known(state[0]["attitude"])
    state, _ = fly(still(), 10.0, start_s=25.0, rate_hz=9.0, gnss=False, state=state)
    assert not att.imu_can_be_integrated(state[0]["attitude"])
    state, _ = fly(still(), 10.0, start_s=35.0, rate_hz=10.0, gnss=False, state=state)
    assert att.imu_can_be_integrated(state[0]["attitude"])


def test_a_gap_begins_the_alignment_again_and_keeps_the_bias() -> None:
    state, _ = fly(still(), 30.0, rate_bias=(0.02, 0.0, 0.0))
    bias = state["attitude"]["own"]["bias_b_radps"][0].copy()
    state, out = fly(still(0.3), 0.5, start_s=90.0, rate_bias=(0.02, 0.0, 0.0), state=state)
    assert np.isnan(out[:, 1]).all()
    assert (state["attitude"]["own"]["bias_b_radps"][0] == bias).all()
    state, out = fly(still(0.3), 10.0, start_s=90.5, rate_bias=(0.02, 0.0, 0.0), state=state)
    assert tilt_deg(out[80:], still(0.3)).max() < 0.5


def test_deterministic_and_free_of_the_epoch() -> None:
    """The same flight an hour later on the vehicle's clock."""
    one, _ = fly(turn, 5.0)
    other, _ = fly(lambda t: turn(t - 3600.0), 5.0, start_s=3600.0)
    for name in ("up_b", "bias_b_radps", "tilt_var"):
        ours, theirs = one["attitude"]["own"][name], other["attitude"]["own"][name]
        assert ours == pytest.approx(theirs, abs=1e-9)
