"""Disorder: what displacements of the particles do to an estimate, in mean and spread.

The leading law, averages over displacements of any size, of each particle or of samples of all,
derivatives with respect to every particle, and the damping of lattice sums. The rule: a prediction
says how far it holds.
"""
