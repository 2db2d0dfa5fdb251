"""Logs after the fact: sessions, what each held, the report, expectations, fleets."""
