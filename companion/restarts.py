"""Restarts the service after a failure of the code, so that no display freezes.

A ground station that has heard one ALTITUDE shows nothing else (see `companion.mavlink.outputs`),
so the service is made anew on the same link at once, and begins with the vehicle's own height. What
ends the whole process (a signal, no memory) is restarted by systemd or Docker.
"""

import logging
from collections.abc import Callable
from typing import TypeVar

from companion.clock import Clock
from companion.errors import KollsmanError

logger = logging.getLogger("kollsman.service")

SHORTEST_US = 1_000_000
"""a service that fails sooner after its start than this waits for the rest of it"""


Served = TypeVar("Served")


def serve(make: Callable[[], Served], run: Callable[[Served], None], clock: Clock) -> int:
    """Run what `make` makes until it ends; when it fails, make another. The number of failures.

    Raises
    ------
    KollsmanError
        What the user can act on is not a failure of ours.
    """
    failures = 0
    while True:
        start_us = clock.now_us()
        try:
            run(make())
        except KollsmanError:
            raise
        except Exception:
            failures += 1
            logger.exception("the service failed and starts anew (failure %d)", failures)
            clock.sleep_s((SHORTEST_US - (clock.now_us() - start_us)) * 1e-6)
        else:
            return failures
