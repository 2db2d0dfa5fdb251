"""Paper C's equations against published facts, and the three altimeters on a synthetic flight."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.estimators.method import Filter, run_log
from companion.estimators.robust_altimeter import METHOD
from companion.estimators.robust_altimeter import altimeters as integrated_altimeters
from companion.estimators.robust_altimeter import error_model as paper
from companion.estimators.robust_altimeter import isolation as pair
from companion.estimators.robust_altimeter.settings import RobustAltimeterSettings
from companion.samples import FaultySensor, Kind, Rows, SampleLog, Verdict, sample
from tests.flights import Flight, Plan, flight

Array = NDArray[np.float64]


def printed(sigma_ub: float = 0.1) -> Rows:
    """Table 1 of the paper."""
    params = RobustAltimeterSettings(preset="paper").params()
    params["sigma_UB"] = sigma_ub
    return params


# The paper's equations. Facts: vectors.json "002", an independent implementation.

P_0 = np.diag([9.0, 0.0025, 1e-6, 1e-6, 1.0])
INDICES = (0, 1, 10, 59, 60, 65, 89, 90, 119)
OPTIMAL_IBI = (0.9, 1.9868664253011317, 1.9852291457169147, 3.2085245000411873, 4.315551584844807,
               9.116783316037266, 24.019575452968066, 23.50667523938689,
               11.731163628795539)  # fmt: skip
OPTIMAL_IIG = (1.958829751576858, 2.204776964099356, 2.1840188890357948, 3.4433429492903946,
               3.3682436509221914, 3.5332568292739563, 4.479618135328487, 4.424430083522272,
               5.491868187322116)  # fmt: skip
OPTIMAL_IBIG = (1.40279679096452, 2.090978778188843, 2.10063971396898, 3.3625730493766826,
                3.695346414830212, 5.496868203988654, 11.79197458167854, 11.57839807562586,
                7.920334816587213)  # fmt: skip
ROBUST_IBI = (0.8949361943266096, 1.9621979810472554, 1.975003479446843, 3.2077716174211988,
              3.2271047691472, 3.3394817008719953, 3.9058550939549126, 4.029113229476641,
              5.302745541689868)  # fmt: skip
ROBUST_IIG = (1.9094455311230445, 2.1684387470806223, 2.1680205807550617, 3.4322536110845334,
              3.3583846218344275, 3.523968290365916, 4.473372986025038, 4.41910271477783,
              5.49213823062095)  # fmt: skip
ROBUST_IBIG = (1.3766869556601844, 2.0607348004756174, 2.087062647955425, 3.355039115296021,
               3.3130540581162333, 3.4590881529704225, 4.26099314050963, 4.272894956083135,
               5.418422563650177)  # fmt: skip
VAR_IBI = (4.95, 3.598732602904992, 1.568168404102395, 1.136743110694432, 1.1330663293381142,
           1.1133646553500511, 1.0073206332207383, 1.0030219457297305,
           0.8954064664715983)  # fmt: skip
VAR_IIG = (5.474106447161656, 3.933531712891948, 1.1329342700603156, 0.5960109827352645,
           0.5975911616616988, 0.6039410963461592, 0.6023984265930881, 0.6015610466302634,
           0.5706015228205379)  # fmt: skip
PROB_IBI = (0.9943735492517884, 0.9804391877924465, 0.983399494537947, 0.9852998081794735,
            0.000157368233754848, 0.008219336230244557, 0.007269890250522381, 0.9905701116957325,
            0.9816870275692929)  # fmt: skip


def iterate(robust: bool) -> Array:
    """The vectors' measurements through both filters: (120, 6).

    Columns: estimates of IBI, IIG, IBIG; variances of IBI and IIG; prob of IBI.
    """
    params = printed()
    x, P, K = np.zeros((2, 5)), np.stack([P_0, P_0]), np.zeros(5)
    out = []
    for i in range(120):
        Z = (
            2 + 0.03 * i + 3 * math.sin(2.1 * i) + 20 * (60 <= i < 90),
            2 + 0.03 * i + 3 * math.cos(1.3 * i),
        )
        probability = [0.0, 0.0]
        for k, R in enumerate((10.0, 13.9729)):
            if i > 0:
                paper.extrapolate(
                    x[k], P[k], 0.5, params["alpha"][0, 1], params["sigma_a"][0, 1], params
                )
            probability[k] = paper.take_in(x[k], P[k], params["rows_H"][0, k], K, Z[k], R, robust)
        ibi = paper.share(P[0], P[1])
        out.append(
            (
                x[0, 0],
                x[1, 0],
                ibi * x[0, 0] + (1 - ibi) * x[1, 0],
                P[0, 0, 0],
                P[1, 0, 0],
                probability[0],
            )
        )
    return np.array(out)


def test_optimal_filter_is_that_of_the_vectors() -> None:
    ours = iterate(robust=False)[list(INDICES)]
    for column, facts in enumerate((OPTIMAL_IBI, OPTIMAL_IIG, OPTIMAL_IBIG, VAR_IBI, VAR_IIG)):
        assert ours[:, column] == pytest.approx(facts, rel=1e-12)


def test_robust_filter_is_that_of_the_vectors() -> None:
    ours = iterate(robust=True)[list(INDICES)]
    for column, facts in enumerate(
        (ROBUST_IBI, ROBUST_IIG, ROBUST_IBIG, VAR_IBI, VAR_IIG, PROB_IBI)
    ):
        assert ours[:, column] == pytest.approx(facts, rel=1e-12, abs=1e-15)


def test_neither_covariance_nor_weights_see_the_fault() -> None:
    """(26) and (19) do not depend on the measurements: 20 m of bias change no variance."""
    optimal, robust = iterate(robust=False), iterate(robust=True)
    assert (optimal[:, 3:5] == robust[:, 3:5]).all()
    assert optimal[60:90, 3].max() < 1.14


def test_measurement_variances_of_table_1() -> None:
    """R = 10 (13) and 13.9729 (18) m2."""
    result = Filter(METHOD, RobustAltimeterSettings(preset="paper"))
    channels = result.state[0]["pair"]
    channels["inertial"], channels["sigma_gps_m"] = 1, 2.23
    variances = [
        integrated_altimeters.height_variance(channels, result.params, k)
        for k in (paper.IBI, paper.IIG)
    ]
    assert variances == pytest.approx([10.0, 13.9729], abs=1e-12)


@pytest.mark.parametrize(("sigma_ub", "sd_m"), [(1.0, 5.0), (0.1997, 1.0)])
def test_stationary_bias_of_the_barometer(sigma_ub: float, sd_m: float) -> None:
    """sigma_B = 1 m as driving noise makes a bias of 5.0 m; one of 1 m needs 0.1997."""
    params, x, P = printed(sigma_ub), np.zeros(5), np.zeros((5, 5))
    paper.extrapolate(x, P, 2000.0, 0.001, 2e-5, params)
    assert math.sqrt(P[4, 4]) == pytest.approx(sd_m, rel=2e-3)


def test_probability_of_normal_operation() -> None:
    """Of a unit normal about the innovation, what lies within 3: 0.9973 at none, a half at 3,
    nothing far out."""
    assert paper.normal_probability(0.0) == pytest.approx(0.9973002, abs=1e-7)
    assert paper.normal_probability(3.0) == pytest.approx(0.5, abs=1e-8)
    assert paper.normal_probability(30.0) == 0.0
    assert paper.normal_probability(-2.0) == pytest.approx(paper.normal_probability(2.0), abs=1e-15)
    assert math.isnan(paper.normal_probability(math.nan))


def test_fusion_weights_are_the_paper_s() -> None:
    """(19), (20): each altimeter counts by the other's variance; the variance is the harmonic
    one."""
    P = np.stack([np.eye(5), 3.0 * np.eye(5)])
    ibi = paper.share(P[0], P[1])
    assert ibi == 0.75
    assert ibi**2 * 1.0 + (1 - ibi) ** 2 * 3.0 == pytest.approx(1.0 / (1 / 1.0 + 1 / 3.0))


def test_an_interval_is_taken_in_steps_of_the_paper() -> None:
    params = printed()
    whole, parts = (np.zeros(5), P_0.copy()), (np.zeros(5), P_0.copy())
    paper.extrapolate(*whole, 5.0, 0.001, 2e-5, params)
    for _ in range(10):
        paper.extrapolate(*parts, 0.5, 0.001, 2e-5, params)
    np.testing.assert_allclose(whole[1], parts[1], rtol=1e-12)


def test_noise_density_does_not_depend_on_the_interval() -> None:
    """After a second, Var of Delta a_z is sigma^2 T_d t, in however many steps."""
    params = printed()
    for T in (0.02, 0.1, 0.5):
        x, P = np.zeros(5), np.zeros((5, 5))
        for _ in range(round(1.0 / T)):
            paper.extrapolate(x, P, T, 0.0, 0.6, params)
        assert P[2, 2] == pytest.approx(0.36 * 0.5, rel=1e-9)


# On a vehicle

FAULT_S = (150.0, 210.0)


@dataclass
class Result:
    """Of one compiled run."""

    made: Flight
    log: SampleLog
    estimates: Rows
    verdicts: Rows
    state: Rows

    @property
    def elapsed_s(self) -> Array:
        return self.made.elapsed_s(self.estimates["time_us"])

    @property
    def errors_m(self) -> Array:
        return np.asarray(
            self.estimates["altitude_amsl_m"] - self.made.truth_m(self.estimates["time_us"])
        )

    def rms_m(self, start_s: float, end_s: float) -> float:
        within = (self.elapsed_s >= start_s) & (self.elapsed_s < end_s)
        return float(np.sqrt(np.mean(self.errors_m[within] ** 2)))

    def worst_m(self, start_s: float, end_s: float) -> float:
        within = (self.elapsed_s >= start_s) & (self.elapsed_s < end_s)
        return float(np.abs(self.errors_m[within]).max())

    def share_of(self, kind: Kind, verdict: Verdict) -> float:
        return float(np.mean(self.verdicts[self.log.tables.order["kind"] == kind] == verdict))


def run(made: Flight, **settings: Any) -> Result:
    log = made.log()
    return Result(made, log, *run_log(METHOD, log, RobustAltimeterSettings(**settings)))


def cruise(**changes: Any) -> Flight:
    return flight(Plan(duration_s=300.0, **changes))


def baro_step(step_m: float) -> Callable[[Any], Any]:
    return lambda pressure_pa: pressure_pa * math.exp(-step_m * 9.80665 / (287.05 * 286.0))


def faulty(kind: Kind, step_m: float, **changes: Any) -> Flight:
    """A barometer or a receiver that reads `step_m` too high for a minute."""
    if kind is Kind.PRESSURE:
        return cruise(**changes).change(kind, "pressure_pa", baro_step(step_m), *FAULT_S)
    return cruise(**changes).change(
        kind, "altitude_amsl_m", lambda height_m: height_m + step_m, *FAULT_S
    )


@pytest.mark.parametrize("publish", ["ibi", "iig", "ibig", "recommended"])
def test_every_altimeter_follows_a_healthy_flight(publish: str) -> None:
    result = run(cruise(), publish=publish)
    assert result.rms_m(60.0, 300.0) < 1.5  # the receiver wanders by 1 m
    spread_m = result.estimates["altitude_sd_m"][result.elapsed_s > 60.0]
    assert 1.0 < np.median(spread_m) < 5.0


def test_fused_is_between_the_two_by_the_paper_s_weights() -> None:
    heights = {name: run(cruise(), publish=name) for name in ("ibi", "iig", "ibig")}
    last = {name: result.estimates[-1]["altitude_amsl_m"] for name, result in heights.items()}
    P = heights["ibig"].state["pair"]["P"][0]
    ibi = paper.share(P[0], P[1])
    assert last["ibig"] == pytest.approx(ibi * last["ibi"] + (1 - ibi) * last["iig"], abs=1e-9)


@pytest.mark.parametrize("gain", ["optimal", "robust"])
@pytest.mark.parametrize("kind", [Kind.PRESSURE, Kind.GNSS])
@pytest.mark.parametrize("step_m", [15.0, 40.0, 200.0])
def test_a_fault_is_isolated_and_forgotten(gain: str, kind: Kind, step_m: float) -> None:
    """Half a minute into it the other altimeter is recommended; a minute after it nothing is left
    of it."""
    damaged, healthy = faulty(kind, step_m), run(cruise(), gain=gain)
    tables = {k: t[~damaged.within(k, 180.0, math.inf)] for k, t in damaged.tables.items()}
    half = run(Flight(damaged.plan, tables), gain=gain)
    baro = kind is Kind.PRESSURE
    assert half.state["pair"]["isolation"]["trust"][0] == (
        pair.TRUST_IIG if baro else pair.TRUST_IBI
    )
    last = half.estimates[-1]
    assert last["faulty"] == (FaultySensor.BAROMETER if baro else FaultySensor.GNSS)
    assert 0.0 < half.made.elapsed_s(last["faulty_since_us"]) - FAULT_S[0] < 25.0
    result = run(damaged, gain=gain)
    assert result.state["pair"]["isolation"]["trust"][0] == pair.TRUST_IBIG
    late = result.elapsed_s > FAULT_S[1] + 60.0
    assert np.abs(result.errors_m[late] - healthy.errors_m[late]).max() < 1.0


@pytest.mark.parametrize("kind", [Kind.PRESSURE, Kind.GNSS])
def test_recommended_altimeter_is_better_than_the_fused_one_under_a_fault(kind: Kind) -> None:
    """The paper's second recommendation."""
    fused, recommended = (run(faulty(kind, 40.0), publish=name) for name in ("ibig", "recommended"))
    assert fused.rms_m(*FAULT_S) > 10.0
    assert recommended.rms_m(*FAULT_S) < 2.0


