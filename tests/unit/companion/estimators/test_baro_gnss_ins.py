"""Paper R's altimetry against its figures, and its filter on made-up flights: modes, faults,
lateness, honesty."""

import math
import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.estimators.baro_gnss_ins import METHOD
from companion.estimators.baro_gnss_ins.altimetry import (
    INCH_OF_MERCURY_PA,
    cubic_altitude_m,
    kollsman_altitude_m,
    kollsman_slope_mppa,
)
from companion.estimators.baro_gnss_ins.settings import BaroGnssInsSettings
from companion.estimators.method import Filter, run_log
from companion.kernels.atmosphere import geopotential_m, pressure_altitude_m, standard_pressure_pa
from companion.samples import Kind, SampleLog, Verdict, sample
from tests.flights import Flight, flight

Array = NDArray[np.float64]

# The paper's altimetry. Figures of papers/vectors.json "003" and papers/README.md R.


@pytest.mark.parametrize(
    ("height_m", "pressure_pa", "cubic_m"),
    [
        (-1000.0, 113929.09247592048, -2215.6660247061445),
        (0.0, 101325.0, -251.6038157869625),
        (1000.0, 89874.56291621955, 1102.302841131208),
        (3000.0, 70108.52649606044, 3058.2031631089885),
        (5000.0, 54019.888188145786, 4882.066362195452),
        (8000.0, 35599.78521264196, 7969.468318268739),
        (11000.0, 22632.040095007793, 11199.434288084478),
        (15000.0, 12044.552807152813, 14709.495737122912),
        (18288.0, 7171.627675260844, 16634.89346970209),
    ],
)
def test_cubic_as_printed(height_m: float, pressure_pa: float, cubic_m: float) -> None:
    assert standard_pressure_pa(height_m) == pytest.approx(pressure_pa, rel=1e-6)
    assert pressure_altitude_m(pressure_pa) == pytest.approx(height_m, abs=0.01)
    assert cubic_altitude_m(pressure_pa) == pytest.approx(cubic_m, abs=1e-6)


def test_what_is_wrong_with_the_cubic() -> None:
    assert cubic_altitude_m(101325.0) == pytest.approx(-251.60, abs=0.01)
    assert cubic_altitude_m(standard_pressure_pa(-1000.0)) + 1000.0 == pytest.approx(
        -1216.0, abs=1.0
    )
    assert cubic_altitude_m(standard_pressure_pa(18288.0)) - 18288.0 == pytest.approx(
        -1653.0, abs=1.0
    )
    slope = cubic_altitude_m(101326.0) - cubic_altitude_m(101324.0)
    closed = pressure_altitude_m(101326.0) - pressure_altitude_m(101324.0)
    assert slope / closed - 1.0 == pytest.approx(0.60, abs=0.02)


def test_kollsman_derivative() -> None:
    """Positive, local, and the derivative of the indicated altitude by the sea-level pressure."""
    assert kollsman_slope_mppa(101325.0, 101325.0) == pytest.approx(0.08324213860333743, rel=1e-9)
    at_3km = kollsman_slope_mppa(70108.52649606044, 101325.0)
    assert at_3km == pytest.approx(0.07760888612107097, rel=1e-9)

    def altitude(setting_pa: float) -> float:
        return float(
            288.15 / 0.0065 * (1.0 - (70108.5265 / setting_pa) ** (287.05287 * 0.0065 / 9.80665))
        )

    assert at_3km == pytest.approx((altitude(101326.0) - altitude(101324.0)) / 2.0, rel=1e-6)


def test_kollsman_correction_of_a_low_sea_level_pressure() -> None:
    """500 m with 1000 hPa below: h_std 609.63, corrected 500.85, of which 0.85 are second order."""
    assert pressure_altitude_m(94212.51945376887) == pytest.approx(609.6337797268479, abs=1e-3)
    assert kollsman_altitude_m(94212.51945376887, 100_000.0) == pytest.approx(
        500.8547270203821, abs=1e-3
    )
    assert kollsman_altitude_m(94212.51945376887, 101_325.0) == pressure_altitude_m(
        94212.51945376887
    )
    assert pytest.approx(101325.0, abs=1.0) == INCH_OF_MERCURY_PA * 29.9213


