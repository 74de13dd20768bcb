"""What `deepir train NAME` trains. One a file; a new file is found by itself."""
