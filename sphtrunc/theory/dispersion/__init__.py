"""Dispersion: what a small wave of displacements does to particles at rest on a lattice.

`lattice_waves` sums the kernel over a lattice that carries a plane wave, `relation` makes ω² of it
for every momentum equation, `brillouin` knows which waves there are, `modes` says which grow.
"""
