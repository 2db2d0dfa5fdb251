"""Every guard rail of the feedback, against a vehicle that answers as ArduPilot or PX4 does."""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import pytest

from companion.feedback import Feedback, FeedbackSettings, Hold, Mark, Phase, Situation
from companion.feedback.knobs import KNOBS, REAL32, parameter_value
from companion.health import Health
from companion.mavlink.codec import Message, mavlink
from companion.samples import ESTIMATE, FaultySensor, rows

ARDUPILOT, PX4 = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mavlink.MAV_AUTOPILOT_PX4
ARDUPILOT_VALUES = {
    "BARO_ALT_OFFSET": 0.0,
    "AHRS_EKF_TYPE": 3.0,
    "EK3_SRC1_POSZ": 1.0,
    "EK3_OGN_HGT_MASK": 0.0,
}
PX4_VALUES = {"SENS_BARO_QNH": 1013.25, "EKF2_HGT_REF": 0.0, "EKF2_BARO_CTRL": 1.0}
FIELD_M, GROUND_S = 300.0, 60


class Bench:
    """A vehicle whose altitude is its barometer's, a machine, and time in steps of 0.2 s."""

    def __init__(self, mark: Mark | None = None, kept: bool = True, **settings: object) -> None:
        values = {"mode": "baro-alt-offset"} | settings
        self.px4 = values["mode"] == "qnh"
        self.autopilot = PX4 if self.px4 else ARDUPILOT
        self.values = dict(PX4_VALUES if self.px4 else ARDUPILOT_VALUES)
        self.original = self.values[self.name]
        self.marks: list[Mark | None] = []
        self.kept = kept
        self.settings = FeedbackSettings.model_validate(values)
        self.feedback = Feedback(self.settings, keep=self._keep, mark=mark)
        self.time_s = 10.0
        self.armed = False
        self.height_m = 0.0
        self.drift_m = 0.0
        """what the weather has added to the barometer's altitude"""
        self.drift_mps = 0.0
        self.error_m = 0.0
        """of our own altitude"""
        self.sd_m = 0.1
        self.health, self.faulty, self.level_m = Health.OK, FaultySensor.NONE, 12.0
        self.answers = self.follows = self.sends_height = True
        self.sets: list[tuple[float, float]] = []
        self.texts: list[str] = []
        self._effect_m = self.effect_m

    @property
    def name(self) -> str:
        return "SENS_BARO_QNH" if self.px4 else "BARO_ALT_OFFSET"

    @property
    def effect_m(self) -> float:
        """By how much the parameter raises the vehicle's altitude."""
        return KNOBS[self.settings.mode].metres(self.original, self.values[self.name])

    @property
    def own_error_m(self) -> float:
        """Of the vehicle's own altitude."""
        return self.drift_m + (self._effect_m if self.follows else 0.0)

    def _keep(self, mark: Mark | None) -> bool:
        self.marks.append(mark)
        return self.kept

    def tell(self, name: str) -> None:
        """PARAM_VALUE, as the vehicle sends it."""
        value, kind = self.values[name], REAL32
        if name.startswith("EKF2_"):
            kind = mavlink.MAV_PARAM_TYPE_INT32
            value = math.ldexp(value, -149)  # PX4: the bytes of the integer
        self.feedback.parameter(
            mavlink.MAVLink_param_value_message(name.encode(), value, kind, 1, 0)
        )

    def run(self, duration_s: float, each: Callable[[], None] = lambda: None) -> "Bench":
        for _ in range(round(duration_s / 0.2)):
            self.time_s += 0.2
            self.drift_m += 0.2 * self.drift_mps
            self._effect_m += (self.effect_m - self._effect_m) * (1 - math.exp(-0.2 / 2.0))
            each()
            self._turn()
        return self

    def _turn(self) -> None:
        now_us = round(self.time_s * 1e6)
        self.feedback.heartbeat(self.armed)
        true_m = FIELD_M + self.height_m
        if self.sends_height:
            own_m = true_m + self.own_error_m
            self.feedback.height(now_us, own_m, own_m - FIELD_M)
        estimate = rows(ESTIMATE)
        estimate["time_us"], estimate["climb_mps"] = now_us, 0.0
        estimate["altitude_amsl_m"] = true_m + self.error_m
        estimate["baro_offset_m"] = self.error_m - self.drift_m
        estimate["protection_level_m"], estimate["faulty"] = self.level_m, self.faulty
        estimate["altitude_sd_m"] = self.sd_m
        situation = Situation(self.health, estimate, (1, 1), self.autopilot)
        for message in self.feedback.step(now_us, situation):
            self.answer(message)

    def answer(self, message: Message) -> None:
        kind = message.get_type()
        if kind == "STATUSTEXT":
            self.texts.append(str(message.text))
        elif kind == "PARAM_SET":
            assert message.param_id == self.name
            self.sets.append((self.time_s, float(message.param_value)))
            if self.answers:
                self.values[self.name] = float(message.param_value)
                self.tell(self.name)
        elif kind == "PARAM_REQUEST_READ" and self.answers and message.param_id in self.values:
            self.tell(str(message.param_id))

    def fly(self, drift_mps: float = 0.05, duration_s: float = 300.0) -> "Bench":
        """Stand, take off to 100 m, and fly with a drifting barometer."""
        self.run(GROUND_S)
        self.armed = True
        self.run(1.0)
        self.height_m, self.drift_mps = 100.0, drift_mps
        return self.run(duration_s)

    def land(self) -> "Bench":
        self.height_m = self.drift_mps = 0.0
        self.run(10.0)
        self.armed = False
        return self.run(20.0)


