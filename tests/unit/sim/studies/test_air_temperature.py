"""Air temperature live: from the simulated probe over MAVLink to the scale factor of paper W."""

import numpy as np
import pytest

from sim.studies.papers.air_data_gnss import air_temperature as live


def test_the_scale_factor_converges_with_the_probe() -> None:
    """15 K warmer: a = 288.15 / 303.15 - 1 = -.0495; the probe errs by 0.2 K, the lapse rate by 3
    K/km."""
    with_probe, without = live.fly()
    assert pytest.approx(-0.0495, abs=1e-4) == live.TRUE_SCALE
    assert with_probe.temperatures > 60
    assert without.temperatures == 0
    assert np.mean(with_probe.scales[-100:]) == pytest.approx(live.TRUE_SCALE, abs=0.005)
    waiting = (np.interp(25.0, *each.curve) for each in (with_probe, without))  # not yet climbed
    ours, blind = waiting
    assert abs(ours - live.TRUE_SCALE) < 0.01
    assert abs(blind - live.TRUE_SCALE) > 0.02, "GNSS alone needs a climb"
    assert np.sqrt(np.nanmean(np.square(with_probe.errors_m[-500:]))) < 8.0
