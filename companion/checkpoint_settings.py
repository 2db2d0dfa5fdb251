"""Section ``checkpoint`` of the configuration."""

from pydantic import Field

from companion.config import Settings


class CheckpointSettings(Settings):
    """Section ``checkpoint``."""

    period_s: float = Field(2.0, ge=0, le=600)
    """time in seconds between checkpoints of the state; 0 writes none"""
    fresh_s: float = Field(30.0, ge=0, le=600)
    """largest age in seconds at which a checkpoint is continued after a restart of the process"""
