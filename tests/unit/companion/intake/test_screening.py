"""Barometer against GNSS: refused at once when they never agreed or one jumped, else after ten
seconds."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from companion.intake import IntakeSettings
from companion.intake.screening import DatumScreen
from companion.samples import Kind, Suspicion, sample
from tests.flights import flight, standard_pressure_pa

SECOND_US = 1_000_000
Height = Callable[[float], float | None]


def pascals(altitude_m: float) -> float:
    return float(standard_pressure_pa(np.array(altitude_m), 100_725.0))


class Bench:
    """A screen fed 5 Hz of each; heights are functions of seconds, None sends nothing."""

    def __init__(self, **changes: float) -> None:
        self.screen = DatumScreen(IntakeSettings(**changes))
        self.tick = 0
        self.marks: list[tuple[float, Kind]] = []
        """(seconds, kind) of every row that was marked"""

    def run(
        self, duration_s: float, baro: Height, gnss: Height, sd_m: float = 2.0, **fields: float
    ) -> "Bench":
        """`baro` gives an altitude; the pressure has a pascal of noise, as every living sensor."""
        random = np.random.default_rng(self.tick)
        for _ in range(round(duration_s * 5)):
            self.tick += 1
            now_s = self.tick * 0.2
            time_us, height_m, baro_m = round(now_s * SECOND_US), gnss(now_s), baro(now_s)
            if height_m is not None:
                values = {
                    "altitude_amsl_m": height_m,
                    "fix_type": 3,
                    "vertical_sd_m": sd_m,
                    "instance": 0,
                } | fields
                row = sample(Kind.GNSS, time_us - 120_000, **values)
                self.screen.gnss(row)
                self._note(now_s, Kind.GNSS, int(row["suspect"][0]))
            if baro_m is not None:
                pressure_pa = pascals(baro_m) + random.normal()
                row = sample(
                    Kind.PRESSURE, time_us, pressure_pa=pressure_pa, die_temperature_k=300.0
                )
                self.screen.pressure(row)
                self._note(now_s, Kind.PRESSURE, int(row["suspect"][0]))
        return self

    def _note(self, now_s: float, kind: Kind, suspect: int) -> None:
        if suspect:
            assert suspect == Suspicion.DATUM
            self.marks.append((now_s, kind))

    def marked(self, kind: Kind) -> list[float]:
        return [now_s for now_s, marked in self.marks if marked is kind]


def at(height_m: float) -> Height:
    return lambda now_s: height_m


def half_pressure(now_s: float) -> float:
    """505 hPa, as an altitude in this test's air."""
    return 5376.0


