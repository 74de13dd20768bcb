"""How the objective curves: where L-BFGS starts from, and how sure what it finds is."""
