"""The method `joint`: from a configuration and a burst to a problem, and from its solution to a result."""
