"""The study of stability: predicted limits of the step against measured ones."""
