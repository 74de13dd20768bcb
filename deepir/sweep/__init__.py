"""Sweeps: the product of listed values, run on Dask, with a table and plots of the results."""
