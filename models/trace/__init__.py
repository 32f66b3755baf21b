"""TRACE: the guided trajectory-diffusion planner."""
