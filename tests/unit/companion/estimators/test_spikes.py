"""The gate against spikes: what it passes, what it rejects, and that it always comes back."""

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.estimators.baro_gnss_ins.spikes import SPIKES, accepts, spikes_start
from companion.samples import readable

Array = NDArray[np.float64]
GATE_PA = 8.0
PA_PER_M = 12.0


def judge(pressure_pa: Array, rate_hz: float) -> NDArray[np.bool_]:
    """What the gate makes of each pressure of a stream."""
    state = readable(np.zeros(1, SPIKES))[0]
    spikes_start(state, GATE_PA)
    times_us = np.round(np.arange(pressure_pa.size) / rate_hz * 1e6).astype(int)
    pairs = zip(times_us.tolist(), pressure_pa.tolist(), strict=True)
    return np.array([accepts(state, time_us, value, GATE_PA) for time_us, value in pairs])


def descent(
    rate_hz: float, seconds: float, sink_mps: float, noise_pa: float, seed: int = 1
) -> Array:
    random = np.random.default_rng(seed)
    times_s = np.arange(int(seconds * rate_hz)) / rate_hz
    return np.asarray(
        90_000.0 + PA_PER_M * sink_mps * times_s + random.normal(0.0, noise_pa, times_s.size)
    )


@pytest.mark.parametrize("rate_hz", [1.0, 5.0, 10.0, 20.0])
@pytest.mark.parametrize("noise_pa", [0.5, 1.5, 3.5, 6.0])
def test_a_steady_descent_is_no_spike(rate_hz: float, noise_pa: float) -> None:
    """papers/README.md R: fewer than 0.1 % wrongly rejected, at 10 m/s; also for sensors noisier
    than the gate."""
    accepted = judge(descent(rate_hz, 1000.0, 10.0, noise_pa), rate_hz)
    assert (~accepted).mean() < 1e-3


@pytest.mark.parametrize("rate_hz", [10.0, 20.0])
@pytest.mark.parametrize("size_pa", [25.0, -60.0, 500.0])
def test_no_spike_passes(rate_hz: float, size_pa: float) -> None:
    """papers/README.md R: passes no spikes (1 % of the samples), in a descent of 10 m/s."""
    pressure = descent(rate_hz, 600.0, 10.0, 1.0)
    spiked = np.random.default_rng(2).random(pressure.size) < 0.01
    spiked[:10] = False
    accepted = judge(pressure + np.where(spiked, size_pa, 0.0), rate_hz)
    assert not (accepted & spiked).any()
    assert (~accepted[~spiked]).mean() < 2e-3


def test_at_one_hertz_only_spikes_beyond_a_manoeuvre_are_told() -> None:
    """120 Pa, 10 m: what a vertical acceleration of 5 m/s2 adds between two samples."""
    pressure = descent(1.0, 2000.0, 5.0, 1.0)
    spiked = np.arange(pressure.size) % 50 == 25
    for size_pa, passes in ((60.0, True), (200.0, False)):
        accepted = judge(pressure + np.where(spiked, size_pa, 0.0), 1.0)
        assert accepted[spiked].all() == passes


@pytest.mark.parametrize(("rate_hz", "rejects"), [(20.0, 10), (5.0, 6), (1.0, 2)])
def test_a_lasting_step_is_believed_after_some_rejections(rate_hz: float, rejects: int) -> None:
    pressure = descent(rate_hz, 60.0, 10.0, 0.5)
    step = pressure.size // 2
    pressure[step:] += 2000.0
    accepted = judge(pressure, rate_hz)
    assert not accepted[step : step + rejects].any()
    assert accepted[step + rejects :].all()
    assert accepted[:step].all()


@pytest.mark.parametrize("rate_hz", [1.0, 4.0, 20.0])
def test_a_multirotor_that_shoots_up_is_no_spike_for_long(rate_hz: float) -> None:
    """From rest to 10 m/s in 1.5 s and to rest again."""
    times_s = np.arange(0.0, 40.0, 1.0 / rate_hz)
    climb = np.interp(times_s, [10.0, 11.5, 20.0, 21.5], [0.0, 10.0, 10.0, 0.0])
    pressure = 100_000.0 - PA_PER_M * np.cumsum(climb) / rate_hz
    assert (
        ~judge(pressure + np.random.default_rng(3).normal(0.0, 1.0, pressure.size), rate_hz)
    ).sum() <= 2


def test_a_sensor_that_became_noisy_is_heard_again() -> None:
    """5 m of noise: most is rejected at first; the gate learns the noise and lets it through."""
    pressure = descent(20.0, 120.0, 0.0, 1.0)
    pressure[600:] += np.random.default_rng(4).normal(0.0, 60.0, pressure.size - 600)
    accepted = judge(pressure, 20.0)
    assert accepted[-600:].mean() > 0.95
