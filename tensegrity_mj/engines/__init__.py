"""Engines: independent formulations of the same scene, each with frozen options and one `run`."""
