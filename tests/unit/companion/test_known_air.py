"""What is known of the air: keys, METAR, live changes, and how they reach the estimator."""

import math

import pytest

from companion.errors import ConfigError
from companion.intake import Intake, IntakeSettings
from companion.known_air import AirSettings, KnownAir, read_metar
from companion.samples import DTYPES, Kind, rows
from companion.settings import CompanionSettings


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
    assert not known.waits
    known.set(metar="LSZH 281420Z CAVOK 12/08 Q1013")
    assert known.waits
    assert (known.qnh_hpa, known.temperature_c) == (1013.0, 12.0)
    known.waits = False
    known.restart()
    assert known.waits
    known.set(field_elevation_m=432.0)
    assert (known.qnh_hpa, known.field_elevation_m, known.temperature_c) == (None, 432.0, 12.0)
    with pytest.raises(ConfigError, match="qnh_hpa"):
        known.set(qnh_hpa=300.0)


def test_samples_of_the_air_are_never_older_than_the_last() -> None:
    """A setting that comes with the same pressure as a temperature is not lost as stale."""
    intake, known = Intake(IntakeSettings()), KnownAir(AirSettings(qnh_hpa=1005.0))
    at = rows(DTYPES[Kind.PRESSURE])
    at["time_us"], at["arrival_us"] = 5_000_000, 5_000_000
    first = int(intake.air(known, at)["time_us"][0])
    second = intake.air(known, at)
    assert int(second["time_us"][0]) == first + 1
    assert second["qnh_pa"][0] == 100_500.0
    assert math.isnan(second["air_temperature_k"][0])
