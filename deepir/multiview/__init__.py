"""The sensor from frames of different scenes, without registration."""
