"""Errors of the environment, each with a message that says what to do.

::

    KollsmanError
     ├─ ConfigError      a configuration file cannot be used     (wrong key, type, range; no file)
     ├─ LinkError        a link cannot be opened or used         (bad URL, no port, address in use)
     ├─ LogFormatError   a file is not a log of its format       (not a tlog, unreadable, empty)
     └─ SimulationError  the simulated flight left reality       (non-finite state, below ground)

Bad *data* (corrupt frames, absurd values, clock jumps) never raises: it is counted by reason, or
becomes a `Verdict`. The command line catches `KollsmanError` once, prints one line and exits with
1.
"""


class KollsmanError(Exception):
    """Base of every error that a user can do something about."""


class ConfigError(KollsmanError, ValueError):
    """A configuration value, key or file cannot be used."""


class LinkError(KollsmanError, OSError):
    """A link cannot be opened: the URL is wrong, the port is missing or taken."""


class LogFormatError(KollsmanError, ValueError):
    """A file is not of the log format that its name or content suggests, or holds no log."""


class SimulationError(KollsmanError):
    """The simulated flight is no longer physical, or its scenario cannot be flown."""