def test_robust_gain_holds_out_against_a_short_fault() -> None:
    """40 m for eight seconds: the inertial channel bridges it; the optimal gain follows."""

    def short(gain: str) -> float:
        made = cruise().change(Kind.PRESSURE, "pressure_pa", baro_step(40.0), 150.0, 158.0)
        return run(made, gain=gain).worst_m(150.0, 175.0)

    assert short("robust") < 2.0
    assert short("optimal") > 10.0


def test_without_reacquisition_the_robust_gain_locks_out() -> None:
    """The paper's filter on a barometer that steps by 100 m for good, and ours."""
    made = cruise().change(Kind.PRESSURE, "pressure_pa", baro_step(100.0), 150.0)
    paper_s = run(made, publish="ibi", reacquire_s="never")
    assert paper_s.state["pair"]["prob"][0, paper.IBI] < 1e-3
    assert paper_s.state["pair"]["refused_s"][0, paper.IBI] > 140.0
    ours = run(made, publish="ibi")
    assert ours.state["pair"]["prob"][0, paper.IBI] > 0.9
    assert ours.worst_m(290.0, 300.0) < 3.0, "and the new level is a new datum"


def test_an_imu_that_both_contradict_is_the_fault() -> None:
    """1 m/s2 of accelerometer bias in flight: alone for ten seconds it would be 50 m."""
    made = cruise().change(
        Kind.IMU, "specific_force_b_mps2", lambda force: force + np.array([0.0, 0.0, 1.0]), 150.0
    )
    result = run(made)
    assert result.worst_m(150.0, 300.0) < 20.0
    assert result.worst_m(180.0, 300.0) < 2.0


