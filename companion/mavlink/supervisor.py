"""Keeps the vehicle's message rates at what the estimator needs, for as long as we run.

Each message is requested with SET_MESSAGE_INTERVAL, one at a time, because COMMAND_ACK does not say
which message it answers. From then on the rate that arrives is measured, in vehicle time, so that a
simulation at twenty times real time counts the same. What happens next:

=============================  =====================================================================
a rate falls short             requested again at once
it stays short three times     accepted and reported; requested again after 10 s, after a minute
                               where something arrives, then ever less often
DENIED, FAILED                 requested at 40, 25, 10 Hz (a 50 Hz ArduPlane grants at most 40 Hz)
TEMPORARILY_REJECTED           requested again after 3 s, then ever less often
unsupported or no answer       REQUEST_DATA_STREAM, where the vehicle does not save it
lowered again and again        reported with the ids of who does it; we pause for 30 s, then longer
reboot, reconnect, new peer    everything is requested anew
=============================  =====================================================================

Time is the host's unless a name says vehicle. Nothing is written to the vehicle's parameters, and
`restore` undoes what was requested.
"""

import logging
from collections.abc import Mapping, Sequence

from companion.mavlink.codec import Message, mavlink
from companion.mavlink.stream_watch import FRUITLESS, RETRY_US, Asked, Watch
from companion.mavlink.streams import Stream

logger = logging.getLogger("kollsman.streams")

SET_MESSAGE_INTERVAL: int = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
RESULTS: dict[int, str] = {
    key: value.name[len("MAV_RESULT_") :] for key, value in mavlink.enums["MAV_RESULT"].items()
}
DENIED_HZ = (40.0, 25.0, 10.0)
"""rates requested after a refusal"""
ACK_TIMEOUT_US = 1_000_000
ATTEMPTS = 3
SHORT_RATIO = 0.6
"""share of the requested rate below which a rate is short"""
SETTLE_US = 200_000
DEAD_US = 1_500_000
"""time without a frame after which the vehicle is silent"""
STOPPED_US = 1_000_000
"""time of frames that do not advance the vehicle's clock after which it stands still"""
FORGOTTEN_US = 10_000_000
"""length of a silence in which the vehicle may have been restarted"""
GROUP_PAUSE_US = 3_000_000
JUDGE_US = 100_000
LONGEST_RETRY_US = 300_000_000
REDUCTION_US = 2_500_000
"""time within which falling rates count as one reduction by another program"""
GROUP_HZ = 25.0
"""rate of a whole group by REQUEST_DATA_STREAM; more would fill the link"""
REDUCTIONS, REDUCTIONS_US = 4, 120_000_000
"""number of reductions, and the time within it, after which another program is reported"""
PAUSE_US = 30_000_000
WHO_US = 30_000_000


