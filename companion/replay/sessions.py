"""Log sessions: one vehicle, one boot, one day each.

A log may hold several. The vehicle's clock that restarts ends a session (the same pipeline goes on,
as live), a day between two stamps that the boot clock does not explain ends it too (with a new
pipeline), and each autopilot in the log has sessions of its own. A host clock that is set while the
vehicle's goes on, a stamp of zero, and stamps that step back end nothing.
"""

import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Generic, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from companion.errors import LogFormatError
from companion.logs import LogReader
from companion.logs.files import opened
from companion.mavlink.codec import Frame, FrameReject, Message, decode, mavlink
from companion.mavlink.convert import TimeBase
from companion.mavlink.identity import autopilot_name, is_autopilot
from companion.observer import Block, BlockObserver, Observer
from companion.pipeline import Pipeline
from companion.recorded import Batch, Item, Sensed
from companion.replay.blocks import BlockRunner
from companion.replay.events import LinkQuality
from companion.replay.merged import Merged, Writer
from companion.samples import Kind, Rows, Verdict
from companion.settings import CompanionSettings

DAY_US = 12 * 3_600_000_000
"""a step of the stamps by this much is looked into"""
SAME_BOOT_US = 10_000_000
"""the boot clock may go on by this much across such a step, and the session goes on"""
HELD_ITEMS = 200
"""how many items may lack a boot stamp after such a step"""
MOSTLY = 0.5
"""share of a file that may be junk"""

Seen = TypeVar("Seen", bound=Observer)


@dataclass
class Session(Generic[Seen]):
    """What one session held."""

    seen: Seen
    vehicle: tuple[int, int] | None = None
    autopilot: str = "unknown"
    first_us: int = 0
    """when the first item arrived: UNIX time, or boot time where the log knows no date"""
    last_us: int = 0
    samples: dict[Kind, Counter[Verdict]] = field(default_factory=dict)
    left_out: Counter[str] = field(default_factory=Counter)
    heard: Counter[int] = field(default_factory=Counter)
    """messages of the vehicle by id"""
    health: str = "LOST"
    reason: str = ""
    notes: list[str] = field(default_factory=list)
    """who else spoke, and when the vehicle fell silent"""
    link: LinkQuality = field(default_factory=LinkQuality)
    """frames and lost frames by sender, of logs that hold frames"""
    rebooted: bool = False
    """it began with a restart of the vehicle's clock"""

    @property
    def has_height(self) -> bool:
        """Whether there was a barometer or a GNSS receiver at all."""
        return any(sum(self.samples[kind].values()) for kind in (Kind.PRESSURE, Kind.GNSS))


