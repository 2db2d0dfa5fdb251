"""Equations that two or more estimators use: compiled steps that own no state record."""