class StreamSupervisor:
    """Requests messages and measures their rates.

    Parameters
    ----------
    streams : what is wanted.
    target : system and component id of the vehicle.
    use_groups : whether REQUEST_DATA_STREAM may be sent.
    """

    def __init__(
        self, streams: Sequence[Stream], target: tuple[int, int], *, use_groups: bool
    ) -> None:
        self.watches = {stream.message_id: Watch(stream) for stream in streams}
        self.rivals = ""
        """the programs that lower the rates again and again; empty when there are none"""
        self._target = target
        self._may_group = use_groups
        self._groups: dict[int, float] = {}
        """groups requested, with the rate that was measured before"""
        self._grouped_us = -GROUP_PAUSE_US
        self._by_groups = self._ignored = self._told = False
        self._waiting: Watch | None = None
        self._attempts = 0
        self._deadline_us = 0
        self._judged_us = -JUDGE_US
        self._frames = -1
        self._alive_us = self._moved_us = 0
        self._vehicle_us = -1
        self._reductions_us: list[int] = []
        self._pause_us = PAUSE_US
        self._paused_until_us = 0
        self._other: tuple[int, str] | None = None

    @property
    def problems(self) -> list[str]:
        """The messages that are slow, missing or refused now."""
        found = [watch.problem for watch in self.watches.values()]
        if self.rivals:
            found.append(f"rates lowered by {self.rivals}")
        return [problem for problem in found if problem]

    def restart(self, why: str) -> None:
        """The vehicle may have forgotten what was requested: request everything anew."""
        logger.info("requesting the message rates again: %s", why)
        for watch in self.watches.values():
            watch.start()
        self._waiting = None
        self._by_groups = self._ignored = False
        self._grouped_us = -GROUP_PAUSE_US
        self._paused_until_us = 0

    def other_request(self, now_us: int, who: str) -> None:
        """Somebody else requested rates from the vehicle."""
        self._other = (now_us, who)

    def poll(
        self, now_us: int, vehicle_us: int, heard: Mapping[int, int], frames: int, stations: str
    ) -> list[Message]:
        """The messages to send now.

        Parameters
        ----------
        now_us, vehicle_us : the host's and the vehicle's clock.
        heard : how many messages of the vehicle came, by message id.
        frames : how many frames of the vehicle came in all.
        stations : the ground stations on the link, for the report of who lowers the rates.
        """
        if now_us - self._judged_us >= JUDGE_US:
            self._judged_us = now_us
            if self._listen(now_us, vehicle_us, frames):
                self._judge(now_us, vehicle_us, heard, stations)
        return self._requests(now_us) if now_us - self._alive_us <= DEAD_US else []

    def acknowledge(self, message: Message, now_us: int) -> None:
        """COMMAND_ACK came, for the one request that waits for an answer."""
        watch = self._waiting
        if watch is None or message.command != SET_MESSAGE_INTERVAL:
            return
        self._ignored = False
        if message.result == mavlink.MAV_RESULT_ACCEPTED:
            self._answered(watch, now_us)
        elif message.result == mavlink.MAV_RESULT_UNSUPPORTED:
            self._refused(watch, "UNSUPPORTED", now_us)
            self._try_groups()
        elif message.result == mavlink.MAV_RESULT_TEMPORARILY_REJECTED:
            watch.due_us, self._waiting = now_us + watch.busy_us, None
            watch.busy_us = min(2 * watch.busy_us, LONGEST_RETRY_US)
        elif message.result != mavlink.MAV_RESULT_IN_PROGRESS:  # the answer is still to come
            self._denied(watch, RESULTS.get(message.result, str(message.result)), now_us)

    def restore(self) -> list[Message]:
        """What undoes our requests: every interval back to the vehicle's default, every group to
        the rate measured before."""
        intervals = [self._interval(watch, 0.0) for watch in self.watches.values() if watch.changed]
        return intervals + [self._group(group, hz) for group, hz in self._groups.items()]

    def _listen(self, now_us: int, vehicle_us: int, frames: int) -> bool:
        """Whether the vehicle is there; after a silence everything is requested anew."""
        if frames != self._frames:
            if self._frames >= 0 and now_us - self._alive_us > FORGOTTEN_US:
                self.restart("the vehicle was silent")
            self._frames, self._alive_us = frames, now_us
        if vehicle_us != self._vehicle_us:
            self._vehicle_us, self._moved_us = vehicle_us, now_us
        if now_us - self._alive_us <= DEAD_US:
            return True
        for watch in self.watches.values():
            watch.settle(now_us)
        return False

    def _judge(self, now_us: int, vehicle_us: int, heard: Mapping[int, int], stations: str) -> None:
        stopped = self._alive_us - self._moved_us > STOPPED_US
        for watch in self.watches.values():
            count = heard.get(watch.stream.message_id, 0)
            watch.heard = watch.heard or count > 0
            rate_hz = watch.measure(now_us, vehicle_us, count, stopped=stopped)
            watch.rate_hz = watch.rate_hz if rate_hz is None else rate_hz
            if rate_hz is None or watch is self._waiting:
                continue
            if rate_hz >= SHORT_RATIO * min(watch.asked_hz, watch.ceiling_hz):
                watch.good, watch.fruitless, watch.retry_us = True, 0, RETRY_US
            elif watch.asked is not Asked.NO and (watch.heard or watch.stream.label):
                self._short(watch, now_us, stations)
            self._report(watch)
        if self.rivals and now_us - self._paused_until_us > REDUCTIONS_US:
            self.rivals, self._pause_us = "", PAUSE_US

    def _short(self, watch: Watch, now_us: int, stations: str) -> None:
        """A rate is too low: request it again, unless requests are known to have no effect."""
        if watch.good:
            watch.good = False
            if watch.stream.label:
                self._lowered(now_us, stations)
        else:
            watch.fruitless += 1
        if watch.asked is Asked.REFUSED:
            return
        watch.asked = Asked.NO
        watch.due_us = now_us
        if watch.fruitless >= FRUITLESS:
            watch.ceiling_hz = watch.rate_hz or watch.asked_hz
            watch.due_us = now_us + (6 * watch.retry_us if watch.rate_hz else watch.retry_us)
            watch.retry_us = min(2 * watch.retry_us, LONGEST_RETRY_US)

    def _lowered(self, now_us: int, stations: str) -> None:
        """A rate that had been granted fell: somebody lowered it, or the vehicle rebooted."""
        if self._reductions_us and now_us - self._reductions_us[-1] < REDUCTION_US:
            return
        recent = [us for us in self._reductions_us if now_us - us < REDUCTIONS_US]
        self._reductions_us = [*recent, now_us]
        if len(self._reductions_us) < REDUCTIONS:
            return
        other = self._other
        seen = other[1] if other is not None and now_us - other[0] < WHO_US else ""
        who = seen or (f"{stations}?" if stations else "a program that is not heard here")
        if not self.rivals:
            logger.warning(
                "the message rates are lowered again and again by %s (MAVProxy: --streamrate=-1): "
                "requesting them less often from now on",
                who,
            )
        self.rivals = who
        self._paused_until_us = now_us + self._pause_us
        self._pause_us = min(2 * self._pause_us, LONGEST_RETRY_US)

    def _requests(self, now_us: int) -> list[Message]:
        waiting = self._waiting
        if waiting is not None:
            if now_us < self._deadline_us:
                return []
            if self._attempts >= ATTEMPTS or self._ignored:
                self._unanswered(waiting, now_us)
        if self._by_groups:
            return self._group_requests(now_us)
        if self._waiting is None:
            if now_us < self._paused_until_us:
                return []
            pending = [
                watch
                for watch in self.watches.values()
                if watch.asked is Asked.NO and watch.due_us <= now_us
            ]
            self._waiting = min(pending, key=lambda watch: watch.due_us, default=None)
            self._attempts = 0
        if self._waiting is None:
            return []
        self._attempts += 1
        self._deadline_us = now_us + ACK_TIMEOUT_US
        self._waiting.changed = True
        return [self._interval(self._waiting, 1e6 / self._waiting.asked_hz, self._attempts - 1)]

    def _answered(self, watch: Watch, now_us: int) -> None:
        watch.asked = Asked.YES
        watch.settle(now_us + SETTLE_US)
        self._waiting = None

    def _unanswered(self, watch: Watch, now_us: int) -> None:
        """No COMMAND_ACK: the rate will tell whether it worked; where it did not, groups may."""
        self._answered(watch, now_us)
        self._ignored = True
        if watch.rate_hz < SHORT_RATIO * watch.asked_hz and watch.stream.label:
            watch.asked = Asked.NO if self._may_group else Asked.YES
            self._try_groups()

    def _try_groups(self) -> None:
        """Intervals have no effect: groups from now on, where they may be used."""
        if not self._may_group and not self._told:
            self._told = True
            logger.warning(
                "SET_MESSAGE_INTERVAL has no effect; streams.data_stream: always uses "
                "REQUEST_DATA_STREAM, which ArduPlane saves to its SRn_ parameters"
            )
        self._by_groups = self._may_group

    def _denied(self, watch: Watch, result: str, now_us: int) -> None:
        """Another rate may be granted: request the next lower one, if there is one."""
        lower_hz = next((rate_hz for rate_hz in DENIED_HZ if rate_hz < watch.asked_hz), 0.0)
        if not lower_hz:
            self._refused(watch, result, now_us)
            return
        name, asked_hz = watch.stream.name, watch.asked_hz
        logger.info("%s: %g Hz %s, requesting %g Hz", name, asked_hz, result, lower_hz)
        watch.asked_hz = watch.ceiling_hz = lower_hz
        self._waiting = None

    def _refused(self, watch: Watch, result: str, now_us: int) -> None:
        watch.result, watch.changed = result, False
        if watch.stream.label:
            logger.warning(
                "the vehicle refuses %s at %g Hz: %s", watch.stream.name, watch.asked_hz, result
            )
        self._answered(watch, now_us)
        watch.asked = Asked.REFUSED

    def _group_requests(self, now_us: int) -> list[Message]:
        """REQUEST_DATA_STREAM for the groups of what falls short, at most every three seconds."""
        self._waiting = None
        if now_us < max(self._grouped_us + GROUP_PAUSE_US, self._paused_until_us):
            return []
        groups = {
            watch.stream.group
            for watch in self.watches.values()
            if watch.asked is not Asked.YES
            and watch.due_us <= now_us
            and watch.rate_hz < SHORT_RATIO * min(watch.asked_hz, watch.ceiling_hz)
        } - {-1}
        found: list[Message] = []
        for group in sorted(groups):
            members = [watch for watch in self.watches.values() if watch.stream.group == group]
            rate_hz = min(GROUP_HZ, max(watch.stream.rate_hz for watch in members))
            self._groups.setdefault(group, max(watch.rate_hz for watch in members))
            for watch in members:
                watch.asked, watch.asked_hz = Asked.YES, min(watch.asked_hz, rate_hz)
                watch.settle(now_us + SETTLE_US)
            logger.info("REQUEST_DATA_STREAM of group %d at %g Hz", group, rate_hz)
            found.append(self._group(group, rate_hz))
        if found:
            self._grouped_us = now_us
        return found

    def _report(self, watch: Watch) -> None:
        """Log a problem once, and its end."""
        problem = watch.problem
        kind = problem.split(":")[0].split(",")[0]
        if kind == watch.reported:
            return
        watch.reported = kind
        if problem:
            logger.warning("%s (%s)", problem, watch.stream.name)
        else:
            logger.info("%s arrives at %.0f Hz", watch.stream.name, watch.rate_hz)

    def _interval(self, watch: Watch, interval_us: float, confirmation: int = 0) -> Message:
        values = (watch.stream.message_id, interval_us, 0, 0, 0, 0, 0)
        return mavlink.MAVLink_command_long_message(
            *self._target, SET_MESSAGE_INTERVAL, confirmation, *values
        )

    def _group(self, group: int, rate_hz: float) -> Message:
        return mavlink.MAVLink_request_data_stream_message(
            *self._target, group, round(rate_hz), int(rate_hz >= 1.0)
        )
