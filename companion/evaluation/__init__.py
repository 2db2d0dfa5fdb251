"""How good an altitude is: errors against truth, and spreads where there is none."""
