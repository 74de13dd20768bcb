"""How noisy the samples are, and the means and medians that say so."""
