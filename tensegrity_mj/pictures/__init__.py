"""How runs are drawn: motion between samples, camera, off-screen OpenGL, geometry, text. `tensegrity_mj.render` uses it."""
