"""Classical and learned methods to compare with.

A rival is a function that estimates or corrects; `@rival(NAME, HOW)` of `deepir.baselines.rival` makes it a method. The
registry finds it in any file of this folder.
"""
