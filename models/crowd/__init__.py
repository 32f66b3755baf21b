"""Crowds: collision avoidance, ways around obstacles, plans."""