# b and s.


def vertical_log(
    profile_m: Array, *, b_m: float, s: float, seed: int, baro_sd_m: float = 1.0
) -> SampleLog:
    """A pressure and a fix a second at true heights; the barometer reads h_p with h = h_p + b + s
    h_p."""
    random, log = np.random.default_rng(seed), SampleLog()
    for second, height in enumerate(profile_m.tolist()):
        h_p = (height - b_m) / (1.0 + s) + baro_sd_m * random.normal()
        time_us = (second + 1) * 1_000_000
        pressure_pa = standard_pressure_pa(geopotential_m(h_p))
        log.append(
            Kind.PRESSURE, sample(Kind.PRESSURE, time_us, pressure_pa=pressure_pa, suspect=0)
        )
        gnss_m = height + 3.0 * random.normal()
        log.append(
            Kind.GNSS,
            sample(Kind.GNSS, time_us, altitude_amsl_m=gnss_m, vertical_sd_m=3.0, fix_type=3),
        )
    return log


CONSTANT_ERRORS = BaroGnssInsSettings(
    baro_walk_m_rts=0.0,
    baro_scale_walk_rts=0.0,
    gnss_correlation_s=0.0,
    gnss_correlated_ratio=0.0,
    baro_scale_sd_ratio=0.1,
)


def test_level_flight_tells_only_the_sum_of_bias_and_scale() -> None:
    log = vertical_log(np.full(600, 800.0), b_m=25.0, s=0.03, seed=1)
    state = run_log(METHOD, log, CONSTANT_ERRORS)[2][0]
    P, h_p = state["ins"]["P"], (800.0 - 25.0) / 1.03
    combined = np.sqrt(P[15, 15] + 2 * h_p * P[15, 16] + h_p**2 * P[16, 16])
    assert combined < 0.3
    assert state["ins"]["b_m"] + state["ins"]["s"] * h_p == pytest.approx(
        25.0 + 0.03 * h_p, abs=3 * combined
    )
    assert np.sqrt(P[15, 15]) > 50.0
    assert np.sqrt(P[16, 16]) > 0.06


def test_a_climb_separates_bias_and_scale() -> None:
    """papers/README.md R: b 24.98 +- .28 (true 25), s .0300 +- .0002 (true .03) after 100 to 1600
    m."""
    profile = np.concatenate(
        [np.full(60, 100.0), np.arange(100.0, 1600.0, 5.0), np.full(60, 1600.0)]
    )
    found = np.array(
        [
            [float(final["ins"][name]) for name in ("b_m", "s")]
            for final in (
                run_log(
                    METHOD, vertical_log(profile, b_m=25.0, s=0.03, seed=seed), CONSTANT_ERRORS
                )[2][0]
                for seed in range(24)
            )
        ]
    )
    assert found[:, 0].mean() == pytest.approx(25.0, abs=0.25)
    assert found[:, 1].mean() == pytest.approx(0.03, abs=2e-4)
    np.testing.assert_allclose(found.std(axis=0), [0.28, 0.0002], rtol=0.6)


def test_noise_of_the_barometer_does_not_drive_the_scale() -> None:
    """With the measured altitude in H (16), a minute of 5 m noise at 20 Hz brings s to -0.6."""
    made = flight(duration_s=160.0)
    random = np.random.default_rng(5)
    made.change(Kind.PRESSURE, "pressure_pa", lambda p: p + random.normal(0.0, 60.0, p.size), 100.0)
    state = run_log(METHOD, made.log())[2][0]
    assert abs(state["ins"]["s"]) < 0.03


