"""Evaluation of altitudes: errors against truth, and residuals where there is no truth."""
