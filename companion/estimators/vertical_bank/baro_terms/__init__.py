"""What a real barometer's error is made of: one file a term, with its prior, source and ablation
flag. `docs/vertical-bank.md` has the table."""
