"""Flows on frozen particles: the error of a solution, from the truncation error of its operator.

A steady viscous flow is one linear system, or a few, of the matrices of `experiment.matrices`; its
error e solves L e = −τ, τ what the operator leaves of the exact solution. There is no solver here
beside those of scipy.sparse, and a wall is a matrix that continues a field beyond it.
"""
