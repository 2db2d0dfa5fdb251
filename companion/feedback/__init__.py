"""Feedback of the weather to the autopilot, off by default: its barometer parameter is moved
slowly, so that the vehicle holds its true altitude.

`Feedback` is a state machine without I/O: what was heard goes in, the next message comes out, or
none and the reason. `companion.feedback.mark` keeps on disk what must survive a crash.
"""

import logging

from companion.feedback.conditions import Hold, Situation
from companion.feedback.machine import Feedback, Phase
from companion.feedback.mark import Mark, MarkFile
from companion.feedback.settings import FeedbackSettings

__all__ = [
    "start_feedback",
    "Feedback",
    "FeedbackSettings",
    "Hold",
    "Mark",
    "MarkFile",
    "Phase",
    "Situation",
]

logger = logging.getLogger("kollsman.feedback")


def start_feedback(settings: FeedbackSettings, link: str) -> Feedback:
    """The feedback of a service on one link, with its mark on disk."""
    file = MarkFile([link])
    if settings.mode == "none":
        mark = file.load()
        if mark is not None:
            logger.warning(
                "an earlier run left %s at %g instead of %g: set feedback.mode to restore it",
                *(mark.parameter, mark.written, mark.original),
            )
        return Feedback(settings)
    return Feedback(settings, keep=file.save, mark=file.load())
