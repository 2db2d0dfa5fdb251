"""docs/messages.md: whole, and as the code has it."""

import re

import numpy as np
import pytest

from companion.estimators import ESTIMATORS
from companion.mavlink.codec import mavlink
from companion.mavlink.debug import state_floats, state_labels
from companion.message_page import page
from companion.samples import rows
from tests.paths import ROOT

NOT_SENT = {"warmup.py", "logs"}
"""where messages are made that are not sent: a made-up vehicle, logs of other formats as MAVLink"""


def test_the_page_is_that_of_the_code() -> None:
    written = (ROOT / "docs" / "messages.md").read_text(encoding="utf-8")
    assert written == page(), "make messages-page"


def test_every_message_that_the_code_makes_is_on_the_page() -> None:
    text = page()
    made: set[str] = set()
    for path in (ROOT / "companion").rglob("*.py"):
        if not NOT_SENT & set(path.relative_to(ROOT / "companion").parts):
            made |= set(re.findall(r"MAVLink_(\w+)_message\(", path.read_text(encoding="utf-8")))
    assert len(made) > 10
    assert [name for name in sorted(made) if f"`{name.upper()}" not in text] == []


def test_altitude_is_told_field_by_field() -> None:
    told = re.findall(r"`ALTITUDE\.(\w+)`", page())
    assert told == mavlink.MAVLink_altitude_message.fieldnames


@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_label_for_every_float_in_its_order(name: str) -> None:
    dtype = ESTIMATORS[name].state
    labels = state_labels(dtype)
    state = rows(dtype)
    sent = len(labels[:57])
    for index, label in enumerate(labels[:57]):
        owner, *rest = re.split(r"\.", label)
        field, *at = re.split(r"\[|\]", rest[-1] if rest else owner)
        record = state
        for part in [owner, *rest][:-1]:
            record = record[part]
        place = tuple(int(each) for each in at[0].split(",")) if at else ()
        np.atleast_1d(record[field])[(0, *place)] = index + 1.0
    assert state_floats(state)[:sent] == [index + 1.0 for index in range(sent)]
