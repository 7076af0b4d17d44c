"""Scenes: which particles there are.

A scene is a rule or arrays; only what the targets need is made. Lattices (`sites` knows all of
them), displaced and graded ones, explicit particles, files. Offsets are never differences of large
coordinates where they need not be. Theory reads descriptions here, never arrays of neighbours.
"""
