"""Heights that no receiver can mean, which sensor is the first, and the geoid."""

import math
from collections.abc import Callable

import pytest

from companion.health import Health
from companion.intake.geoid import undulation_m
from companion.mavlink.codec import Message, mavlink
from companion.samples import Kind, Verdict
from companion.settings import CompanionSettings
from tests.flights import HOST_EPOCH_US
from tests.vehicle import (
    ALTITUDE_M,
    Outcome,
    Vehicle,
    feed,
    gps,
    heartbeat,
    merged,
    pressure,
    standing,
)

LATITUDE, LONGITUDE, UNDULATION_M = 47.1, 8.3, 48.5


def here(boot_s: float, altitude_m: float = ALTITUDE_M, **fields: int) -> Message:
    """A fix in Switzerland, where the geoid is 48 m above the ellipsoid."""
    place = {"lat": round(LATITUDE * 1e7), "lon": round(LONGITUDE * 1e7)}
    return gps(boot_s, altitude_m, **place | fields)


def gps2(boot_s: float) -> Message:
    first = gps(boot_s)
    return mavlink.MAVLink_gps2_raw_message(
        first.time_usec, 3, first.lat, first.lon, first.alt, 90, 140, 20, 9000, 12, 0, 0
    )


def pressure2(boot_s: float) -> Message:
    first = pressure(boot_s)
    return mavlink.MAVLink_scaled_pressure2_message(
        first.time_boot_ms, first.press_abs, 0.0, first.temperature
    )


def worst_m(outcome: Outcome) -> float:
    return max(abs(height_m - ALTITUDE_M) for height_m in outcome.amsl_m())


@pytest.mark.parametrize(
    ("latitude", "longitude", "height_m"),
    [
        (0.0, 0.0, 17.16),
        (47.0, 8.0, 48.6),
        (38.0, -78.0, -32.0),
        (90.0, 0.0, 13.6),
        (-90.0, 17.0, -29.5),
        (4.0, 78.5, -103.0),
    ],
)
def test_the_geoid_where_it_is_known(latitude: float, longitude: float, height_m: float) -> None:
    """EGM96 at places of its own tables, to the metre or two of a one-degree grid."""
    assert undulation_m(latitude, longitude) == pytest.approx(height_m, abs=2.5)
    assert undulation_m(latitude, longitude + 360.0) == undulation_m(latitude, longitude)


def test_no_geoid_nowhere() -> None:
    assert math.isnan(undulation_m(91.0, 0.0))
    assert math.isnan(undulation_m(math.nan, 0.0))


def test_a_height_of_the_ellipsoid_is_counted_in_the_spread() -> None:
    """alt = alt_ellipsoid to the millimetre: 48 m wrong, and never OK with a spread of metres."""

    def wrong(boot_s: float) -> Message:
        height_m = ALTITUDE_M + UNDULATION_M
        return here(boot_s, height_m, alt_ellipsoid=round(height_m * 1e3), v_acc=1800)

    outcome = feed(standing(30.0, 90.0, gps=wrong))
    fixes = [row for kind, row in outcome.rows if kind is Kind.GNSS]
    assert fixes[-1]["vertical_sd_m"] > 45.0
    assert outcome.pipeline.health.health is Health.LOST
    assert "ellipsoid" in outcome.pipeline.health.reason
    assert outcome.amsl_m() == []


def test_it_is_corrected_where_that_is_configured() -> None:
    settings = CompanionSettings().with_changes(intake={"equal_heights": "ellipsoid"})

    def wrong(boot_s: float) -> Message:
        height_m = ALTITUDE_M + UNDULATION_M
        return here(boot_s, height_m, alt_ellipsoid=round(height_m * 1e3), v_acc=1800)

    outcome = feed(standing(30.0, 90.0, gps=wrong), settings)
    assert abs(outcome.amsl_m()[-1] - ALTITUDE_M) < 3.0
    assert outcome.pipeline.health.health is Health.OK


def test_a_simulator_without_a_geoid_can_be_trusted() -> None:
    settings = CompanionSettings().with_changes(intake={"equal_heights": "sea_level"})
    same = lambda s: here(s, alt_ellipsoid=round(ALTITUDE_M * 1e3), v_acc=1800)
    outcome = feed(standing(30.0, 60.0, gps=same), settings)
    assert worst_m(outcome) < 3.0
    assert outcome.pipeline.health.health is Health.OK


