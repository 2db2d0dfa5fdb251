"""A recorded log as a `SampleLog`, the input of the compiled loops."""

from collections.abc import Callable
from pathlib import Path

from companion.logs import open_log
from companion.mavlink.codec import Message
from companion.observer import Block, Observer
from companion.pipeline import Pipeline
from companion.replay.blocks import BlockRunner
from companion.samples import Kind, Rows, SampleLog, Verdict
from companion.settings import CompanionSettings

BOOT_US = 1 << 50
"""offset added for each boot to the times of truth, so that times of several boots differ"""


class Tap:
    """An observer that keeps every sample as the estimator gets it, with truth and the autopilot's
    own beside."""

    def __init__(self) -> None:
        self.log = SampleLog()
        self._boot_us = 0

    def sample(self, kind: Kind, row: Rows, verdict: Verdict, estimate: Rows) -> None:
        if kind is Kind.STATUS and row[0]["reboot"] == 1:
            self._boot_us += BOOT_US
        self.log.append(kind, row)

    def truth(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        self.log.append_truth((time_us + self._boot_us, altitude_amsl_m, climb_mps))

    def autopilot(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        self.log.append_autopilot((time_us + self._boot_us, altitude_amsl_m, climb_mps))

    def published(self, message: Message) -> None:
        """Not a sample."""

    def block(self, block: Block) -> None:
        self.log.extend(block.tables)
        for heights, extend in (
            (block.truth, self.log.extend_truth),
            (block.autopilot, self.log.extend_autopilot),
        ):
            moved = heights.copy()
            moved["time_us"] += self._boot_us
            extend(moved)


class Sampler(Pipeline):
    """A pipeline without an estimator: it ends with the sample rows."""

    estimates = False

    def __init__(self, settings: CompanionSettings, observer: Observer) -> None:
        super().__init__(settings, datagrams=True, observer=observer, sends=False)


def samples_of(
    path: Path,
    settings: CompanionSettings | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> SampleLog:
    """The samples of a log, with the vehicle clock and plausibility check of live ones. Raises
    `LogFormatError`.

    `on_progress` is called with the fraction read.
    """
    tap = Tap()
    pipeline = Sampler(settings or CompanionSettings(), tap)
    reader = open_log(path)
    runner = BlockRunner(pipeline, lambda time_us, item: pipeline.feed_item(item, time_us))
    for batch in reader.batches():
        runner.run(batch, lambda: tap)
        reader.passed(batch)
        if on_progress is not None:
            on_progress(reader.position_bytes / max(1, reader.size_bytes))
    return tap.log
