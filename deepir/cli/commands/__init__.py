"""The sub-commands of `deepir`, one a module."""
