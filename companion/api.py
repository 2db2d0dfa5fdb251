"""Kollsman as a library: read a log, run an estimator, get arrays.

::

    import companion

    for flight in companion.read_log("flight.BIN"):
        found = companion.run_estimator(flight, "vertical-bank")
        print(flight.vehicle, found.time_us, found.altitude_m, found.sd_m)

Everything is in SI units; unknown is NaN. Names that are not imported here may change.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.errors import ConfigError
from companion.estimators import DEFAULT_ESTIMATOR, ESTIMATORS, run_log
from companion.evaluation.samples import Sampler, Tap
from companion.logs import open_log
from companion.replay.sessions import sessions_of
from companion.samples import Kind, Rows, SampleLog
from companion.settings import CompanionSettings, load_settings

__all__ = ["Estimated", "LogFlight", "estimator_names", "read_log", "run_estimator"]


@dataclass(frozen=True)
class LogFlight:
    """One session of a log: one vehicle, one boot."""

    vehicle: tuple[int, int] | None
    """MAVLink system and component id"""
    autopilot: str
    first_us: int
    """when the first message arrived: UNIX time, or boot time where the log knows no date"""
    samples: SampleLog
    """what an estimator gets, in order of arrival; ``samples[Kind.GNSS]`` is a structured array"""

    def table(self, kind: Kind) -> Rows:
        """The samples of a kind, shape (n,), with the fields of
        ``companion.samples.DTYPES[kind]``."""
        return self.samples[kind]

    @property
    def truth(self) -> Rows:
        """A simulator's truth: ``time_us, altitude_amsl_m, climb_mps``; empty without one."""
        return self.samples.truth

    @property
    def autopilot_altitude(self) -> Rows:
        """The autopilot's own altitude, with the fields of `truth`."""
        return self.samples.autopilot


@dataclass(frozen=True)
class Estimated:
    """What an estimator says after each barometer sample (each fix, without a barometer); shape
    (n,)."""

    estimator: str
    rows: Rows
    """all fields of ``companion.samples.ESTIMATE``"""
    arrival_us: NDArray[np.int64]
    verdicts: NDArray[np.int64]
    """`companion.samples.Verdict` of those samples"""

    @property
    def time_us(self) -> NDArray[np.int64]:
        """Of the vehicle's boot clock."""
        return np.asarray(self.rows["time_us"], np.int64)

    @property
    def altitude_m(self) -> NDArray[np.float64]:
        """Above mean sea level."""
        return np.asarray(self.rows["altitude_amsl_m"], np.float64)

    @property
    def climb_mps(self) -> NDArray[np.float64]:
        return np.asarray(self.rows["climb_mps"], np.float64)

    @property
    def sd_m(self) -> NDArray[np.float64]:
        """Standard deviation of `altitude_m`, as the estimator reports it."""
        return np.asarray(self.rows["altitude_sd_m"], np.float64)


def estimator_names() -> tuple[str, ...]:
    """The estimators, those of other packages included (entry points ``kollsman.estimators``)."""
    return tuple(ESTIMATORS)


def read_log(
    path: str | Path, settings: CompanionSettings | str | Path | None = None
) -> list[LogFlight]:
    """The sessions of a log of any format that `kollsman replay` reads.

    Parameters
    ----------
    settings : a configuration, or the path of a companion.yaml; default: the defaults.

    Raises
    ------
    LogFormatError
        The file cannot be read, is mostly junk, or has neither a barometer nor a GNSS height.
    """
    found = sessions_of(open_log(path), _settings(settings), lambda _: Tap(), Sampler)
    return [LogFlight(each.vehicle, each.autopilot, each.first_us, each.seen.log) for each in found]


def run_estimator(
    flight: LogFlight | SampleLog,
    estimator: str = DEFAULT_ESTIMATOR,
    settings: CompanionSettings | str | Path | None = None,
    **changes: Any,
) -> Estimated:
    """Run an estimator over a session, in its compiled loop.

    Parameters
    ----------
    changes : keys of the estimator's section, such as ``baro_sd_m=0.3``.

    Raises
    ------
    ConfigError
        There is no such estimator, or no such key.
    """
    if estimator not in ESTIMATORS:
        raise ConfigError(
            f"no estimator is called {estimator!r}; there are: {', '.join(ESTIMATORS)}"
        )
    log = flight.samples if isinstance(flight, LogFlight) else flight
    given = [f"estimators.{estimator}.{key}={value}" for key, value in changes.items()]
    section = _settings(settings).with_assignments(given).section(estimator)
    estimates, verdicts, _ = run_log(ESTIMATORS[estimator], log, section)
    order = log.tables.order
    kinds = np.asarray(order["kind"])
    ticks = Kind.PRESSURE if np.any(kinds == Kind.PRESSURE) else Kind.GNSS
    chosen = np.flatnonzero(kinds == ticks)
    arrival_us = np.asarray(log[ticks]["arrival_us"])[np.asarray(order["row"])[chosen]]
    return Estimated(estimator, estimates[chosen], arrival_us, np.asarray(verdicts[chosen]))


def _settings(given: CompanionSettings | str | Path | None) -> CompanionSettings:
    return (
        given
        if isinstance(given, CompanionSettings)
        else load_settings(Path(given) if given else None)
    )
