"""The state of the vertical bank: its records, and a state in which nothing is known."""

from companion.estimators.judging import reset, state_dtype
from companion.estimators.vertical_bank.aids import AIDS, aids_start
from companion.estimators.vertical_bank.attribution import ATTRIBUTION, attribution_start
from companion.estimators.vertical_bank.barometer import BAROMETER_RECORD, barometer_start
from companion.estimators.vertical_bank.beginning import bank_start
from companion.estimators.vertical_bank.inertial import INERTIAL as INERTIAL_RECORD
from companion.estimators.vertical_bank.inertial import inertial_start
from companion.estimators.vertical_bank.mixture import BANK
from companion.estimators.vertical_bank.redundancy import SPARES, spares_start
from companion.estimators.vertical_bank.reported_accuracy import (
    RECEIVER,
    receiver_restart,
    receiver_start,
)
from companion.estimators.vertical_bank.takeoff import TAKEOFF_RECORD, takeoff_start
from companion.jit import step
from companion.kernels.attitude import ATTITUDE_STATE, attitude_start
from companion.samples import Rows, readable, rows

STATE = state_dtype(
    ("attitude", ATTITUDE_STATE),
    ("imu", INERTIAL_RECORD),
    ("bank", BANK),
    ("named", ATTRIBUTION),
    ("baro", BAROMETER_RECORD),
    ("gnss", RECEIVER),
    ("spares", SPARES),
    ("takeoff", TAKEOFF_RECORD),
    ("aids", AIDS),
)


def init(params: Rows) -> Rows:
    """A fresh state: nothing known."""
    state = readable(rows(STATE))
    start(state, params)
    return state


@step
def start(state: Rows, params: Rows) -> None:
    """Forget everything but the counters."""
    receiver_start(state[0].gnss)
    restart(state, params)


@step
def restart(state: Rows, params: Rows) -> None:
    """Forget everything but the counters and what the receiver has shown of itself."""
    s, p = state[0], params[0]
    reset(state)
    attitude_start(s.attitude)
    inertial_start(s.imu, p)
    bank_start(s.bank, p)
    attribution_start(s.named)
    barometer_start(s.baro, p)
    receiver_restart(s.gnss)
    spares_start(s.spares)
    takeoff_start(s.takeoff)
    aids_start(s.aids)
