"""The live page of `kollsman run --http`, and what programs read beside it.

The estimator's thread puts a snapshot into a slot four times a second (`snapshot`, `board`). A
second thread serves the page, the event stream, ``/api/state``, ``/metrics`` and ``/healthz`` from
it (`server`, `metrics`). The estimator never waits for a reader, and a reader can change nothing.
"""
