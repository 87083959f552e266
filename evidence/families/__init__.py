"""Families of scenes that the thesis alone has, by the names of their calls: `tower_in_waves(2e4, 0.15)`."""
