"""Paper W's filter: its vectors and acceptance figures through the live steps, and what a vehicle
may do to it."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.config import dump
from companion.estimators.air_data_gnss import METHOD
from companion.estimators.air_data_gnss.settings import AirDataGnssSettings
from companion.estimators.air_data_gnss.steps import baro_at
from companion.estimators.method import Filter, run_log
from companion.kernels.atmosphere import (
    G0_MPS2,
    L0_KPM,
    P0_PA,
    R_AIR,
    T0_K,
    baro_altitude_array,
    geopotential_m,
    standard_pressure_pa,
)
from companion.samples import Kind, Rows, SampleLog, Verdict, sample
from sim.studies.page import generators
from sim.studies.papers.air_data_gnss import simulation as paper
from tests.flights import Flight, flight

Array = NDArray[np.float64]

# vectors.json "001": barometer, temperature every 0.2 s, GPS every fifth; the state after cycles 0,
# 5, 50 and 100
BARO_M = np.array([
    76.2060578, 77.5809847, 78.9537917, 80.3223665, 81.6846118, 83.0384535, 84.3818475, 85.7127872,
    87.0293111, 88.3295093, 89.6115309, 90.8735903, 92.1139737, 93.3310454, 94.5232535, 95.6891357,
    96.8273243, 97.9365515, 99.0156534, 100.0635749, 101.0793727, 102.0622194, 103.0114062,
    103.9263453, 104.8065722, 105.6517473, 106.4616572, 107.2362154, 107.9754627, 108.6795668,
    109.3488221, 109.9836481, 110.5845887, 111.1523092, 111.6875949, 112.1913475, 112.6645825,
    113.1084249, 113.5241058, 113.9129574, 114.2764085, 114.6159795, 114.9332766, 115.2299861,
    115.5078685, 115.7687520, 116.0145260, 116.2471343, 116.4685681, 116.6808587, 116.8860704,
    117.0862930, 117.2836342, 117.4802121, 117.6781475, 117.8795564, 118.0865421, 118.3011881,
    118.5255503, 118.7616493, 119.0114638, 119.2769231, 119.5599001, 119.8622047, 120.1855772,
    120.5316821, 120.9021021, 121.2983324, 121.7217753, 122.1737352, 122.6554137, 123.1679058,
    123.7121952, 124.2891514, 124.8995262, 125.5439514, 126.2229359, 126.9368644, 127.6859960,
    128.4704627, 129.2902697, 130.1452948, 131.0352893, 131.9598783, 132.9185626, 133.9107204,
    134.9356092, 135.9923688, 137.0800244, 138.1974898, 139.3435716, 140.5169736, 141.7163011,
    142.9400660, 144.1866924, 145.4545221, 146.7418207, 148.0467834, 149.3675422, 150.7021721,
    152.0486981,
])  # fmt: skip
GPS_M = np.array([
    50.0000000, 96.6217945, 53.4247807, 32.8006818, 95.0849249, 111.9144344, 55.7434888, 61.9066092,
    123.1211044, 106.1434217, 52.9553004, 86.4625820, 133.5665116, 90.7768746, 58.4123044,
    114.5870330, 139.2092764, 85.3163596, 85.1379244, 151.4262602, 148.3691525,
])  # fmt: skip
TEMPERATURE_K = np.array([
    293.3250000, 293.3059356, 293.2673492, 293.2104309, 293.1371027, 293.0499423, 292.9520811,
    292.8470791, 292.7387846, 292.6311801, 292.5282248, 292.4336968, 292.3510431, 292.2832425,
    292.2326870, 292.2010875, 292.1894052, 292.1978139, 292.2256935, 292.2716550, 292.3335956,
    292.4087837, 292.4939671, 292.5855033, 292.6795047, 292.7719939, 292.8590621, 292.9370251,
    293.0025701, 293.0528880, 293.0857850, 293.0997704, 293.0941155, 293.0688828, 293.0249234,
    292.9638425, 292.8879357, 292.8000969, 292.7037027, 292.6024775, 292.5003449, 292.4012706,
    292.3091042, 292.2274252, 292.1594000, 292.1076552, 292.0741723, 292.0602084, 292.0662458,
    292.0919719, 292.1362914, 292.1973695, 292.2727045, 292.3592268, 292.4534212, 292.5514663,
    292.6493863, 292.7432090, 292.8291239, 292.9036330, 292.9636908, 293.0068242, 293.0312311,
    293.0358519, 293.0204112, 292.9854282, 292.9321958, 292.8627285, 292.7796821, 292.6862471,
    292.5860210, 292.4828655, 292.3807512, 292.2835998, 292.1951273, 292.1186955, 292.0571782,
    292.0128463, 291.9872771, 291.9812914, 291.9949210, 292.0274069, 292.0772302, 292.1421723,
    292.2194036, 292.3055963, 292.3970573, 292.4898758, 292.5800791, 292.6637912, 292.7373880,
    292.7976417, 292.8418498, 292.8679434, 292.8745698, 292.8611469, 292.8278869, 292.7757882,
    292.7065958, 292.6227326, 292.5272030,
])  # fmt: skip

EXPECTED = {
    "signfix_G": {
        "a": (-0.01965818765, -0.01893053139, -0.01606083108, -0.01821175693),
        "b": (3.799331654, -1.692605906, 38.27997459, 14.10320222),
        "Pa": (2.775926435e-05, 1.562971572e-05, 1.594126188e-05, 1.614563896e-05),
        "Pb": (688.2109621, 1739.026747, 2293.951655, 2294.036795),
        "hc": (73.85865338, 86.36601398, 79.8891825, 140.5043265),
        "hf": (75.9273542, 77.458823, 97.98414342, 129.2761568),
    },
    "printed_sign_G": {
        "a": (0.01967089439, 0.01890290961, 0.01607715285, 0.01819261471),
        "b": (3.524543308, -3.161129741, 35.70777479, 9.249138683),
        "Pa": (2.775926435e-05, 1.562249887e-05, 1.593746028e-05, 1.613324843e-05),
        "Pb": (688.2109621, 1739.026738, 2293.951645, 2294.036713),
        "hc": (71.2793852, 84.60038975, 79.89383031, 140.2480801),
        "hf": (75.57932987, 76.37380294, 98.15110138, 128.9297177),
    },
    "signfix_P": {
        "a": (-0.01965454252, -0.0189293555, -0.016060783, -0.01821201275),
        "b": (3.871280764, -1.781714358, 38.55669843, 13.79020126),
        "Pa": (2.775881919e-05, 1.562965385e-05, 1.594290738e-05, 1.614648011e-05),
        "Pb": (688.2127548, 1739.020659, 2293.974673, 2294.0057),
        "hc": (73.78498717, 86.45673822, 79.60793781, 140.8231702),
        "hf": (75.91860657, 77.44366009, 98.08297101, 129.4105557),
    },
}
CYCLES = (0, 5, 50, 100)
READINGS: dict[str, dict[str, Any]] = {
    "signfix_G": {"regressor": "gnss"},
    "printed_sign_G": {"regressor": "gnss", "temperature_law": "printed"},
    "signfix_P": {},
}


def start_us(cycle: int) -> int:
    return 1_000_000 + 200_000 * cycle


def pressure(time_us: int, height_m: float, **values: Any) -> Rows:
    return sample(
        Kind.PRESSURE, time_us, pressure_pa=standard_pressure_pa(geopotential_m(height_m)), **values
    )


def fix(time_us: int, height_m: float, sd_m: float = 3.0) -> Rows:
    return sample(Kind.GNSS, time_us, fix_type=3, altitude_amsl_m=height_m, vertical_sd_m=sd_m)


def air(time_us: int, temperature_k: float) -> Rows:
    return sample(Kind.AIR, time_us, air_temperature_k=temperature_k)


@pytest.mark.parametrize("key", EXPECTED)
def test_vectors(key: str) -> None:
    """The independent implementation adds Q before its first update, so the first covariance is one
    step older here."""
    first = {"scale_sd": math.sqrt(0.04 + 2e-5), "bias_sd_m": math.sqrt(400.0 + 400.0)}
    running = Filter(METHOD, AirDataGnssSettings(preset="paper", **first, **READINGS[key]))
    found = []
    for cycle, (baro_m, temperature_k) in enumerate(zip(BARO_M, TEMPERATURE_K, strict=True)):
        running.step(Kind.AIR, air(start_us(cycle), temperature_k))
        if cycle % 5 == 0:
            running.step(Kind.GNSS, fix(start_us(cycle), GPS_M[cycle // 5]))
        running.step(Kind.PRESSURE, pressure(start_us(cycle), baro_m))
        if cycle in CYCLES:
            state, estimate = running.state[0], running.estimate[0]
            P = state["error"]["P"]
            h_c = baro_m + estimate["baro_offset_m"]
            found.append((*state["error"]["x"], P[0, 0], P[1, 1], h_c, estimate["altitude_amsl_m"]))
    expected = np.array([EXPECTED[key][name] for name in ("a", "b", "Pa", "Pb", "hc", "hf")]).T
    np.testing.assert_allclose(np.array(found), expected, rtol=1e-6)


@pytest.mark.parametrize(("law", "error_m"), [("linear", 4.5), ("printed", -149.8), ("exact", 0.0)])
def test_temperature_alone_15_k_above_standard_at_1600_m(law: str, error_m: float) -> None:
    """papers/README.md, W: the minus that the print lacks."""
    height_m, ground_k = 1600.0, T0_K + 15.0
    above = geopotential_m(height_m)
    pressure_pa = P0_PA * (1.0 + L0_KPM * above / ground_k) ** (-G0_MPS2 / (R_AIR * L0_KPM))
    running = Filter(METHOD, AirDataGnssSettings(preset="paper", temperature_law=law))
    for cycle in range(300):
        running.step(Kind.AIR, air(start_us(cycle), ground_k + L0_KPM * above))
        running.step(Kind.PRESSURE, sample(Kind.PRESSURE, start_us(cycle), pressure_pa=pressure_pa))
    assert running.estimate["altitude_amsl_m"][0] - height_m == pytest.approx(error_m, abs=0.1)


@pytest.mark.parametrize(
    ("reading", "name", "seeds", "low_m", "high_m"),
    [
        (paper.WEATHER, "paper", 100, 36.7, 38.7),
        (paper.WALK_SECOND, "paper", 100, 39.5, 42.5),
        (paper.WALK_STEP, "paper", 100, 51.7, 55.7),
        (paper.WEATHER, "slow walks", 400, 5.7, 6.2),
        (paper.WEATHER, "tuned", 400, 5.7, 6.2),
    ],
)
def test_final_rms(reading: str, name: str, seeds: int, low_m: float, high_m: float) -> None:
    """papers/README.md, W: 37.7 +- 1, 41 +- 1.5, 53.7 +- 2; tuned 5.7-6.2 m, where the raw
    barometer has 5.5-7.8 m."""
    stream = paper.VehicleRows()
    errors, raw = [], []
    for random in generators("W", seeds):
        data = paper.readings(reading, random)
        errors.append(stream.run(data, paper.SETTINGS[name]).final_m)
        raw.append(data.baro_m - paper.HEIGHT_M)
    assert low_m < paper.rms(np.array(errors)[:, paper.SETTLED :]) < high_m
    if reading == paper.WEATHER:
        assert 5.5 < paper.rms(np.array(raw)[:, paper.SETTLED :]) < 7.8


def test_preset_gives_defaults_that_single_keys_override() -> None:
    printed = AirDataGnssSettings(preset="paper")
    assert (printed.scale_walk_per_second * 0.2, printed.bias_walk_m2ps * 0.2) == pytest.approx(
        (2e-5, 400.0)
    )
    assert (printed.gnss_variance_m2, printed.baro_variance_m2, printed.climb_time_s) == (
        4900.0,
        25.0,
        100.0,
    )
    changed = AirDataGnssSettings(preset="paper", baro_variance_m2=1.0)
    assert changed.baro_variance_m2 == 1.0
    assert changed.model_copy(update={"baro_variance_m2": 25.0}) == printed
    assert AirDataGnssSettings().bias_walk_m2ps * 0.2 == pytest.approx(0.01)
    assert AirDataGnssSettings().scale_walk_per_second * 0.2 == pytest.approx(1e-9)
    assert AirDataGnssSettings.model_validate(printed.model_dump()) == printed
    assert "preset: paper" in dump(printed)


# Temperature


def scale_after(
    settings: AirDataGnssSettings, *, die_k: float = math.nan, air_k: float = math.nan
) -> float:
    """The scale factor after ten seconds at 1000 m with these temperatures."""
    running = Filter(METHOD, settings)
    for cycle in range(50):
        if not math.isnan(air_k):
            running.step(Kind.AIR, air(start_us(cycle), air_k))
        running.step(Kind.PRESSURE, pressure(start_us(cycle), 1000.0, die_temperature_k=die_k))
    return float(running.state["error"]["x"][0, 0])


def test_the_temperature_of_the_die_is_unused_unless_asked_for() -> None:
    warm_k = T0_K - 6.5 + 30.0
    assert scale_after(AirDataGnssSettings(), die_k=warm_k) == 0.0
    assert scale_after(AirDataGnssSettings(temperature="none"), die_k=warm_k, air_k=warm_k) == 0.0
    asked = scale_after(AirDataGnssSettings(temperature="die"), die_k=warm_k)
    assert (
        T0_K / (T0_K + 10.0) - 1.0 < asked < -0.01
    )  # 30 K over the air is 10 K over the offset, half weighted


def test_a_thermometer_in_the_air_is_preferred_to_the_die() -> None:
    air_k = T0_K - 6.5 + 10.0
    settings = AirDataGnssSettings(temperature="die")
    both = scale_after(settings, die_k=air_k + 20.0, air_k=air_k)
    assert both == scale_after(AirDataGnssSettings(), air_k=air_k)
    assert both == pytest.approx(T0_K / (T0_K + 10.0) - 1.0, abs=0.005)


def test_a_temperature_is_news_once_a_minute_but_one_of_many_in_the_paper() -> None:
    """1500 equal readings would otherwise imply a lapse rate that nobody measured."""
    spreads = {}
    for name, settings in (
        ("tuned", AirDataGnssSettings()),
        ("each", AirDataGnssSettings(temperature_time_s=0.0)),
    ):
        running = Filter(METHOD, settings)
        for cycle in range(1500):
            running.step(Kind.AIR, air(start_us(cycle), 290.0))
            running.step(Kind.PRESSURE, pressure(start_us(cycle), 1000.0))
        spreads[name] = math.sqrt(running.state["error"]["P"][0, 0, 0])
    assert spreads["each"] < 0.0015
    assert 0.003 < spreads["tuned"] < 0.012  # 3 K/km is 1 % of the height


@pytest.mark.parametrize(
    ("values", "verdict"),
    [
        ({"air_temperature_k": 290.0}, Verdict.USED),
        ({"air_temperature_k": 100.0}, Verdict.INVALID),
        ({"air_temperature_k": math.inf}, Verdict.INVALID),
        ({}, Verdict.INVALID),
        ({"qnh_pa": 101_000.0}, Verdict.USED),
        ({"air_temperature_k": 290.0, "instance": 1}, Verdict.IGNORED),
    ],
)
def test_air_samples(values: dict[str, float], verdict: Verdict) -> None:
    running = Filter(METHOD)
    assert running.step(Kind.AIR, sample(Kind.AIR, 1_000_000, **values)) is verdict
    if verdict is Verdict.USED:
        assert running.step(Kind.AIR, sample(Kind.AIR, 1_000_000, **values)) is Verdict.STALE


# Time


def test_a_fix_waits_for_the_barometer_height_of_its_own_time() -> None:
    """In a climb at 10 m/s with a barometer at 1 Hz, the wrong barometer height would be metres
    wrong."""
    errors = []
    for age_s in (0.0, 0.3, 0.9):
        running = Filter(METHOD, AirDataGnssSettings(outliers="kept"))
        for second in range(5, 100):
            time_us = second * 1_000_000
            running.step(Kind.PRESSURE, pressure(time_us, 10.0 * second - 30.0))
            fix_us = time_us + round((1.0 - age_s) * 1e6)
            running.step(Kind.GNSS, fix(fix_us, fix_us * 1e-5))
        errors.append(
            running.estimate["altitude_amsl_m"][0] - running.estimate["time_us"][0] * 1e-5
        )
    assert np.abs(errors).max() < 0.3


def test_a_late_fix_meets_the_barometer_height_of_its_own_time() -> None:
    running = Filter(METHOD)
    for cycle in range(400):
        time_us = start_us(cycle)
        running.step(Kind.PRESSURE, pressure(time_us, 1e-5 * time_us - 30.0))
        late_us = time_us - 250_000
        if cycle % 5 == 4:
            assert running.step(Kind.GNSS, fix(late_us, 1e-5 * late_us)) is Verdict.USED
    assert abs(running.estimate["altitude_amsl_m"][0] - 1e-5 * running.estimate["time_us"][0]) < 0.1
    assert math.isnan(baro_at(running.state, 1_000_000))


def test_a_reboot_forgets_everything_but_the_counters() -> None:
    running, fresh = Filter(METHOD), Filter(METHOD)
    for cycle in range(50):
        running.step(Kind.GNSS, fix(start_us(cycle), 100.0))
        running.step(Kind.PRESSURE, pressure(start_us(cycle), 90.0))
    running.step(Kind.STATUS, sample(Kind.STATUS, 1_000_000, reboot=1))
    fresh.state["verdicts"] = running.state["verdicts"]
    assert running.state.tobytes() == fresh.state.tobytes()
    assert not running.is_valid


# Faults


def errors_of(
    damaged: Flight, settings: AirDataGnssSettings | None = None
) -> tuple[Array, Array, Rows]:
    """(seconds since the start, error, estimate rows) after each sample that left an estimate."""
    log = damaged.log()
    estimates, _, _ = run_log(METHOD, log, settings)
    known = np.isfinite(estimates["altitude_amsl_m"])
    rows = estimates[known]
    return (
        damaged.elapsed_s(rows["time_us"]),
        rows["altitude_amsl_m"] - damaged.truth_m(rows["time_us"]),
        rows,
    )


@pytest.fixture(scope="module")
def clean() -> Flight:
    return flight()


def faulty(clean: Flight, name: str) -> Flight:
    """The flight with a fault from 80 to 140 s."""
    damaged, at = clean.copy(), (80.0, 140.0)
    random = np.random.default_rng(3)
    if name == "GNSS 50 m up":
        damaged.change(Kind.GNSS, "altitude_amsl_m", lambda m: m + 50.0, *at)
    elif name == "GNSS slides":
        damaged.change(
            Kind.GNSS, "altitude_amsl_m", lambda m: m + np.linspace(0.0, 60.0, m.size), *at
        )
    elif name == "GNSS noisy":
        damaged.change(
            Kind.GNSS, "altitude_amsl_m", lambda m: m + random.normal(0.0, 30.0, m.size), *at
        )
    elif name == "GNSS silent":
        damaged.drop(Kind.GNSS, *at)
    elif name == "barometer 15 m up":
        damaged.change(Kind.PRESSURE, "pressure_pa", lambda pa: pa - 180.0, *at)
    elif name == "barometer 300 m down":
        damaged.change(Kind.PRESSURE, "pressure_pa", lambda pa: pa + 3600.0, *at)
    elif name == "barometer frozen":
        damaged.change(Kind.PRESSURE, "pressure_pa", lambda pa: np.full_like(pa, pa[0]), *at)
    elif name == "barometer noisy":
        damaged.change(
            Kind.PRESSURE, "pressure_pa", lambda pa: pa + random.normal(0.0, 60.0, pa.size), *at
        )
    elif name == "barometer silent":
        damaged.drop(Kind.PRESSURE, *at)
    else:
        damaged.drop(Kind.PRESSURE, *at).drop(Kind.GNSS, *at)
    return damaged


@pytest.mark.parametrize(
    ("name", "worst_m"),
    [
        ("GNSS 50 m up", 55.0),
        ("GNSS slides", 60.0),
        ("GNSS noisy", 6.0),
        ("GNSS silent", 3.0),
        ("barometer 15 m up", 18.0),
        ("barometer 300 m down", 320.0),
        ("barometer frozen", 10.0),
        ("barometer noisy", 15.0),
        ("barometer silent", 4.0),
        ("both silent", 2.0),
    ],
)
def test_a_minute_after_a_fault_nothing_is_left_of_it(
    clean: Flight, name: str, worst_m: float
) -> None:
    elapsed_s, error_m, _ = errors_of(faulty(clean, name))
    without_s, without_m, _ = errors_of(clean)
    after_s = np.arange(200.0, 259.0, 0.1)
    difference = np.interp(after_s, elapsed_s, error_m) - np.interp(after_s, without_s, without_m)
    assert np.abs(difference).max() < 1.0
    assert np.abs(error_m[elapsed_s > 20.0]).max() < worst_m


def test_a_jump_of_the_barometer_is_admitted(clean: Flight) -> None:
    """For as long as no fix has told otherwise, the spread covers the jump."""
    elapsed_s, error_m, rows = errors_of(faulty(clean, "barometer 300 m down"))
    wrong = (np.abs(error_m) > 50.0) & (elapsed_s > 20.0)
    assert wrong.any()
    assert (rows["altitude_sd_m"][wrong] > 100.0).mean() > 0.4


@pytest.mark.parametrize("preset", ["tuned", "paper"])
@pytest.mark.parametrize(
    "rates", [{}, {"pressure_hz": 1.0, "gnss_hz": 1.0}, {"pressure_hz": 0.0}, {"gnss_hz": 0.0}]
)
def test_any_minute_is_near_the_better_of_healthy_sensors(
    preset: Any, rates: dict[str, Any]
) -> None:
    """Over any minute never worse than the worse of raw barometer and raw GNSS by more than 5 m."""
    made = flight(**rates)
    elapsed_s, error_m, _ = errors_of(
        made, AirDataGnssSettings(preset=preset, gnss_variance_m2="claimed")
    )
    raw = []
    for kind in (Kind.PRESSURE, Kind.GNSS):
        table = made.tables[kind]
        heights = (
            baro_altitude_array(table["pressure_pa"])
            if kind is Kind.PRESSURE
            else table["altitude_amsl_m"]
        )
        raw.append((made.elapsed_s(table["time_us"]), heights - made.truth_m(table["time_us"])))
    for start_s in range(0, 200, 10):
        within = (elapsed_s >= start_s) & (elapsed_s < start_s + 60)
        worse = max(
            paper.rms(error[(at >= start_s) & (at < start_s + 60)])
            for at, error in raw
            if ((at >= start_s) & (at < start_s + 60)).any()
        )
        assert paper.rms(error_m[within]) < worse + 5.0


def test_spread_is_honest_on_a_clean_flight(clean: Flight) -> None:
    elapsed_s, error_m, rows = errors_of(clean)
    settled = elapsed_s > 10.0
    nees = np.mean((error_m[settled] / rows["altitude_sd_m"][settled]) ** 2)
    assert 0.1 < nees < 2.0
    assert np.nanmax(rows["altitude_sd_m"][settled]) < 3.0


def test_spread_of_the_paper_preset_is_that_of_its_fixes_not_of_its_q() -> None:
    """Q^b would be 45 m a second; with fixes of 3 m every second nothing of the kind happens."""
    running = Filter(
        METHOD,
        AirDataGnssSettings(preset="paper", gnss_variance_m2="claimed", baro_variance_m2=1.0),
    )
    for cycle in range(200):
        running.step(Kind.AIR, air(start_us(cycle), T0_K))
        if cycle % 5 == 0:
            running.step(Kind.GNSS, fix(start_us(cycle), 0.0))
        running.step(Kind.PRESSURE, pressure(start_us(cycle), 0.0))
        if cycle > 50:
            assert 2.0 < running.estimate["altitude_sd_m"][0] < 5.0


def test_a_barometer_alone_admits_what_the_weather_may_do(clean: Flight) -> None:
    elapsed_s, error_m, rows = errors_of(clean.copy().drop(Kind.GNSS))
    assert (rows["altitude_sd_m"] > 100.0).all()
    assert np.abs(error_m[elapsed_s > 5.0]).max() < 60.0


def test_a_frozen_barometer_in_a_climb_does_not_leave_a_scale_factor(clean: Flight) -> None:
    damaged = clean.copy().change(
        Kind.PRESSURE, "pressure_pa", lambda pa: np.full_like(pa, pa[0]), 25.0, 85.0
    )
    _, _, state = run_log(METHOD, damaged.log())
    assert abs(state["error"]["x"][0, 0]) < 0.1
    elapsed_s, error_m, _ = errors_of(damaged)
    assert np.abs(error_m[elapsed_s > 100.0]).max() < 3.0


def test_scale_factor_is_guarded() -> None:
    """h^B = 0 at any height would be a = -1, and the compensated height anything."""
    running = Filter(
        METHOD,
        AirDataGnssSettings(outliers="kept", scale_sd=1.0, bias_sd_m=0.01, bias_walk_m2ps=1e-6),
    )
    for cycle in range(500):
        running.step(Kind.GNSS, fix(start_us(cycle), 3000.0 + cycle))
        running.step(Kind.PRESSURE, pressure(start_us(cycle), 0.0))
    assert running.state["error"]["x"][0, 0] >= -0.5
    assert math.isfinite(running.estimate["altitude_amsl_m"][0])


@pytest.mark.parametrize("height_m", [-100.0, 5_000.0, 15_000.0])
def test_reference_height_changes_the_words_not_the_height(height_m: float) -> None:
    """H_0 only says from where the scale factor counts; with a joint covariance any does."""
    log = SampleLog()
    random = np.random.default_rng(4)
    for cycle in range(600):
        truth_m = height_m + 300.0 * math.sin(cycle / 100.0)
        if cycle % 5 == 0:
            log.append(Kind.GNSS, fix(start_us(cycle), truth_m + 3.0 * random.normal()))
        log.append(
            Kind.PRESSURE, pressure(start_us(cycle), 1.03 * truth_m - 40.0 + 0.3 * random.normal())
        )
    heights = [
        run_log(METHOD, log, AirDataGnssSettings(reference_height_m=base_m))[0]["altitude_amsl_m"][
            -200:
        ]
        for base_m in (0.0, 1000.0)
    ]
    assert np.abs(heights[0] - heights[1]).max() < 1.0
    assert abs(heights[0][-1] - truth_m) < 3.0
