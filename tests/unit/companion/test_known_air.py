"""What is known of the air: keys, METAR, live changes, and how they reach the estimator."""

import math
from collections.abc import Iterable, Iterator

import pytest

from companion.errors import ConfigError
from companion.estimators import ESTIMATORS
from companion.intake import Intake, IntakeSettings
from companion.known_air import AirSettings, Known, KnownAir, read_metar
from companion.pipeline import Pipeline
from companion.samples import DTYPES, Kind, Rows, rows, sample
from companion.settings import CompanionSettings
from tests.vehicle import ALTITUDE_M, gps, pressure, standing


@pytest.mark.parametrize(
    ("text", "qnh_hpa", "temperature_c"),
    [
        ("LSZH 281420Z 24008KT CAVOK 12/08 Q1013 NOSIG", 1013.0, 12.0),
        ("METAR KJFK 281451Z 31015KT 10SM FEW250 M03/M14 A3012 RMK AO2 SLP199", 1019.98, -3.0),
        ("ENGM 281420Z 01004KT 9999 M12/ Q0987", 987.0, -12.0),
        ("EDDF 281420Z 24008KT CAVOK ///// Q//// TEMPO 25/20 Q1000", None, None),
        ("no report", None, None),
    ],
)
def test_metar(text: str, qnh_hpa: float | None, temperature_c: float | None) -> None:
    assert read_metar(text) == pytest.approx((qnh_hpa, temperature_c), abs=0.01)


def test_keys_count_more_than_the_metar() -> None:
    air = AirSettings(metar="LSZH 281420Z CAVOK 12/08 Q1013", qnh_hpa=1005.0)
    assert air.report == (1005.0, 12.0)


@pytest.mark.parametrize("text", ["hello", "LSZH Q0400", "LSZH Q9999"])
def test_a_metar_that_tells_nothing_possible_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="metar"):
        CompanionSettings().with_changes(air={"metar": text})


def test_live_changes_are_told_once_and_again_after_a_restart() -> None:
    known = KnownAir(AirSettings())
    assert known.tell(0) is None
    known.set(metar="LSZH 281420Z CAVOK 12/08 Q1013")
    assert known.tell(0) == Known(12.0, 1013.0)
    assert known.tell(1) is None
    known.restart()
    assert known.tell(2) == Known(12.0, 1013.0)
    known.set(field_elevation_m=432.0)
    assert (known.qnh_hpa, known.field_elevation_m, known.temperature_c) == (None, 432.0, 12.0)
    with pytest.raises(ConfigError, match="qnh_hpa"):
        known.set(qnh_hpa=300.0)


def test_samples_of_the_air_are_never_older_than_the_last() -> None:
    """A setting that comes with the same pressure as a temperature is not lost as stale."""
    intake, known = Intake(IntakeSettings()), Known(qnh_hpa=1005.0)
    at = rows(DTYPES[Kind.PRESSURE])
    at["time_us"], at["arrival_us"] = 5_000_000, 5_000_000
    first = int(intake.air(known, at)["time_us"][0])
    second = intake.air(known, at)
    assert int(second["time_us"][0]) == first + 1
    assert second["qnh_pa"][0] == 100_500.0
    assert math.isnan(second["air_temperature_k"][0])


def on_field(start_s: float, end_s: float, **changes: float) -> Iterator[tuple[Kind, Rows]]:
    """Samples of a disarmed vehicle at rest at 432 m, or with `changes`: armed, landed, speed_mps,
    sink_mps, gnss_m."""
    for tenth in range(int(start_s * 10), int(end_s * 10)):
        time_us = tenth * 100_000
        armed, landed = int(changes.get("armed", 0)), int(changes.get("landed", -1))
        yield Kind.STATUS, sample(Kind.STATUS, time_us, armed=armed, landed=landed)
        fix = {"altitude_amsl_m": changes.get("gnss_m", 435.0), "vertical_sd_m": 3.0}
        fix |= {"ground_speed_mps": changes.get("speed_mps", 0.2), "fix_type": 3}
        yield Kind.GNSS, sample(Kind.GNSS, time_us, **fix)
        fallen_m = changes.get("sink_mps", 0.0) * tenth / 10.0
        pressure_pa = 96_000.0 + 11.5 * fallen_m
        yield Kind.PRESSURE, sample(Kind.PRESSURE, time_us, pressure_pa=pressure_pa)


def told_m(known: KnownAir, samples: Iterable[tuple[Kind, Rows]]) -> list[float]:
    """Times (s) at which the field's elevation is told."""
    times_s = []
    for kind, row in samples:
        known.sample(kind, row)
        now_us = int(row["time_us"][0])
        told = known.tell(now_us) if kind is Kind.PRESSURE else None
        if told is not None and told.field_elevation_m is not None:
            assert told.field_elevation_m == 432.0
            times_s.append(now_us * 1e-6)
    return times_s


def field() -> KnownAir:
    return KnownAir(AirSettings(field_elevation_m=432.0))


def test_the_elevation_is_told_while_the_vehicle_rests() -> None:
    assert told_m(field(), on_field(10.0, 35.0)) == pytest.approx(list(range(13, 35, 2)))
    assert told_m(field(), on_field(10.0, 20.0, armed=1, landed=1))


@pytest.mark.parametrize(
    "changes",
    [
        {"armed": 1},  # a copter that hovers, or a glider that does not tell
        {"landed": 0},
        {"armed": -1},  # nothing is known
        {"speed_mps": 4.0},
        {"sink_mps": 1.0},
        {"gnss_m": 132.0},  # the elevation of another field, or in feet
    ],
)
def test_the_elevation_is_not_told_elsewhere(changes: dict[str, float]) -> None:
    assert told_m(field(), on_field(10.0, 30.0, **changes)) == []


@pytest.mark.parametrize("flown", [{"landed": 0}, {"speed_mps": 40.0}, {"armed": 1, "sink_mps": 2}])
def test_a_vehicle_that_has_left_rests_on_another_field(flown: dict[str, float]) -> None:
    """Until somebody tells its elevation. A new start of the estimator changes nothing."""
    known = field()
    assert told_m(known, on_field(10.0, 20.0)) != []
    assert told_m(known, on_field(20.0, 40.0, **flown)) == []
    known.restart()
    known.set(temperature_c=12.0)
    assert told_m(known, on_field(40.0, 60.0, landed=1)) == []
    known.set(field_elevation_m=432.0)
    assert told_m(known, on_field(60.0, 65.0, landed=1)) != []


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_a_vehicle_at_rest_is_at_the_elevation_of_its_field(name: str) -> None:
    """The receiver's fixes are 7 m high and claim 4 m; `tests.vehicle` stands at 500 m. Without the
    elevation every estimator that follows GNSS is 7 m wrong."""
    settings = CompanionSettings().with_changes(
        estimator=name, air={"field_elevation_m": ALTITUDE_M}
    )
    pipeline = Pipeline(settings)
    high = round((ALTITUDE_M + 7.0) * 1e3)
    noisy = standing(
        *(30.0, 50.0),
        gps=lambda t: gps(t, alt=high, v_acc=4000),
        pressure=lambda t: pressure(t, ALTITUDE_M + 0.3 * math.sin(7.0 * t)),
    )
    for packet in noisy:
        pipeline.feed(packet)
    estimate = pipeline.estimate[0]
    assert estimate["altitude_amsl_m"] == pytest.approx(ALTITUDE_M, abs=3.0)
    assert abs(estimate["altitude_amsl_m"] - ALTITUDE_M) < 2.0 * estimate["altitude_sd_m"]
