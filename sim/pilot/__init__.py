"""The simulated pilot: flight profile, guidance and control loops."""
