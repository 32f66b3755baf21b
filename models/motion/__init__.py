"""Motion capture: clips, importers, retargeting on to any body, and the library that training draws from."""
