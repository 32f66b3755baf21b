"""Start the processes of a scene from a launch file."""
