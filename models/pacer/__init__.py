"""PACER: physics-based control of pedestrians, learned in many worlds (Rempe et al. 2023, sec 3.2)."""
