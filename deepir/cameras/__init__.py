"""Live cameras for `deepir capture`: one driver a file, found by its short name. `deepir.cameras.camera` says what a
driver is."""
