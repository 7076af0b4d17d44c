"""Theory: what the error must be, exactly.

Continuous limits, Euler–Maclaurin terms at every knot in 1D, lattice sums and their reciprocal
explanation in 2D and 3D, orders read off exact coefficients, and `disorder/` for displaced
particles. It never sees an experiment. The rule: an order is never decided by a tolerance.
"""