def test_a_spike_is_gated_and_leaves_no_trace() -> None:
    spiky = cruise()
    table = spiky.tables[Kind.PRESSURE]
    table["pressure_pa"][3000::97] -= 600.0  # 50 m
    result, clean = run(spiky), run(cruise())
    late = result.elapsed_s > 160.0
    assert np.abs(result.errors_m[late] - clean.errors_m[late]).max() < 0.5
    assert result.share_of(Kind.PRESSURE, Verdict.GATED) > 0.004


@pytest.mark.parametrize("imu_hz", [0.0, 1.0, 4.0])
def test_without_an_integrable_imu_barometer_and_gnss_remain(imu_hz: float) -> None:
    result = run(cruise(imu_hz=imu_hz, attitude_hz=0.0, pressure_hz=2.0, gnss_hz=1.0))
    assert result.state["pair"]["inertial"][0] == 0
    assert result.rms_m(60.0, 300.0) < 1.5
    if imu_hz > 0:
        assert result.share_of(Kind.IMU, Verdict.IGNORED) == 1.0


def test_an_imu_that_falls_silent_is_replaced_and_comes_back() -> None:
    result = run(cruise().drop(Kind.IMU, 100.0, 200.0))
    assert result.worst_m(60.0, 300.0) < 3.0
    assert result.state["pair"]["inertial"][0] == 1


