"""The protection level against a root search of scipy over the same sum written in numpy."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from companion.estimators.vertical_bank import channel as vc
from companion.estimators.vertical_bank.mixture import BANK, N
from companion.estimators.vertical_bank.protection import TOLERANCE, protection_level_m
from companion.estimators.vertical_bank.settings import VerticalBankSettings


@pytest.mark.parametrize("before_m", [0.0, 1e-3, 30.0, 1e6])
@pytest.mark.parametrize("seed", range(10))
def test_level_is_where_the_risk_is_the_allowed_one(seed: int, before_m: float) -> None:
    """Hypotheses near and far, whatever level the search begins at."""
    rng, settings = np.random.default_rng(seed), VerticalBankSettings()
    p, bank = settings.params()[0], np.zeros(1, BANK).view(np.recarray)[0]
    weight = 10.0 ** rng.uniform(-9.0, 0.0, N) * (rng.random(N) < 0.7)
    weight[0] = 1.0
    weight /= weight.sum()
    height_m, sd_m = 100.0 + rng.normal(0.0, 40.0, N), 10.0 ** rng.uniform(-0.5, 1.5, N)
    bank.weight[:], bank.protection_m = weight, before_m
    bank.x[:, vc.HEIGHT], bank.P[:, vc.HEIGHT, vc.HEIGHT] = height_m, sd_m**2
    mean_m = float(weight @ height_m)

    def excess(level_m: float) -> float:
        k = (level_m - np.abs(height_m - mean_m)) / np.hypot(sd_m, 1.0)
        rates = 7200.0 / (math.sqrt(math.tau) * settings.gnss_time_s) * k * np.exp(-0.5 * k**2)
        chances = np.where(k > 1.0, np.minimum(1.0, rates), 1.0)
        return float(weight @ chances) - settings.integrity_risk_probability

    expected_m = float(brentq(excess, 0.0, 1e4, xtol=1e-9))
    found_m = protection_level_m(bank, p, 5.0, 1.0)
    assert found_m == pytest.approx(expected_m, rel=TOLERANCE)
    assert bank.protection_m == found_m, "where the next search begins"
