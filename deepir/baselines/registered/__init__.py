"""Methods that estimate scene or sensor from registered frames."""
