"""The audit of `accuracy=`: experiments that are drawn, their true errors, and the fraction of promises kept."""
