"""Writing files: results, recordings, tone-mapped pictures."""
