"""tensegrity_mj: a MuJoCo testbed for tensegrity structures, checked by an independent DAE reference model."""
