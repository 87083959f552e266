"""Shipped scenes: data, generated MJCF, picture and README each. See `tensegrity_mj.load_scene`."""