@pytest.mark.parametrize("kinds", [(Kind.GNSS,), (Kind.PRESSURE,), (Kind.GNSS, Kind.PRESSURE)])
def test_an_outage_of_a_minute_is_bridged_and_said(kinds: tuple[Kind, ...]) -> None:
    made = cruise()
    for kind in kinds:
        made = made.drop(kind, *FAULT_S)
    result = run(made)
    during = (result.elapsed_s > FAULT_S[1] - 5.0) & (result.elapsed_s < FAULT_S[1])
    assert result.worst_m(*FAULT_S) < (3.0 if len(kinds) == 1 else 30.0)
    assert (np.abs(result.errors_m[during]) < 3.0 * result.estimates["altitude_sd_m"][during]).all()
    if len(kinds) == 2:
        last = np.flatnonzero(result.elapsed_s < FAULT_S[1])[-1]
        assert result.estimates["altitude_sd_m"][last] > 30.0, (
            "so long alone, the inertial channel is LOST"
        )
    assert result.worst_m(270.0, 300.0) < 3.0


def test_a_gap_of_minutes_starts_anew() -> None:
    made = cruise()
    for kind in (Kind.IMU, Kind.PRESSURE, Kind.GNSS, Kind.ATTITUDE):
        made = made.drop(kind, 60.0, 240.0)
    assert run(made).worst_m(250.0, 300.0) < 3.0


