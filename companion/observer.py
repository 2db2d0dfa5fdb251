"""`Observer`: what evaluation, CSV output and tests may see of a pipeline."""

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from companion.mavlink.codec import Message
from companion.samples import Kind, Rows, Tables, Verdict


class Observer(Protocol):
    """Sees what happens inside a pipeline. Rows are valid during the call only."""

    def sample(self, kind: Kind, row: Rows, verdict: Verdict, estimate: Rows) -> None:
        """A sample got its verdict; the estimate is as it was left by it."""

    def truth(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        """The simulator's truth."""

    def autopilot(self, time_us: int, altitude_amsl_m: float, climb_mps: float) -> None:
        """The autopilot's own result."""

    def published(self, message: Message) -> None:
        """An ALTITUDE of ours went out."""


class Block(NamedTuple):
    """What happened in a piece of a log; shape (n,) with a value for each sample in order."""

    tables: Tables
    """the samples, in the order of their arrival"""
    verdicts: NDArray[np.int64]
    estimates: Rows
    """ESTIMATE rows: as each sample left them"""
    times_us: NDArray[np.int64]
    """of the samples"""
    instances: NDArray[np.int64]
    now_us: NDArray[np.int64]
    """the vehicle's clock"""
    unix_us: NDArray[np.int64]
    """UNIX time minus boot time as the vehicle said it; far below 0 where it did not"""
    health: NDArray[np.int64]
    """`Health` before what the sample changed of it"""
    truth: Rows
    """HEIGHT rows of a simulator's truth"""
    autopilot: Rows
    """HEIGHT rows of the autopilot's own"""
    published: int
    """number of ALTITUDE of ours"""


@runtime_checkable
class BlockObserver(Observer, Protocol):
    """An observer that takes many samples at once: a log is replayed in compiled loops for it."""

    def block(self, block: Block) -> None:
        """Many samples; equal to the calls of the other methods, one at a time."""
