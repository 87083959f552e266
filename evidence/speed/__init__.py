"""Speed as ratios, side by side in one run: `benchmark` is `tensegrity-mj audit speed`, the others are scripts."""
