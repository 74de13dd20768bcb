"""From a configuration to a problem."""
