"""Seeded random runs at the extremes, each judged: right, refused, stopped, warned of, or wrong without a word."""