def test_noise_at_a_low_rate_does_not_either() -> None:
    log = vertical_log(np.full(300, 500.0), b_m=0.0, s=0.0, seed=2, baro_sd_m=5.0)
    state = run_log(METHOD, log, BaroGnssInsSettings(baro_sd_m=5.0))[2][0]
    assert abs(state["ins"]["s"]) < 0.02


# On flights.


def errors_of(
    made: Flight, settings: BaroGnssInsSettings | None = None, *, after_s: float = 30.0
) -> Array:
    estimates, verdicts, _ = run_log(METHOD, made.log(), settings)
    known = (verdicts == Verdict.USED) & np.isfinite(estimates["altitude_amsl_m"])
    times_us = estimates["time_us"][known]
    late = made.elapsed_s(times_us) >= after_s
    return np.asarray((estimates["altitude_amsl_m"][known] - made.truth_m(times_us))[late])


@pytest.mark.parametrize(
    "plan",
    [
        {},
        {"imu_hz": 10.0},
        {"imu_hz": 4.0},
        {"imu_hz": 0.0},
        {"imu_hz": 0.0, "pressure_hz": 1.0, "gnss_hz": 1.0},
        {"pressure_hz": 0.0},
        {"pressure_hz": 0.0, "imu_hz": 0.0},
        {"gnss_age_s": 0.25},
        {"start_m": 3000.0},
    ],
    ids=str,
)
def test_follows_a_flight_with_whatever_there_is(plan: dict[str, Any]) -> None:
    """The receiver wanders by 1 m; the barometer's offset is 50 m."""
    error = errors_of(flight(duration_s=160.0, **plan))
    assert np.sqrt(np.mean(error**2)) < 1.1
    assert np.abs(error).max() < 3.5


def test_barometer_alone_is_weather_wide() -> None:
    estimates, _, _ = run_log(METHOD, flight(duration_s=60.0, gnss_hz=0.0).log())
    last = estimates[-1]
    assert abs(last["altitude_amsl_m"] - 460.0) < 3 * last["altitude_sd_m"]
    assert 95.0 < last["altitude_sd_m"] < 120.0


def test_nothing_but_an_imu_gives_no_height() -> None:
    made = flight(duration_s=20.0, pressure_hz=0.0, gnss_hz=0.0)
    estimates, verdicts, _ = run_log(METHOD, made.log())
    assert np.isnan(estimates["altitude_amsl_m"]).all()
    assert (verdicts[made.log().tables.order["kind"] == Kind.IMU][20:] == Verdict.USED).all()


def verdict_shares(
    made: Flight, kind: Kind, settings: BaroGnssInsSettings | None = None
) -> dict[Verdict, float]:
    log = made.log()
    verdicts = run_log(METHOD, log, settings)[1][log.tables.order["kind"] == kind]
    return {verdict: float((verdicts == verdict).mean()) for verdict in Verdict}


def test_a_clean_stream_is_used() -> None:
    made = flight(duration_s=60.0)
    for kind in (Kind.IMU, Kind.PRESSURE, Kind.GNSS):
        assert verdict_shares(made, kind)[Verdict.USED] >= 0.99


def test_an_imu_too_slow_to_integrate_is_ignored() -> None:
    assert verdict_shares(flight(duration_s=60.0, imu_hz=4.0), Kind.IMU)[Verdict.IGNORED] == 1.0
    made = flight(duration_s=60.0, imu_hz=10.0)
    assert run_log(METHOD, made.log())[2][0]["ins"]["inertial"] == 1


def test_vehicle_attitude_is_used_only_if_configured() -> None:
    made = flight(duration_s=60.0)
    assert verdict_shares(made, Kind.ATTITUDE)[Verdict.IGNORED] == 1.0
    settings = BaroGnssInsSettings(attitude="vehicle")
    assert verdict_shares(made, Kind.ATTITUDE, settings)[Verdict.USED] > 0.99
    assert np.sqrt(np.mean(errors_of(made, settings) ** 2)) < 1.1


