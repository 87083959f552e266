"""Studies: many runs of one task, saved as they finish and resumable. `many` is the core, `sweep` runs simulations."""