def simstate(boot_s: float) -> Message:
    return mavlink.MAVLink_simstate_message(*[0.0] * 9, round(LATITUDE * 1e7), 0)


def sim_state(altitude_m: float) -> Message:
    return mavlink.MAVLink_sim_state_message(
        *[0.0] * 13, LATITUDE, LONGITUDE, altitude_m, *[0.0] * 5
    )


def hil_state(altitude_m: float) -> Message:
    return mavlink.MAVLink_hil_state_quaternion_message(
        0, [1.0, 0.0, 0.0, 0.0], *[0.0] * 3, 0, 0, round(altitude_m * 1e3), *[0] * 8
    )


def equal(boot_s: float, altitude_m: float = ALTITUDE_M) -> Message:
    """A fix with one height for sea level and ellipsoid."""
    return here(boot_s, altitude_m, alt_ellipsoid=round(altitude_m * 1e3), v_acc=1800)


@pytest.mark.parametrize("tell", [simstate, lambda s: sim_state(ALTITUDE_M)])
def test_a_simulated_vehicle_ends_the_doubt(tell: Callable[[float], Message]) -> None:
    """Heard for three seconds: that stays, also after a reboot, and no note remains."""
    once = lambda s: tell(s) if 40.0 <= s < 43.0 else None
    outcome = feed(
        [
            *standing(30.0, 90.0, gps=equal, simulator=(5.0, once)),
            *standing(3.0, 40.0, host_us=HOST_EPOCH_US + 100_000_000, gps=equal),
        ]
    )
    fixes = [row for kind, row in outcome.rows if kind is Kind.GNSS]
    assert fixes[0]["vertical_sd_m"] > 45.0
    assert {row["vertical_sd_m"] for row in fixes[-100:]} == {1.8}
    assert outcome.pipeline.intake.clock.reboots == 1
    assert worst_m(outcome) < 3.0
    assert outcome.pipeline.health.health is Health.OK
    assert outcome.pipeline.intake.notes == []


@pytest.mark.parametrize("tell", [sim_state, hil_state])
def test_a_simulated_ellipsoid_height_stays_in_doubt(tell: Callable[[float], Message]) -> None:
    """The simulator's true altitude is 48 m below both heights of the fix."""
    outcome = feed(
        standing(
            30.0,
            90.0,
            gps=lambda s: equal(s, ALTITUDE_M + UNDULATION_M),
            simulator=(5.0, lambda s: tell(ALTITUDE_M)),
        )
    )
    assert outcome.amsl_m() == []
    assert "ellipsoid" in outcome.pipeline.health.reason
    assert len(outcome.pipeline.intake.notes) == 1


def test_another_sender_does_not_end_the_doubt() -> None:
    """SIMSTATE of system 2 beside the vehicle, which is system 1."""
    other = standing(30.0, 60.0, vehicle=Vehicle(2, 1), simulator=(5.0, simstate))
    outcome = feed(merged(standing(30.0, 60.0, gps=equal), other))
    assert outcome.amsl_m() == []


def test_heights_of_the_two_kinds_are_left_alone() -> None:
    right = lambda s: here(s, alt_ellipsoid=round((ALTITUDE_M + UNDULATION_M) * 1e3), v_acc=1800)
    outcome = feed(standing(30.0, 60.0, gps=right))
    fixes = [row for kind, row in outcome.rows if kind is Kind.GNSS]
    assert {row["vertical_sd_m"] for row in fixes} == {1.8}
    assert outcome.pipeline.health.health is Health.OK


def test_heights_of_exactly_zero_are_none() -> None:
    """A 3D fix that never fills in its height: no ALTITUDE, and a reason."""
    outcome = feed(standing(30.0, 60.0, gps=lambda s: gps(s, 0.0, alt_ellipsoid=0)))
    assert outcome.amsl_m() == []
    assert outcome.count(Kind.GNSS, Verdict.USED) == 0
    assert outcome.pipeline.health.health is Health.LOST


