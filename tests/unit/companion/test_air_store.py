"""What a ground station set of the air, kept for the next start."""

from pathlib import Path

import pytest

from companion.air_store import FRESH_S, AirStore
from companion.known_air import AirSettings, KnownAir

NOW_S = 1_760_000_000.0


def kept(folder: Path, **values: float) -> None:
    air = KnownAir(AirSettings())
    air.set(**values)  # type: ignore[arg-type]
    assert AirStore(["tcp:a"], folder, lambda: NOW_S).keep(air)


def restored(folder: Path, age_s: float, link: str = "tcp:a", **given: float) -> KnownAir:
    settings = AirSettings(**given)
    air = KnownAir(settings)
    AirStore([link], folder, lambda: NOW_S + age_s).restore(air, settings)
    return air


def test_it_is_there_after_a_restart(tmp_path: Path) -> None:
    kept(tmp_path, qnh_hpa=1009.0, temperature_c=-5.0)
    air = restored(tmp_path, 60.0)
    assert (air.qnh_hpa, air.temperature_c) == (1009.0, -5.0)
    assert air.tell(0) is not None
    assert restored(tmp_path, 60.0, "tcp:b").qnh_hpa is None


def test_the_weather_of_yesterday_is_not_used_but_the_field_stays(tmp_path: Path) -> None:
    kept(tmp_path, field_elevation_m=432.0, temperature_c=20.0)
    air = restored(tmp_path, FRESH_S + 1.0)
    assert (air.field_elevation_m, air.temperature_c) == (432.0, None)
    kept(tmp_path, qnh_hpa=1009.0)
    assert restored(tmp_path, FRESH_S + 1.0).qnh_hpa is None
    assert restored(tmp_path, -FRESH_S).qnh_hpa is None  # a clock that went back


def test_the_configuration_wins(tmp_path: Path) -> None:
    kept(tmp_path, field_elevation_m=432.0)
    air = restored(tmp_path, 60.0, qnh_hpa=990.0)
    assert (air.qnh_hpa, air.field_elevation_m) == (990.0, None)
    kept(tmp_path, qnh_hpa=1009.0)
    air = restored(tmp_path, 60.0, field_elevation_m=400.0)
    assert (air.qnh_hpa, air.field_elevation_m) == (None, 400.0)


def test_it_can_be_forgotten(tmp_path: Path) -> None:
    kept(tmp_path, qnh_hpa=1009.0)
    store = AirStore(["tcp:a"], tmp_path)
    assert store.keep(None)
    assert store.keep(None)
    assert restored(tmp_path, 60.0).qnh_hpa is None


@pytest.mark.parametrize(
    "content",
    ["", "[]", "{}", '{"qnh_hpa": 5000, "unix_s": 1760000000}', '{"qnh_hpa": "x"}', "\0\0"],
)
def test_a_damaged_file_is_not_used(tmp_path: Path, content: str) -> None:
    store = AirStore(["tcp:a"], tmp_path)
    assert store.path is not None
    store.path.write_text(content)
    air = restored(tmp_path, 60.0)
    assert (air.qnh_hpa, air.field_elevation_m, air.tell(0)) == (None, None, None)


def test_a_disk_that_refuses_is_reported(tmp_path: Path) -> None:
    store = AirStore(["tcp:a"], tmp_path / "absent")
    assert not store.keep(KnownAir(AirSettings()))
