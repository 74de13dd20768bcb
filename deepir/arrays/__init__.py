"""Array helpers that know no problem: statistics, windows, filling."""
