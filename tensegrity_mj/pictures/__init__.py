"""How runs are drawn: motion between samples, camera, off-screen OpenGL, geometry, text; used by `video`."""