@pytest.mark.parametrize(
    "settings", [BaroGnssInsSettings(), BaroGnssInsSettings(attitude="vehicle")]
)
def test_alignment_in_motion_finds_the_attitude(settings: BaroGnssInsSettings) -> None:
    """In the air from the first sample on: roll and pitch within a degree, yaw within three, after
    half a minute."""
    made = flight(duration_s=60.0)
    w, x, y, z = run_log(METHOD, made.log(), settings)[2][0]["ins"]["quaternion"]
    roll, pitch = (
        math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        math.asin(2 * (w * y - z * x)),
    )
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    assert math.degrees(roll) == pytest.approx(0.0, abs=1.0)
    assert math.degrees(pitch) == pytest.approx(math.degrees(math.atan2(4.0, 30.0)), abs=1.0)
    assert math.degrees(yaw - 0.7) == pytest.approx(0.0, abs=3.0)


def test_at_rest_the_yaw_stays_unknown_and_the_height_does_not() -> None:
    made = flight(duration_s=19.0)  # the climb begins at 20 s
    made.change(Kind.GNSS, "ground_speed_mps", lambda speed: 0.02 + 0 * speed)
    for name in ("latitude_deg", "longitude_deg"):
        made.tables[Kind.GNSS][name] = made.tables[Kind.GNSS][name][0]
    estimates, _, state = run_log(METHOD, made.log())
    assert state[0]["ins"]["inertial"] == 1
    assert state[0]["ins"]["yaw_known"] == 0
    assert math.sqrt(state[0]["ins"]["P"][8, 8]) > 1.5
    assert abs(estimates[-1]["altitude_amsl_m"] - 300.0) < 2.0


