"""Curves survive the packing to their resolution, and stay small."""

import numpy as np
import pytest

from companion.plots.packing import pack, resolution, unpack


def test_every_column_has_the_resolution_of_its_unit() -> None:
    assert resolution("altitude_m") == 0.01
    assert resolution("drift_m_per_h") == 0.1
    assert resolution("climb_mps") == 0.01
    assert resolution("t") == 0.001
    assert resolution("satellites") == 1.0
    assert resolution("stormy") == 0.001


def test_values_come_back_and_unknown_stays_unknown() -> None:
    values = np.array([np.nan, -12.344, 8848.0, np.inf, 3e8, np.nan])
    tables = {"estimate": {"t": np.arange(6.0), "altitude_m": values, "sd_m": np.full(6, np.nan)}}
    back = unpack(pack(tables))["estimate"]
    assert list(back) == ["t", "altitude_m"]  # a column without a value is left out
    assert back["t"] == pytest.approx(np.arange(6.0))
    assert back["altitude_m"][1:3] == pytest.approx([-12.34, 8848.0])
    assert np.isnan(back["altitude_m"][[0, 3, 5]]).all()
    assert back["altitude_m"][4] == pytest.approx((2**31 - 1) * 0.01)  # clipped, not wrapped


def test_nothing_to_draw_is_empty() -> None:
    assert unpack(pack({})) == {}


def test_twenty_minutes_of_fast_telemetry_fit_in_three_megabytes() -> None:
    random = np.random.default_rng(1)
    count = 20 * 60 * 50
    columns = {f"column_{number}_m": random.normal(0, 0.3, count).cumsum() for number in range(20)}
    packed = pack({"estimate": {"t": np.arange(count) * 0.02} | columns})
    assert len(packed["data"]) < 3e6
