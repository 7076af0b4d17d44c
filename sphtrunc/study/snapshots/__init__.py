"""Snapshots: what is in a file of particles, which kernel made it, and where its sums are wrong."""
