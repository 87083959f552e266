"""The thesis' model of a structure (chapter 2): coordinates, affine maps, equations of motion. No MuJoCo."""
