"""The state machine of the feedback: what was heard -> the next message to the vehicle, or none and
the reason.

===========  ===============================================================================
OFF          ``feedback.mode`` is none, or no vehicle yet
READING      the parameters are read, one at a time
READY        it writes when nothing holds it (`Hold`)
ENDED        it writes no more until the vehicle restarts; after disarming it restores
===========  ===============================================================================

Every instant is of the vehicle's clock. A silent vehicle is never written to.
"""

import logging
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import Enum, auto

from companion.feedback.conditions import Hold, OwnHeight, Situation, objection
from companion.feedback.evidence import target_m
from companion.feedback.knobs import KNOBS, REAL32, Knob, parameter_value, same, single
from companion.feedback.mark import Mark
from companion.feedback.need import Need
from companion.feedback.questions import ANSWER_US, Questions
from companion.feedback.settings import FeedbackSettings
from companion.mavlink.codec import Message, mavlink

logger = logging.getLogger("kollsman.feedback")

STEP_M = 0.1
"""largest change of the altitude by one write"""
FAILURES = 2
"""writes in a row that were not read back and end it"""
POLL_US = 10_000_000
"""how often the parameter is read while nothing is written"""
TELL_M = 5.0
"""the correction is told by STATUSTEXT each time it has changed by so much"""
LATE_US = 3_000_000
BESIDE_M, BESIDE_SHARE, BESIDE_GROUND_M = 5.0, 0.05, 1.0
"""How far the vehicle's altitude may leave its barometer's: filters and static ports, and a column
that is warmer than the firmware thinks. On the ground there is less, and ArduPlane sets its datum
anew there every second, so that it follows no write."""
TEXT_SIZE = 50
NAMED = mavlink.MAV_SEVERITY_NOTICE
WARNED = mavlink.MAV_SEVERITY_WARNING


class Phase(Enum):
    """What the state machine is doing."""

    OFF = auto()
    READING = auto()
    READY = auto()
    ENDED = auto()


@dataclass
class _Pending:
    """A write that was not read back yet."""

    value: float
    sent_us: int
    asked: bool = False


