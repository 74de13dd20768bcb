"""What frames hold: unusable samples, ends of the range, telemetry rows, noise and motion."""
