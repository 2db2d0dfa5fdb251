"""docs/messages.md: every message that we send, with units, and the labels of klState.

    python -m companion.message_page > docs/messages.md

A test compares the page with this, and the table with the messages that the code makes.
"""

import sys

from companion.estimators import ESTIMATORS
from companion.mavlink.debug import FLOAT_ARRAY_SIZE, HEALTH_NAME, NAMED, state_labels

ALTITUDE = (
    ("time_usec", "us", "vehicle's boot clock: of the estimate, or of the autopilot's own heights"),
    ("altitude_monotonic", "m", "standard-atmosphere height above the first pressure; never steps"),
    ("altitude_amsl", "m", "altitude above mean sea level: ours, or the autopilot's own"),
    ("altitude_local", "m", "altitude_amsl minus its first value since boot"),
    ("altitude_relative", "m", "height above take-off, or the autopilot's height above home"),
    ("altitude_terrain", "m", "as bottom_clearance"),
    ("bottom_clearance", "m", "range finder, downward, corrected for tilt; else NaN"),
)
DEBUG = (
    (f"NAMED_VALUE_FLOAT {HEALTH_NAME}", "", "health: 0 OK, 1 DEGRADED, 2 LOST"),
    *((f"NAMED_VALUE_FLOAT {name}", row.unit, row.meaning) for name, row in NAMED.items()),
    ("DEBUG 0", "m", "standard deviation of the altitude"),
    ("DEBUG_VECT kollsman", "m, m/s, m", "x altitude, y climb rate, z standard deviation"),
    ("DEBUG_FLOAT_ARRAY klState", "as labelled", "state of the estimator: labels below"),
)
OTHERS = (
    (
        "HEARTBEAT",
        "",
        "1 Hz; onboard controller, component 191; CRITICAL in LOST, BOOT at first",
    ),
    (
        "STATUSTEXT",
        "",
        "health, excluded sensor, streams, and whose height ALTITUDE carries",
    ),
    ("COMMAND_LONG", "us", "SET_MESSAGE_INTERVAL to the vehicle: param1 message, param2 interval"),
    ("REQUEST_DATA_STREAM", "Hz", "where the vehicle refuses the above (`streams.data_stream`)"),
    ("TIMESYNC", "ns", "our requests (every 5 s), and answers to the vehicle's; host's clock"),
    ("COMMAND_ACK", "", "to a command addressed to us; only what is listed below is obeyed"),
    ("PARAM_VALUE", "as named", "our parameters, REAL32, as component 191"),
    ("AUTOPILOT_VERSION", "", "on request: our version; parameters, COMMAND_INT, MAVLink 2"),
    ("MESSAGE_INTERVAL", "us", "on request: interval of a message of ours; 0 not available"),
    ("PARAM_REQUEST_READ", "", "to the vehicle; only with `feedback.mode`"),
    (
        "PARAM_SET",
        "m, hPa",
        "to the vehicle: correction of its barometer; only with `feedback.mode`",
    ),
)
ENDING = """
**Commands to us** (component 191): REQUEST_MESSAGE for AUTOPILOT_VERSION, MESSAGE_INTERVAL,
HEARTBEAT, ALTITUDE and the DEBUG family (DENIED where the last one is older than two seconds),
REQUEST_AUTOPILOT_CAPABILITIES, GET_MESSAGE_INTERVAL, and PREFLIGHT_STORAGE (1 keeps QNH, air
temperature and field elevation for the next start, 2 forgets them). Every other command is answered
with UNSUPPORTED. PROTOCOL_VERSION is no longer a part of MAVLink's message set; AUTOPILOT_VERSION
tells that we speak MAVLink 2.

**PX4 republishes the DEBUG family**: it takes DEBUG, DEBUG_VECT, NAMED_VALUE_FLOAT and
DEBUG_FLOAT_ARRAY that arrive on any of its links, logs them, and may send them on with its own
system and component id where such a stream is on. So a ground station may show our values as
PX4's; `publish.debug: false` ends that.

## Labels of DEBUG_FLOAT_ARRAY klState

Index: field of the estimator's state record. The unit is the suffix of the name (`_m`, `_mps`,
`_m2` ...); `[]` are the elements of an array. A record that is longer than the message is cut.
Element 57 is the protection level (m), NaN where the estimator has none.
"""


def page() -> str:
    """The page in Markdown."""
    altitude = [(f"ALTITUDE.{name}", unit, text) for name, unit, text in ALTITUDE]
    lines = ["# Messages that Kollsman sends", "", "Made by `make messages-page`; a test compares."]
    lines += ["", "| message | unit | meaning |", "|---|---|---|"]
    lines += [
        f"| `{name}` | {unit} | {text} |" for name, unit, text in (*altitude, *DEBUG, *OTHERS)
    ]
    return "\n".join(lines) + "\n" + ENDING + "".join(_labels(name) for name in ESTIMATORS)


def _labels(estimator: str) -> str:
    """The labels of one estimator, with runs of an array's elements as one."""
    labels = state_labels(ESTIMATORS[estimator].state)[: FLOAT_ARRAY_SIZE - 1]
    groups: list[tuple[int, int, str]] = []
    for index, label in enumerate(labels):
        name = label.partition("[")[0]
        if groups and "[" in label and groups[-1][2].partition("[")[0] == name:
            groups[-1] = (groups[-1][0], index, f"{name}[]")
        else:
            groups.append((index, index, label))
    shown = (
        f"{first if first == last else f'{first}-{last}'} `{name}`" for first, last, name in groups
    )
    return f"\n**{estimator}**: {', '.join(shown)}.\n"


if __name__ == "__main__":
    sys.stdout.write(page())
