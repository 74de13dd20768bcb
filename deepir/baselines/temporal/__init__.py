"""Methods that compare the frames pixel by pixel over time, without registration."""