FAULTS: dict[str, Callable[[Flight], Flight]] = {
    "no barometer": lambda made: made.drop(Kind.PRESSURE, 70, 130),
    "no GNSS": lambda made: made.drop(Kind.GNSS, 70, 130),
    "no IMU": lambda made: made.drop(Kind.IMU, 70, 130),
    "nothing": lambda made: (
        made.drop(Kind.PRESSURE, 70, 130).drop(Kind.GNSS, 70, 130).drop(Kind.IMU, 70, 130)
    ),
    "barometer +15 m": lambda made: made.change(
        Kind.PRESSURE, "pressure_pa", lambda p: p - 170.0, 70, 130
    ),
    "barometer +5 m": lambda made: made.change(
        Kind.PRESSURE, "pressure_pa", lambda p: p - 57.0, 70, 130
    ),
    "barometer drifts": lambda made: made.change(
        Kind.PRESSURE, "pressure_pa", lambda p: p - np.linspace(0.0, 700.0, p.size), 70, 130
    ),
    "barometer frozen": lambda made: made.change(
        Kind.PRESSURE, "pressure_pa", lambda p: 0 * p + p[0], 70, 130
    ),
    "GNSS +5 m": lambda made: made.change(Kind.GNSS, "altitude_amsl_m", lambda h: h + 5.0, 70, 130),
    "GNSS +100 m": lambda made: made.change(
        Kind.GNSS, "altitude_amsl_m", lambda h: h + 100.0, 70, 130
    ),
    "GNSS slides": lambda made: made.change(
        Kind.GNSS, "altitude_amsl_m", lambda h: h + np.linspace(0.0, 60.0, h.size), 70, 130
    ),
    "accelerometers +3 m/s2": lambda made: made.change(
        Kind.IMU, "specific_force_b_mps2", lambda f: f + 3.0, 70, 130
    ),
    "gyros +0.3 rad/s": lambda made: made.change(
        Kind.IMU, "angular_rate_b_radps", lambda w: w + 0.3, 70, 130
    ),
    "no force": lambda made: made.change(
        Kind.IMU, "specific_force_b_mps2", lambda f: 0 * f, 70, 130
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_recovers_from_a_minute_s_fault(fault: str) -> None:
    """A minute after it is gone the altitude is within a metre of that without it."""
    clean = flight(duration_s=200.0)
    wanted = run_log(METHOD, clean.log())[0]
    found = run_log(METHOD, FAULTS[fault](clean.copy()).log())[0]
    times_us = clean.start_us + np.arange(190.0, 199.5, 0.5) * 1e6
    heights = [
        np.interp(times_us, run["time_us"], run["altitude_amsl_m"]) for run in (wanted, found)
    ]
    assert np.abs(heights[1] - heights[0]).max() < 1.0


@pytest.mark.parametrize(
    "fault", ["barometer +15 m", "barometer +5 m", "barometer frozen", "GNSS +100 m", "no GNSS"]
)
def test_the_fault_itself_does_not_show(fault: str) -> None:
    error = errors_of(FAULTS[fault](flight(duration_s=130.0)))
    assert np.abs(error).max() < 2.0


def test_a_receiver_is_believed_at_last() -> None:
    """Refuted after having contradicted for as long as it had agreed; for a while the spread says
    so."""
    made = flight(duration_s=220.0).change(Kind.GNSS, "altitude_amsl_m", lambda h: h + 40.0, 100.0)
    estimates, _, _ = run_log(METHOD, made.log())
    error = estimates["altitude_amsl_m"] - made.truth_m(estimates["time_us"])
    elapsed = made.elapsed_s(estimates["time_us"])
    assert np.abs(error[(elapsed > 30) & (elapsed < 189)]).max() < 2.0
    assert error[-1] == pytest.approx(40.0, abs=2.0)
    assert estimates["altitude_sd_m"][elapsed > 190].max() > 35.0
    assert estimates["altitude_sd_m"][-1] < 15.0


def test_a_repeated_pressure_is_no_news() -> None:
    """A frozen barometer in a climb: GATED once it contradicts, and it corrects nothing."""
    made = FAULTS["barometer frozen"](flight(duration_s=100.0))
    log = made.log()
    verdicts = run_log(METHOD, log)[1][log.tables.order["kind"] == Kind.PRESSURE]
    assert (verdicts[-200:] == Verdict.GATED).mean() > 0.5


BAD: list[tuple[Kind, dict[str, Any], Verdict]] = [
    (Kind.PRESSURE, {"pressure_pa": math.nan}, Verdict.INVALID),
    (Kind.PRESSURE, {"pressure_pa": 5.0}, Verdict.INVALID),
    (Kind.PRESSURE, {"pressure_pa": 95_000.0, "suspect": 1}, Verdict.INVALID),
    (Kind.PRESSURE, {"pressure_pa": 95_000.0, "time_us": 10}, Verdict.STALE),
    (Kind.PRESSURE, {"pressure_pa": 95_000.0, "instance": 1}, Verdict.IGNORED),
    (Kind.GNSS, {"altitude_amsl_m": math.nan}, Verdict.INVALID),
    (Kind.GNSS, {"fix_type": 2}, Verdict.INVALID),
    (Kind.GNSS, {"time_us": 10}, Verdict.STALE),
    (Kind.IMU, {"specific_force_b_mps2": (math.nan, 0.0, -9.8)}, Verdict.INVALID),
    (Kind.IMU, {"angular_rate_b_radps": (0.0, 1e6, 0.0)}, Verdict.INVALID),
    (Kind.IMU, {"time_us": 10}, Verdict.STALE),
]


@pytest.mark.parametrize(("kind", "change", "verdict"), BAD, ids=str)
def test_what_is_not_used_changes_nothing_but_counters(
    kind: Kind, change: dict[str, Any], verdict: Verdict
) -> None:
    made, running = flight(duration_s=10.0), Filter(METHOD)
    log = made.log()
    tables = {int(k): log[k] for k in Kind}
    for number, row in zip(log.tables.order["kind"], log.tables.order["row"], strict=True):
        running.step(Kind(number), tables[int(number)][row : row + 1])
    row = log[kind][-1:].copy()
    row["time_us"] += 50_000
    for name, value in change.items():
        row[name] = value
    before, estimate = running.state.copy(), running.estimate.copy()
    assert running.step(kind, row) is verdict
    after = running.state.copy()
    assert after["verdicts"][0, kind, verdict] == before["verdicts"][0, kind, verdict] + 1
    after["verdicts"] = before["verdicts"]
    assert after.tobytes() == before.tobytes()
    assert running.estimate.tobytes() == estimate.tobytes()


def test_a_reboot_starts_anew() -> None:
    made, running = flight(duration_s=10.0), Filter(METHOD)
    log = made.log()
    for row in range(50):
        running.step(Kind.PRESSURE, log[Kind.PRESSURE][row : row + 1])
    assert running.is_valid
    running.step(Kind.STATUS, sample(Kind.STATUS, 0, reboot=1, armed=-1, landed=-1))
    assert not running.is_valid
    fresh = Filter(METHOD).state
    fresh["verdicts"] = running.state["verdicts"]
    assert running.state.tobytes() == fresh.tobytes()


def test_time_of_boot_does_not_matter() -> None:
    early = run_log(METHOD, flight(duration_s=40.0).log())[0]
    late = run_log(METHOD, flight(duration_s=40.0).shift(3_600_000_000).log())[0]
    np.testing.assert_array_equal(early["altitude_amsl_m"], late["altitude_amsl_m"])


def test_a_long_silence_leaves_the_barometer_s_bias() -> None:
    """Nothing for two minutes; then a pressure alone gives the height, as well as the bias was
    known."""
    made = flight(duration_s=200.0).drop(Kind.GNSS, 40.0)
    for kind in (Kind.PRESSURE, Kind.IMU):
        made.drop(kind, 40.0, 160.0)
    estimates, _, _ = run_log(METHOD, made.log())
    assert abs(estimates[-1]["altitude_amsl_m"] - made.truth_m(estimates[-1]["time_us"])) < 8.0
    assert 3.0 < estimates[-1]["altitude_sd_m"] < 12.0


def test_fixes_come_back_after_minutes_of_the_imu_alone() -> None:
    """What was integrated meanwhile has lost height, climb and attitude: all of it is known again
    in seconds."""
    made = flight(duration_s=220.0).drop(Kind.PRESSURE, 50.0).drop(Kind.GNSS, 50.0, 200.0)
    estimates, _, state = run_log(METHOD, made.log())
    error = np.abs(estimates["altitude_amsl_m"] - made.truth_m(estimates["time_us"]))
    elapsed = made.elapsed_s(estimates["time_us"])
    lost = (elapsed > 150.0) & (elapsed < 199.0)
    assert (error[lost] < 3.0 * estimates["altitude_sd_m"][lost]).all()
    assert error[elapsed > 202.0].max() < 6.0
    assert state[0]["ins"]["inertial"] == 1


def test_compiled_and_not_compiled_agree_bit_for_bit() -> None:
    code = (
        "import hashlib\nfrom companion.estimators.baro_gnss_ins.steps import METHOD\n"
        "from companion.estimators.method import run_log\nfrom tests.flights import flight\n"
        "results = run_log(METHOD, flight(duration_s=8.0).log(), "
        "METHOD.settings(attitude='vehicle'))\nprint(hashlib.sha1(b''.join(each.tobytes() for "
        "each in results)).hexdigest())\n"
    )
    digests = {
        subprocess.run(
            [sys.executable, "-c", code],
            env=os.environ | {"NUMBA_DISABLE_JIT": disabled},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for disabled in ("0", "1")
    }
    assert len(digests) == 1