@pytest.mark.parametrize("mode", ["baro-alt-offset", "qnh"])
@pytest.mark.parametrize("drift_mps", [0.05, -0.05, 0.02])
def test_the_vehicle_holds_its_altitude_while_the_barometer_drifts(
    mode: str, drift_mps: float
) -> None:
    bench = Bench(mode=mode).fly(drift_mps, 600.0)
    assert abs(bench.drift_m) > 11.0
    assert abs(bench.own_error_m) < 1.5
    assert bench.texts[0] == f"Kollsman feedback starts: {bench.name} {bench.original:g}"


@pytest.mark.parametrize("mode", ["baro-alt-offset", "qnh"])
def test_writes_are_small_and_seldom(mode: str) -> None:
    bench = Bench(mode=mode).fly(-0.3, 200.0)
    metres = [KNOBS[mode].metres(bench.original, value) for _, value in bench.sets]
    steps = [after - before for before, after in zip([0.0, *metres], metres, strict=False)]
    assert len(steps) > 50
    assert max(map(abs, steps)) <= 0.101  # single precision of a QNH is .5 mm
    times = [time_s for time_s, _ in bench.sets]
    gaps = [after - before for before, after in pairwise(times)]
    assert min(gaps) >= 1.999


def test_nothing_is_written_without_a_need() -> None:
    assert Bench().fly(0.0).sets == []


def test_the_dead_band_is_that_of_the_configuration() -> None:
    bench = Bench(dead_band_m=3.0).fly(0.05, 55.0)
    assert bench.sets == []
    bench.run(40.0)
    assert bench.sets


def test_a_change_within_its_own_spread_is_not_written() -> None:
    """In calm air a poor receiver moves our altitude by a standard deviation and back."""
    bench = Bench().run(5.0)
    bench.sd_m = 4.0
    bench.fly(0.0, 60.0)
    for bench.error_m in (5.0, -5.0, 5.0, 0.0):
        bench.run(300.0)
    assert bench.sets == []
    assert bench.feedback.hold is Hold.ENOUGH


def test_a_change_beyond_its_spread_is_written_but_for_what_is_not_proven() -> None:
    bench = Bench().run(5.0)
    bench.sd_m = 2.0  # of the change 2.8, twice that is the limit
    bench.fly(0.02, 1500.0)
    bench.drift_mps = 0.0
    bench.run(30.0)
    assert bench.drift_m == pytest.approx(30.0, abs=0.1)
    unproven_m = 8.0 * 2.0**2 / 30.0
    assert bench.own_error_m == pytest.approx(unproven_m, abs=0.6)


