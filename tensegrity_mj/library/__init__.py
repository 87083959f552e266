"""Families of scenes: builders with parameters, of which the shipped scenes are members."""
