"""Towers in waves: how far they bend, over their own parameters and those of the sea."""
