"""Pictures and films of people, drawn off screen."""
