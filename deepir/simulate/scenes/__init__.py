"""What the simulated camera looks at: drawn scenes and pictures."""
