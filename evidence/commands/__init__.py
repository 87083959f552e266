"""The commands `audit` and `reproduce`, which tensegrity-mj finds by their entry points."""
