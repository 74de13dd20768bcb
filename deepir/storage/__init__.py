"""Runs on disk: folders, checkpoints, and how a run goes on."""
