"""A flood of junk from strangers is bounded; who sends MAVLink is always heard."""

from companion.admission import JUNK_BYTES_PER_S, Admission

SECOND_US = 1_000_000


def test_strangers_share_a_budget_and_the_vehicle_is_always_admitted() -> None:
    admission = Admission()
    admission.framed("vehicle", 0)
    admitted = 0
    for tick in range(1000):  # ten seconds of 280 kB/s from ten addresses
        now_us = tick * SECOND_US // 100
        assert admission.admits("vehicle", 300, now_us)
        if tick % 100 == 0:
            admission.framed("vehicle", now_us)
        for address in range(2):
            admitted += 1400 * admission.admits(address, 1400, now_us)
    assert admitted <= 11 * JUNK_BYTES_PER_S
    assert admission.refused_bytes > 2_000_000


def test_a_new_sender_is_heard_and_a_single_sender_has_no_limit() -> None:
    admission = Admission()
    assert admission.admits("new", 300, 0)
    assert all(admission.admits(None, 4096, 0) for _ in range(1000))


def test_what_is_remembered_is_bounded() -> None:
    admission = Admission()
    for address in range(1000):
        admission.framed(address, address)
    assert len(admission._framed_us) <= 64