class TestDatum:
    def test_half_the_true_pressure_is_refused_at_once(self) -> None:
        bench = Bench().run(30, half_pressure, at(90))
        assert bench.marked(Kind.PRESSURE)[0] <= 0.4
        assert len(bench.marked(Kind.PRESSURE)) >= 149
        assert bench.marked(Kind.GNSS) == []
        assert bench.marks[-1][0] == pytest.approx(30.0)

    @pytest.mark.parametrize("error_m", [-650, -300, 0, 300, 650])
    def test_weather_makes_nothing_suspect(self, error_m: float) -> None:
        assert Bench().run(60, at(500 + error_m), at(500)).marks == []

    def test_the_limit_grows_with_height(self) -> None:
        assert Bench().run(60, at(9000), at(10_000)).marks == []
        assert Bench().run(60, at(9000 - 1300), at(10_000)).marks != []

    def test_a_barometer_that_drifts_off_is_refused_after_ten_seconds(self) -> None:
        """30 m/s of error, from the 50 m of today's weather, while the vehicle stands: 775 m after
        24 s."""
        bench = (
            Bench()
            .run(20, at(500), at(500))
            .run(60, lambda now_s: 500 + 30 * (now_s - 20), at(500))
        )
        assert bench.marked(Kind.PRESSURE)[0] == pytest.approx(20 + 24.2 + 10, abs=0.5)
        assert bench.marked(Kind.GNSS) == []

    def test_a_gnss_height_that_slides_off_is_refused_after_ten_seconds(self) -> None:
        """Past 700 m + 15 % of itself above a barometer at 550 m: at 1470 m, after 32 s."""
        bench = (
            Bench()
            .run(20, at(500), at(500))
            .run(60, at(500), lambda now_s: 500 + 30 * (now_s - 20))
        )
        assert bench.marked(Kind.GNSS)[0] == pytest.approx(20 + 32.3 + 10, abs=0.5)
        assert bench.marked(Kind.PRESSURE) == []

    def test_a_shorter_contradiction_makes_nothing_suspect(self) -> None:
        bench = Bench(step_limit_m=10_000)
        bench.run(20, at(500), at(500)).run(9, at(500), at(1600)).run(20, at(500), at(500))
        assert bench.marks == []

    def test_two_glimpses_of_a_contradiction_are_no_ten_seconds(self) -> None:
        bench = Bench(step_limit_m=10_000).run(20, at(500), at(500))
        bench.run(0.2, at(500), at(1600)).run(60, at(500), lambda now_s: None).run(
            0.4, at(500), at(1600)
        )
        assert bench.marks == []

    def test_they_may_make_it_up(self) -> None:
        bench = Bench().run(30, half_pressure, at(90)).run(30, at(90), at(90))
        assert max(bench.marked(Kind.PRESSURE)) == pytest.approx(40, abs=1)

    def test_a_frozen_barometer_is_suspect_though_the_vehicle_moved(self) -> None:
        """It repeats one value while the vehicle climbs: who moved is GNSS, who is wrong is not."""
        bench = Bench().run(20, at(500), at(500))
        frozen_pa = pascals(500.0)
        for tick in range(60 * 5):
            now_s = 20 + tick * 0.2
            time_us = round(now_s * SECOND_US)
            row = sample(
                Kind.GNSS,
                time_us,
                altitude_amsl_m=500 + 30.0 * tick * 0.2,
                fix_type=3,
                vertical_sd_m=2.0,
            )
            bench.screen.gnss(row)
            assert row["suspect"][0] == 0
            row = sample(Kind.PRESSURE, time_us, pressure_pa=frozen_pa)
            bench.screen.pressure(row)
        assert row["suspect"][0] == Suspicion.DATUM

    @pytest.mark.parametrize(
        "fields",
        [
            {"fix_type": 2},
            {"sd_m": 25.0},
            {"sd_m": math.nan, "hdop": 20.0},
            {"sd_m": math.nan, "vdop": 99.99},
            {"instance": 1},
        ],
    )
    def test_a_fix_that_proves_nothing_makes_nothing_suspect(
        self, fields: dict[str, float]
    ) -> None:
        assert Bench().run(30, half_pressure, at(90), **fields).marks == []

    @pytest.mark.parametrize(
        "fields", [{"sd_m": math.nan}, {"sd_m": math.nan, "hdop": 1.2}, {"sd_m": 19.0}]
    )
    def test_a_fix_without_a_claim_is_good_enough(self, fields: dict[str, float]) -> None:
        assert Bench().run(30, half_pressure, at(90), **fields).marked(Kind.PRESSURE)

    def test_no_pressure_at_all_is_no_height(self) -> None:
        screen = DatumScreen(IntakeSettings())
        for pressure_pa in (0.0, -1.0, math.nan, math.inf):
            row = sample(Kind.PRESSURE, SECOND_US, pressure_pa=pressure_pa)
            screen.gnss(sample(Kind.GNSS, SECOND_US, altitude_amsl_m=90.0, fix_type=3))
            screen.pressure(row)
            assert row["suspect"][0] == 0

    def test_every_barometer_has_its_own_verdict(self) -> None:
        screen = DatumScreen(IntakeSettings())
        marks = []
        for tick in range(100):
            time_us = tick * 200_000
            screen.gnss(
                sample(Kind.GNSS, time_us, altitude_amsl_m=90.0, fix_type=3, vertical_sd_m=2.0)
            )
            for instance, pressure_pa in ((0, pascals(90) + tick % 2), (1, 50_500.0 + tick % 2)):
                row = sample(Kind.PRESSURE, time_us, pressure_pa=pressure_pa, instance=instance)
                screen.pressure(row)
                marks.append((instance, int(row["suspect"][0])))
        assert set(marks) == {(0, 0), (1, 1)}

    def test_a_reboot_forgets(self) -> None:
        bench = Bench().run(30, half_pressure, at(90))
        bench.screen.restart()
        bench.marks.clear()
        assert bench.run(0.2, half_pressure, lambda now_s: None).marks == []