def test_what_a_good_receiver_has_proven_stays_with_a_poor_one() -> None:
    bench = Bench().fly(0.05, 300.0)
    bench.drift_mps = 0.0
    bench.run(60.0)
    held, writes = bench.values["BARO_ALT_OFFSET"], len(bench.sets)
    assert held < -14.0
    bench.sd_m = 4.0
    for bench.error_m in (3.0, -3.0, 0.0):
        bench.run(200.0)
    assert len(bench.sets) == writes
    assert bench.values["BARO_ALT_OFFSET"] == held


@pytest.mark.parametrize("datum", ["change", "absolute"])
def test_a_spread_that_is_unknown_holds_it(datum: str) -> None:
    bench = Bench(datum=datum)
    bench.sd_m, bench.drift_m = math.nan, -3.0
    assert bench.fly().sets == []


def test_an_absolute_datum_that_the_vehicle_does_not_take_is_not_pursued() -> None:
    """ArduPlane sets its datum to the GNSS height every second until it is armed."""
    bench = Bench(datum="absolute")
    bench.drift_m, bench.follows = -8.0, False
    bench.run(GROUND_S + 300.0)
    assert bench.feedback.hold is Hold.UNFOLLOWED
    assert abs(bench.values["BARO_ALT_OFFSET"]) < 2.0


def test_off_by_default() -> None:
    feedback = Feedback(FeedbackSettings())
    situation = Situation(Health.OK, rows(ESTIMATE), (1, 1), ARDUPILOT)
    assert feedback.step(1_000_000, situation) == []
    assert feedback.phase is Phase.OFF


@pytest.mark.parametrize(
    ("name", "value"), [("EK3_SRC1_POSZ", 3.0), ("AHRS_EKF_TYPE", 10.0), ("EK3_OGN_HGT_MASK", 5.0)]
)
def test_a_vehicle_that_takes_its_height_from_elsewhere_is_refused(name: str, value: float) -> None:
    bench = Bench()
    bench.values[name] = value
    bench.fly()
    assert bench.sets == []
    assert bench.texts[0].startswith(f"Kollsman feedback ends: {name} {value:g}, not ")


def test_px4_with_its_default_height_reference_is_refused() -> None:
    bench = Bench(mode="qnh")
    bench.values["EKF2_HGT_REF"] = 1.0
    bench.fly()
    assert bench.sets == []
    assert "EKF2_HGT_REF 1" in bench.texts[0]


def test_px4_that_does_not_use_its_barometer_is_refused() -> None:
    bench = Bench(mode="qnh")
    bench.values["EKF2_BARO_CTRL"] = 0.0
    assert bench.fly().sets == []
    assert "EKF2_BARO_CTRL 0" in bench.texts[0]


def test_a_parameter_of_another_autopilot_is_refused() -> None:
    bench = Bench(mode="qnh")
    bench.autopilot = ARDUPILOT
    bench.run(5.0)
    assert bench.texts == ["Kollsman feedback ends: no SENS_BARO_QNH here"]


def test_a_vehicle_that_does_not_answer_is_left_alone() -> None:
    bench = Bench()
    bench.answers = False
    bench.fly()
    assert bench.sets == []
    assert bench.texts == ["Kollsman feedback ends: BARO_ALT_OFFSET not heard"]


@pytest.mark.parametrize("value", [500.0, math.nan])
def test_a_value_out_of_range_is_refused(value: float) -> None:
    bench = Bench()
    bench.values["BARO_ALT_OFFSET"] = value
    assert bench.fly().sets == []


def test_a_parameter_of_another_type_is_refused() -> None:
    bench = Bench()
    bench.answers = False
    bench.run(0.4)
    message = mavlink.MAVLink_param_value_message(
        b"BARO_ALT_OFFSET", 0.0, mavlink.MAV_PARAM_TYPE_INT16, 1, 0
    )
    bench.feedback.parameter(message)
    assert bench.feedback.phase is Phase.ENDED


