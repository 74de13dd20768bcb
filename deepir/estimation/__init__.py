"""Hyperparameters from the data: marginal likelihood, variance components, cross-validation."""
