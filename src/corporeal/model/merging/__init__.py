"""Hand models joined to a body model: the recipe of SMPL+H (section 3.4 of Romero et al. 2017)."""
