"""Parameters of a scene from measurements: what these determine, the fit, and how well it is known."""