def test_integers_of_px4_are_read_by_their_bytes() -> None:
    message = mavlink.MAVLink_param_value_message(
        b"EKF2_HGT_REF", math.ldexp(1.0, -149), mavlink.MAV_PARAM_TYPE_INT32, 1, 0
    )
    assert parameter_value(message, PX4) == 1.0
    message.param_value = 3.0
    assert parameter_value(message, ARDUPILOT) == 3.0


@pytest.mark.parametrize(
    ("hold", "change"),
    [
        (Hold.HEALTH, {"health": Health.DEGRADED}),
        (Hold.HEALTH, {"health": Health.LOST}),
        (Hold.EXCLUDED, {"faulty": FaultySensor.BAROMETER}),
        (Hold.EXCLUDED, {"faulty": FaultySensor.GNSS}),
        (Hold.LEVEL, {"level_m": 40.0}),
        (Hold.LEVEL, {"level_m": math.nan}),
        (Hold.NO_HEIGHT, {"sends_height": False}),
        (Hold.LOW, {"height_m": 15.0}),
    ],
)
def test_what_freezes_it_and_how_it_goes_on(hold: Hold, change: dict[str, object]) -> None:
    bench = Bench().fly()
    before = {name: getattr(bench, name) for name in change}
    vars(bench).update(change)
    bench.run(4.0)
    frozen, value = len(bench.sets), bench.values["BARO_ALT_OFFSET"]
    bench.run(60.0)
    assert bench.feedback.hold is hold
    assert len(bench.sets) == frozen
    assert bench.values["BARO_ALT_OFFSET"] == value != 0.0
    vars(bench).update(before)
    bench.run(20.0)
    assert hold is Hold.LOW or len(bench.sets) == frozen  # it settles first
    bench.run(40.0)
    assert len(bench.sets) > frozen


def test_the_floor_may_be_allowed() -> None:
    bench = Bench(floor_m=0.0).run(GROUND_S)
    bench.armed = True
    bench.run(1.0)
    bench.height_m, bench.drift_mps = 10.0, 0.05
    assert bench.run(100.0).sets


def test_the_total_is_bounded() -> None:
    bench = Bench(bound_m=5.0).fly(-0.05, 300.0)
    assert bench.values["BARO_ALT_OFFSET"] == pytest.approx(5.0, abs=0.051)
    assert bench.feedback.hold is Hold.BOUND


def test_a_spoofer_gains_no_more_than_rate_and_bound() -> None:
    """The largest error that the estimator can have while everything else is well."""
    bench = Bench(bound_m=10.0).fly(0.0, 60.0)
    bench.error_m = 60.0
    bench.run(100.0)
    assert bench.own_error_m <= 0.05 * 100.0 + 0.1
    bench.run(400.0)
    assert bench.own_error_m <= 10.0 + 0.1


def test_a_vehicle_that_does_not_respond_is_not_written_to_for_long() -> None:
    bench = Bench()
    bench.follows = False
    bench.fly(0.05, 600.0)
    assert bench.feedback.hold is Hold.UNFOLLOWED
    assert (
        abs(bench.values["BARO_ALT_OFFSET"]) < 11.0
    )  # 5 m, 5 % of the height, the lag of the filter


def test_a_height_that_leaves_the_barometer_freezes_it() -> None:
    """The vehicle has switched to GNSS height, as by its source sets."""
    bench = Bench().fly(0.05, 100.0)
    bench.drift_mps, truth_m = 0.0, bench.drift_m
    bench.run(1.0, lambda: None)
    frozen = len(bench.sets)
    assert truth_m > 4.0
    bench.follows = False  # its altitude no longer has what was written
    bench.drift_m += 12.0
    bench.error_m = 0.0

    def unexplained() -> None:
        bench.feedback._need._beside.value = 20.0

    bench.run(10.0, unexplained)
    assert bench.feedback.hold is Hold.UNFOLLOWED
    assert len(bench.sets) <= frozen + 1


