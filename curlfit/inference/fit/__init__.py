"""The fit of one throw: its record, its steps, what it says."""
