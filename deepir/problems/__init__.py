"""Problem definitions: how a problem is started, solved and reported. One a file; a new file is found by itself."""
