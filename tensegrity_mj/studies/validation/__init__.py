"""The controller's report: a law under test in every engine, under everything that may be off. See docs/validate.md."""
