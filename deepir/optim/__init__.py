"""Optimisers, and the solve that runs them."""

from deepir.optim.adam import Adam
from deepir.optim.base import Optimiser, free_parameters
from deepir.optim.lbfgs import LBFGS

__all__ = ["LBFGS", "Adam", "Optimiser", "free_parameters"]
