"""Experiment: what the discrete sums are, on any particles.

Blocks of targets, in any arithmetic, folded in a fixed order, so that no result depends on threads
or on the size of blocks; statistics with confidence intervals; operators as sparse matrices;
`engine/` for pairs of explicit particles. It never sees theory: the two meet in `study`.
"""
