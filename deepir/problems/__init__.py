"""Problem definitions: how a problem is started, solved and reported. A new file is found by itself."""