class TestStep:
    @pytest.mark.parametrize("jump_m", [-480, -150, 150, 480])
    def test_a_jump_of_the_barometer_is_refused_at_once_and_learned_after_ten_seconds(
        self, jump_m: float
    ) -> None:
        bench = Bench().run(20, at(500), at(500)).run(40, at(500 + jump_m), at(500))
        marked_s = bench.marked(Kind.PRESSURE)
        assert marked_s[0] == pytest.approx(20.2, abs=0.01)
        assert marked_s[-1] == pytest.approx(30.2, abs=0.5)
        assert bench.marked(Kind.GNSS) == []

    @pytest.mark.parametrize("jump_m", [-480, -150, 150, 480])
    def test_a_jump_of_gnss_is_refused_at_once_for_a_minute(self, jump_m: float) -> None:
        bench = Bench().run(20, at(500), at(500)).run(90, at(500), at(500 + jump_m))
        marked_s = bench.marked(Kind.GNSS)
        assert marked_s[0] == pytest.approx(20.2, abs=0.01)
        assert marked_s[-1] == pytest.approx(80.2, abs=0.5)
        assert bench.marked(Kind.PRESSURE) == []

    def test_a_jump_beyond_the_datum_limit_is_refused_for_good(self) -> None:
        bench = Bench().run(20, at(500), at(500)).run(200, at(500), at(3500))
        assert len(bench.marked(Kind.GNSS)) == pytest.approx(1000, abs=2)
        bench.marks.clear()
        bench.run(30, at(500), at(500))
        assert max(bench.marked(Kind.GNSS)) - 220 <= 10.5

    def test_a_spike_costs_one_sample(self) -> None:
        spike = (
            Bench().run(20, at(500), at(500)).run(0.2, at(900), at(500)).run(20, at(500), at(500))
        )
        assert [kind for _, kind in spike.marks] == [Kind.PRESSURE]
        slip = (
            Bench().run(20, at(500), at(500)).run(0.2, at(500), at(100)).run(20, at(500), at(500))
        )
        assert [kind for _, kind in slip.marks] == [Kind.GNSS]

    def test_noise_within_what_the_receiver_admits_is_no_jump(self) -> None:
        bench = Bench()
        random = np.random.default_rng(7)
        bench.run(300, at(500), lambda now_s: float(500 + random.normal(0, 15)), sd_m=15.0)
        assert bench.marks == []

    @pytest.mark.parametrize("climb_mps", [-60, -30, 30, 60])
    def test_a_fast_climb_is_no_jump(self, climb_mps: float) -> None:
        height = lambda now_s: 6000 + climb_mps * (now_s if climb_mps < 0 else now_s - 50)
        assert Bench().run(80, height, height).marks == []

    def test_after_an_outage_they_start_anew(self) -> None:
        """Minutes without GNSS, 2 km further down in warm air: the difference changed honestly."""
        silent: Height = lambda now_s: None
        descent: Height = lambda now_s: 3000 - 16 * (now_s - 20)
        bench = (
            Bench()
            .run(20, at(3000), at(3000))
            .run(125, descent, silent)
            .run(30, at(1000), at(1250))
        )
        assert bench.marks == []


@pytest.mark.parametrize("rate_hz", [1.0, 5.0])
def test_a_whole_flight_makes_nothing_suspect(rate_hz: float) -> None:
    made = flight(seed=3, pressure_hz=rate_hz, gnss_hz=1.0, imu_hz=0.0, attitude_hz=0.0)
    screen, tables = DatumScreen(IntakeSettings()), made.log().tables
    for kind, number in tables.order:
        if kind == Kind.PRESSURE:
            screen.pressure(tables.pressure[number : number + 1])
        elif kind == Kind.GNSS:
            screen.gnss(tables.gnss[number : number + 1])
    assert not tables.pressure["suspect"].any()
    assert not tables.gnss["suspect"].any()
