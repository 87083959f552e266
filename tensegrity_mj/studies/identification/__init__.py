"""Parameters of a scene from measurements: what these can tell, the fit, and how well it is known."""
