"""One process a file, named by role."""
