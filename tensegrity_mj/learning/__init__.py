"""Learning: `tasks` for robots, and the environments of `gymnasium` and `dm_control` that play them."""
