"""Optimisers, and the solve that runs them."""

from deepir.optim.adam import Adam
from deepir.optim.base import Optimiser, free_parameters
from deepir.optim.lbfgs import LBFGS

OPTIMISERS: dict[str, type[Optimiser]] = {"adam": Adam, "lbfgs": LBFGS}

__all__ = ["LBFGS", "OPTIMISERS", "Adam", "Optimiser", "free_parameters"]
