"""Small motions of a structure: modes, the largest stable step of an integrator, joints and resistance in them."""