def test_two_writes_that_are_not_read_back_end_it() -> None:
    bench = Bench().fly(0.05, 60.0)
    bench.answers = False
    before = len(bench.sets)
    bench.run(60.0)
    assert len(bench.sets) == before + 2
    assert bench.sets[-1][1] == pytest.approx(
        bench.sets[-2][1]
    )  # the same again, not one step further
    assert bench.texts[-1] == "Kollsman feedback ends: writes are not read back"


def test_one_lost_answer_does_not_end_it() -> None:
    bench = Bench().fly(0.05, 60.0)
    bench.answers = False
    before = len(bench.sets)
    while len(bench.sets) == before:
        bench.run(0.2)
    bench.run(1.8)
    bench.answers = True
    bench.run(60.0)
    assert bench.feedback.phase is Phase.READY
    assert len(bench.sets) > before + 10


def test_a_write_whose_answer_was_lost_is_not_taken_for_somebody_else_s() -> None:
    bench = Bench().fly(0.05, 60.0)
    bench.answers = False
    before = len(bench.sets)
    while len(bench.sets) == before:
        bench.run(0.2)
    bench.values["BARO_ALT_OFFSET"] = bench.sets[-1][1]  # it arrived
    bench.run(2.2)
    bench.answers = True
    bench.tell("BARO_ALT_OFFSET")
    bench.run(30.0)
    assert bench.feedback.phase is Phase.READY


def test_a_change_by_somebody_else_ends_it_and_stays() -> None:
    bench = Bench().fly()
    bench.values["BARO_ALT_OFFSET"] = 1.5
    bench.tell("BARO_ALT_OFFSET")
    bench.run(60.0)
    assert bench.texts[-1] == "Kollsman feedback ends: parameter changed to 1.5"
    writes = len(bench.sets)
    bench.land()
    assert bench.values["BARO_ALT_OFFSET"] == 1.5
    assert len(bench.sets) == writes
    assert bench.marks[-1] is None


def test_a_change_that_was_not_heard_is_found_by_reading() -> None:
    bench = Bench(dead_band_m=10.0).fly(0.0, 60.0)
    bench.values["BARO_ALT_OFFSET"] = 1.5
    bench.run(12.0)
    assert bench.feedback.phase is Phase.ENDED


def test_another_height_source_in_flight_ends_it() -> None:
    bench = Bench().fly()
    bench.values["EK3_SRC1_POSZ"] = 3.0
    bench.tell("EK3_SRC1_POSZ")
    writes = len(bench.sets)
    bench.run(60.0)
    assert len(bench.sets) == writes
    bench.land()
    assert bench.values["BARO_ALT_OFFSET"] == 0.0  # what was written is taken back


def test_disarming_restores_and_says_so() -> None:
    bench = Bench().fly()
    assert bench.values["BARO_ALT_OFFSET"] != 0.0
    bench.land()
    assert bench.values["BARO_ALT_OFFSET"] == 0.0
    assert bench.texts[-1] == "Kollsman feedback BARO_ALT_OFFSET restored to 0"
    assert bench.marks[-1] is None


def test_the_correction_is_told_every_five_metres() -> None:
    bench = Bench().fly(-0.05, 450.0)
    told_m = [float(text.split()[-2]) for text in bench.texts if text.endswith(" m")]
    assert told_m == pytest.approx([5.0, 10.0, 15.0, 20.0], abs=0.1)


@pytest.mark.parametrize(
    ("on_stop", "on_ground", "restored"),
    [("restore", True, True), ("restore", False, False), ("keep", True, False)],
)
def test_a_stop_restores_or_keeps(on_stop: str, on_ground: bool, restored: bool) -> None:
    bench = Bench(on_stop=on_stop, datum="absolute").run(5.0)
    bench.drift_m = -3.0
    bench.run(120.0)
    if not on_ground:
        bench.armed, bench.height_m = True, 100.0
        bench.run(1.0)
    assert bench.values["BARO_ALT_OFFSET"] > 2.0
    for message in bench.feedback.stop():
        bench.answer(message)
    assert (bench.values["BARO_ALT_OFFSET"] == 0.0) is restored
    assert "stops" in bench.texts[-1]
    if not on_ground:
        assert bench.marks[-1] is not None  # the next start restores