@pytest.mark.parametrize("kind", [Kind.PRESSURE, Kind.GNSS])
def test_with_one_of_the_two_only(kind: Kind) -> None:
    """Without GNSS there is no datum and no altitude; without a barometer IIG remains."""
    result = run(cruise().drop(kind))
    known = np.isfinite(result.estimates["altitude_amsl_m"])
    if kind is Kind.GNSS:
        assert not known.any()
    else:
        assert result.rms_m(60.0, 300.0) < 2.0
        assert not np.isfinite(
            run(cruise().drop(kind), publish="ibi").estimates["altitude_amsl_m"]
        ).any()


def test_late_fixes_meet_the_height_of_their_own_time() -> None:
    """In a climb of 4 m/s a quarter of a second is a metre, were it not taken care of."""
    prompt, late = (run(cruise(gnss_age_s=age_s), publish="iig") for age_s in (0.0, 0.25))
    assert late.rms_m(60.0, 90.0) == pytest.approx(prompt.rms_m(60.0, 90.0), abs=0.2)


def test_secondary_instances_are_ignored() -> None:
    result = Filter(METHOD)
    for kind in (Kind.IMU, Kind.PRESSURE, Kind.GNSS, Kind.ATTITUDE):
        assert result.step(kind, sample(kind, 1_000_000, instance=1)) is Verdict.IGNORED


def test_the_autopilot_s_attitude_may_be_refused() -> None:
    result = run(cruise(), use_attitude=False)
    assert result.share_of(Kind.ATTITUDE, Verdict.IGNORED) == 1.0
    assert result.rms_m(60.0, 300.0) < 1.5


def test_a_wrong_attitude_of_the_vehicle_does_little() -> None:
    made = cruise().change(
        Kind.ATTITUDE, "roll_rad", lambda roll_rad: roll_rad + math.radians(26.0), 150.0
    )
    assert run(made).worst_m(150.0, 300.0) < 6.0
