"""`Observer`: what evaluation, CSV output and tests may see of a pipeline."""

from typing import Protocol

from companion.mavlink.codec import Message
from companion.samples import Kind, Rows, Verdict


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