class _Switch:
    """An observer that hands on to that of the present session, and begins one at a reboot."""

    def __init__(self, on_reboot: Callable[[], None]) -> None:
        self.target: Observer
        self._on_reboot = on_reboot

    def sample(self, kind: Kind, row: Rows, verdict: Verdict, estimate: Rows) -> None:
        if kind is Kind.STATUS and row[0]["reboot"] == 1:
            self._on_reboot()
        self.target.sample(kind, row, verdict, estimate)

    def truth(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        self.target.truth(time_us, altitude_amsl_m, climb_mps)

    def autopilot(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        self.target.autopilot(time_us, altitude_amsl_m, climb_mps)

    def published(self, message: Message) -> None:
        self.target.published(message)

    def block(self, block: Block) -> None:
        cast(BlockObserver, self.target).block(block)


class _Splitter(Generic[Seen]):
    """One pass over a log for one vehicle."""

    def __init__(
        self,
        settings: CompanionSettings,
        observe: Callable[[Pipeline], Seen],
        make: Callable[[CompanionSettings, Observer], Pipeline],
        merged: Merged | None,
    ) -> None:
        self.merged = merged
        self.sessions: list[Session[Seen]] = []
        self.autopilots: dict[int, int] = {}
        """systems with an autopilot's HEARTBEAT, and how many of those"""
        self.runner: BlockRunner | None = None
        """where the log is taken in blocks"""
        self._settings, self._observe, self._make = settings, observe, make
        self._renew()

    def _renew(self) -> None:
        self._switch = _Switch(self._reboot)
        self.pipeline = self._make(self._settings, self._switch)
        self.pipeline.sends &= self.merged is not None
        self._base = _counts(self.pipeline)
        self._begin()

    def _begin(self, *, rebooted: bool = False) -> None:
        self._open = Session(self._observe(self.pipeline), rebooted=rebooted)
        self._switch.target = self._open.seen

    def _reboot(self) -> None:
        self.close()
        self._begin(rebooted=True)

    def close(self) -> None:
        """End the present session, and keep it if there was anything in it."""
        if self.runner is not None:
            self.runner.flush()
        session, pipeline = self._open, self.pipeline
        now, base = _counts(pipeline), self._base
        self._base = now
        session.vehicle = pipeline.identity.vehicle
        session.autopilot = autopilot_name(pipeline.identity.autopilot)
        session.samples = {kind: now.samples[kind] - base.samples[kind] for kind in Kind}
        session.left_out = now.left_out - base.left_out
        session.heard = now.heard - base.heard
        session.notes = [*pipeline.identity.notes[base.notes :], *pipeline.intake.notes]
        session.health, session.reason = pipeline.health.health.name, pipeline.health.reason
        if session.has_height:
            self.sessions.append(session)

    def feed(self, time_us: int, item: Item) -> None:
        """Take in an item of the present session, and write it with what is sent because of it."""
        if not self._open.first_us:
            self._open.first_us = time_us
        self._open.last_us = time_us
        if isinstance(item, Frame):
            self._open.link.take(time_us, item)
        sent = self.take(time_us, item)
        if self.merged is not None:
            self.merged.item(self.pipeline, time_us, item, sent)

    def take(self, time_us: int, item: Item) -> list[bytes]:
        """As `feed`, for an item that `passed` is told of."""
        if isinstance(item, Frame) and item.message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            message = item.message or decode(item)
            if message is not None and is_autopilot(message):
                self.autopilots[item.system_id] = self.autopilots.get(item.system_id, 0) + 1
        return self.pipeline.feed_item(item, time_us)

    def passed(self, batch: Batch) -> None:
        """A part of a batch was taken in the present session."""
        if not self._open.first_us:
            self._open.first_us = int(batch.times_us[np.argmax(batch.times_us != 0)])
        self._open.last_us = int(batch.times_us[-1])
        self._open.link.take_block(batch)

    @property
    def takes_blocks(self) -> bool:
        """Whether the pipeline and the observer of the present session take blocks."""
        return self.pipeline.in_blocks and isinstance(self._open.seen, BlockObserver)

    def block_observer(self) -> BlockObserver:
        """The observer of the present session."""
        return cast(BlockObserver, self._open.seen)

    def renew(self) -> None:
        """Another day: nothing of the session before is of use."""
        self.close()
        self._renew()

    def goes_on(self, boot_us: int | None) -> bool:
        """Whether the vehicle's clock explains a step of the stamps: it went on as if nothing
        was."""
        now_us = self.pipeline.now_us
        return boot_us is None or now_us < 0 or abs(boot_us - now_us) <= SAME_BOOT_US


@dataclass
class _Counts:
    samples: dict[Kind, Counter[Verdict]]
    left_out: Counter[str]
    heard: Counter[int]
    notes: int


def _counts(pipeline: Pipeline) -> _Counts:
    samples = {
        kind: Counter(dict(zip(Verdict, pipeline.verdicts[kind], strict=True))) for kind in Kind
    }
    left_out = Counter({str(cause): n for cause, n in pipeline.intake.counters.items()})
    notes = len(pipeline.identity.notes)
    return _Counts(samples, left_out, Counter(pipeline.heard), notes)


def sessions_of(
    reader: LogReader,
    settings: CompanionSettings,
    observe: Callable[[Pipeline], Seen],
    make: Callable[[CompanionSettings, Observer], Pipeline],
    *,
    writer: Writer | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> list[Session[Seen]]:
    """Every session of a log, the vehicle latched first before the others.

    Parameters
    ----------
    observe : makes the observer of a new session.
    make : makes the pipeline, as for `Pipeline(settings, datagrams=True, observer=...)`.
    writer : gets the log's frames and ours, of the vehicle latched first.
    on_progress : called with the share of the file that is read.

    Raises `LogFormatError` when the file is mostly junk, or holds neither barometer nor GNSS.
    """
    merged = Merged(writer) if writer is not None else None
    first = _pass(reader, settings, observe, make, merged, on_progress)
    refuse_junk(reader)
    found = list(first.sessions)
    latched = first.pipeline.identity.vehicle
    if settings.vehicle.system_id is None:
        known = {latched[0] if latched else 0, 0, settings.air.reference_system_id}
        for system_id in sorted(set(first.autopilots) - known):
            vehicle = settings.vehicle.model_copy(update={"system_id": system_id})
            other = settings.model_copy(update={"vehicle": vehicle})
            found += _pass(reader, other, observe, make, None, None).sessions
    found = [each for each in found if each.vehicle is not None] or found
    if not found:
        told = "; ".join(first.pipeline.identity.notes) or "no vehicle is heard"
        if latched:
            told = f"vehicle {latched[0]}/{latched[1]} sends none"
        raise LogFormatError(
            f"{reader.path}: nothing usable in it: no barometer and no GNSS height; {told}"
        )
    return found


def _pass(
    reader: LogReader,
    settings: CompanionSettings,
    observe: Callable[[Pipeline], Seen],
    make: Callable[[CompanionSettings, Observer], Pipeline],
    merged: Merged | None,
    on_progress: Callable[[float], None] | None,
) -> _Splitter[Seen]:
    splitter = _Splitter(settings, observe, make, merged)
    if splitter.takes_blocks and (merged is None or merged.takes_blocks):
        _pass_blocks(reader, splitter, on_progress)
        return splitter
    items = reader.items(splitter.pipeline.wanted)
    days = _Days(splitter)
    for count, (time_us, item) in enumerate(itertools.chain(days.take(items), days.rest())):
        splitter.feed(time_us, item)
        if on_progress is not None and count % 2000 == 0:
            on_progress(reader.position_bytes / max(1, reader.size_bytes))
    splitter.close()
    return splitter


def _pass_blocks(
    reader: LogReader, splitter: _Splitter[Seen], on_progress: Callable[[float], None] | None
) -> None:
    """As `_pass`, in blocks; a block with a step of a day is taken one item at a time."""
    days = _Days(splitter)
    for batch in reader.batches():
        pipeline, runner = splitter.pipeline, splitter.runner
        if runner is None or runner.pipeline is not pipeline:
            runner = BlockRunner(pipeline, splitter.take, splitter.passed, splitter.merged)
            splitter.runner = runner
        if days.steps(batch.times_us):
            for time_us, item in days.take(reader.items_of(batch, pipeline.wanted)):
                splitter.feed(time_us, item)
        elif batch.size:
            runner.run(batch, splitter.block_observer)
            reader.passed(batch)
        if on_progress is not None:
            on_progress(reader.position_bytes / max(1, reader.size_bytes))
    for time_us, item in days.rest():
        splitter.feed(time_us, item)
    splitter.close()


class _Days(Generic[Seen]):
    """Where a day lies between two items, the splitter begins anew."""

    def __init__(self, splitter: _Splitter[Seen]) -> None:
        self._splitter = splitter
        self._held: list[tuple[int, Item]] = []
        self._last_us: int | None = None

    def steps(self, times_us: NDArray[np.int64]) -> bool:
        """Whether there may be a day within these times; if not they are taken note of."""
        if not times_us.size:
            return False
        before_us = int(times_us[0]) if self._last_us is None else self._last_us
        if self._held or np.abs(np.diff(times_us, prepend=before_us)).max() > DAY_US:
            return True
        self._last_us = int(times_us[-1])
        return False

    def take(self, items: Iterable[tuple[int, Item]]) -> Iterator[tuple[int, Item]]:
        """The items, each when it is clear to which session it belongs."""
        for time_us, item in items:
            last_us, self._last_us = self._last_us, time_us
            if self._held or (last_us is not None and abs(time_us - last_us) > DAY_US):
                self._held.append((time_us, item))
                boot_us = _boot_us(item)
                if boot_us is None and len(self._held) < HELD_ITEMS:
                    continue
                if not self._splitter.goes_on(boot_us):
                    self._splitter.renew()
                yield from self.rest()
            else:
                yield time_us, item

    def rest(self) -> Iterator[tuple[int, Item]]:
        """The items that are still held back, when it is asked for them."""
        held, self._held = self._held, []
        yield from held


def _boot_us(item: Item) -> int | None:
    """The boot stamp in an item, where it has one."""
    if isinstance(item, Sensed):
        return item.reading.stamp_us if item.reading.base is TimeBase.BOOT else None
    stamp_ms = getattr(item.message, "time_boot_ms", None) if isinstance(item, Frame) else None
    return stamp_ms * 1000 if stamp_ms else None


def refuse_junk(reader: LogReader) -> None:
    """Raise `LogFormatError` when most of a file belongs to no message; zeros do not count."""
    path, junk = reader.path, reader.counters[FrameReject.JUNK]
    if junk <= MOSTLY * reader.size_bytes:
        return
    zeros = 0
    with opened(path) as file:
        while chunk := file.read(1 << 20):
            zeros += len(chunk) - int(np.count_nonzero(np.frombuffer(chunk, np.uint8)))
    if junk - zeros > MOSTLY * max(1, reader.size_bytes - zeros):
        raise LogFormatError(
            f"{path}: mostly junk: only {reader.frames} frames could be read, {junk} of "
            f"{reader.size_bytes} bytes belong to none"
        )