class Feedback:
    """Moves one parameter of one vehicle.

    Parameters
    ----------
    keep : called with the mark before each write; False when it could not be kept, which ends it.
    mark : what an earlier run has left.
    """

    def __init__(
        self,
        settings: FeedbackSettings,
        *,
        keep: Callable[[Mark | None], bool] = lambda mark: True,
        mark: Mark | None = None,
    ) -> None:
        self.settings = settings
        self.knob: Knob | None = KNOBS.get(settings.mode)
        self.phase = Phase.OFF
        self.hold = Hold.DISARMED
        self.why_ended = ""
        self.writes = 0
        self.mark = mark
        self._keep = keep
        self._target = (0, 0)
        self._autopilot = 0
        self._texts: list[Message] = []
        self.restart()
        self.mark = mark

    def restart(self) -> None:
        """The vehicle started anew: everything is read again. A mark stays."""
        self.phase, self.why_ended = Phase.OFF, ""
        self.offset_m = 0.0
        """the correction that is written, metres above the original"""
        self._questions = Questions(self.knob.names if self.knob is not None else ())
        self._armed: bool | None = None
        self._has_flown = self._restores = self._corrects = False
        self._need = Need()
        self._reference_m = self._reference_beside_m = self._reference_height_m = math.nan
        self._reference_sd_m = self._sd_m = 0.0
        self._original = self._value = self._previous = self._unconfirmed = math.nan
        self._pending: _Pending | None = None
        self._failures = 0
        self._now_us = self._due_us = self._poll_us = self._good_us = 0
        self._is_good = False
        self._height: OwnHeight | None = None
        self._told_m = 0.0
        if self.mark is not None:
            self.mark = replace(self.mark, reference_m=None)

    # What is heard

    def heartbeat(self, armed: bool) -> None:
        """The vehicle's HEARTBEAT came."""
        before, self._armed = self._armed, armed
        if armed and before is False:
            # The next step sets them: the change counts from here.
            self._reference_m = self._reference_beside_m = math.nan
        elif not armed and before is not False:
            self._has_flown = self._has_flown or bool(before)
            self._restores, self._failures = self.offset_m != 0.0, 0

    def height(self, time_us: int, altitude_amsl_m: float, relative_m: float) -> None:
        """The vehicle's own altitude (GLOBAL_POSITION_INT), and its height above home."""
        self._height = OwnHeight(time_us, altitude_amsl_m, relative_m)

    def parameter(self, message: Message) -> None:
        """PARAM_VALUE of the vehicle came, asked for or not."""
        name = str(message.param_id)
        if self.knob is None or name not in self.knob.names or self.phase is Phase.OFF:
            return
        value = parameter_value(message, self._autopilot)
        if self.phase is Phase.READING:
            if name == self.knob.parameter and message.param_type != REAL32:
                self._end(f"{name} has type {message.param_type}")
            self._questions.values.setdefault(name, value)
        elif name != self.knob.parameter:
            if value != self._questions.values.get(name):
                self._end(f"{name} now {value:g}")
        elif not math.isnan(self._value):
            self._read_back(value)

    def _read_back(self, value: float) -> None:
        pending = self._pending
        if pending is not None and same(value, pending.value):
            self._previous, self._value = self._value, pending.value
            self._pending, self._failures = None, 0
            if self._restores and same(value, self._original):
                self._restored()
        elif same(value, self._unconfirmed):  # the answer was lost, not the write
            self._value, self._failures = value, 0
            self._is_at(value)
        elif not same(value, self._value) and not self._is_old(value):
            self._drop_mark()
            self._value = math.nan  # theirs: it is not restored either
            self._end(f"parameter changed to {value:g}")

    def _is_old(self, value: float) -> bool:
        """Whether an answer from before the last write may have been late."""
        return same(value, self._previous) and self._now_us < self._due_us + LATE_US

    def _is_at(self, value: float) -> None:
        """The parameter is known to hold `value`."""
        assert self.knob is not None
        self.offset_m = self.knob.metres(self._original, value)
        self._need.wrote(self.offset_m)

    # What is due

    def step(self, now_us: int, situation: Situation) -> list[Message]:
        """The messages to send now."""
        knob = self.knob
        if knob is None or now_us < 0:
            return []
        self._now_us = now_us
        if self.phase is Phase.OFF:
            self._target, self._autopilot = situation.vehicle, situation.autopilot
            self.phase = Phase.READING
            if situation.autopilot != knob.autopilot:
                self._end(f"no {knob.parameter} here")
        messages: list[Message] = []
        if self.phase is Phase.READING:
            messages = self._read(knob, now_us)
        elif not math.isnan(self._value):
            self._measure(now_us, situation)
            messages = self._await(knob, now_us)
            if not messages and self._pending is None and now_us >= self._due_us:
                messages = self._write_next(knob, now_us)
        texts, self._texts = self._texts, []
        return texts + messages

    def stop(self) -> list[Message]:
        """This program ends: restore or keep, as configured. The mark stays until the next start
        has read the parameter."""
        if self.knob is None or self.offset_m == 0.0 or math.isnan(self._value):
            return []
        name, messages = self.knob.parameter, []
        in_flight = self._armed is not False and abs(self.offset_m) > STEP_M
        if self.settings.on_stop == "restore" and not in_flight:
            messages = [self._set(self.knob, self._original)]
            self._say(f"stops: {name} restored")
        else:
            if self.settings.on_stop == "keep":
                self._drop_mark()
            self._say(f"stops: {name} {self.offset_m:+.1f} m")
        texts, self._texts = self._texts, []
        return messages + texts

    def _read(self, knob: Knob, now_us: int) -> list[Message]:
        """Ask for the next parameter, or begin when all are known."""
        name = self._questions.next(now_us)
        if not self._questions.missing:
            self._begin(knob, self._questions.values)
        elif self._questions.has_failed:
            self._end(f"{self._questions.missing} not heard")
        return [self._request(name)] if name else []

    def _begin(self, knob: Knob, values: Mapping[str, float]) -> None:
        """All parameters are known: check them, and what an earlier run has left."""
        for name, (needed, meaning) in knob.conditions.items():
            if values[name] != needed:
                self._end(f"{name} {values[name]:g}, not {needed:g}", meaning)
                return
        value = values[knob.parameter]
        if not knob.lowest <= value <= knob.highest:
            self._end(f"{knob.parameter} is {value:g}")
            return
        self.phase, self._value, self._original = Phase.READY, value, value
        mark = self.mark
        if mark is None:
            return
        ours = same(value, mark.written) or same(value, mark.previous)
        is_here = (mark.system_id, mark.parameter) == (self._target[0], knob.parameter)
        if not (is_here and ours) or same(value, mark.original):
            logger.info("%s is %g, no longer ours of an earlier run", knob.parameter, value)
            self._drop_mark()
            return
        self._original = mark.original
        self.offset_m = self._told_m = knob.metres(mark.original, value)
        self._need.holds(self.offset_m)
        if mark.reference_m is not None and self._now_us >= mark.time_us:
            self._reference_m, self._reference_sd_m = mark.reference_m, mark.reference_sd_m
        self._restores = self._armed is False
        self._say(f"found its {knob.parameter} {value:.1f}")

    def _measure(self, now_us: int, situation: Situation) -> None:
        """Follow both altitudes; `hold` is the reason for which nothing can be written now."""
        self.hold = objection(self.settings, now_us, situation, self._height)
        if self.hold is not Hold.NONE:
            self._need.restart()
            self._is_good = False
            return
        assert self._height is not None
        time_us, vehicle_m, relative_m = self._height
        value = situation.estimate[0]
        self._sd_m = float(value["altitude_sd_m"])
        ahead_s = (time_us - int(value["time_us"])) * 1e-6
        ours_m = float(value["altitude_amsl_m"]) + ahead_s * float(value["climb_mps"])
        if not self._is_good:
            self._is_good, self._good_us = True, now_us
        if time_us != self._need.time_us:
            self._need.update(time_us, vehicle_m, ours_m, ours_m - float(value["baro_offset_m"]))
        self.hold = self._reason(now_us, ours_m, relative_m)

    def _reason(self, now_us: int, ours_m: float, relative_m: float) -> Hold:
        """What speaks against a write, now that there is a measurement."""
        if now_us - self._good_us < self.settings.settle_s * 1e6:
            return Hold.UNSETTLED
        need = self._need
        on_ground = self._armed is False
        if math.isnan(self._reference_m):
            absolute = on_ground and self.settings.datum == "absolute" and not self._has_flown
            if on_ground and not absolute:
                return Hold.DISARMED
            self._reference_m = 0.0 if absolute else need.total_m - self.offset_m
            self._reference_sd_m = 0.0 if absolute else self._sd_m
        elif on_ground and (self._has_flown or self.settings.datum != "absolute"):
            return Hold.DISARMED
        if math.isnan(self._reference_beside_m):
            self._reference_beside_m, self._reference_height_m = need.beside_m, ours_m
        allowed_m = BESIDE_GROUND_M if on_ground else BESIDE_M
        allowed_m += BESIDE_SHARE * abs(ours_m - self._reference_height_m)
        if abs(need.beside_m - self._reference_beside_m) > allowed_m:
            return Hold.UNFOLLOWED
        if self._armed is not False and relative_m < self.settings.floor_m:
            return Hold.LOW
        return Hold.NONE

    def _await(self, knob: Knob, now_us: int) -> list[Message]:
        """Ask for the parameter where an answer is missing, or nothing was heard of it for long."""
        pending = self._pending
        if pending is None:
            if now_us < self._poll_us:
                return []
            self._poll_us = now_us + POLL_US
            return [self._request(knob.parameter)]
        waited_us = now_us - pending.sent_us
        if waited_us < ANSWER_US:
            return []
        if not pending.asked:
            pending.asked = True
            return [self._request(knob.parameter)]
        if waited_us < 2 * ANSWER_US:
            return []
        self._failures += 1
        self._unconfirmed, self._pending = pending.value, None
        self._is_at(self._value)
        if self._failures >= FAILURES:
            self._restores = False
            self._end("writes are not read back")
        return []

    def _write_next(self, knob: Knob, now_us: int) -> list[Message]:
        """The next PARAM_SET, if there is anything to write."""
        if self._restores and self._armed is False:
            return self._write(knob, now_us, 0.0) if self._failures < FAILURES else []
        if self.phase is not Phase.READY or self.hold is not Hold.NONE:
            return []
        limit_m = self.settings.proof_ratio * math.hypot(self._reference_sd_m, self._sd_m)
        wanted_m = target_m(self.offset_m, self._need.total_m - self._reference_m, limit_m)
        bound_m = self.settings.bound_m
        error_m = max(-bound_m, min(bound_m, wanted_m)) - self.offset_m
        self._corrects = abs(error_m) > (
            0.5 * STEP_M if self._corrects else self.settings.dead_band_m
        )
        if not self._corrects:
            self.hold = Hold.BOUND if abs(wanted_m) > bound_m else Hold.ENOUGH
            return []
        step_m = max(-STEP_M, min(STEP_M, error_m))
        return self._write(knob, now_us, self.offset_m + step_m)

    def _write(self, knob: Knob, now_us: int, offset_m: float) -> list[Message]:
        """PARAM_SET of a correction, once the mark is kept."""
        value = single(knob.raised(self._original, offset_m)) if offset_m else self._original
        if not knob.lowest <= value <= knob.highest:
            self._end(f"{knob.parameter} at a limit")
            return []
        reference_m = None if math.isnan(self._reference_m) else self._reference_m
        before, counts_from = (
            (self._original, value, self._value),
            (reference_m, self._reference_sd_m),
        )
        self.mark = Mark(self._target[0], knob.parameter, *before, now_us, *counts_from)
        if not self._keep(self.mark):
            self._end("no place for its mark")
            return []
        if not self.writes and not self.offset_m:
            self._say(f"starts: {knob.parameter} {self._original:g}")
        self.writes += 1
        self.offset_m = offset_m
        self._need.wrote(offset_m)
        logger.info("%s %.4f: %+.2f m", knob.parameter, value, offset_m)
        if abs(offset_m - self._told_m) >= TELL_M - 0.5 * STEP_M:
            self._told_m = TELL_M * round(offset_m / TELL_M)
            self._say(f"{knob.parameter} {offset_m:+.1f} m")
        self._pending = _Pending(value, now_us)
        self._due_us = now_us + round(self.settings.period_s * 1e6)
        return [self._set(knob, value)]

    def _restored(self) -> None:
        assert self.knob is not None
        self._restores, self._told_m, self._reference_m = False, 0.0, math.nan
        self._reference_beside_m = math.nan
        self._drop_mark()
        self._say(f"{self.knob.parameter} restored to {self._original:g}")

    def _drop_mark(self) -> None:
        self.mark = None
        self._keep(None)

    def _end(self, why: str, meaning: str = "") -> None:
        """Write no more. What was written stays, and is restored after disarming if it is still
        ours. `why` has room for 26 letters on the ground station; the log tells the meaning too."""
        if self.phase is Phase.ENDED:
            return
        self.why_ended = f"{why}: {meaning}" if meaning else why
        self.phase, self._pending = Phase.ENDED, None
        self._say(f"ends: {why}", WARNED)

    def _say(self, text: str, severity: int = NAMED) -> None:
        logger.log(logging.WARNING if severity == WARNED else logging.INFO, "feedback %s", text)
        line = f"Kollsman feedback {text}".encode("ascii", "replace")[:TEXT_SIZE]
        self._texts.append(mavlink.MAVLink_statustext_message(severity, line))

    def _request(self, name: str) -> Message:
        return mavlink.MAVLink_param_request_read_message(*self._target, name.encode(), -1)

    def _set(self, knob: Knob, value: float) -> Message:
        return mavlink.MAVLink_param_set_message(
            *self._target, knob.parameter.encode(), value, REAL32
        )
