"""What crosses a process border, and how."""
