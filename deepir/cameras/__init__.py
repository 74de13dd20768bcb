"""Live cameras for `deepir capture`: one driver a file, found by its registered name.

`deepir.cameras.camera` defines the interface of a driver.
"""
