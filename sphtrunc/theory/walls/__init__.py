"""Walls: the truncation error of a support that a plane cuts, exactly.

A wall is one more knot of Euler and Maclaurin's sum. `half_space` is what a kernel has on one side
of a plane, `gamma` that of other shapes, `moments` the estimates there, `orders` what the wall's
place in the lattice does to them, `remedies` what each usual answer to a wall leaves.
"""
