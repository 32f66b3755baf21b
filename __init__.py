"""footfall: physically simulated, controllable pedestrians on a ROS-free message bus."""
