"""Other methods than `joint`, to compare with. One a file; a new file is found by itself."""
