"""How a group of unknowns is moved, a step at a time."""

from deepir.optimisers.adam import Adam
from deepir.optimisers.lbfgs import LBFGS
from deepir.optimisers.optimiser import Optimiser, free_parameters

OPTIMISERS: dict[str, type[Optimiser]] = {"adam": Adam, "lbfgs": LBFGS}

__all__ = ["LBFGS", "OPTIMISERS", "Adam", "Optimiser", "free_parameters"]
