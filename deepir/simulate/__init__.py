"""A simulated camera: bursts with truth, `y_k = g · (D B M_k x + s) + o + l_k + n_k`.

Symbols as in docs/reference/conventions.md.
"""

from deepir.simulate.burst import Simulation, Truth, simulate
from deepir.simulate.detector import ADC_MAX
from deepir.simulate.optics import render
from deepir.simulate.settings import Settings

__all__ = ["ADC_MAX", "Settings", "Simulation", "Truth", "render", "simulate"]