def test_a_stop_without_a_write_says_nothing() -> None:
    assert Bench().run(60.0).feedback.stop() == []


def test_the_absolute_datum_is_written_on_the_ground_only_if_asked() -> None:
    for datum, written in (("change", False), ("absolute", True)):
        bench = Bench(datum=datum)
        bench.drift_m = -3.0
        bench.run(GROUND_S + 100.0)
        assert bool(bench.sets) is written
    assert abs(bench.own_error_m) < 0.3


def test_height_above_take_off_does_not_jump_by_an_error_of_the_datum() -> None:
    bench = Bench()
    bench.drift_m = -8.0  # there before arming
    assert bench.fly(0.0).sets == []


def crashed(bench: Bench, **changes: object) -> Bench:
    """The next start of the program, with the mark that the last one has left."""
    after = Bench(mark=replace(bench.marks[-1], **changes), mode=bench.settings.mode)  # type: ignore[type-var]
    for name in ("values", "time_s", "armed", "height_m", "drift_m", "drift_mps", "_effect_m"):
        setattr(after, name, getattr(bench, name))
    return after


@pytest.mark.parametrize("mode", ["baro-alt-offset", "qnh"])
def test_after_a_crash_in_flight_it_goes_on_and_restores_when_disarmed(mode: str) -> None:
    bench = Bench(mode=mode).fly()
    after = crashed(bench).run(200.0)
    assert abs(after.drift_m) > 20.0
    assert abs(after.own_error_m) < 3.0
    after.land()
    assert after.values[after.name] == after.original


def test_after_a_crash_the_next_start_on_the_ground_restores() -> None:
    bench = Bench().fly()
    after = crashed(bench)
    after.armed, after.height_m, after.drift_mps = False, 0.0, 0.0
    after.run(20.0)
    assert after.values["BARO_ALT_OFFSET"] == 0.0
    assert after.marks[-1] is None


def test_a_mark_whose_last_write_was_lost_is_still_known() -> None:
    bench = Bench().fly()
    bench.values["BARO_ALT_OFFSET"] = bench.marks[-1].previous  # type: ignore[union-attr]
    after = crashed(bench)
    after.armed = False
    assert after.run(20.0).values["BARO_ALT_OFFSET"] == 0.0


@pytest.mark.parametrize("change", [{"written": 7.0, "previous": 7.1}, {"system_id": 9}])
def test_a_value_that_is_not_of_the_mark_is_left_alone(change: dict[str, float]) -> None:
    bench = Bench().fly()
    value = bench.values["BARO_ALT_OFFSET"]
    after = crashed(bench, **change)
    after.armed, after.drift_mps = False, 0.0
    after.run(20.0)
    assert after.values["BARO_ALT_OFFSET"] == value
    assert after.marks[-1] is None


def test_without_a_place_for_its_mark_nothing_is_written() -> None:
    bench = Bench(kept=False).fly()
    assert bench.sets == []
    assert bench.texts[-1] == "Kollsman feedback ends: no place for its mark"


def test_a_reboot_of_the_autopilot_begins_anew() -> None:
    """ArduPilot sets BARO_ALT_OFFSET to 0 when it calibrates the barometer at boot."""
    bench = Bench().fly()
    bench.feedback.restart()
    bench.values["BARO_ALT_OFFSET"] = bench._effect_m = 0.0
    bench.time_s, bench.drift_m, bench.drift_mps = 2.0, 0.0, 0.05
    writes = len(bench.sets)
    bench.run(20.0)
    assert len(bench.sets) == writes
    bench.run(280.0)
    assert abs(bench.own_error_m) < 3.0
    assert bench.land().values["BARO_ALT_OFFSET"] == 0.0