@pytest.mark.parametrize("factor", [10.0, 100.0, 0.1])
def test_a_height_in_another_unit_is_not_used(factor: float) -> None:
    """After both heights moved by twenty metres, twice."""
    climb_mps = 3.0 if factor > 1.0 else 12.0

    def height_m(boot_s: float) -> float:
        return 100.0 + climb_mps * max(0.0, boot_s - 40.0)

    outcome = feed(
        standing(
            30.0,
            80.0,
            gps=lambda s: gps(s, height_m(s) * factor),
            pressure=lambda s: pressure(s, height_m(s)),
        )
    )
    fixes = [row for kind, row in outcome.rows if kind is Kind.GNSS]
    assert math.isnan(fixes[-1]["altitude_amsl_m"])


def test_a_receiver_that_slides_is_in_no_other_unit() -> None:
    """It moved by ten times what the barometer did, twice; its heights were withheld, and the
    estimator forgot its doubt. In another unit it reads ten times the height, too."""
    outcome = feed(
        standing(
            30.0,
            80.0,
            gps=lambda s: gps(s, 1200.0 + 30.0 * max(0.0, s - 40.0)),
            pressure=lambda s: pressure(s, 1200.0 + 3.0 * max(0.0, s - 40.0)),
        )
    )
    fixes = [row for kind, row in outcome.rows if kind is Kind.GNSS]
    assert all(math.isfinite(row["altitude_amsl_m"]) for row in fixes)


def test_a_receiver_that_claims_99_99_beside_a_fix_claims_nothing() -> None:
    outcome = feed(standing(30.0, 60.0, gps=lambda s: gps(s, eph=9999, epv=9999, v_acc=0)))
    fixes = [row for kind, row in outcome.rows if kind is Kind.GNSS]
    assert math.isnan(fixes[-1]["hdop"])
    assert worst_m(outcome) < 5.0
    assert outcome.pipeline.health.health is not Health.LOST


ESTIMATORS = ("vertical-bank", "adaptive-fusion", "air-data-gnss")


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_a_second_receiver_steps_in_for_one_that_never_had_a_fix(estimator: str) -> None:
    settings = CompanionSettings().with_changes(estimator=estimator)
    blind = lambda s: gps(s, fix_type=1, lat=0, lon=0, alt=0, eph=9999, epv=65535, v_acc=0)
    outcome = feed(standing(30.0, 70.0, gps=blind, gps2=(5.0, gps2)), settings)
    assert worst_m(outcome) < 5.0
    assert outcome.pipeline.health.health is not Health.LOST


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("is_heard", [True, False])
def test_a_second_barometer_steps_in_for_one_that_never_had_a_value(
    estimator: str, is_heard: bool
) -> None:
    settings = CompanionSettings().with_changes(estimator=estimator)
    dead = (lambda s: pressure(s, press_abs=0.0)) if is_heard else None
    outcome = feed(standing(30.0, 70.0, pressure=dead, pressure2=(5.0, pressure2)), settings)
    assert worst_m(outcome) < 5.0
    assert outcome.pipeline.health.health is Health.OK


def test_the_first_sensor_stays_the_first_when_it_works() -> None:
    outcome = feed(standing(30.0, 40.0, pressure2=(5.0, pressure2), gps2=(5.0, gps2)))
    heard = {(kind, instance) for kind, instance, _ in outcome.samples}
    assert {(Kind.PRESSURE, 0), (Kind.PRESSURE, 1), (Kind.GNSS, 0), (Kind.GNSS, 1)} <= heard
    pressures = [row for kind, row in outcome.rows if kind is Kind.PRESSURE]
    assert pressures[0]["instance"] == 0


def test_airspeed_of_the_vehicle() -> None:
    """VFR_HUD as it says, and a differential pressure by the formula of impact pressure."""
    hud = mavlink.MAVLink_vfr_hud_message(23.5, 20.0, 90, 50, ALTITUDE_M, 0.0)
    outcome = feed(
        standing(
            30.0,
            40.0,
            hud=(4.0, lambda s: hud),
            pressure=lambda s: pressure(s, press_diff=0.5 * 1.225 * 30.0**2 / 100.0),
            heartbeat=lambda s: heartbeat(),
        )
    )
    speeds = [row for kind, row in outcome.rows if kind is Kind.AIRSPEED]
    assert {row["airspeed_mps"] for row in speeds if row["instance"] == 0} == {23.5}
    measured = [row["airspeed_mps"] for row in speeds if row["instance"] == 1]
    assert measured[-1] == pytest.approx(30.0, abs=0.1)
