"""Many runs at once: the product of listed values, run on Dask, with one table and plots of what came out."""
