"""Over any minute no estimator is worse than the worse of its raw sensors by more than 5 m, while
those are healthy.

The four flights with truth (skipped where they are absent) and two of our own through a front. RMS
over windows of 60 s.

An estimator that does not follow a step of the barometer (paper K's two) takes its datum from the
start and keeps it: a raw barometer of the same datum, less its error at the start, is its measure,
since the absolute one may pass through zero error by accident. The front begins at 1019 hPa: after
it the absolute error is 3 m, that since the start 31 m.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from companion.estimators import ESTIMATORS
from companion.evaluation.compare import SETTLE_S, Series, compare
from companion.evaluation.metrics import Array, truth_at
from sim.flight import Flight
from sim.scenario import load_scenario
from tests.paths import DATA

FLIGHTS = DATA / "flights"
WINDOW_S, STRIDE_S = 60.0, 10.0
MARGIN_M = 5.0
START_S = 30.0
RAW = ("raw barometer", "raw GNSS")


def rms_by_window(series: Series, truth_us: Array, truth_m: Array, starts_us: Array) -> Array:
    """Root mean square error in each window, shape (n,); NaN where the series has nothing there."""
    error_m = series.altitude_m - truth_at(series.times_us, truth_us, truth_m)
    found = np.full(starts_us.shape, np.nan)
    for index, start_us in enumerate(starts_us):
        within = error_m[
            (series.times_us >= start_us) & (series.times_us < start_us + WINDOW_S * 1e6)
        ]
        within = within[np.isfinite(within)]
        if within.size:
            found[index] = np.sqrt(np.mean(within**2))
    return found


def assert_no_divergence(path: Path) -> None:
    found = compare(path)
    assert found.reference == "truth"
    first_us = min(series.times_us[0] for series in found.series)
    last_us = found.truth_us[-1]
    starts_us = np.arange(first_us + SETTLE_S * 1e6, last_us - WINDOW_S * 1e6, STRIDE_S * 1e6)
    rms_m = {
        s.label: rms_by_window(s, found.truth_us, found.truth_m, starts_us) for s in found.series
    }
    baro = next(series for series in found.series if series.label == RAW[0])
    baro_error_m = baro.altitude_m - truth_at(baro.times_us, found.truth_us, found.truth_m)
    at_start_m = np.nanmedian(baro_error_m[baro.times_us < first_us + START_S * 1e6])
    set_at_start = replace(baro, altitude_m=baro.altitude_m - at_start_m)
    since_start_m = rms_by_window(set_at_start, found.truth_us, found.truth_m, starts_us)
    for name, method in ESTIMATORS.items():
        limit_m = np.fmax(rms_m[RAW[0]], rms_m[RAW[1]]) + MARGIN_M
        if not method.follows_baro_step:
            limit_m = np.fmax(limit_m, since_start_m + MARGIN_M)
        assert np.isfinite(rms_m[name]).all(), f"{name}: a minute without an altitude"
        worst = int(np.argmax(rms_m[name] - limit_m))
        assert rms_m[name][worst] <= limit_m[worst], (
            f"{name} at {(starts_us[worst] - first_us) * 1e-6:.0f} s"
        )


@pytest.mark.long
@pytest.mark.parametrize("name", ["jsbsim_A", "jsbsim_B", "ardupilot_nominal", "ardupilot_weather"])
def test_on_flights_with_truth(name: str) -> None:
    if not FLIGHTS.exists():
        pytest.skip("the flights are not here")
    assert_no_divergence(FLIGHTS / f"{name}.tlog")


@pytest.mark.long
@pytest.mark.parametrize("seed", [11, 12])
def test_through_a_front(seed: int, tmp_path: Path) -> None:
    path = tmp_path / "front.tlog"
    Flight(load_scenario("weather-change"), tlog=path, seed=seed).run()
    assert_no_divergence(path)
